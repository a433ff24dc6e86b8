"""The HTML pages."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Form, Query, Request
from sqlalchemy.orm import Session
from starlette.responses import FileResponse, HTMLResponse, RedirectResponse, Response

from server.accounts.access import Caller, Installer, LocationReader, Reader, Reviewer, look_at_places
from server.accounts.places import sight_of
from server.database import Database
from server.edge import DatabaseOf, Now, SettingsOf
from server.errors import InvalidError, NotFoundError
from server.events import service as events
from server.events.routes import note_hold
from server.installations import service as installations
from server.installations.routes import note_manual
from server.installations.schemas import ManualMounting
from server.pages import events as event_queries
from server.pages import frame, queries
from server.pages.compare import comparison
from server.pages.templating import renderer
from server.pages.words import BEGINNINGS, CLASSES, STATUSES
from server.reports.words import Words
from server.settings import Settings
from server.wording import marked

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)

NOT_A_MOUNTING = marked("Give three angles, how well they were measured, and a reason.")
TripId = Annotated[str | None, Query(max_length=32)]


@router.get("/vehicles/{vehicle_id}")
def vehicle(
    request: Request,
    vehicle_id: str,
    caller: Reader,
    settings: SettingsOf,
    database: DatabaseOf,
    now: Now,
    trip: TripId = None,
) -> HTMLResponse:
    """A vehicle and the box in it."""
    read = partial(
        queries.vehicle_page, organisation_id=caller.organisation_id, vehicle_id=vehicle_id, now=now, trip_id=trip
    )
    return _subject(request, caller, settings, database, read)


@router.get("/devices/{device_id}")
def device(
    request: Request,
    device_id: str,
    caller: Reader,
    settings: SettingsOf,
    database: DatabaseOf,
    now: Now,
    trip: TripId = None,
) -> HTMLResponse:
    """A box by itself, in a vehicle or not."""
    read = partial(
        queries.device_page, organisation_id=caller.organisation_id, device_id=device_id, now=now, trip_id=trip
    )
    return _subject(request, caller, settings, database, read)


@router.post("/devices/{device_id}/installation")
def set_mounting(
    request: Request,
    device_id: str,
    caller: Installer,
    settings: SettingsOf,
    database: DatabaseOf,
    now: Now,
    theta: Annotated[str, Form(max_length=20)] = "",
    phi: Annotated[str, Form(max_length=20)] = "",
    psi: Annotated[str, Form(max_length=20)] = "",
    sigma: Annotated[str, Form(max_length=20)] = "1",
    reason: Annotated[str, Form(max_length=1000)] = "",
    back: Annotated[str, Form(pattern=r"^/(vehicles|devices)/[0-9a-z]{1,32}$")] = "/",
) -> Response:
    """The page's form for a mounting that somebody measured."""
    typed = {"theta": theta, "phi": phi, "psi": psi, "sigma": sigma, "reason": reason}
    try:
        angles = {name: typed[name] for name in ("theta", "phi", "psi")}
        wanted = ManualMounting.model_validate(
            {"euler_deg": angles, "sigma_deg": dict.fromkeys("xyz", sigma), "reason": reason}
        )
        numbers = [float(value) for value in (theta, phi, psi, sigma)]
        if not all(map(math.isfinite, numbers)) or not 0.0 < numbers[3] <= 90.0:
            raise InvalidError(NOT_A_MOUNTING)  # noqa: TRY301  the same answer as for what is no number
        with database.transaction() as session:
            installations.set_manual(
                session,
                caller.organisation_id,
                device_id,
                wanted.matrix(),
                reason=wanted.reason,
                sigma_deg=wanted.sigma_deg.model_dump() if wanted.sigma_deg else None,
                since=now,
                now=now,
            )
            note_manual(session, caller, device_id, wanted.reason, now=now)
    except (ValueError, InvalidError) as error:
        detail = error.detail if isinstance(error, InvalidError) else NOT_A_MOUNTING
        with database.reading() as session:
            change = queries.last_change(session, caller.organisation_id)
            page = queries.device_page(session, caller.organisation_id, device_id, now=now)
        context = _vehicle_context(page, settings) | {"problem": detail, "typed": typed}
        shown = answer(request, "vehicle.html", caller, "vehicles", change, context)
        shown.status_code = 422
        return shown
    return RedirectResponse(f"{back}#mounting", 303)


