"""Accepting a batch: check, make durable, commit, answer; nothing is estimated here."""

from __future__ import annotations

import datetime as dt
import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np
from sqlalchemy import Connection, Table, and_, bindparam, delete, insert, select, update
from sqlalchemy.orm import Session

from server.devices.provisioning import Quota, answered, counted
from server.diagnosis.service import Reading, keep, per_minute
from server.errors import ConflictError, InvalidError, UnauthenticatedError
from server.formats.columns import Columns
from server.ingest.chain import link
from server.live.changes import announce
from server.models import Batch, Device, SequenceRun, new_id

Stream = Literal["continuous", "burst"]

_KEY = re.compile(r"(?P<boot>[A-Za-z0-9._-]{1,64})/(?P<sequence>0|[1-9][0-9]{0,15})")
# The largest integer that every JSON reader keeps exact.
_MAX_SEQUENCE = 2**53 - 1
_MAX_SENT_S = 1e10


@dataclass(frozen=True, slots=True)
class BatchKey:
    """What makes a batch the same batch again."""

    stream: Stream
    boot: str
    sequence: int


@dataclass(frozen=True, slots=True)
class BoxNotes:
    """What a box says beside a batch."""

    sent_t_s: float | None = None
    """Its clock when it sent the batch."""
    configuration: int | None = None
    """The version of its configuration."""
    answers: tuple[str, ...] = ()
    """Requests that this batch answers."""


@dataclass(frozen=True, slots=True)
class Upload:
    """A checked upload whose blobs are durable."""

    key: BatchKey
    media_type: str
    body_sha256: str
    columns: Columns
    column_sha256: str
    blob_key: str
    body_key: str | None
    stored_bytes: int
    sent_bytes: int = 0
    """What counts against the quota."""
    notes: BoxNotes = BoxNotes()


_ANSWERS = re.compile(r"[0-9a-f]{32}(?:,[0-9a-f]{32}){0,19}")


def notes_of(sent_at: str | None, configuration: str | None, answers: str | None) -> BoxNotes:
    """What the headers Scatola-Sent-At, Scatola-Configuration and Scatola-Answers say."""
    try:
        sent_t_s = None if sent_at is None else float(sent_at)
        version = None if configuration is None else int(configuration)
    except ValueError:
        raise InvalidError(
            "Scatola-Sent-At is the box's clock in s, Scatola-Configuration a version", code="box_notes"
        ) from None
    named = "" if answers is None else answers.replace(" ", "")
    wrong_time = sent_t_s is not None and not abs(sent_t_s) <= _MAX_SENT_S
    if wrong_time or (version is not None and not 0 <= version < 2**31) or (named and not _ANSWERS.fullmatch(named)):
        raise InvalidError(
            "Scatola-Sent-At, Scatola-Configuration or Scatola-Answers is out of range", code="box_notes"
        )
    return BoxNotes(sent_t_s, version, tuple(named.split(",")) if named else ())


def key_of(idempotency_key: str | None, stream: str | None) -> BatchKey:
    """Stream, boot and sequence from the request's headers."""
    match = _KEY.fullmatch(idempotency_key or "")
    if match is None or int(match["sequence"]) > _MAX_SEQUENCE:
        raise InvalidError(
            "Idempotency-Key is <boot>/<sequence>: 1 to 64 of A-Z a-z 0-9 . _ - and a decimal number from 0",
            code="idempotency_key",
        )
    named = "continuous" if stream is None else stream.strip().lower()
    if named not in ("continuous", "burst"):
        raise InvalidError("Scatola-Stream is continuous or burst", code="stream")
    return BatchKey(stream=named, boot=match["boot"], sequence=int(match["sequence"]))


def body_sha256(body: bytes) -> str:
    """Hash of a body once its Content-Encoding is undone."""
    return hashlib.sha256(body).hexdigest()


