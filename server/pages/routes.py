"""The HTML pages."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Request
from starlette.responses import HTMLResponse

from server.accounts.access import Caller, reader
from server.database import Database
from server.pages import queries
from server.pages.templating import renderer
from server.pages.words import BEGINNINGS, STATUSES
from server.settings import Settings

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)

Reader = Annotated[Caller, Depends(reader)]


def _frame(request: Request, caller: Caller, section: str) -> dict[str, object]:
    """What the frame around every page needs."""
    settings: Settings = request.app.state.settings
    return {
        "section": section,
        "csrf_token": caller.csrf_token or "",
        "signed_in": caller.kind == "session",
        "map_tiles_url": settings.map_tiles_url or "",
    }


@router.get("/")
def fleet(request: Request, caller: Reader) -> HTMLResponse:
    """Map, what needs attention, and every box."""
    database: Database = request.app.state.database
    with database.reading() as session:
        found = queries.fleet(session, caller.organisation_id, now=request.app.state.clock())
    return renderer(request.app)("fleet.html", {**_frame(request, caller, "fleet"), "fleet": found})


@router.get("/vehicles")
def vehicles(request: Request, caller: Reader) -> HTMLResponse:
    """Every vehicle, also those without a box."""
    database: Database = request.app.state.database
    with database.reading() as session:
        found = queries.fleet(session, caller.organisation_id, now=request.app.state.clock())
    return renderer(request.app)("vehicles.html", {**_frame(request, caller, "vehicles"), "fleet": found})


@router.get("/vehicles/{vehicle_id}")
def vehicle(request: Request, caller: Reader, vehicle_id: str) -> HTMLResponse:
    """A vehicle and the box in it."""
    database: Database = request.app.state.database
    with database.reading() as session:
        found, page, boxes = queries.vehicle_page(
            session, caller.organisation_id, vehicle_id, now=request.app.state.clock()
        )
    context = {**_frame(request, caller, "vehicles"), "vehicle": found, "page": page, "boxes": boxes}
    return renderer(request.app)("vehicle.html", {**context, "beginnings": BEGINNINGS, "statuses": STATUSES})


@router.get("/devices/{device_id}")
def device(request: Request, caller: Reader, device_id: str) -> HTMLResponse:
    """A box by itself, in a vehicle or not."""
    database: Database = request.app.state.database
    with database.reading() as session:
        page = queries.device_page(session, caller.organisation_id, device_id, now=request.app.state.clock())
    context = {**_frame(request, caller, "vehicles"), "vehicle": page.box.vehicle, "page": page, "boxes": 1}
    return renderer(request.app)("vehicle.html", {**context, "beginnings": BEGINNINGS, "statuses": STATUSES})
