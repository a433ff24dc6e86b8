"""Analyses over HTTP."""

from __future__ import annotations

import datetime as dt
import hashlib
from typing import Annotated, Any, cast

from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from server.accounts.access import Caller, RawReader, look
from server.analyses import kinds, queries, service
from server.analyses.kinds import Kind
from server.analyses.schemas import AnalysisList, AnalysisOut
from server.database import Database
from server.edge import DatabaseOf, Now, StoreOf
from server.errors import ConflictError, ForbiddenError, InvalidError, NotFoundError
from server.ingest.body import read_body
from server.models import Analysis
from server.problems import described
from server.store import BlobStore
from server.trips.queries import trip_of

PATH = "/api/v1/analyses"
MAX_FILE_BYTES = 64 * 1024 * 1024

router = APIRouter(tags=["workbench"])

_BODY = {
    "requestBody": {
        "required": False,
        "description": "the recording, in any format of docs/device-protocol.md, unless `trip` or `again` names one",
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}


@router.post(PATH, status_code=202, openapi_extra=_BODY, responses=described(409, 413, 429))
async def ask(
    request: Request,
    caller: RawReader,
    database: DatabaseOf,
    store: StoreOf,
    now: Now,
    kind: Annotated[Kind, Query()],
    name: Annotated[str, Query(min_length=1, max_length=200, description="of the file, for people")] = "recording",
    parameters: Annotated[str, Query(max_length=2000, description="JSON object, by kind")] = "{}",
    trip: Annotated[str | None, Query(max_length=32, description="analyse the stored data of this trip")] = None,
    again: Annotated[str | None, Query(max_length=32, description="the recording of this analysis")] = None,
) -> AnalysisOut:
    """Ask for an analysis of a recording; a worker does it.  The answer tells where to look."""
    checked = kinds.checked(kind, parameters)
    see(request, caller, kind)
    if trip is not None or again is not None:
        if trip is not None and again is not None:
            raise InvalidError("Either trip or again", code="two_recordings")
        return await to_thread.run_sync(lambda: asked_of_stored(database, caller, kind, checked, trip, again, now))
    body = await read_body(request, MAX_FILE_BYTES)
    limiter = cast("CapacityLimiter", request.app.state.upload_slots)
    return await to_thread.run_sync(
        lambda: asked_of_file(database, store, caller, kind, checked, name, body, now), limiter=limiter
    )


def asked_of_stored(
    database: Database,
    caller: Caller,
    kind: Kind,
    parameters: dict[str, Any],
    trip: str | None,
    again: str | None,
    now: dt.datetime,
) -> AnalysisOut:
    """Ask for an analysis of a trip, or of another analysis' recording."""
    with database.transaction() as session:
        service.check_room(session, caller.organisation_id, 0)
        if trip is not None:
            found = trip_of(session, caller.organisation_id, trip)
            return AnalysisOut.of(service.of_trip(session, caller, kind, parameters, found, now=now))
        before = queries.analysis_of(session, caller.organisation_id, again or "")
        return AnalysisOut.of(service.again(session, caller, kind, parameters, before, now=now))


def asked_of_file(
    database: Database,
    store: BlobStore,
    caller: Caller,
    kind: Kind,
    parameters: dict[str, Any],
    name: str,
    body: bytes,
    now: dt.datetime,
) -> AnalysisOut:
    """Keep a file and ask for its analysis; the blob is durable before the row speaks of it."""
    if not body:
        raise InvalidError("The file is empty", code="empty")
    with database.reading() as session:
        service.check_room(session, caller.organisation_id, len(body))
    sha256 = hashlib.sha256(body).hexdigest()
    store.put(service.file_key(caller.organisation_id, sha256, "input"), body)
    with database.transaction() as session:
        row = service.of_file(session, caller, kind, parameters, name=name, sha256=sha256, size=len(body), now=now)
        return AnalysisOut.of(row)


@router.get(PATH)
def get_analyses(
    caller: RawReader, database: DatabaseOf, limit: Annotated[int, Query(ge=1, le=500)] = 100
) -> AnalysisList:
    """The organisation's analyses, the newest first."""
    with database.reading() as session:
        rows = queries.analyses(session, caller.organisation_id, limit=limit)
        return AnalysisList(items=[AnalysisOut.of(row) for row in rows])


@router.get(PATH + "/{analysis_id}")
def get_analysis(analysis_id: str, caller: RawReader, database: DatabaseOf) -> AnalysisOut:
    """How an analysis stands."""
    with database.reading() as session:
        return AnalysisOut.of(queries.analysis_of(session, caller.organisation_id, analysis_id))


@router.get(
    PATH + "/{analysis_id}/result",
    response_class=Response,
    responses={200: {"content": {"application/json": {"schema": {"type": "object"}}}}, **described(409)},
)
def get_result(request: Request, analysis_id: str, caller: RawReader, database: DatabaseOf, store: StoreOf) -> Response:
    """The document that came out, as the command line prints it and with what the plots show."""
    with database.reading() as session:
        row = queries.analysis_of(session, caller.organisation_id, analysis_id)
    see(request, caller, cast("Kind", row.kind))
    body = result_of(store, row)
    headers = {"Content-Disposition": f'attachment; filename="{row.kind}-{row.id}.json"'}
    return Response(body, media_type="application/json", headers=headers)


@router.post(PATH + "/{analysis_id}/cancel")
def cancel(analysis_id: str, caller: RawReader, database: DatabaseOf, now: Now) -> AnalysisOut:
    """Give an analysis up; one that is finished stays as it is."""
    with database.transaction() as session:
        return AnalysisOut.of(service.cancel(session, caller.organisation_id, analysis_id, now=now))


@router.delete(PATH + "/{analysis_id}", status_code=204, responses=described(409))
def delete(analysis_id: str, caller: RawReader, database: DatabaseOf, now: Now) -> None:
    """Throw an analysis away with its file, which is gone within a day."""
    with database.transaction() as session:
        service.delete(session, caller, analysis_id, now=now)


def see(request: Request, caller: Caller, kind: Kind) -> None:
    """Refuse a kind that tells of places, or write down that they are seen."""
    if kind in kinds.WITH_PLACES:
        if not caller.may("location.read"):
            raise ForbiddenError(f"An analysis of the kind {kind} needs the permission location.read")
        look(request, caller, "location.read")


def result_of(store: BlobStore, row: Analysis) -> bytes:
    """The result's bytes, which have the hash that the row tells."""
    if row.result_key is None:
        raise ConflictError(f"The analysis is {row.status}; there is no result", code="no_result")
    try:
        body = store.get(row.result_key)
    except KeyError:
        raise NotFoundError("The result is no longer there") from None
    if hashlib.sha256(body).hexdigest() != row.result_sha256:
        raise ConflictError("The stored result is damaged; ask for the analysis again", code="damaged")
    return body