# Statements are built once, and rows written without the mapper's unit of work: it would cost most of an upload.
_OF_KEY = and_(
    Batch.stream == bindparam("stream"), Batch.boot == bindparam("boot"), Batch.sequence == bindparam("sequence")
)
_STORED = Batch.id, Batch.body_sha256, Batch.media_type
_QUOTA = Device.quota_day, Device.quota_bytes, Device.bytes_per_day
_STANDING = (
    select(*_QUOTA, *_STORED)
    .outerjoin(Batch, and_(Batch.device_id == Device.id, _OF_KEY))
    .where(Device.id == bindparam("device_id"))
)
_LOCKED = (
    select(
        Device.organisation_id, Device.vehicle_id, Device.revoked_at, Device.chain_length, Device.chain_head, *_QUOTA
    )
    .where(Device.id == bindparam("device_id"))
    .with_for_update()
)
_KNOWN = select(*_STORED).where(Batch.device_id == bindparam("device_id"), _OF_KEY)
_BATCHES, _DEVICES, _RUNS = (cast("Table", row.__table__) for row in (Batch, Device, SequenceRun))
_INSERT_BATCH = insert(_BATCHES)
_UPDATE_DEVICE = update(_DEVICES).where(_DEVICES.c.id == bindparam("device_id"))
_OF_BOOT = and_(
    _RUNS.c.device_id == bindparam("of_device"),
    _RUNS.c.stream == bindparam("of_stream"),
    _RUNS.c.boot == bindparam("of_boot"),
)
_NEIGHBOURS = (
    select(_RUNS.c.first, _RUNS.c.last)
    .where(_OF_BOOT, _RUNS.c.first <= bindparam("next"))
    .order_by(_RUNS.c.first.desc())
    .limit(2)
)
_INSERT_RUN = insert(_RUNS)
_UPDATE_RUN = update(_RUNS).where(_OF_BOOT, _RUNS.c.first == bindparam("of_first"))
_DELETE_RUN = delete(_RUNS).where(_OF_BOOT, _RUNS.c.first == bindparam("of_first"))


def _checked(row: Sequence[Any] | None, media_type: str, sha256: str) -> str | None:
    """Id of the batch stored under a key, from `_STORED`, if any; raises when it was another."""
    if row is None or row[0] is None:
        return None
    if (row[1], row[2]) != (sha256, media_type):
        raise ConflictError(
            "Another body was stored under this key; a sequence is used once", code="sequence_reused", batch_id=row[0]
        )
    return row[0]


def standing(session: Session, device_id: str, key: BatchKey, media_type: str, sha256: str) -> tuple[str | None, Quota]:
    """Id of the batch stored under this key, if any, and the box's quota; raises when the batch was another."""
    asked = {"device_id": device_id, "stream": key.stream, "boot": key.boot, "sequence": key.sequence}
    row = session.connection().execute(_STANDING, asked).one()
    return _checked(row[3:], media_type, sha256), Quota(*row[:3])


def accept(session: Session, device_id: str, upload: Upload, *, now: dt.datetime) -> tuple[str, bool]:
    """Store the row of an upload; its id, and whether it was there already.

    The device's row is locked: its chain grows one link at a time, and a key that is sent twice at
    once is stored once.
    """
    connection, key = session.connection(), upload.key
    device = connection.execute(_LOCKED, {"device_id": device_id}).one()
    if device.revoked_at is not None:
        raise UnauthenticatedError("The device is revoked")
    seen: dict[str, Any] = {"device_id": device_id, "last_seen_at": now}
    if upload.notes.configuration is not None:
        seen["configuration_seen"] = upload.notes.configuration
    asked = {"device_id": device_id, "stream": key.stream, "boot": key.boot, "sequence": key.sequence}
    stored = _checked(connection.execute(_KNOWN, asked).first(), upload.media_type, upload.body_sha256)
    if stored is not None:
        connection.execute(_UPDATE_DEVICE, seen)
        return stored, True
    chain = link(
        device.chain_head or device_id,
        body_sha256=upload.body_sha256,
        column_sha256=upload.column_sha256,
        stream=key.stream,
        boot=key.boot,
        sequence=key.sequence,
        received_at=now,
    )
    t = upload.columns.values["t"]
    batch_id = new_id()
    row = {
        **asked,
        "id": batch_id,
        "organisation_id": device.organisation_id,
        "media_type": upload.media_type,
        "body_sha256": upload.body_sha256,
        "column_sha256": upload.column_sha256,
        "blob_key": upload.blob_key,
        "body_key": upload.body_key,
        "stored_bytes": upload.stored_bytes,
        "rows": upload.columns.rows,
        "t_first_s": float(t.min()),
        "t_last_s": float(t.max()),
        "received_at": now,
        "sent_t_s": upload.notes.sent_t_s,
        "chain_index": device.chain_length,
        "chain_sha256": chain,
        "remarks": remarks_on(upload.columns),
    }
    connection.execute(_INSERT_BATCH, row)
    answered(session, device_id, upload.notes.answers, batch_id, now=now)
    _extend_runs(connection, device_id, key)
    if upload.columns.named:
        keep(session, device_id, _named(upload.columns, now), now=now)
    quota = counted(Quota(device.quota_day, device.quota_bytes, device.bytes_per_day), upload.sent_bytes, now=now)
    grown = {"chain_length": device.chain_length + 1, "chain_head": chain}
    connection.execute(_UPDATE_DEVICE, {**seen, **grown, "quota_day": quota.day, "quota_bytes": quota.used})
    announce(
        session,
        "batch",
        at=now,
        organisation_id=device.organisation_id,
        device_id=device_id,
        vehicle_id=device.vehicle_id,
        data={"stream": key.stream, "rows": upload.columns.rows},
    )
    return batch_id, False


