"""Accepting a batch: check, make durable, commit, answer; nothing is estimated here."""

from __future__ import annotations

import datetime as dt
import hashlib
import re
from dataclasses import dataclass
from typing import Literal

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session

from server.devices.provisioning import answered, count_bytes
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


def known(session: Session, device_id: str, key: BatchKey, media_type: str, sha256: str) -> Batch | None:
    """The batch stored under this key, if any; raises when it was another."""
    batch = session.scalar(
        select(Batch).where(
            Batch.device_id == device_id,
            Batch.stream == key.stream,
            Batch.boot == key.boot,
            Batch.sequence == key.sequence,
        )
    )
    if batch is not None and (batch.body_sha256, batch.media_type) != (sha256, media_type):
        raise ConflictError(
            "Another body was stored under this key; a sequence is used once", code="sequence_reused", batch_id=batch.id
        )
    return batch


def accept(session: Session, device_id: str, upload: Upload, *, now: dt.datetime) -> tuple[Batch, bool]:
    """Store the row of an upload, and whether it was there already.

    The device's row is locked: its chain grows one link at a time, and a key that is sent twice at
    once is stored once.
    """
    device = session.get_one(Device, device_id, with_for_update=True)
    if device.revoked_at is not None:
        raise UnauthenticatedError("The device is revoked")
    device.last_seen_at = now
    if upload.notes.configuration is not None:
        device.configuration_seen = upload.notes.configuration
    stored = known(session, device_id, upload.key, upload.media_type, upload.body_sha256)
    if stored is not None:
        return stored, True
    chain = link(
        device.chain_head or device.id,
        body_sha256=upload.body_sha256,
        column_sha256=upload.column_sha256,
        stream=upload.key.stream,
        boot=upload.key.boot,
        sequence=upload.key.sequence,
        received_at=now,
    )
    t = upload.columns.values["t"]
    batch = Batch(
        id=new_id(),
        organisation_id=device.organisation_id,
        device_id=device.id,
        stream=upload.key.stream,
        boot=upload.key.boot,
        sequence=upload.key.sequence,
        media_type=upload.media_type,
        body_sha256=upload.body_sha256,
        column_sha256=upload.column_sha256,
        blob_key=upload.blob_key,
        body_key=upload.body_key,
        stored_bytes=upload.stored_bytes,
        rows=upload.columns.rows,
        t_first_s=float(t.min()),
        t_last_s=float(t.max()),
        received_at=now,
        sent_t_s=upload.notes.sent_t_s,
        chain_index=device.chain_length,
        chain_sha256=chain,
        remarks=remarks_on(upload.columns),
    )
    session.add(batch)
    count_bytes(device, upload.sent_bytes, now=now)
    answered(session, device.id, upload.notes.answers, batch.id, now=now)
    _extend_runs(session, device_id, upload.key)
    if upload.columns.named:
        keep(session, device_id, _named(upload.columns, now), now=now)
    device.chain_length += 1
    device.chain_head = chain
    announce(
        session,
        "batch",
        at=now,
        organisation_id=device.organisation_id,
        device_id=device.id,
        vehicle_id=device.vehicle_id,
        data={"stream": batch.stream, "rows": batch.rows},
    )
    return batch, False


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


def _extend_runs(session: Session, device_id: str, key: BatchKey) -> None:
    """Count a new sequence into the runs: it lengthens one, joins two, or begins its own."""
    of_boot = SequenceRun.device_id == device_id, SequenceRun.stream == key.stream, SequenceRun.boot == key.boot
    below = session.scalar(
        select(SequenceRun)
        .where(*of_boot, SequenceRun.first < key.sequence)
        .order_by(SequenceRun.first.desc())
        .limit(1)
    )
    above = session.get(SequenceRun, (device_id, key.stream, key.boot, key.sequence + 1))
    last = key.sequence if above is None else above.last
    if above is not None:
        session.delete(above)
    if below is not None and below.last == key.sequence - 1:
        below.last = last
    else:
        session.add(SequenceRun(device_id=device_id, stream=key.stream, boot=key.boot, first=key.sequence, last=last))


BLOW_MPS2 = 14.8
"""A sample of this size or more: 0.8 km/h in 20 ms, the start of an event by 49 CFR 563, beside gravity."""


def may_hold_a_blow(columns: Columns) -> bool:
    """Whether anything in a batch could begin an event; its body is then kept as it came."""
    force = [columns.values[name] for name in ("fx", "fy", "fz") if name in columns.values]
    if not force:
        return False
    squares = sum(axis * axis for axis in force)
    return bool(np.nanmax(squares, initial=0.0) >= BLOW_MPS2**2)


def readings(columns: Columns) -> int:
    """Rows with a reading of the accelerometer."""
    force = columns.values.get("fx")
    return 0 if force is None else int(np.count_nonzero(~np.isnan(force)))


def remarks_on(columns: Columns) -> list[dict[str, str]]:
    """What a reader of the results must know of these rows."""
    remarks = [{"code": remark.code, "detail": remark.detail} for remark in columns.remarks]
    steps = np.diff(columns.values["t"])
    back = int(np.count_nonzero(steps < 0.0))
    if back:
        remarks.append({"code": "rows_out_of_order", "detail": f"Time goes back {back} times within the batch"})
    return remarks
