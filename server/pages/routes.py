"""The HTML pages."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request
from starlette.responses import HTMLResponse

from server.accounts.access import Caller, Reader, look
from server.edge import DatabaseOf, Now, SettingsOf
from server.pages import queries
from server.pages.templating import renderer
from server.pages.words import BEGINNINGS, STATUSES

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)


@router.get("/")
def fleet(request: Request, caller: Reader, settings: SettingsOf, database: DatabaseOf, now: Now) -> HTMLResponse:
    """Map, what needs attention, and every box."""
    _look(request, caller)
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        found = queries.fleet(session, caller.organisation_id, now=now)
    context = {"fleet": found, "map_tiles_url": settings.map_tiles_url or ""}
    return answer(request, "fleet.html", caller, "fleet", change, context)


@router.get("/vehicles")
def vehicles(request: Request, caller: Reader, database: DatabaseOf, now: Now) -> HTMLResponse:
    """Every vehicle, also those without a box."""
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        found = queries.fleet(session, caller.organisation_id, now=now)
    return answer(request, "vehicles.html", caller, "vehicles", change, {"fleet": found})


@router.get("/vehicles/{vehicle_id}")
def vehicle(
    request: Request, vehicle_id: str, caller: Reader, settings: SettingsOf, database: DatabaseOf, now: Now
) -> HTMLResponse:
    """A vehicle and the box in it."""
    _look(request, caller)
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        page = queries.vehicle_page(session, caller.organisation_id, vehicle_id, now=now)
    return answer(request, "vehicle.html", caller, "vehicles", change, _vehicle_context(page, settings.map_tiles_url))


@router.get("/devices/{device_id}")
def device(
    request: Request, device_id: str, caller: Reader, settings: SettingsOf, database: DatabaseOf, now: Now
) -> HTMLResponse:
    """A box by itself, in a vehicle or not."""
    _look(request, caller)
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        page = queries.device_page(session, caller.organisation_id, device_id, now=now)
    return answer(request, "vehicle.html", caller, "vehicles", change, _vehicle_context(page, settings.map_tiles_url))


def _look(request: Request, caller: Caller) -> None:
    """The page shows where vehicles are to whoever may see it, and the audit log tells that it did."""
    if caller.may("location.read"):
        look(request, caller, "location.read")


def _vehicle_context(page: queries.VehiclePage, map_tiles_url: str | None) -> dict[str, Any]:
    return {"page": page, "map_tiles_url": map_tiles_url or "", "beginnings": BEGINNINGS, "statuses": STATUSES}


def answer(
    request: Request, template: str, caller: Caller, section: str, last_change: int, context: dict[str, Any]
) -> HTMLResponse:
    """A page in the frame that all share."""
    frame = {
        "section": section,
        "csrf_token": caller.csrf_token or "",
        "signed_in": caller.kind == "session",
        "last_change": last_change,
        "may": caller.permissions,
    }
    return renderer(request.app)(template, {**frame, **context})
