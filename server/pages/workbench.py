"""The engineers' pages: the workbench with its analyses, and the live monitor of a box."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, cast

import orjson
from anyio import to_thread
from fastapi import APIRouter, Query, Request
from sqlalchemy.orm import Session
from starlette.datastructures import UploadFile
from starlette.responses import HTMLResponse, RedirectResponse, Response

from server.accounts.access import Caller, RawReader
from server.analyses import kinds, service
from server.analyses import queries as analyses
from server.analyses.kinds import Kind
from server.analyses.routes import asked_of_file, asked_of_stored, result_of, see
from server.database import Database
from server.edge import DatabaseOf, Now, StoreOf
from server.errors import ConflictError, InvalidError, NotFoundError, TooLargeError, TooManyRequestsError
from server.models import Analysis, Device, Trip, Vehicle
from server.pages import queries
from server.pages.routes import answer
from server.pages.words import STATUSES
from server.pages.workbench_plots import METHODS, shown
from server.trips.queries import trips
from server.wording import marked

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)

PATH = "/workbench"
LISTED = 100
NOTHING = marked("Choose a file or a trip.")
KIND_WORDS: dict[str, str] = {
    "allan": marked("Allan deviation"),
    "accelerometer": marked("Accelerometer from poses"),
    "gyro": marked("Gyro on a turntable"),
    "magnetometer": marked("Magnetometer, hard and soft iron"),
    "track": marked("Track against GPS"),
    "mounting": marked("Estimators of the mounting"),
}
STATES = {
    "waiting": ("unknown", marked("Waiting")),
    "running": ("attention", marked("Under way")),
    "done": ("good", marked("Done")),
    "failed": ("alarm", marked("Failed")),
    "cancelled": ("unknown", marked("Cancelled")),
}
TERMS = {
    "N": marked("White noise"),
    "B": marked("Bias instability"),
    "K": marked("Random walk"),
    "Q": marked("Quantisation"),
}
TRACK_METHODS = {
    "inertial-gnss": marked("gyro, accelerometer and GPS"),
    "position-velocity": marked("accelerometer and GPS"),
}
REFERENCES = {
    "given": marked("Reference: the mounting that was entered for the box."),
    "estimate": marked("Reference: the estimate from the whole drive, or else the surest; no mounting was entered."),
    "none": marked("No estimator found a mounting that could be the reference."),
}


@router.get(PATH)
def workbench(
    request: Request,
    caller: RawReader,
    database: DatabaseOf,
    kind: Annotated[Kind, Query()] = "allan",
    trip: Annotated[str | None, Query(max_length=32)] = None,
    again: Annotated[str | None, Query(max_length=32)] = None,
) -> HTMLResponse:
    """Ask for an analysis, and find those that were asked for."""
    return _workbench(request, caller, database, kind, trip, again)


@router.post(PATH)
async def ask(request: Request, caller: RawReader, database: DatabaseOf, store: StoreOf, now: Now) -> Response:
    """The page's form: a file, a trip or another analysis' recording, and settings."""
    async with request.form(max_files=1, max_fields=40) as form:
        typed = {name: value for name, value in form.items() if isinstance(value, str)}
        file = form.get("file")
        body, name = (await file.read(), file.filename) if isinstance(file, UploadFile) else (b"", None)
    known: list[Kind] = [one for one in kinds.KINDS if one == typed.get("kind")]
    kind = known[0] if known else "allan"
    trip, again = typed.get("trip") or None, typed.get("again") or None

    def asked() -> str:
        if not known:
            raise InvalidError("kind: not one of the list")
        parameters = kinds.from_form(kind, typed)
        see(request, caller, kind)
        if trip is not None or again is not None:
            return asked_of_stored(database, caller, kind, parameters, trip, again, now).id
        if not body:
            raise InvalidError(NOTHING)
        return asked_of_file(database, store, caller, kind, parameters, (name or "file")[-200:], body, now).id

    try:
        return RedirectResponse(f"{PATH}/{await to_thread.run_sync(asked)}", 303)
    except (InvalidError, ConflictError, TooLargeError, TooManyRequestsError) as error:
        problem, status = error.detail, error.status
    page = await to_thread.run_sync(lambda: _workbench(request, caller, database, kind, trip, again, problem))
    page.status_code = status
    return page


def _workbench(
    request: Request,
    caller: Caller,
    database: Database,
    kind: Kind,
    trip: str | None,
    again: str | None,
    problem: str | None = None,
) -> HTMLResponse:
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        before = None if again is None else analyses.analysis_of(session, caller.organisation_id, again)
        listed = analyses.analyses(session, caller.organisation_id, limit=LISTED)
        known = trips(session, caller.organisation_id, limit=LISTED)
        named = _named(session, known)
    context = {
        "kinds": KIND_WORDS,
        "states": STATES,
        "chosen": kind,
        "before": before,
        "analyses": listed,
        "trips": named,
        "trip_id": trip,
        "problem": problem,
    }
    return answer(request, "workbench.html", caller, "workbench", change, context)


def _named(session: Session, known: Sequence[Trip]) -> list[tuple[Trip, str]]:
    """Trips with the names of their vehicles, or of their boxes."""
    named: list[tuple[Trip, str]] = []
    for trip in known:
        vehicle = None if trip.vehicle_id is None else session.get(Vehicle, trip.vehicle_id)
        named.append((trip, (vehicle or session.get_one(Device, trip.device_id)).name))
    return named


@router.get("/workbench/{analysis_id}")
def analysis(
    request: Request,
    analysis_id: str,
    caller: RawReader,
    database: DatabaseOf,
    store: StoreOf,
    show: Annotated[str, Query(pattern="^(angles|apart)$")] = "angles",
) -> HTMLResponse:
    """How an analysis stands, and what came out."""
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        row = analyses.analysis_of(session, caller.organisation_id, analysis_id)
    kind = cast("Kind", row.kind)
    see(request, caller, kind)
    document, lost = _document(row, store) if row.status == "done" else (None, None)
    apart = show == "apart"
    context = {
        "analysis": row,
        "kinds": KIND_WORDS,
        "states": STATES,
        "terms": TERMS,
        "methods": METHODS,
        "track_methods": TRACK_METHODS,
        "references": REFERENCES,
        "statuses": STATUSES,
        "document": document,
        "lost": lost,
        "apart": apart,
        "shown": None if document is None else shown(kind, document, apart=apart),
        "zip_reasons": _reasons,
        "deletable": service.may_delete(caller, row),
    }
    return answer(request, "analysis.html", caller, "workbench", change, context)


def _document(row: Analysis, store: StoreOf) -> tuple[dict[str, Any] | None, str | None]:
    try:
        return orjson.loads(result_of(store, row)), None
    except (ConflictError, NotFoundError) as error:
        return None, error.detail


def _reasons(result: dict[str, Any]) -> list[tuple[str, str]]:
    """Names in the catalogues and sentences of an estimate's reasons."""
    return [(f"reason:{code}", text) for code, text in zip(result["reason_codes"], result["reasons"], strict=True)]


@router.post("/workbench/{analysis_id}/cancel")
def cancel(analysis_id: str, caller: RawReader, database: DatabaseOf, now: Now) -> Response:
    """The page's button."""
    with database.transaction() as session:
        service.cancel(session, caller.organisation_id, analysis_id, now=now)
    return RedirectResponse(f"/workbench/{analysis_id}", 303)


@router.post("/workbench/{analysis_id}/delete")
def delete(analysis_id: str, caller: RawReader, database: DatabaseOf, now: Now) -> Response:
    """The page's button."""
    with database.transaction() as session:
        service.delete(session, caller, analysis_id, now=now)
    return RedirectResponse("/workbench", 303)


@router.get("/devices/{device_id}/live")
def monitor(request: Request, device_id: str, caller: RawReader, database: DatabaseOf, now: Now) -> HTMLResponse:
    """The newest samples of a box as they come."""
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        page = queries.device_page(session, caller.organisation_id, device_id, now=now)
    return answer(request, "monitor.html", caller, "vehicles", change, {"page": page})
