"""Orders of erasure: what one would erase and keep, carrying it out a bounded piece at a time, and its certificate.

An order is a row; whoever runs it may die anywhere, and the next goes on: every piece looks for what is still there.
What a legal hold keeps is left and listed.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Sequence
from importlib import metadata
from typing import Any

import structlog
from sqlalchemy import ColumnElement, delete, func, select, update
from sqlalchemy.orm import Session

from server.accounts import audit
from server.accounts.caller import Caller
from server.accounts.users import erase_user, user_holdings, user_of
from server.database import Database
from server.errors import ConflictError, NotFoundError
from server.events.canonical import sha256
from server.events.holds import alert_held, claim_held, held, trip_held
from server.evidence.package import instant
from server.models import (
    AccidentClaim,
    Alert,
    AuditEntry,
    Batch,
    Boot,
    Change,
    Device,
    DeviceState,
    Diagnosis,
    Erasure,
    Event,
    EventRevision,
    Installation,
    TrackPoint,
    Trip,
    Vehicle,
    new_id,
)
from server.privacy import subjects, tombstones
from server.privacy.subjects import Subject
from server.store import BlobStore

SCHEMA = "scatola-erasure-1"
AUDIT_STAYS = "The audit log keeps who did and saw what until its own retention ends"

log = structlog.stdlib.get_logger("scatola.privacy")

Counts = dict[str, int]
Kept = list[dict[str, Any]]


def order(
    session: Session,
    caller: Caller,
    kind: str,
    subject_id: str,
    *,
    since: dt.datetime | None,
    until: dt.datetime | None,
    reason: str,
    now: dt.datetime,
) -> Erasure:
    """Order an erasure, on record before anything is done."""
    if kind == "vehicle":
        subjects.vehicle_subject(session, caller.organisation_id, subject_id, since, until)
    else:
        user_of(session, caller, subject_id)
    row = Erasure(
        id=new_id(),
        organisation_id=caller.organisation_id,
        subject_kind=kind,
        subject_id=subject_id,
        since=since,
        until=until,
        reason=reason,
        requested_at=now,
        requested_by=caller.name[:254],
        erased={},
        kept=[],
    )
    session.add(row)
    session.flush()
    period = {name: None if at is None else at.isoformat() for name, at in (("since", since), ("until", until))}
    detail = {"erasure_id": row.id, "reason": reason, **period}
    audit.record(session, caller, "erasure.ordered", f"{kind} {subject_id}", now=now, detail=detail)
    return row


def erasure_of(session: Session, organisation_id: str, erasure_id: str) -> Erasure:
    """An order of the organisation."""
    row = session.get(Erasure, erasure_id)
    if row is None or row.organisation_id != organisation_id:
        raise NotFoundError(f"There is no erasure {erasure_id!r}")
    return row


def erasures(session: Session, organisation_id: str, *, limit: int = 100) -> Sequence[Erasure]:
    """The newest orders first."""
    query = select(Erasure).where(Erasure.organisation_id == organisation_id)
    return session.scalars(query.order_by(Erasure.requested_at.desc(), Erasure.id).limit(limit)).all()


# --- what there is


def vehicle_holdings(session: Session, subject: Subject) -> tuple[Counts, Kept]:
    """What an erasure would take, and what it would leave and why."""
    there = subject.events()
    held_events = list(session.scalars(select(Event).where(*there, Event.held_at.is_not(None))))
    takes: Counts = {
        "events": _count(session, Event.id, *there, Event.held_at.is_(None), Event.erased_at.is_(None)),
        "batches": 0,
        "trips": _count(session, Trip.id, *subject.trips(), ~trip_held()),
        "track_points": _points(session, *subject.trips(), ~trip_held()),
        "alerts": _count(session, Alert.id, *subject.alerts(), ~alert_held()),
        "claims": _count(session, AccidentClaim.id, *subject.claims(), ~claim_held()),
        "diagnosis": sum(
            _count(session, Diagnosis.value, *subjects.diagnosis(stay)) for stay in subjects.stays(session, subject)
        ),
        "changes": _count(session, Change.id, *subject.changes()),
        "installations": _count(session, Installation.id, *subject.installations()) if subject.whole else 0,
    }
    kept_batches = 0
    for _, wanted in subjects.batches(session, subject):
        left = *wanted, Batch.erasing_at.is_(None)
        takes["batches"] += _count(session, Batch.id, *left, ~held())
        kept_batches += _count(session, Batch.id, *left, held())
    kept: Kept = [
        {"what": "event", "id": row.id, "count": 1, "why": f"legal hold since {instant(row.held_at or row.at)}"}
        for row in held_events
    ]
    for what, count, how in (
        ("batches", kept_batches, "rests on them"),
        ("trips", _count(session, Trip.id, *subject.trips(), trip_held()), "rests on them"),
        ("alerts", _count(session, Alert.id, *subject.alerts(), alert_held()), "they were raised for"),
        ("claims", _count(session, AccidentClaim.id, *subject.claims(), claim_held()), "they may be about"),
    ):
        if count:
            why = f"legal hold on an event that {how}"
            kept.append({"what": what, "id": None, "count": count, "why": why})
    if subject.whole and kept:
        kept.append({"what": "name and plate", "id": subject.vehicle_id, "count": 1, "why": "legal hold on an event"})
    of_vehicle = AuditEntry.organisation_id == subject.organisation_id, AuditEntry.subject.contains(subject.vehicle_id)
    entries = _count(session, AuditEntry.id, *of_vehicle)
    if entries:
        kept.append({"what": "audit entries", "id": None, "count": entries, "why": AUDIT_STAYS})
    return takes, kept


def plan(session: Session, caller: Caller, kind: str, subject_id: str, **period: dt.datetime | None) -> dict[str, Any]:
    """A dry run."""
    if kind == "vehicle":
        subject = subjects.vehicle_subject(session, caller.organisation_id, subject_id, **period)
        takes, kept = vehicle_holdings(session, subject)
    else:
        takes, entries = user_holdings(session, user_of(session, caller, subject_id))
        kept = _of_user(entries)
    return {"would_erase": takes, "would_keep": kept}


def _of_user(entries: Counts) -> Kept:
    whys = {"audit entries": AUDIT_STAYS, "event actions": "Who reviewed and held an event is part of its evidence"}
    return [{"what": what, "id": None, "count": n, "why": whys[what]} for what, n in entries.items() if n]


def _count(session: Session, column: Any, *wanted: ColumnElement[bool]) -> int:  # any mapped column
    return session.scalar(select(func.count(column)).where(*wanted)) or 0


def _points(session: Session, *wanted: ColumnElement[bool]) -> int:
    query = select(func.count()).select_from(TrackPoint).join(Trip, Trip.id == TrackPoint.trip_id)
    return session.scalar(query.where(*wanted)) or 0


# --- carrying it out


def run_open(
    database: Database,
    store: BlobStore,
    *,
    clock: Callable[[], dt.datetime],
    stopped: Callable[[], bool] = lambda: False,
) -> int:
    """Carry on with every open order; how many are finished now."""
    with database.reading() as session:
        waiting = list(
            session.scalars(select(Erasure.id).where(Erasure.finished_at.is_(None)).order_by(Erasure.requested_at))
        )
    finished = 0
    for erasure_id in waiting:
        try:
            finished += run(database, store, erasure_id, now=clock(), stopped=stopped)
        except _StoppedError:
            break
    return finished


class _StoppedError(Exception):
    """The process is about to end; the order stays open."""


def run(
    database: Database,
    store: BlobStore,
    erasure_id: str,
    *,
    now: dt.datetime,
    stopped: Callable[[], bool] = lambda: False,
) -> bool:
    """Carry out one order as far as it goes; whether it is finished.  Blobs younger than a day make it wait."""
    with database.reading() as session:
        row = session.get_one(Erasure, erasure_id)
    if row.finished_at is not None:
        return True
    if row.subject_kind == "user":
        return _run_user(database, row, now)
    subject = Subject(row.organisation_id, row.subject_id, row.since, row.until)
    _erase_vehicle(database, row.id, subject, now, stopped)
    with database.reading() as session:
        boxes = list(session.scalars(select(Batch.device_id).where(Batch.erasure_id == row.id).distinct()))
    for device_id in boxes:
        tombstones.finish_batches(database, store, now=now, device_id=device_id, stopped=stopped)
    with database.transaction() as session:
        order_row = session.get_one(Erasure, erasure_id, with_for_update=True)
        order_row.kept = vehicle_holdings(session, subject)[1]
        if _count(session, Batch.id, Batch.erasure_id == erasure_id, Batch.erased_at.is_(None)):
            return False
        _finish(session, order_row, now)
    return True


def _finish(session: Session, row: Erasure, now: dt.datetime) -> None:
    if row.finished_at is not None:
        return
    row.finished_at = now
    job = Caller(row.organisation_id, "job", name="erasure")
    detail = {"erasure_id": row.id, "erased": row.erased, "kept": len(row.kept)}
    audit.record(session, job, "erasure.finished", f"{row.subject_kind} {row.subject_id}", now=now, detail=detail)


def _run_user(database: Database, row: Erasure, now: dt.datetime) -> bool:
    with database.transaction() as session:
        order_row = session.get_one(Erasure, row.id, with_for_update=True)
        caller = Caller(row.organisation_id, "job", name="erasure")
        user = user_of(session, caller, row.subject_id, lock=True)
        takes, entries = user_holdings(session, user)
        try:
            erase_user(session, user, now=now)
        except ConflictError as error:  # the last administrator: it says so and is not tried for ever
            order_row.kept = [{"what": "account", "id": user.id, "count": 1, "why": error.detail}]
        else:
            order_row.erased, order_row.kept = dict(takes), _of_user(entries)
        _finish(session, order_row, now)
    return True


def _erase_vehicle(
    database: Database, erasure_id: str, subject: Subject, now: dt.datetime, stopped: Callable[[], bool]
) -> None:
    with database.reading() as session:
        stays = subjects.stays(session, subject)
        parts = list(subjects.batches(session, subject))

    def drain(take: Callable[[Session], Counts]) -> None:
        while True:
            if stopped():
                raise _StoppedError
            with database.transaction() as session:
                found = take(session)
                row = session.get_one(Erasure, erasure_id, with_for_update=True)
                row.erased = {k: row.erased.get(k, 0) + found.get(k, 0) for k in {**row.erased, **found}}
            if not any(found.values()):
                return

    def trips_of(session: Session, box: str) -> Counts:
        trips, points = tombstones.delete_trips(session, box, *subject.trips(), now=now)
        return {"trips": trips, "track_points": points}

    with database.reading() as session:
        of_trips = set(session.scalars(select(Trip.device_id).where(*subject.trips()).distinct()))
        of_events = set(session.scalars(select(Event.device_id).where(*subject.events()).distinct()))
    for box in sorted(of_events):
        drain(
            lambda s, box=box: {
                "events": tombstones.erase_events(s, box, *subject.events(), now=now, erasure_id=erasure_id)
            }
        )
    for box, wanted in parts:
        drain(
            lambda s, box=box, wanted=wanted: {
                "batches": tombstones.mark_batches(s, box, *wanted, now=now, erasure_id=erasure_id)
            }
        )
    for box in sorted(of_trips):
        drain(lambda s, box=box: trips_of(s, box))
    drain(lambda s: _erase_small(s, subject, stays))
    with database.transaction() as session:
        _forget_positions(session, stays, now)
        if subject.whole:
            row = session.get_one(Erasure, erasure_id, with_for_update=True)
            row.erased = {**row.erased, **_forget_vehicle(session, subject, row.erased)}


def _erase_small(session: Session, subject: Subject, stays: Sequence[subjects.Stay]) -> Counts:
    """A piece of what has no tombstone."""
    of_claims = select(AccidentClaim.id).where(*subject.claims(), ~claim_held())
    claims = list(session.scalars(of_claims.limit(tombstones.CHUNK)))
    session.execute(delete(AccidentClaim).where(AccidentClaim.id.in_(claims)))
    values = (tombstones.delete_diagnosis(session, stay.device_id, *subjects.diagnosis(stay)) for stay in stays)
    return {
        "alerts": tombstones.delete_alerts(session, *subject.alerts()),
        "claims": len(claims),
        "diagnosis": sum(values),
        "changes": _erase_changes(session, subject),
    }


def _erase_changes(session: Session, subject: Subject) -> int:
    # The newest row keeps its number: SQLite would give it again, and who reads on from there would miss a row.
    newest = session.scalar(select(func.max(Change.id)))
    ids = list(session.scalars(select(Change.id).where(*subject.changes()).limit(tombstones.CHUNK)))
    blank = {"vehicle_id": None, "device_id": None, "data": {}}
    session.execute(update(Change).where(Change.id.in_(ids), Change.id == newest).values(blank))
    session.execute(delete(Change).where(Change.id.in_(ids), Change.id != newest))
    return len(ids)


def _forget_positions(session: Session, stays: Sequence[subjects.Stay], now: dt.datetime) -> None:
    """The last known place of the boxes, and where the reckoning of their trips stood."""
    for stay in stays:
        tombstones.lock(session, stay.device_id, now=now)
        state = session.get_one(DeviceState, stay.device_id)
        if state.position_at is not None and stay.began_at <= state.position_at < stay.ended_at:
            state.position_at = state.lat_deg = state.lon_deg = state.speed_mps = state.course_rad = None
        ends = [b.boot for b in subjects.boots_of(session, stay) if b.utc(b.t_last_s) < stay.ended_at]
        session.execute(update(Boot).where(Boot.device_id == stay.device_id, Boot.boot.in_(ends)).values(trip_state={}))


def _forget_vehicle(session: Session, subject: Subject, erased: Counts) -> Counts:
    """Mountings, name and plate, unless a hold keeps an event: who was in it must then stay known."""
    there = subject.events()
    if _count(session, Event.id, *there, Event.held_at.is_not(None)):
        return {}
    session.execute(update(Event).where(*there, Event.erased_at.is_not(None)).values(vehicle_id=None))
    count = _count(session, Installation.id, *subject.installations())
    session.execute(delete(Installation).where(*subject.installations()))
    vehicle = session.get_one(Vehicle, subject.vehicle_id, with_for_update=True)
    vehicle.name, vehicle.plate = f"Erased vehicle {vehicle.id[:8]}", None
    return {"installations": erased.get("installations", 0) + count, "name and plate": 1}


# --- the certificate


def certificate(session: Session, row: Erasure) -> dict[str, Any]:
    """What was erased and by whose order, with the hashes that stay behind in the boxes' chains."""
    if row.finished_at is None:
        raise ConflictError("The erasure is not finished; blobs put less than a day ago wait", code="not_finished")
    batches = session.execute(
        select(Batch.device_id, Batch.chain_index, Batch.body_sha256, Batch.column_sha256, Batch.erased_at)
        .where(Batch.erasure_id == row.id)
        .order_by(Batch.device_id, Batch.chain_index)
    ).all()
    revisions = session.execute(
        select(Event.id, EventRevision.number, EventRevision.event_sha256, EventRevision.input_sha256)
        .join(EventRevision, EventRevision.event_id == Event.id)
        .where(Event.erasure_id == row.id)
        .order_by(Event.id, EventRevision.number)
    ).all()
    boxes = session.execute(
        select(Device.id, Device.chain_length, Device.chain_head)
        .where(Device.id.in_({batch.device_id for batch in batches}))
        .order_by(Device.id)
    ).all()
    told: dict[str, Any] = {
        "schema": SCHEMA,
        "software": {"name": "scatola", "version": metadata.version("scatola")},
        "erasure_id": row.id,
        "organisation_id": row.organisation_id,
        "subject": {"kind": row.subject_kind, "id": row.subject_id},
        "period": {"since": row.since and instant(row.since), "until": row.until and instant(row.until)},
        "reason": row.reason,
        "requested_at": instant(row.requested_at),
        "requested_by": row.requested_by,
        "finished_at": instant(row.finished_at),
        "erased": row.erased,
        "kept": row.kept,
        "chains": [{"device_id": b.id, "length": b.chain_length, "head": b.chain_head} for b in boxes],
        "batches": [
            {
                "device_id": b.device_id,
                "chain_index": b.chain_index,
                "body_sha256": b.body_sha256,
                "column_sha256": b.column_sha256,
                "erased_at": instant(b.erased_at or row.finished_at),
            }
            for b in batches
        ],
        "event_revisions": [
            {"event_id": r.id, "number": r.number, "event_sha256": r.event_sha256, "input_sha256": r.input_sha256}
            for r in revisions
        ],
    }
    return {**told, "sha256": sha256(told)}
