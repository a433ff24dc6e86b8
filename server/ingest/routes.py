"""Uploading over HTTP."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from typing import Annotated, cast

from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Header, Request

from server.accounts.access import Caller, DeviceCaller
from server.database import Database
from server.devices.provisioning import check_quota
from server.edge import Wake, parts_for_box
from server.errors import TooManyRequestsError, UnauthenticatedError
from server.formats.decode import MEDIA_TYPES, decode, media_type_of
from server.formats.encoding import encoding_of, unpack
from server.ingest import queries, service, standing
from server.ingest.body import read_body
from server.ingest.schemas import Acknowledgement
from server.limits import TokenBuckets
from server.problems import described
from server.settings import Settings
from server.store import BlobStore, blob_key
from server.telemetry import Telemetry
from server.tracing import tracer

PATH = "/api/v1/batches"

router = APIRouter(tags=["devices"])


@dataclass(frozen=True, slots=True)
class _Sent:
    """What a request says of its body."""

    key: service.BatchKey
    media_type: str
    notes: service.BoxNotes
    size: int


_SHAPES: dict[str, dict[str, object]] = {
    "application/json": {"type": "object", "required": ["columns"]},
    "text/csv": {"type": "string"},
}
_BODY = {
    "requestBody": {
        "required": True,
        "content": {
            media_type: {"schema": _SHAPES.get(media_type, {"type": "string", "format": "binary"})}
            for media_type in MEDIA_TYPES
        },
    }
}


@router.post(PATH, status_code=202, openapi_extra=_BODY, responses=described(408, 409, 413, 415, 429, 503, 507))
async def upload(
    request: Request,
    caller: DeviceCaller,
    idempotency_key: Annotated[str | None, Header(description="<boot>/<sequence>")] = None,
    scatola_stream: Annotated[str | None, Header(description="continuous or burst")] = None,
    scatola_sent_at: Annotated[str | None, Header(description="the box's clock now, s since boot")] = None,
    scatola_configuration: Annotated[str | None, Header(description="version of the configuration it uses")] = None,
    scatola_answers: Annotated[str | None, Header(description="ids of requests that this batch answers")] = None,
    content_type: Annotated[str, Header()] = "",
    content_encoding: Annotated[str, Header()] = "",
) -> Acknowledgement:
    """Store a batch of columns; once this answers 202 it is durable and will be worked off."""
    state = request.app.state
    settings, database, store, now = parts_for_box(request)
    wait_s = cast("TokenBuckets", state.uploads).take(cast("str", caller.device_id), now.timestamp())
    if wait_s > 0.0:
        seconds = int(wait_s) + 1
        raise TooManyRequestsError(f"Too many uploads; try again in {seconds} s", retry_after_s=seconds)
    key = service.key_of(idempotency_key, scatola_stream)
    notes = service.notes_of(scatola_sent_at, scatola_configuration, scatola_answers)
    media_type = media_type_of(content_type)
    encoding = encoding_of(content_encoding)
    packed = await read_body(request, settings.max_body_bytes)
    if caller.signed_body_sha256 not in (None, service.bytes_sha256(packed)):
        raise UnauthenticatedError("The body is not the one that was signed", code="signature")
    sent = _Sent(key, media_type, notes, len(packed))

    def work() -> tuple[Acknowledgement, int, int]:
        body = unpack(packed, encoding, max_bytes=settings.max_decoded_bytes)
        return _store(settings, database, store, caller, sent, body, now)

    answer, rows, readings = await to_thread.run_sync(work, limiter=cast("CapacityLimiter", state.upload_slots))
    telemetry = cast("Telemetry", state.telemetry)
    telemetry.batches.labels("duplicate" if answer.duplicate else "accepted").inc()
    if not answer.duplicate:
        telemetry.batch_bytes.inc(len(packed))
        telemetry.batch_rows.inc(rows)
        telemetry.batch_readings.inc(readings)
        wake = state.wake_burst if key.stream == "burst" else state.wake
        cast("Wake", wake)(cast("str", caller.device_id))
    return answer


def _store(
    settings: Settings,
    database: Database,
    store: BlobStore,
    caller: Caller,
    sent: _Sent,
    body: bytes,
    now: dt.datetime,
) -> tuple[Acknowledgement, int, int]:
    """The answer, how many rows are new, and how many of them have an accelerometer reading."""
    device_id, key, media_type = cast("str", caller.device_id), sent.key, sent.media_type
    sha256 = service.bytes_sha256(body)
    with database.glance() as connection:
        before = standing.read(connection, device_id, key, sent.notes, now=now)
    # Most repeats end here, undecoded.
    stored = before.repeated(media_type, sha256)
    if stored is not None:
        return _answer(service.Accepted(stored, True, before), now), 0, 0
    check_quota(before.quota, sent.size, limit=settings.device_bytes_per_day, burst=key.stream == "burst", now=now)
    with tracer.start_as_current_span("decode"):
        columns = decode(media_type, body, max_decoded_bytes=settings.max_decoded_bytes)
    column_sha256 = columns.column_sha256()
    parquet = columns.to_parquet()
    stored_key = blob_key(caller.organisation_id, device_id, column_sha256, "parquet")
    with tracer.start_as_current_span("store blob"):
        store.put(stored_key, parquet)
    keeps = key.stream == "burst" or service.may_hold_a_blow(columns)
    body_key = blob_key(caller.organisation_id, device_id, sha256, "body") if keeps else None
    if body_key is not None:
        store.put(body_key, body)
    made = service.Upload(
        key=key,
        media_type=media_type,
        body_sha256=sha256,
        columns=columns,
        column_sha256=column_sha256,
        blob_sha256=service.bytes_sha256(parquet),
        blob_key=stored_key,
        body_key=body_key,
        stored_bytes=len(parquet) + (len(body) if body_key is not None else 0),
        sent_bytes=sent.size,
        notes=sent.notes,
    )
    with tracer.start_as_current_span("commit row"), database.transaction() as session:
        accepted = service.accept(session, device_id, made, now=now, before=before)
    answer = _answer(accepted, now)
    return (answer, 0, 0) if answer.duplicate else (answer, columns.rows, service.readings(columns))


def _answer(accepted: service.Accepted, now: dt.datetime) -> Acknowledgement:
    progress = queries.progress(accepted.standing.runs)
    return Acknowledgement(
        batch_id=accepted.batch_id,
        duplicate=accepted.duplicate,
        next_sequence=progress.next_sequence,
        missing=progress.missing,
        server_time=now,
        requests=accepted.standing.told,
    )
