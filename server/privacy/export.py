"""Everything that is held about a vehicle or a user as one archive, made while it is sent.

No more than one member of it is in memory, and no transaction stays open while a slow client reads.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any

import orjson
import pyarrow as pa
import pyarrow.parquet as pq
from sqlalchemy import ColumnElement, false, or_, select
from sqlalchemy.orm import InstrumentedAttribute, Session

from server.database import Database
from server.events import queries as event_queries
from server.models import (
    AccidentClaim,
    Alert,
    AlertDelivery,
    Analysis,
    ApiKey,
    Assignment,
    AuditEntry,
    Base,
    Batch,
    Change,
    Device,
    DeviceState,
    Diagnosis,
    Event,
    EventAction,
    EventRevision,
    Installation,
    MountingRevision,
    TrackPoint,
    Trip,
    User,
    Vehicle,
    WebSession,
)
from server.privacy import analyses, subjects
from server.privacy.subjects import Subject
from server.store import BlobStore, raw_body, raw_columns

PAGE = 500
SECRET = frozenset(
    {
        "token_hash",
        "next_token_hash",
        "key_hash",
        "password_hash",
        "totp_secret",
        "totp_step",
        "csrf_token",
        "document",
        "body",
    }
)
"""Columns that open something, come as files of their own, or repeat what another row says (a message sent)."""
README = """Everything that Scatola holds about one {kind}.

