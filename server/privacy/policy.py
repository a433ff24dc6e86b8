"""How long each class of data is kept: an organisation's rules, and what holds where it set none."""

from __future__ import annotations

import datetime as dt

from sqlalchemy import select
from sqlalchemy.orm import Session

from server.models import Organisation, RetentionRule
from server.models.privacy import DATA_CLASSES
from server.wording import marked

DEFAULT_DAYS: dict[str, int | None] = {
    "raw": 90,
    "tracks": 365,
    "trips": 1095,
    "manoeuvres": 365,
    "events": 3650,
    "diagnosis": 365,
    "alerts": 365,
    "changes": 30,
    "audit": 1095,
}
MEANINGS = {
    "raw": marked("Raw samples and their digests, but for those that a crash rests on; the workbench's analyses"),
    "tracks": marked("The way of a trip, a position a second"),
    "trips": marked("Trips as figures: times, distance, top speed"),
    "manoeuvres": marked("Harsh driving and other events without a reconstruction"),
    "events": marked("Crashes, rollovers and parked impacts, with the raw data they rest on"),
    "diagnosis": marked("Battery, temperature and other named values of the vehicle"),
    "alerts": marked("Alerts and the messages sent of them"),
    "changes": marked("What the live pages replay to a browser that lost its connection"),
    "audit": marked("The audit log"),
}
OBJECTION = dt.timedelta(days=7)
"""So long after a default was first written down nothing is removed by it: time to choose another."""
NOBODY = "default"


def rules(session: Session, organisation_id: str, *, now: dt.datetime) -> list[RetentionRule]:
    """The rules of an organisation, one for each class; a default that is not stored yet is given as it would be."""
    query = select(RetentionRule).where(RetentionRule.organisation_id == organisation_id)
    stored = {row.data_class: row for row in session.scalars(query)}
    return [stored.get(name) or _default(organisation_id, name, now) for name in DATA_CLASSES]


def _default(organisation_id: str, name: str, now: dt.datetime) -> RetentionRule:
    return RetentionRule(
        organisation_id=organisation_id,
        data_class=name,
        days=DEFAULT_DAYS[name],
        applies_at=now + OBJECTION,
        updated_at=now,
        updated_by=NOBODY,
        removed=0,
    )


def write_defaults(session: Session, organisation_id: str, *, now: dt.datetime) -> list[RetentionRule]:
    """The rules, all of them stored from now on."""
    # Two writers take turns: else both would find a rule missing.
    session.get_one(Organisation, organisation_id, with_for_update=True)
    found = rules(session, organisation_id, now=now)
    session.add_all(found)
    session.flush()
    return found


def set_rules(
    session: Session, organisation_id: str, wanted: dict[str, int | None], *, actor: str, now: dt.datetime
) -> dict[str, list[int | None]]:
    """Set days by class, None for ever; they apply from now on.  What changed: class to days before and after."""
    changed: dict[str, list[int | None]] = {}
    for row in write_defaults(session, organisation_id, now=now):
        if row.data_class not in wanted:
            continue
        days = wanted[row.data_class]
        if days != row.days:
            changed[row.data_class] = [row.days, days]
        row.days, row.applies_at, row.updated_at, row.updated_by = days, now, now, actor[:254]
    return changed
