"""What the vehicle page shows of a vehicle's use: kilometres, style, theft mode, diagnosis."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass
from zoneinfo import ZoneInfo

from sqlalchemy.orm import Session

from server.alerts.queries import theft
from server.alerts.schemas import TheftOut
from server.diagnosis.queries import newest
from server.models import Diagnosis
from server.statistics.queries import periods, score
from server.statistics.schemas import PeriodOut, ScoreOut
from server.wording import marked

DAYS, SCORED = dt.timedelta(days=14), dt.timedelta(days=30)
_UNITS = {"battery_v": "V", "temperature_c": "°C"}
_NAMES = {
    "battery_v": marked("Battery"),
    "temperature_c": marked("Temperature of the box"),
    "ignition": marked("Ignition"),
}


@dataclass(frozen=True)
class Use:
    """How a vehicle is used and watched."""

    days: Sequence[PeriodOut]
    style: ScoreOut
    theft: TheftOut


def use_of(session: Session, organisation_id: str, vehicle_id: str, *, now: dt.datetime) -> Use:
    """The last two weeks by UTC days, the style of the last thirty days, and the theft watch."""
    days = periods(
        session,
        organisation_id,
        group="day",
        zone=ZoneInfo("UTC"),
        since=now - DAYS,
        until=now,
        vehicle_id=vehicle_id,
    )
    style = score(session, organisation_id, vehicle_id, now - SCORED, now)
    return Use(days, style, theft(session, organisation_id, vehicle_id))


def values_of(session: Session, device_id: str) -> list[tuple[str, Diagnosis, str]]:
    """Diagnosis values of a box: name in words, the newest reading, unit."""
    return [(_NAMES.get(row.name, row.name), row, _UNITS.get(row.name, "")) for row in newest(session, device_id)]
