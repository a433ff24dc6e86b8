"""How good a box's data are, and how its estimate got sharper: from stored figures to what a page shows."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from server.models import MountingRevision
from server.pages.words import State, largest_sigma
from server.wording import marked


@dataclass(frozen=True)
class Figure:
    """One figure of the data's health, with a mark that says whether to worry."""

    name: str
    value: float | str
    unit: str
    digits: int
    state: State
    note: str = ""


REMARKS = {
    "utc_from_arrival": marked("The box has no time from satellites; its data are dated by their arrival."),
    "rows_out_of_order": marked("Some rows came out of order and were sorted."),
    "rows_repeated": marked("Some rows repeated an instant and were dropped."),
    "inertial_rows_repeated": marked("Some inertial rows repeated an instant and were dropped."),
    "gnss_rows_repeated": marked("Some GPS rows repeated an instant and were dropped."),
}


def _good_if(holds: bool, otherwise: State = "attention") -> State:
    return "good" if holds else otherwise


_FIGURES: tuple[tuple[str, str, float, str, int, Callable[[float], State], str], ...] = (
    # key, name, factor, unit, digits, state of the value, what it means
    ("rate_hz", marked("Samples"), 1.0, "Hz", 0, lambda v: _good_if(v >= 20.0), ""),
    ("jitter_s", marked("Scatter of the sampling"), 1e3, "ms", 2, lambda v: _good_if(v < 5.0), ""),
    ("gaps", marked("Gaps in the last upload"), 1.0, "", 0, lambda v: _good_if(v == 0.0), ""),
    ("gap_s", marked("Missing in the last upload"), 1.0, "s", 1, lambda v: _good_if(v < 1.0), ""),
    ("gnss_rate_hz", marked("GPS fixes"), 1.0, "Hz", 1, lambda v: _good_if(v >= 0.9), ""),
    ("fix_share", marked("Fixes that are usable"), 100.0, "%", 0, lambda v: _good_if(v >= 80.0), ""),
    ("hdop", marked("GPS dilution (HDOP)"), 1.0, "", 1, lambda v: _good_if(v <= 3.0), ""),
    ("sats", marked("Satellites"), 1.0, "", 0, lambda v: _good_if(v >= 5.0), ""),
    ("utc_sigma_s", marked("Clock against UTC, 1-sigma"), 1e3, "ms", 0, lambda v: _good_if(v < 100.0), ""),
    ("temp_c", marked("Temperature"), 1.0, "°C", 0, lambda v: _good_if(-20.0 <= v <= 70.0), ""),
    ("battery_v", marked("Battery"), 1.0, "V", 1, lambda v: _good_if(v >= 3.4), ""),
    (
        "unreadable_batches",
        marked("Uploads that could not be read"),
        1.0,
        "",
        0,
        lambda v: _good_if(v == 0.0, "alarm"),
        "",
    ),
)
NOT_RECORDED = marked("not recorded")


def figures(health: Mapping[str, Any]) -> list[Figure]:
    """Rate, gaps, clock, GPS, temperature, battery; nothing before the first data."""
    if not health:
        return []
    found: list[Figure] = []
    for key, name, factor, unit, digits, state, note in _FIGURES:
        value: float | None = health.get(key)
        if value is None:
            found.append(Figure(name, NOT_RECORDED, "", 0, "unknown"))
        else:
            found.append(Figure(name, value * factor, unit, digits, state(value * factor), note))
    return found


def remark_sentences(health: Mapping[str, Any]) -> list[str]:
    """What was found odd in the newest upload; a remark that has no sentence here is told by its code."""
    codes: Sequence[str] = health.get("remarks", ())
    return [REMARKS.get(code, code) for code in codes]


WIDTH, HEIGHT = 480.0, 150.0
_FLOOR_DEG, _TOP_DEG = 0.1, 90.0


@dataclass(frozen=True)
class Course:
    """The largest 1-sigma over time as a line in a box of `WIDTH` by `HEIGHT`, degrees on a logarithmic scale."""

    line: str
    grid: Sequence[tuple[float, str]]
    """Height and degrees of each line across."""
    began_at: dt.datetime
    ended_at: dt.datetime
    first_deg: float
    last_deg: float


def course_of(revisions: Sequence[MountingRevision]) -> Course | None:
    """Of one installation's estimates in the order of their data; None where fewer than two knew the mounting."""
    known = [(row.data_at, sigma) for row in revisions if (sigma := largest_sigma(row.result)) is not None]
    if len(known) < 2:
        return None
    begin, end = known[0][0], known[-1][0]
    span = max((end - begin).total_seconds(), 1e-9)

    def height(sigma: float) -> float:
        share = math.log(min(max(sigma, _FLOOR_DEG), _TOP_DEG) / _FLOOR_DEG) / math.log(_TOP_DEG / _FLOOR_DEG)
        return round(HEIGHT * (1.0 - share), 1)

    points = [f"{round(WIDTH * (at - begin).total_seconds() / span, 1)},{height(sigma)}" for at, sigma in known]
    grid = [(height(degrees), f"{degrees:g}°") for degrees in (0.1, 1.0, 10.0)]
    return Course(" ".join(points), grid, begin, end, known[0][1], known[-1][1])