@router.get("/events/{event_id}")
def event(request: Request, event_id: str, caller: Reader, settings: SettingsOf, database: DatabaseOf) -> HTMLResponse:
    """One event: replay, curves, map, numbers, downloads, review."""
    look_at_places(request, caller)
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        language, measures = frame.language_of(request), frame.measures_of(request)
        page = event_queries.event_page(session, caller.organisation_id, event_id, language, measures)
    context = {"page": page, "actions": event_queries.ACTIONS, **map_settings(settings)}
    return answer(request, "event.html", caller, "events", change, context)


@router.get("/events/{event_id}/compare")
def compare(
    request: Request,
    event_id: str,
    caller: LocationReader,
    database: DatabaseOf,
    before: Annotated[int, Query(ge=1, le=1_000_000)],
    after: Annotated[int, Query(ge=1, le=1_000_000)],
) -> HTMLResponse:
    """Two revisions of an event side by side."""
    measures = frame.measures_of(request)
    words = Words(frame.language_of(request), measures.speed)
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        found = comparison(session, caller.organisation_id, event_id, before, after, words, measures.per_mps / 3.6)
    return answer(request, "event-compare.html", caller, "events", change, {"found": found})


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
        event = events.hold(
            session, caller.organisation_id, event_id, held=held, reason=reason, actor=caller.name, now=now
        )
        note_hold(session, caller, event, now=now)
    return RedirectResponse(f"/events/{event_id}", 303)


def _subject(
    request: Request,
    caller: Caller,
    settings: Settings,
    database: Database,
    read: Callable[[Session], queries.VehiclePage],
) -> HTMLResponse:
    """The page of a vehicle or of a box."""
    look_at_places(request, caller)
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        page = read(session)
    return answer(request, "vehicle.html", caller, "vehicles", change, _vehicle_context(page, settings))


def _vehicle_context(page: queries.VehiclePage, settings: Settings) -> dict[str, Any]:
    words = {"beginnings": BEGINNINGS, "statuses": STATUSES, "classes": CLASSES}
    return {"page": page, "problem": None, "typed": {}, **words, **map_settings(settings)}


def map_settings(settings: Settings) -> dict[str, str]:
    """What a map of a page needs to know: the operator's tiles, a template or a PMTiles archive."""
    return {"map_tiles_url": settings.map_tiles_url or "", "map_pmtiles": _pmtiles_url(settings)}


def _pmtiles_url(settings: Settings) -> str:
    """Another host's archive is asked there, a file here."""
    archive = settings.map_pmtiles or ""
    return "/map/basemap.pmtiles" if archive and not archive.startswith(("http:", "https:")) else archive


@router.get("/map/basemap.pmtiles")
def basemap(caller: Reader, settings: SettingsOf) -> Response:
    """The operator's map, a part of the file at a time (Range)."""
    del caller
    if not _pmtiles_url(settings).startswith("/") or not Path(settings.map_pmtiles or "").is_file():
        raise NotFoundError("No map file is set")
    headers = {"Cache-Control": "private, max-age=86400"}
    return FileResponse(settings.map_pmtiles or "", media_type="application/octet-stream", headers=headers)


def answer(
    request: Request, template: str, caller: Caller, section: str, last_change: int, context: dict[str, Any]
) -> HTMLResponse:
    """A page in the frame that all share."""
    shared = {
        "section": section,
        "sections": frame.sections(caller),
        "on_phone": frame.ON_PHONE,
        "administration": frame.administration(caller),
        "csrf_token": caller.csrf_token or "",
        "signed_in": caller.kind == "session",
        "last_change": last_change,
        "may": caller.permissions,
        "sight": sight_of(caller),
    }
    return renderer(request.app)(template, {**shared, **context}, connection=request)
