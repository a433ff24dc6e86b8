"""Bulk export over HTTP; each is a permission of its own and an entry in the audit log."""

from __future__ import annotations

import datetime as dt
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request
from starlette.responses import StreamingResponse

from server.accounts import audit
from server.accounts.access import Caller, Exporter, address_of, needs
from server.bulk.service import Kind, Wanted, export
from server.database import Database
from server.edge import DatabaseOf, Moment, Now, StoreOf
from server.store import BlobStore

router = APIRouter(prefix="/api/v1/export", tags=["export"])

MEDIA_TYPE = "application/vnd.apache.parquet"
_FILE: dict[int | str, dict[str, Any]] = {
    200: {"content": {MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}}}
}

Located = Annotated[Caller, Depends(needs("location.read"))]
Raw = Annotated[Caller, Depends(needs("raw.read"))]
Device = Annotated[str | None, Query(max_length=32)]
Since = Annotated[Moment | None, Query(alias="from")]
Until = Annotated[Moment | None, Query(alias="to")]


def _stream(
    request: Request, caller: Caller, database: Database, store: BlobStore, wanted: Wanted, now: dt.datetime
) -> StreamingResponse:
    with database.transaction() as session:
        # Not as a look: each one is written down, also when it is repeated.
        address = address_of(request)
        audit.record(session, caller, "export", wanted.kind, now=now, address=address, detail=wanted.told())
    name = f"{wanted.kind}-{now:%Y%m%dT%H%M%SZ}.parquet"
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return StreamingResponse(export(database, store, wanted), media_type=MEDIA_TYPE, headers=headers)


@router.get("/tracks", response_class=StreamingResponse, responses=_FILE)
def export_tracks(
    request: Request,
    caller: Exporter,
    located: Located,
    database: DatabaseOf,
    store: StoreOf,
    now: Now,
    device: Device = None,
    since: Since = None,
    until: Until = None,
) -> StreamingResponse:
    """The 1 Hz tracks of all trips that began in a time, as Parquet."""
    del located
    return _stream(request, caller, database, store, _wanted("tracks", device, since, until), now)


@router.get("/events", response_class=StreamingResponse, responses=_FILE)
def export_events(
    request: Request,
    caller: Exporter,
    located: Located,
    database: DatabaseOf,
    store: StoreOf,
    now: Now,
    device: Device = None,
    since: Since = None,
    until: Until = None,
) -> StreamingResponse:
    """All events of a time as Parquet; `result` holds the whole of each as JSON."""
    del located
    return _stream(request, caller, database, store, _wanted("events", device, since, until), now)


@router.get("/samples", response_class=StreamingResponse, responses=_FILE)
def export_samples(
    request: Request,
    caller: Exporter,
    located: Located,
    raw: Raw,
    database: DatabaseOf,
    store: StoreOf,
    now: Now,
    device: Device = None,
    since: Since = None,
    until: Until = None,
) -> StreamingResponse:
    """The samples of all batches that arrived in a time, in the columns of a drive file, as Parquet."""
    del located, raw
    return _stream(request, caller, database, store, _wanted("samples", device, since, until), now)


def _wanted(kind: Kind, device: str | None, since: dt.datetime | None, until: dt.datetime | None) -> Wanted:
    return Wanted(kind, device, since, until)
