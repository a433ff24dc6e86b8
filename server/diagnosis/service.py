"""Values of the vehicle beside the streams: battery, temperatures, whatever a box reads on the vehicle's bus.

Kept once a minute at most, and only where the value changed or an hour went by: an engine's temperature
is worth a curve, not a thousand equal rows.
"""

from __future__ import annotations

import datetime as dt
from bisect import bisect_right
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Insert
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.orm import Session

from server.diagnosis.queries import around
from server.models import Diagnosis

AGAIN = dt.timedelta(hours=1)
"""A value that stays the same is kept again after this long, so that a curve shows it was still read."""
RESOLUTION = {"battery_v": 0.05, "temperature_c": 0.5}
"""Smaller changes are noise; of a name that is not here every change counts."""
MAX_AHEAD = dt.timedelta(days=1)

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Reading:
    """A value and when it was read."""

    name: str
    at: dt.datetime
    value: float


def per_minute(name: str, unix_s: Floats, values: Floats) -> list[Reading]:
    """The first value of each minute; what is not a number was not read."""
    known = np.isfinite(values) & np.isfinite(unix_s)
    unix_s, values = unix_s[known], values[known]
    order = np.argsort(unix_s, kind="stable")
    minute = np.floor(unix_s[order] / 60.0)
    first = order[np.flatnonzero(np.diff(minute, prepend=-np.inf) > 0.0)]
    return [
        Reading(name, dt.datetime.fromtimestamp(t, dt.UTC), v)
        for t, v in zip(unix_s[first].tolist(), values[first].tolist(), strict=True)
    ]


def keep(session: Session, device_id: str, readings: Iterable[Reading], *, now: dt.datetime) -> int:
    """Store what is new, in whatever order it comes; a minute that has a value keeps it.  How many were stored."""
    minutes = [(each.at.replace(second=0, microsecond=0), each) for each in readings if each.at < now + MAX_AHEAD]
    if not minutes:
        return 0
    minutes.sort(key=lambda item: item[0])
    known: dict[str, list[tuple[dt.datetime, float]]] = {}
    for row in around(session, device_id, {each.name for _, each in minutes}, minutes[0][0], minutes[-1][0]):
        known.setdefault(row.name, []).append((row.at, row.value))
    rows: list[dict[str, object]] = []
    for minute, each in minutes:
        stored = known.setdefault(each.name, [])
        place = bisect_right(stored, minute, key=lambda item: item[0])
        if place and not _is_news(each, minute, stored[place - 1]):
            continue
        rows.append({"device_id": device_id, "name": each.name, "at": minute, "value": each.value})
        stored.insert(place, (minute, each.value))
    if rows:
        session.execute(_unless_there(session), rows)
    return len(rows)


def _is_news(each: Reading, minute: dt.datetime, before: tuple[dt.datetime, float]) -> bool:
    at, value = before
    changed = abs(each.value - value) >= RESOLUTION.get(each.name, 0.0) and each.value != value
    return minute > at and (changed or minute - at >= AGAIN)


def _unless_there(session: Session) -> Insert:
    """An insert that passes over rows that are there."""
    dialect = postgresql if session.get_bind().dialect.name == "postgresql" else sqlite
    return dialect.insert(Diagnosis).on_conflict_do_nothing()


def of_columns(values: Mapping[str, Floats], offset_s: float, rate: float = 1.0) -> list[Reading]:
    """What a batch's own columns say of the vehicle; ``utc = offset + rate * t``."""
    names = {"battery": "battery_v", "temp": "temperature_c", "ignition": "ignition"}
    readings: list[Reading] = []
    for column, name in names.items():
        if column in values:
            readings += per_minute(name, offset_s + rate * values["t"], values[column])
    return readings
