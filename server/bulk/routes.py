"""Bulk export over HTTP; each is a permission of its own and an entry in the audit log."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query
from starlette.responses import StreamingResponse

from server.accounts import audit
from server.accounts.access import Caller, Exporter, needs
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


@dataclass(frozen=True, slots=True)
class Asked:
    """What every export is asked with."""

    caller: Caller
    database: Database
    store: BlobStore
    now: dt.datetime
    device_id: str | None
    since: dt.datetime | None
    until: dt.datetime | None

    def stream(self, kind: Kind) -> StreamingResponse:
        """Write the export down, then begin it."""
        wanted = Wanted(kind, self.device_id, self.since, self.until)
        with self.database.transaction() as session:
            # Not as a look: each one is written down, also when it is repeated.
            audit.record(session, self.caller, "export", kind, now=self.now, detail=wanted.told())
        name = f"{kind}-{self.now:%Y%m%dT%H%M%SZ}.parquet"
        headers = {"Content-Disposition": f'attachment; filename="{name}"'}
        return StreamingResponse(export(self.database, self.store, wanted), media_type=MEDIA_TYPE, headers=headers)


async def _asked(
    caller: Exporter,
    database: DatabaseOf,
    store: StoreOf,
    now: Now,
    device: Annotated[str | None, Query(max_length=32)] = None,
    since: Annotated[Moment | None, Query(alias="from")] = None,
    until: Annotated[Moment | None, Query(alias="to")] = None,
) -> Asked:
    return Asked(caller, database, store, now, device, since, until)


# The permission stands beside it, where a reader of the routes and their test look for it.
AskedOf = Annotated[Asked, Depends(_asked)]


@router.get("/tracks", response_class=StreamingResponse, responses=_FILE)
def export_tracks(exporter: Exporter, located: Located, asked: AskedOf) -> StreamingResponse:
    """The 1 Hz tracks of all trips that began in a time, as Parquet."""
    del exporter, located
    return asked.stream("tracks")


@router.get("/events", response_class=StreamingResponse, responses=_FILE)
def export_events(exporter: Exporter, located: Located, asked: AskedOf) -> StreamingResponse:
    """All events of a time as Parquet; `result` holds the whole of each as JSON."""
    del exporter, located
    return asked.stream("events")


@router.get("/samples", response_class=StreamingResponse, responses=_FILE)
def export_samples(exporter: Exporter, located: Located, raw: Raw, asked: AskedOf) -> StreamingResponse:
    """The samples of all batches that arrived in a time, in the columns of a drive file, as Parquet."""
    del exporter, located, raw
    return asked.stream("samples")
