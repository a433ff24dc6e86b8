"""Erasing rows of one box so that what stays can be believed.

A batch loses its raw data and keeps its row with both hashes and its link, so the chain verifies.  First the row is
marked, in one transaction with everything that says so (events, trips, installations) and under the box's lock, where
no legal hold can come in between; from then on nobody reads the blobs.  Then the blobs go, and the row says `erased`
only once they have.  A process that dies between the two leaves a mark, and the next round goes on from it.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Sequence

from sqlalchemy import ColumnElement, delete, func, or_, select, tuple_, update
from sqlalchemy.orm import Session

from server.database import Database
from server.events.holds import alert_held, held, trip_held
from server.models import (
    Alert,
    Batch,
    BatchDigest,
    Boot,
    Device,
    DeviceState,
    Diagnosis,
    Event,
    EventAction,
    EventInput,
    EventRevision,
    Installation,
    TrackPoint,
    Trip,
)
from server.store import COLLECT_AGE, BlobStore

CHUNK = 200
"""Rows of one transaction: bounds how long an upload of that box waits."""
ROWS = 1000
"""Small rows of one transaction: alerts, values."""
TRIPS = 10
"""Trips of one transaction; each has up to some ten thousand points."""
NEIGHBOUR_S = 2.0
NEVER_WORKED_OFF = "erased before it was worked off"


def lock(session: Session, device_id: str, *, now: dt.datetime) -> None:
    """Hold uploads and holds of a box back until this transaction ends, and have the worker's round start over."""
    session.execute(select(Device.id).where(Device.id == device_id).with_for_update())
    state = session.get(DeviceState, device_id, with_for_update=True)
    if state is None:
        session.add(DeviceState(device_id=device_id, version=1, updated_at=now, health={}))
        session.flush()
    else:
        state.version += 1


def mark_batches(
    session: Session, device_id: str, *wanted: ColumnElement[bool], now: dt.datetime, erasure_id: str | None = None
) -> int:
    """Mark the first of the wanted batches of a box that no hold keeps; everything that rests on them says so."""
    lock(session, device_id, now=now)
    query = select(Batch).where(Batch.device_id == device_id, Batch.erasing_at.is_(None), ~held(), *wanted)
    batches = list(session.scalars(query.order_by(Batch.chain_index).limit(CHUNK)))
    for batch in batches:
        batch.erasing_at, batch.erasure_id = now, erasure_id
        if batch.processed_at is None:
            batch.processed_at, batch.failure = now, NEVER_WORKED_OFF
    ids = [batch.id for batch in batches]
    session.execute(delete(BatchDigest).where(BatchDigest.batch_id.in_(ids)))
    rests = select(EventInput.event_id).where(EventInput.batch_id.in_(ids))
    session.execute(update(Event).where(Event.id.in_(rests), Event.raw_erased_at.is_(None)).values(raw_erased_at=now))
    _remark_results(session, device_id, batches, now=now)
    return len(batches)


def _remark_results(session: Session, device_id: str, batches: Sequence[Batch], *, now: dt.datetime) -> None:
    boots = {boot.boot: boot for boot in session.scalars(select(Boot).where(Boot.device_id == device_id))}
    for name, first, last in _stretches(batches):
        trips = Trip.device_id == device_id, Trip.boot == name, Trip.t_first_s <= last, Trip.t_last_s >= first
        session.execute(update(Trip).where(*trips, Trip.raw_erased_at.is_(None)).values(raw_erased_at=now))
        boot = boots.get(name)
        if boot is not None:
            over = or_(Installation.ended_at.is_(None), Installation.ended_at >= boot.utc(first))
            rows = Installation.device_id == device_id, Installation.began_at <= boot.utc(last), over
            session.execute(
                update(Installation).where(*rows, Installation.raw_erased_at.is_(None)).values(raw_erased_at=now)
            )


def _stretches(batches: Sequence[Batch]) -> list[tuple[str, float, float]]:
    """Boot, first and last box time of neighbouring batches taken together."""
    joined: list[tuple[str, float, float]] = []
    for batch in sorted(batches, key=lambda batch: (batch.boot, batch.t_first_s)):
        if joined and joined[-1][0] == batch.boot and batch.t_first_s <= joined[-1][2] + NEIGHBOUR_S:
            joined[-1] = batch.boot, joined[-1][1], max(joined[-1][2], batch.t_last_s)
        else:
            joined.append((batch.boot, batch.t_first_s, batch.t_last_s))
    return joined


