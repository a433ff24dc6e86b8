"""What the event pages show, read once."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from sqlalchemy import or_, select
from sqlalchemy.orm import Session

from server.contradictions.queries import contradictions
from server.contradictions.schemas import ContradictionOut
from server.events import queries
from server.events.exports import utc_t0
from server.models import Device, Event, EventAction, EventRevision, Vehicle
from server.pages.frame import MEASURES, Measures
from server.pages.words import KINDS, State
from server.reports.figures import Row, basis_rows, in_unit, number_rows, risk_rows, sentences
from server.reports.words import Language, Words
from server.view3d.instants import instants
from server.wording import marked

SHOWN = 200
NEWS_FOR = dt.timedelta(days=14)
"""How long a crash that nobody has looked at stays in the list of what needs attention."""

ID_LETTERS = 6
"""So much of an id must be typed to search by it: less is the word of a name."""

SEVERITIES: dict[str, State] = {"crash": "alarm", "rollover": "alarm", "parked_impact": "attention"}
REVIEWS = {"confirmed": marked("Confirmed"), "false_alarm": marked("False alarm"), None: marked("Open")}
ACTIONS = {
    "confirmed": marked("Confirmed"),
    "false_alarm": marked("Called a false alarm"),
    "reopened": marked("Opened again"),
    "held": marked("Put under legal hold"),
    "released": marked("Legal hold ended"),
}


@dataclass(frozen=True)
class Line:
    """An event in a list."""

    event: Event
    vehicle: Vehicle | None
    device: Device

    @property
    def url(self) -> str:
        return f"/events/{self.event.id}"

    @property
    def name(self) -> str:
        return self.vehicle.name if self.vehicle else self.device.name

    @property
    def state(self) -> State:
        """Mark of the list: what was called a false alarm alarms nobody."""
        return "unknown" if self.event.verdict == "false_alarm" else SEVERITIES.get(self.event.kind, "unknown")

    @property
    def kind(self) -> str:
        return KINDS[self.event.kind]

    @property
    def review(self) -> str:
        return REVIEWS[self.event.verdict]


@dataclass(frozen=True)
class EventPage:
    """One event with everything beside it."""

    line: Line
    revision: EventRevision
    document: Mapping[str, Any]
    revisions: Sequence[EventRevision]
    actions: Sequence[EventAction]
    words: Words
    """Of the report, in the reader's language."""
    contradictions: Sequence[ContradictionOut]
    per_kmh: float
    """From km/h to the reader's unit, which `words` names."""

    @property
    def event(self) -> Event:
        return self.line.event

    @cached_property
    def told(self) -> dict[str, Any]:
        """The crash JSON of the newest revision, speeds in the reader's unit."""
        return in_unit(self.document["event"], self.per_kmh)

    @property
    def at(self) -> dt.datetime:
        return dt.datetime.fromtimestamp(round(utc_t0(dict(self.document)), 2), dt.UTC)

    @property
    def sentences(self) -> list[str]:
        return sentences({**self.document, "event": self.told}, self.words, self.at)

    @property
    def numbers(self) -> list[Row]:
        return number_rows(self.told, self.words)

    @property
    def risks(self) -> list[tuple[str, str, str, str, str]]:
        return risk_rows(self.told, self.words)

    @property
    def basis(self) -> list[tuple[str, str]]:
        return basis_rows(dict(self.document), self.words)

    @property
    def from_where(self) -> str | None:
        """Direction in words; None where it is not known."""
        clock = self.told["pdof_clock"]
        return None if clock is None else self.words(f"where{clock}")

    @property
    def replayed(self) -> tuple[float, float]:
        """The first and the last instant of the replay, s from time zero."""
        t = instants(self.document)
        return float(t[0]), float(t[-1])

    @property
    def sketch(self) -> dict[str, float | str] | None:
        """Geometry of the sketch: the arrow's angle, and the sector as an SVG path on a circle of 100."""
        pdof, interval = self.told["pdof_deg"], self.told["pdof_interval95_deg"]
        if pdof is None:
            return None
        (x1, y1), (x2, y2) = (_on_circle(end) for end in interval)
        wide = int(interval[1] - interval[0] > 180.0)
        return {"angle": pdof, "sector": f"M0 0L{x1:.2f} {y1:.2f}A100 100 0 {wide} 1 {x2:.2f} {y2:.2f}Z"}


def _on_circle(angle_deg: float) -> tuple[float, float]:
    angle = math.radians(angle_deg)
    return 100.0 * math.sin(angle), -100.0 * math.cos(angle)


def line_of(session: Session, event: Event) -> Line:
    """An event as a list shows it."""
    vehicle = session.get(Vehicle, event.vehicle_id) if event.vehicle_id else None
    return Line(event, vehicle, session.get_one(Device, event.device_id))


def lines(
    session: Session,
    organisation_id: str,
    *,
    severe: bool | None = None,
    device_id: str | None = None,
    vehicle_id: str | None = None,
    since: dt.datetime | None = None,
    limit: int = SHOWN,
) -> list[Line]:
    """Events with their vehicles, the newest first."""
    wanted = queries.selection(
        organisation_id, severe=severe, device_id=device_id, vehicle_id=vehicle_id, since=since, limit=limit
    )
    query = (
        wanted.add_columns(Vehicle, Device)
        .join(Device, Device.id == Event.device_id)
        .outerjoin(Vehicle, Vehicle.id == Event.vehicle_id)
    )
    return [Line(event, vehicle, device) for event, vehicle, device in session.execute(query)]


def search(session: Session, organisation_id: str, text: str, *, limit: int = 20) -> list[Line]:
    """Events by the beginning of their id, and by what was written of them: a note, the reason of a hold (a claim)."""
    found = [column.icontains(text, autoescape=True) for column in (Event.note, Event.hold_reason)]
    if len(text) >= ID_LETTERS and set(text.lower()) <= set("0123456789abcdef"):
        found.append(Event.id.startswith(text.lower()))
    query = (
        select(Event, Vehicle, Device)
        .join(Device, Device.id == Event.device_id)
        .outerjoin(Vehicle, Vehicle.id == Event.vehicle_id)
        .where(Event.organisation_id == organisation_id, *queries.LISTED, or_(*found))
        .order_by(Event.at.desc(), Event.id)
        .limit(limit)
    )
    return [Line(event, vehicle, device) for event, vehicle, device in session.execute(query)]


def unreviewed(session: Session, organisation_id: str, *, now: dt.datetime) -> list[Line]:
    """Severe events of late that nobody has looked at."""
    found = lines(session, organisation_id, severe=True, since=now - NEWS_FOR)
    return [line for line in found if line.event.verdict is None]


def event_page(
    session: Session, organisation_id: str, event_id: str, language: Language = "en", measures: Measures | None = None
) -> EventPage:
    """One event, in a language and in the units of its reader."""
    measures = measures or MEASURES["metric"]
    event = queries.event_of(session, organisation_id, event_id)
    revision = queries.revision_of(session, event)
    return EventPage(
        line_of(session, event),
        revision,
        queries.document(revision),
        queries.revisions(session, event.id),
        queries.actions(session, event.id),
        Words(language, measures.speed),
        contradictions(session, event),
        measures.per_mps / 3.6,
    )
