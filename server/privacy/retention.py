"""Applying the rules: what is older than they allow goes, a bounded piece at a time.

Each transaction removes a piece and counts it in the rule's row, so a run that dies leaves nothing half removed and no
removal untold: the next run goes on and tells the audit log of both.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import structlog
from sqlalchemy import ColumnElement, Select, delete, func, select, text, update
from sqlalchemy.orm import Session

from server.accounts import audit
from server.accounts.caller import Caller
from server.database import Database
from server.events.holds import evidence, held, trip_held
from server.models import Alert, AuditEntry, Batch, Change, Device, Diagnosis, Event, Organisation, RetentionRule, Trip
from server.privacy import analyses, policy, tombstones
from server.store import BlobStore

ROWS = 1000
"""Rows of the change table, the audit log or the alerts in one transaction."""

log = structlog.stdlib.get_logger("scatola.privacy")


@dataclass
class Removed:
    """What a run removed, by class."""

    counts: dict[str, int] = field(default_factory=dict[str, int])
    blobs_gone: int = 0


@dataclass(frozen=True)
class _Rule:
    organisation_id: str
    name: str
    days: int
    before: dt.datetime


def apply_retention(
    database: Database, store: BlobStore, *, now: dt.datetime, stopped: Callable[[], bool] = lambda: False
) -> Removed:
    """One run over all organisations."""
    removed = Removed()
    for rule in _due_rules(database, now):
        _report(database, rule, now)  # of a run that died
        for count in _pieces(database, rule, now):
            removed.counts[rule.name] = removed.counts.get(rule.name, 0) + count
            if stopped():
                return removed
        _report(database, rule, now)
    removed.blobs_gone = tombstones.finish_batches(database, store, now=now, stopped=stopped)
    return removed


def _due_rules(database: Database, now: dt.datetime) -> list[_Rule]:
    with database.reading() as session:
        organisations = list(session.scalars(select(Organisation.id).order_by(Organisation.id)))
    found: list[_Rule] = []
    for organisation_id in organisations:
        with database.transaction() as session:
            rows = policy.write_defaults(session, organisation_id, now=now)
        found += [
            _Rule(organisation_id, row.data_class, row.days, now - dt.timedelta(days=row.days))
            for row in rows
            if row.days is not None and row.applies_at <= now
        ]
    return found


def _pieces(database: Database, rule: _Rule, now: dt.datetime) -> Iterator[int]:
    """Remove a piece at a time and give its count."""
    if rule.name in ("changes", "audit"):
        model = Change if rule.name == "changes" else AuditEntry
        while count := _remove(database, rule, lambda session: _delete_rows(session, rule, model)):
            yield count
        return
    if rule.name == "alerts":
        old = Alert.organisation_id == rule.organisation_id, Alert.created_at < rule.before
        while count := _remove(database, rule, lambda session: tombstones.delete_alerts(session, *old)):
            yield count
        return
    candidates, remove = _OF_BOXES[rule.name](rule.before)
    for device_id in _boxes(database, rule, candidates):
        # A piece that removes nothing ends it: what is left is kept by a hold.
        while count := _remove(database, rule, lambda session, box=device_id: remove(session, box, now)):
            yield count
    if rule.name == "raw":  # what the workbench made of samples, and the files that were brought to it
        while count := _remove(database, rule, lambda s: analyses.delete_old(s, rule.organisation_id, rule.before)):
            yield count


def _boxes(database: Database, rule: _Rule, candidates: Select[str]) -> list[str]:
    of_organisation = select(Device.id).where(Device.organisation_id == rule.organisation_id)
    with database.reading() as session:
        return list(session.scalars(of_organisation.where(candidates.correlate(Device).exists()).order_by(Device.id)))


Candidates = tuple["Select[str]", Callable[[Session, str, dt.datetime], int]]


def _raw(before: dt.datetime) -> Candidates:
    # What was not worked off yet is not lost for being old; what a crash rests on stays with it.
    wanted = Batch.received_at < before, Batch.processed_at.is_not(None), ~evidence()
    there = select(Batch.id).where(Batch.device_id == Device.id, Batch.erasing_at.is_(None), ~held(), *wanted)
    return there, lambda session, box, now: tombstones.mark_batches(session, box, *wanted, now=now)


def _events(*, severe: bool) -> Callable[[dt.datetime], Candidates]:
    def of(before: dt.datetime) -> Candidates:
        kind = Event.severe.is_(severe)
        wanted = Event.at < before, kind
        there = select(Event.id).where(Event.device_id == Device.id, Event.erased_at.is_(None), Event.held_at.is_(None))
        return there.where(*wanted), lambda session, box, now: tombstones.erase_events(session, box, *wanted, now=now)

    return of


def _tracks(before: dt.datetime) -> Candidates:
    wanted = _ended(before)
    there = select(Trip.id).where(Trip.device_id == Device.id, Trip.track_erased_at.is_(None), ~trip_held(), *wanted)
    return there, lambda session, box, now: tombstones.erase_tracks(session, box, *wanted, now=now)[0]


def _trips(before: dt.datetime) -> Candidates:
    wanted = _ended(before)
    there = select(Trip.id).where(Trip.device_id == Device.id, ~trip_held(), *wanted)
    return there, lambda session, box, now: tombstones.delete_trips(session, box, *wanted, now=now)[0]


def _diagnosis(before: dt.datetime) -> Candidates:
    there = select(Diagnosis.device_id).where(Diagnosis.device_id == Device.id, Diagnosis.at < before)
    return there, lambda session, box, _: tombstones.delete_diagnosis(session, box, Diagnosis.at < before)


def _ended(before: dt.datetime) -> tuple[ColumnElement[bool], ...]:
    return Trip.ended_at < before, ~Trip.under_way


_OF_BOXES: dict[str, Callable[[dt.datetime], Candidates]] = {
    "raw": _raw,
    "tracks": _tracks,
    "trips": _trips,
    "manoeuvres": _events(severe=False),
    "events": _events(severe=True),
    "diagnosis": _diagnosis,
}


def _delete_rows(session: Session, rule: _Rule, model: type[Change | AuditEntry]) -> int:
    # Never the newest: SQLite would give its number again, and who reads on from there would miss a row.
    newest = select(func.max(model.id)).scalar_subquery()
    old = model.organisation_id == rule.organisation_id, model.at < rule.before, model.id < newest
    ids = list(session.scalars(select(model.id).where(*old).order_by(model.id).limit(ROWS)))
    if ids and model is AuditEntry and session.get_bind().dialect.name == "postgresql":
        session.execute(text("SET LOCAL scatola.audit_retention = 'on'"))
    session.execute(delete(model).where(model.id.in_(ids)))
    return len(ids)


def _remove(database: Database, rule: _Rule, remove: Callable[[Session], int]) -> int:
    with database.transaction() as session:
        count = remove(session)
        if count:
            of_rule = RetentionRule.organisation_id == rule.organisation_id, RetentionRule.data_class == rule.name
            session.execute(update(RetentionRule).where(*of_rule).values(removed=RetentionRule.removed + count))
    return count


def _report(database: Database, rule: _Rule, now: dt.datetime) -> None:
    """Tell the audit log what was removed and not told yet."""
    with database.transaction() as session:
        row = session.get_one(RetentionRule, (rule.organisation_id, rule.name), with_for_update=True)
        if not row.removed:
            return
        detail = {"removed": row.removed, "days": rule.days, "before": rule.before.isoformat()}
        job = Caller(rule.organisation_id, "job", name="retention")
        audit.record(session, job, "retention", rule.name, now=now, detail=detail)
        log.info("retention", organisation_id=rule.organisation_id, data_class=rule.name, removed=row.removed)
        row.removed = 0