def finish_batches(
    database: Database,
    store: BlobStore,
    *,
    now: dt.datetime,
    device_id: str | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> int:
    """Delete the blobs of marked batches, and say so once they are gone; how many rows now do.

    A blob that was put less than a day ago stays that long: an upload that put it again may be about to commit its
    row.  One that another, kept row of the box speaks of stays with that row.
    """
    done, after = 0, ("", "")
    while not stopped() and (rows := _marked(database, device_id, after)):
        shared = _kept_keys(database, rows)
        gone = [row.id for row in rows if _are_gone(store, [k for k in _keys(row) if k not in shared], now)]
        if gone:
            once = Batch.id.in_(gone), Batch.erased_at.is_(None)
            with database.transaction() as session:
                session.execute(update(Batch).where(*once).values(erased_at=now))
        done += len(gone)
        after = rows[-1].device_id, rows[-1].id
    return done


def _marked(database: Database, device_id: str | None, after: tuple[str, str]) -> Sequence[Batch]:
    query = select(Batch).where(Batch.erasing_at.is_not(None), Batch.erased_at.is_(None))
    query = query.where(tuple_(Batch.device_id, Batch.id) > after).order_by(Batch.device_id, Batch.id)
    if device_id is not None:
        query = query.where(Batch.device_id == device_id)
    with database.reading() as session:
        return session.scalars(query.limit(CHUNK)).all()


def _keys(batch: Batch) -> list[str]:
    return [key for key in (batch.blob_key, batch.body_key) if key is not None]


def _kept_keys(database: Database, batches: Sequence[Batch]) -> set[str]:
    """Blobs that kept rows of the same boxes speak of as well, one look at a box."""
    shared: set[str] = set()
    for device_id in {batch.device_id for batch in batches}:
        keys = [key for batch in batches if batch.device_id == device_id for key in _keys(batch)]
        kept = Batch.device_id == device_id, Batch.erasing_at.is_(None)
        query = select(Batch.blob_key, Batch.body_key).where(*kept)
        with database.reading() as session:
            for row in session.execute(query.where(or_(Batch.blob_key.in_(keys), Batch.body_key.in_(keys)))):
                shared |= {key for key in row if key is not None}
    return shared


def _are_gone(store: BlobStore, keys: Sequence[str], now: dt.datetime) -> bool:
    left = [key for key in keys if not store.delete_stale(key, now - COLLECT_AGE)]
    return not left


def erase_events(
    session: Session, device_id: str, *wanted: ColumnElement[bool], now: dt.datetime, erasure_id: str | None = None
) -> int:
    """Turn the first of the wanted events of a box that no hold keeps into tombstones; how many."""
    lock(session, device_id, now=now)
    there = Event.device_id == device_id, Event.erased_at.is_(None), Event.held_at.is_(None)
    query = select(Event).where(*there, *wanted)
    events = list(session.scalars(query.order_by(Event.at).limit(CHUNK).with_for_update()))
    for event in events:
        event.erased_at, event.erasure_id = now, erasure_id
        event.result, event.note, event.hold_reason = {}, None, None
    ids = [event.id for event in events]
    session.execute(
        update(EventRevision)
        .where(EventRevision.event_id.in_(ids))
        .values(document=b"", device_name=None, vehicle_name=None, plate=None)
    )
    session.execute(update(EventAction).where(EventAction.event_id.in_(ids)).values(note=None))
    return len(events)


def erase_tracks(session: Session, device_id: str, *wanted: ColumnElement[bool], now: dt.datetime) -> tuple[int, int]:
    """Take the 1 Hz track off the first of the wanted trips; how many trips and points."""
    lock(session, device_id, now=now)
    query = select(Trip).where(Trip.device_id == device_id, Trip.track_erased_at.is_(None), ~trip_held(), *wanted)
    trips = list(session.scalars(query.order_by(Trip.began_at).limit(TRIPS)))
    points = _delete_points(session, [trip.id for trip in trips])
    for trip in trips:
        trip.track_erased_at = now
    return len(trips), points


def delete_trips(session: Session, device_id: str, *wanted: ColumnElement[bool], now: dt.datetime) -> tuple[int, int]:
    """Delete the first of the wanted trips of a box with their tracks; how many trips and points."""
    lock(session, device_id, now=now)
    query = select(Trip.id).where(Trip.device_id == device_id, ~trip_held(), *wanted)
    ids = list(session.scalars(query.order_by(Trip.began_at).limit(TRIPS)))
    points = _delete_points(session, ids)
    session.execute(delete(Trip).where(Trip.id.in_(ids)))
    return len(ids), points


def _delete_points(session: Session, trips: Sequence[str]) -> int:
    count = select(func.count()).select_from(TrackPoint).where(TrackPoint.trip_id.in_(trips))
    points = session.scalar(count) or 0
    session.execute(delete(TrackPoint).where(TrackPoint.trip_id.in_(trips)))
    return points


def delete_alerts(session: Session, *wanted: ColumnElement[bool]) -> int:
    """Delete the first of the wanted alerts that no hold keeps, with the messages sent of them; how many alerts."""
    query = select(Alert.id).where(~alert_held(), *wanted).order_by(Alert.created_at, Alert.id)
    ids = list(session.scalars(query.limit(ROWS)))
    session.execute(delete(Alert).where(Alert.id.in_(ids)))
    return len(ids)


def delete_diagnosis(session: Session, device_id: str, *wanted: ColumnElement[bool]) -> int:
    """Delete the oldest of the wanted named values of a box; how many."""
    of_box = Diagnosis.device_id == device_id, *wanted
    last = session.scalar(select(Diagnosis.at).where(*of_box).order_by(Diagnosis.at).offset(ROWS - 1).limit(1))
    there = of_box if last is None else (*of_box, Diagnosis.at <= last)
    count = session.scalar(select(func.count()).select_from(Diagnosis).where(*there)) or 0
    session.execute(delete(Diagnosis).where(*there))
    return count
