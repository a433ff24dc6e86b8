"""The HTML pages."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Form, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from server.accounts.access import Caller, Reader, Reviewer, look_at_places
from server.edge import DatabaseOf, Now, SettingsOf
from server.events import service as events
from server.pages import events as event_queries
from server.pages import queries
from server.pages.templating import renderer
from server.pages.words import BEGINNINGS, STATUSES

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)


@router.get("/")
def fleet(request: Request, caller: Reader, settings: SettingsOf, database: DatabaseOf, now: Now) -> HTMLResponse:
    """Map, what needs attention, and every box."""
    look_at_places(request, caller)
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
    look_at_places(request, caller)
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        page = queries.vehicle_page(session, caller.organisation_id, vehicle_id, now=now)
    return answer(request, "vehicle.html", caller, "vehicles", change, _vehicle_context(page, settings.map_tiles_url))


@router.get("/devices/{device_id}")
def device(
    request: Request, device_id: str, caller: Reader, settings: SettingsOf, database: DatabaseOf, now: Now
) -> HTMLResponse:
    """A box by itself, in a vehicle or not."""
    look_at_places(request, caller)
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        page = queries.device_page(session, caller.organisation_id, device_id, now=now)
    return answer(request, "vehicle.html", caller, "vehicles", change, _vehicle_context(page, settings.map_tiles_url))


@router.get("/events")
def event_list(
    request: Request,
    caller: Reader,
    database: DatabaseOf,
    show: Literal["severe", "manoeuvres", "all"] = "severe",
) -> HTMLResponse:
    """What happened, the newest first."""
    severe = {"severe": True, "manoeuvres": False, "all": None}[show]
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        found = event_queries.lines(session, caller.organisation_id, severe=severe)
    return answer(request, "events.html", caller, "events", change, {"lines": found, "show": show})


@router.get("/events/{event_id}")
def event(request: Request, event_id: str, caller: Reader, settings: SettingsOf, database: DatabaseOf) -> HTMLResponse:
    """One event: replay, curves, map, numbers, downloads, review."""
    look_at_places(request, caller)
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        page = event_queries.event_page(session, caller.organisation_id, event_id)
    context = {"page": page, "map_tiles_url": settings.map_tiles_url or "", "actions": event_queries.ACTIONS}
    return answer(request, "event.html", caller, "events", change, context)


@router.post("/events/{event_id}/review")
def review(
    event_id: str,
    caller: Reviewer,
    database: DatabaseOf,
    now: Now,
    verdict: Annotated[Literal["confirmed", "false_alarm", "open"], Form()],
    note: Annotated[str, Form(max_length=2000)] = "",
) -> Response:
    """The page's review form."""
    said = None if verdict == "open" else verdict
    with database.transaction() as session:
        events.review(session, caller.organisation_id, event_id, said, note.strip() or None, actor=caller.name, now=now)
    return RedirectResponse(f"/events/{event_id}", 303)


@router.post("/events/{event_id}/hold")
def hold(
    event_id: str,
    caller: Reviewer,
    database: DatabaseOf,
    now: Now,
    held: Annotated[bool, Form()],
    reason: Annotated[str, Form(min_length=1, max_length=500)],
) -> Response:
    """The page's form for a legal hold."""
    with database.transaction() as session:
        events.hold(session, caller.organisation_id, event_id, held=held, reason=reason, actor=caller.name, now=now)
    return RedirectResponse(f"/events/{event_id}", 303)


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