*.jsonl         rows of the database, one JSON object a line; times are UTC, units stand in the names
tracks/*.parquet  the 1 Hz track of each trip: time, latitude and longitude (degrees, WGS84), altitude, speed, course
events/*.json   what was computed of each event, canonical JSON, one file a revision
analyses/*.json  what the workbench made of trips
raw/DEVICE/N.parquet  what upload N of a box's chain measured, columns as in docs/device-protocol.md; N.body the upload
                as it came, where it was kept.  Uploads that were erased have their row in batches.jsonl and no file
"""


class _Sink(io.RawIOBase):
    """Where the archive is written to, and read off piece by piece."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:  # any buffer
        self._parts.append(bytes(data))
        return len(self._parts[-1])

    def take(self) -> bytes:
        parts, self._parts = self._parts, []
        return b"".join(parts)


Member = tuple[str, Iterator[bytes]]


def zipped(members: Iterator[Member]) -> Iterator[bytes]:
    """An archive of members, each given as pieces of its content."""
    sink = _Sink()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as bundle:
        for name, pieces in members:
            # Parquet is compressed already.
            packed = name.endswith((".parquet", ".body"))
            entry = zipfile.ZipInfo(name)
            entry.compress_type = zipfile.ZIP_STORED if packed else zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            with bundle.open(entry, "w", force_zip64=True) as file:
                for piece in pieces:
                    file.write(piece)
                    if data := sink.take():
                        yield data
            yield sink.take()
    yield sink.take()


def vehicle_archive(database: Database, store: BlobStore, subject: Subject) -> Iterator[bytes]:
    """A vehicle's archive."""
    return zipped(_of_vehicle(database, store, subject))


def _of_vehicle(database: Database, store: BlobStore, subject: Subject) -> Iterator[Member]:
    rows = _Rows(database)
    with database.reading() as session:
        stays = subjects.stays(session, subject)
        parts = list(subjects.batches(session, subject))
    boxes = sorted({stay.device_id for stay in stays})
    yield "README.txt", iter([README.format(kind="vehicle").encode()])
    yield "vehicle.jsonl", rows(Vehicle, Vehicle.id, Vehicle.id == subject.vehicle_id)
    yield "assignments.jsonl", rows(Assignment, Assignment.id, Assignment.vehicle_id == subject.vehicle_id)
    yield "devices.jsonl", rows(Device, Device.id, Device.id.in_(boxes))
    now_in_it = select(Device.id).where(Device.vehicle_id == subject.vehicle_id)
    yield "last_position.jsonl", rows(DeviceState, DeviceState.device_id, DeviceState.device_id.in_(now_in_it))
    yield "installations.jsonl", rows(Installation, Installation.id, *subject.installations())
    of_installation = select(Installation.id).where(*subject.installations())
    mountings = MountingRevision.installation_id.in_(of_installation)
    yield "mounting_revisions.jsonl", rows(MountingRevision, MountingRevision.id, mountings)
    yield "trips.jsonl", rows(Trip, Trip.id, *subject.trips())
    for trip_id in _ids(database, Trip.id, *subject.trips()):
        yield f"tracks/{trip_id}.parquet", _track(database, trip_id)
    yield "events.jsonl", rows(Event, Event.id, *subject.events())
    of_events = select(Event.id).where(*subject.events())
    yield "event_actions.jsonl", rows(EventAction, EventAction.id, EventAction.event_id.in_(of_events))
    yield "event_revisions.jsonl", rows(EventRevision, EventRevision.id, EventRevision.event_id.in_(of_events))
    for revision_id in _ids(database, EventRevision.id, EventRevision.event_id.in_(of_events)):
        yield from _document(database, revision_id)
    yield "alerts.jsonl", rows(Alert, Alert.id, *subject.alerts())
    of_alerts = select(Alert.id).where(*subject.alerts())
    yield "alert_deliveries.jsonl", rows(AlertDelivery, AlertDelivery.id, AlertDelivery.alert_id.in_(of_alerts))
    yield "claims.jsonl", rows(AccidentClaim, AccidentClaim.id, *subject.claims())
    yield "diagnosis.jsonl", (piece for stay in stays for piece in _diagnosis(database, rows, stay))
    yield from _analyses(database, store, rows, subject)
    yield "changes.jsonl", rows(Change, Change.id, *subject.changes())
    mentions = AuditEntry.organisation_id == subject.organisation_id, AuditEntry.subject.contains(subject.vehicle_id)
    yield "audit.jsonl", rows(AuditEntry, AuditEntry.id, *mentions)
    yield "boots.jsonl", _boots(database, stays)
    yield "batches.jsonl", (piece for _, wanted in parts for piece in rows(Batch, Batch.id, *wanted))
    for _, wanted in parts:
        for batch_id in _ids(database, Batch.id, Batch.erasing_at.is_(None), *wanted):
            yield from _raw(database, store, batch_id)


def _analyses(database: Database, store: BlobStore, rows: _Rows, subject: Subject) -> Iterator[Member]:
    with database.reading() as session:
        of_vehicle = or_(false(), *analyses.wanted(session, subject))
    yield "analyses.jsonl", rows(Analysis, Analysis.id, of_vehicle)
    for analysis_id in _ids(database, Analysis.id, of_vehicle):
        with database.reading() as session:
            row = session.get(Analysis, analysis_id)
        if row is None or row.status != "done" or row.result_key is None:
            continue
        with suppress(KeyError):  # erased while the archive was being made
            yield f"analyses/{analysis_id}.json", iter([store.get(row.result_key)])


def _diagnosis(database: Database, rows: _Rows, stay: subjects.Stay) -> Iterator[bytes]:
    of_stay = subjects.diagnosis(stay)
    with database.reading() as session:
        names = session.scalars(select(Diagnosis.name).where(*of_stay).distinct().order_by(Diagnosis.name)).all()
    for name in names:
        yield from rows(Diagnosis, Diagnosis.at, *of_stay, Diagnosis.name == name)


def _boots(database: Database, stays: Sequence[subjects.Stay]) -> Iterator[bytes]:
    for stay in stays:
        with database.reading() as session:
            yield b"".join(_line(boot) for boot in subjects.boots_of(session, stay))


def user_archive(database: Database, organisation_id: str, user_id: str) -> Iterator[bytes]:
    """A user's archive."""
    return zipped(_of_user(database, organisation_id, user_id))


def _of_user(database: Database, organisation_id: str, user_id: str) -> Iterator[Member]:
    rows = _Rows(database)
    with database.reading() as session:
        email = session.get_one(User, user_id).email
    yield "README.txt", iter([README.format(kind="user").encode()])
    yield "user.jsonl", rows(User, User.id, User.id == user_id)
    yield "sessions.jsonl", rows(WebSession, WebSession.id, WebSession.user_id == user_id)
    yield "api_keys.jsonl", rows(ApiKey, ApiKey.id, ApiKey.user_id == user_id)
    theirs = or_(AuditEntry.actor_id == user_id, AuditEntry.actor_name == email, AuditEntry.subject == email)
    yield "audit.jsonl", rows(AuditEntry, AuditEntry.id, AuditEntry.organisation_id == organisation_id, theirs)
    of_events = select(Event.id).where(Event.organisation_id == organisation_id)
    yield "analyses.jsonl", rows(Analysis, Analysis.id, Analysis.user_id == user_id)
    said = EventAction.actor == email, EventAction.event_id.in_(of_events)
    yield "event_actions.jsonl", rows(EventAction, EventAction.id, *said)


class _Rows:
    """Rows of a table as lines of JSON, a page at a time."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def __call__(
        self, model: type[Base], key: InstrumentedAttribute[Any], *wanted: ColumnElement[bool]
    ) -> Iterator[bytes]:
        after: Any = None
        while True:
            query = select(model).where(*wanted).order_by(key).limit(PAGE)
            with self._database.reading() as session:
                page = session.scalars(query if after is None else query.where(key > after)).all()
            yield b"".join(_line(row) for row in page)
            if len(page) < PAGE:
                return
            after = getattr(page[-1], key.key)


def _line(row: Base) -> bytes:
    names = [c.key for c in row.__mapper__.column_attrs if c.key not in SECRET and not c.deferred]
    return orjson.dumps({name: getattr(row, name) for name in names}) + b"\n"


def _ids(database: Database, key: InstrumentedAttribute[str], *wanted: ColumnElement[bool]) -> Iterator[str]:
    after = ""
    while True:
        with database.reading() as session:
            page: Sequence[str] = session.scalars(
                select(key).where(key > after, *wanted).order_by(key).limit(PAGE)
            ).all()
        yield from page
        if len(page) < PAGE:
            return
        after = page[-1]


_TRACK = (
    TrackPoint.t_s,
    TrackPoint.at,
    TrackPoint.lat_deg,
    TrackPoint.lon_deg,
    TrackPoint.alt_m,
    TrackPoint.speed_mps,
    TrackPoint.course_rad,
)


def _track(database: Database, trip_id: str) -> Iterator[bytes]:
    def read(session: Session) -> list[Any]:
        return list(session.execute(select(*_TRACK).where(TrackPoint.trip_id == trip_id).order_by(TrackPoint.t_s)))

    with database.reading() as session:
        found = read(session)
    columns = {
        column.key: pa.array(
            [row[k] for row in found], pa.timestamp("us", "UTC") if column.key == "at" else pa.float64()
        )
        for k, column in enumerate(_TRACK)
    }
    sink = io.BytesIO()
    pq.write_table(pa.table(columns), sink, compression="zstd")
    yield sink.getvalue()


def _document(database: Database, revision_id: str) -> Iterator[Member]:
    with database.reading() as session:
        row = session.get(EventRevision, revision_id)
    if row is not None and row.document:
        yield f"events/{row.event_id}/{row.number}.json", iter([event_queries.canonical_bytes(row)])


def _raw(database: Database, store: BlobStore, batch_id: str) -> Iterator[Member]:
    with database.reading() as session:
        batch = session.get_one(Batch, batch_id)
    name = f"raw/{batch.device_id}/{batch.chain_index}"
    readers: dict[str, Callable[[], bytes | None]] = {
        ".parquet": lambda: raw_columns(store, batch).to_parquet(),
        ".body": lambda: raw_body(store, batch),
    }
    for suffix, reader in readers.items():
        try:
            content = reader()
        except KeyError:  # erased while the archive was being made: its row says so
            continue
        if content is not None:
            yield name + suffix, iter([content])


def describe(kind: str, subject_id: str) -> str:
    """File name of an archive."""
    return json.dumps(f"scatola-{kind}-{subject_id[:8]}.zip")