def _named(columns: Columns, now: dt.datetime) -> list[Reading]:
    """Diagnosis values that came with the batch, at the time of its fixes, or else of its arrival."""
    t, utc = columns.values["t"], columns.values.get("utc", np.full(1, np.nan))
    offsets = (utc - t)[np.isfinite(utc)] if utc.size == t.size else np.empty(0)
    offset_s = float(np.median(offsets)) if offsets.size else now.timestamp() - float(t.max())
    return [
        reading
        for name, (times, values) in columns.named.items()
        for reading in per_minute(name, offset_s + times, values)
    ]


def _extend_runs(connection: Connection, device_id: str, key: BatchKey) -> None:
    """Count a new sequence into the runs: it lengthens one, joins two, or begins its own."""
    of_boot = {"of_device": device_id, "of_stream": key.stream, "of_boot": key.boot}
    runs = connection.execute(_NEIGHBOURS, {**of_boot, "next": key.sequence + 1}).all()
    above = runs[0] if runs and runs[0].first == key.sequence + 1 else None
    below = next((run for run in runs if run.last == key.sequence - 1), None)
    if below is None and above is None:
        began = {"device_id": device_id, "stream": key.stream, "boot": key.boot}
        connection.execute(_INSERT_RUN, {**began, "first": key.sequence, "last": key.sequence})
    elif below is None:
        connection.execute(_UPDATE_RUN, {**of_boot, "of_first": key.sequence + 1, "first": key.sequence})
    else:
        if above is not None:
            connection.execute(_DELETE_RUN, {**of_boot, "of_first": above.first})
        last = key.sequence if above is None else above.last
        connection.execute(_UPDATE_RUN, {**of_boot, "of_first": below.first, "last": last})


BLOW_MPS2 = 14.8
"""A sample of this size or more: 0.8 km/h in 20 ms, the start of an event by 49 CFR 563, beside gravity."""


def may_hold_a_blow(columns: Columns) -> bool:
    """Whether anything in a checked batch could begin an event; its body is then kept as it came."""
    force = [columns.samples[name] for name in ("fx", "fy", "fz") if name in columns.samples]
    if not force:
        return False
    squares = sum(axis * axis for axis in force)
    return bool(np.max(squares, initial=0.0) >= BLOW_MPS2**2)


def readings(columns: Columns) -> int:
    """Rows with a reading of the accelerometer."""
    force = columns.samples.get("fx")
    return 0 if force is None else force.size


def remarks_on(columns: Columns) -> list[dict[str, str]]:
    """What a reader of the results must know of these rows."""
    remarks = [{"code": remark.code, "detail": remark.detail} for remark in columns.remarks]
    steps = np.diff(columns.values["t"])
    back = int(np.count_nonzero(steps < 0.0))
    if back:
        remarks.append({"code": "rows_out_of_order", "detail": f"Time goes back {back} times within the batch"})
    return remarks
