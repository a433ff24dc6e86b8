"""How the numbers of the pages are computed: in words, with the equations' names."""

from __future__ import annotations

from dataclasses import dataclass

from fastapi import APIRouter, Request
from starlette.responses import HTMLResponse

from server.accounts.access import Reader
from server.edge import DatabaseOf
from server.pages import queries
from server.pages.routes import answer
from server.wording import marked

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)


@dataclass(frozen=True)
class Entry:
    """A number, and how it comes about."""

    key: str
    """Pages link here by it."""
    title: str
    words: str
    equations: str
    """As docs/equations.md numbers them, and the source where it is a published one."""


ENTRIES = (
    Entry(
        "mounting",
        marked("How the box sits"),
        marked(
            "The measured force is integrated from fix to fix and compared with speed, course and height of the "
            "receiver. The turn of the box that explains all drives best is the mounting: θ about y, φ about z, ψ "
            "about x."
        ),
        "2a.1-2a.5, 2a.7",
    ),
    Entry(
        "sigma",
        marked("How well that is known"),
        marked(
            "1-sigma about each axis of the vehicle, from what all drives say together, widened where they disagree"
            " with each other or with the model. The cone holds the axis of the box with 95 % probability."
        ),
        "2a.6",
    ),
    Entry(
        "time-zero",
        marked("Time zero of an event"),
        marked(
            "The beginning of the first 20 ms in which the velocity changes by more than 0.8 km/h, where it changes"
            " by 8 km/h or more within 150 ms."
        ),
        "CR1; 49 CFR 563.5",
    ),
    Entry(
        "delta-v",
        marked("Change of velocity"),
        marked(
            "The measured force, freed of gravity, is turned into the vehicle's axes at time zero and integrated "
            "until 30 ms after the end of the event. The number is its largest resultant, with both components at "
            "that moment."
        ),
        "CR2, CR3",
    ),
    Entry(
        "clipped",
        marked("Samples at full scale"),
        marked(
            "What the sensor could not measure is estimated from the shape of the rest of the pulse and from the "
            "velocity by GPS before and after. The interval is as wide as that leaves it open."
        ),
        "CR4-CR8",
    ),
    Entry(
        "pdof",
        marked("Direction of force"),
        marked(
            "Where the force came from, in degrees clockwise from straight ahead: 0 from ahead, 90 from the right. "
            "It is opposite to the change of velocity. The mounting's uncertainty about the vertical is in its "
            "interval."
        ),
        "CR3",
    ),
    Entry(
        "speed",
        marked("Speed before impact"),
        marked(
            "Speed over ground at time zero, from the receiver and the accelerometer together: the receiver's delay"
            " is taken out, and braking since its last fix is not lost."
        ),
        "CR8; 7",
    ),
    Entry(
        "peak",
        marked("Peak acceleration"),
        marked(
            "The largest acceleration free of gravity, after the filter that the table names. Where samples stood "
            "at full scale it was at least that."
        ),
        "CR9; SAE J211-1",
    ),
    Entry(
        "indices",
        marked("Severity indices"),
        marked(
            "ASI and THIV with PHD after EN 1317-1, OLC after Euro NCAP TB 027. They are not given for a pulse that"
            " is clipped or incomplete."
        ),
        "CR10-CR12",
    ),
    Entry(
        "risk",
        marked("Risk of injury"),
        marked(
            "Published curves of the probability over the change of velocity. Their interval is that of the change "
            "of velocity alone; none of them tells what happened to a person."
        ),
        "CR13",
    ),
    Entry(
        "interval",
        marked("95 % intervals"),
        marked(
            "An interval holds the truth with 95 % probability. How often it does was counted on simulated crashes "
            "and on published crash tests; the counts stand in docs/validation.md."
        ),
        "docs/validation.md",
    ),
    Entry(
        "distance",
        marked("Distance and driving"),
        marked(
            "Distance is speed integrated over time, and the way between positions where speed is missing. A trip "
            "ends after four minutes without movement."
        ),
        "trips/1",
    ),
    Entry(
        "score",
        marked("Driving style"),
        marked(
            "Harsh braking, acceleration and cornering are counted and set against the distance: none is 100, and "
            "every five more on 100 km halve the score. The interval is what chance does to a count (Poisson)."
        ),
        "score = 100 · 2^(−n/5)",
    ),
)


@router.get("/how")
def how(request: Request, caller: Reader, database: DatabaseOf) -> HTMLResponse:
    """What the links beside the numbers lead to."""
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
    return answer(request, "how.html", caller, "how", change, {"entries": ENTRIES})
