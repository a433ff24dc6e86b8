"""Accepting a batch: check, make durable, commit, answer; nothing is estimated here."""

from __future__ import annotations

import datetime as dt
import hashlib
import re
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, cast

import numpy as np
from sqlalchemy import Connection, Table, and_, bindparam, delete, insert, select, update
from sqlalchemy.orm import Session

from server.devices.provisioning import answered, counted
from server.diagnosis.service import Reading, keep, per_minute
from server.errors import InvalidError, UnauthenticatedError
from server.formats.columns import Columns
from server.ingest import queries, standing
from server.ingest.chain import link
from server.ingest.queries import Runs
from server.ingest.standing import Standing
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
    blob_sha256: str
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


def bytes_sha256(body: bytes) -> str:
    """Hash of a body once its Content-Encoding is undone, or of a blob."""
    return hashlib.sha256(body).hexdigest()


# Statements are built once, and rows written without the mapper's unit of work: it would cost most of an upload.
_BATCHES, _DEVICES, _RUNS = (cast("Table", row.__table__) for row in (Batch, Device, SequenceRun))
_LOCK = select(_DEVICES.c.id).where(_DEVICES.c.id == bindparam("device_id")).with_for_update()
_SEEN = update(_DEVICES).where(_DEVICES.c.id == bindparam("device_id"))
_GROW = (
    update(_DEVICES)
    .where(
        _DEVICES.c.id == bindparam("device_id"),
        _DEVICES.c.chain_length == bindparam("length_before"),
        _DEVICES.c.chain_head == bindparam("head_before"),
        _DEVICES.c.revoked_at.is_(None),
    )
    .returning(_DEVICES.c.organisation_id, _DEVICES.c.vehicle_id)
)
_INSERT_BATCH = insert(_BATCHES)
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


class Accepted(NamedTuple):
    """What became of an upload, and where the box stands now."""

    batch_id: str
    duplicate: bool
    standing: Standing


def accept(
    session: Session, device_id: str, upload: Upload, *, now: dt.datetime, before: Standing | None = None
) -> Accepted:
    """Store the row of an upload.

    A box's chain grows one link at a time, and a key that is sent twice at once is stored once: either the chain is
    still as it was when `before` was read, or its row is locked and all is read again.
    """
    connection, key = session.connection(), upload.key
    grown = None if before is None else _grow(connection, device_id, upload, before, now)
    if before is None or grown is None:
        connection.execute(_LOCK, {"device_id": device_id})
        before = standing.read(connection, device_id, key, upload.notes, now=now)
        if before.revoked_at is not None:
            raise UnauthenticatedError("The device is revoked")
        stored = before.repeated(upload.media_type, upload.body_sha256)
        if stored is not None:
            connection.execute(_SEEN, {"device_id": device_id, **_seen(upload, now)})
            return Accepted(stored, True, before)
        grown = _grow(connection, device_id, upload, before, now)
        assert grown is not None  # nobody else can: the row is locked
    batch_id = new_id()
    connection.execute(
        _INSERT_BATCH,
        {
            "id": batch_id,
            "device_id": device_id,
            "organisation_id": grown.organisation_id,
            "received_at": now,
            "chain_index": before.chain_length,
            "chain_sha256": grown.link,
            **_described(upload),
        },
    )
    answered(session, device_id, upload.notes.answers, batch_id, now=now)
    runs = _extend_runs(connection, device_id, key, before.runs)
    if upload.columns.named:
        keep(session, device_id, _named(upload.columns, now), now=now)
    announce(
        session,
        "batch",
        at=now,
        organisation_id=grown.organisation_id,
        device_id=device_id,
        vehicle_id=grown.vehicle_id,
        data={"stream": key.stream, "rows": upload.columns.rows},
    )
    return Accepted(batch_id, False, before.after(runs, upload.notes.answers))


class _Grown(NamedTuple):
    """A box whose chain has one link more."""

    organisation_id: str
    vehicle_id: str | None
    link: str


def _grow(connection: Connection, device_id: str, upload: Upload, before: Standing, now: dt.datetime) -> _Grown | None:
    """Add a link to the box's chain; None where it is no longer as it was, or the box is revoked."""
    chain = link(
        before.chain_head or device_id,
        body_sha256=upload.body_sha256,
        column_sha256=upload.column_sha256,
        stream=upload.key.stream,
        boot=upload.key.boot,
        sequence=upload.key.sequence,
        received_at=now,
    )
    quota = counted(before.quota, upload.sent_bytes, now=now)
    values = {
        "device_id": device_id,
        "length_before": before.chain_length,
        "head_before": before.chain_head,
        "chain_length": before.chain_length + 1,
        "chain_head": chain,
        "quota_day": quota.day,
        "quota_bytes": quota.used,
    }
    row = connection.execute(_GROW, {**values, **_seen(upload, now)}).first()
    return None if row is None else _Grown(row[0], row[1], chain)


def _seen(upload: Upload, now: dt.datetime) -> dict[str, Any]:
    """What an upload shows of a box, stored or not."""
    told = upload.notes.configuration
    return {"last_seen_at": now} if told is None else {"last_seen_at": now, "configuration_seen": told}


def _described(upload: Upload) -> dict[str, Any]:
    """A batch's row as far as the upload says."""
    t = upload.columns.values["t"]
    return {
        "stream": upload.key.stream,
        "boot": upload.key.boot,
        "sequence": upload.key.sequence,
        "media_type": upload.media_type,
        "body_sha256": upload.body_sha256,
        "column_sha256": upload.column_sha256,
        "blob_sha256": upload.blob_sha256,
        "blob_key": upload.blob_key,
        "body_key": upload.body_key,
        "stored_bytes": upload.stored_bytes,
        "rows": upload.columns.rows,
        "t_first_s": float(t.min()),
        "t_last_s": float(t.max()),
        "sent_t_s": upload.notes.sent_t_s,
        "remarks": remarks_on(upload.columns),
    }


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


def _extend_runs(connection: Connection, device_id: str, key: BatchKey, runs: Runs) -> Runs:
    """Count a new sequence into the runs: it lengthens one, joins two, or begins its own."""
    of_boot = {"of_device": device_id, "of_stream": key.stream, "of_boot": key.boot}
    whole = len(runs) <= queries.MAX_RANGES
    near = runs if whole else connection.execute(_NEIGHBOURS, {**of_boot, "next": key.sequence + 1}).all()
    above = next((run for run in near if run[0] == key.sequence + 1), None)
    below = next((run for run in near if run[1] == key.sequence - 1), None)
    first = key.sequence if below is None else below[0]
    last = key.sequence if above is None else above[1]
    if below is None and above is None:
        began = {"device_id": device_id, "stream": key.stream, "boot": key.boot}
        connection.execute(_INSERT_RUN, {**began, "first": first, "last": last})
    elif below is None:
        connection.execute(_UPDATE_RUN, {**of_boot, "of_first": key.sequence + 1, "first": first})
    else:
        if above is not None:
            connection.execute(_DELETE_RUN, {**of_boot, "of_first": above[0]})
        connection.execute(_UPDATE_RUN, {**of_boot, "of_first": first, "last": last})
    if not whole:
        return queries.runs(connection, device_id, key.stream, key.boot)
    return sorted([*(run for run in runs if run not in (below, above)), (first, last)])


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
