"""The installation assistant: made for a phone in a car park."""

from __future__ import annotations

import datetime as dt
from typing import Annotated, Any

from fastapi import APIRouter, Form, Query, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from nav_core.by_hand import largest_tilt
from server.accounts import audit
from server.accounts.access import Caller, Installer
from server.database import Database
from server.devices.service import put_into_vehicle
from server.edge import DatabaseOf, Now, StoreOf
from server.errors import ConflictError, InvalidError
from server.installations import level
from server.installations import service as installations
from server.installations.certificate import ACTION, subject
from server.pages import install, queries
from server.pages.routes import answer
from server.pages.words import CLASSES
from server.store import BlobStore
from server.wording import marked

router = APIRouter(prefix="/install", include_in_schema=False, default_response_class=HTMLResponse)

CAMERA = "geolocation=(), camera=(self), microphone=()"
"""Permissions-Policy of the page that scans; no other page may ask for the camera."""
NOT_FOUND = marked("No box has this code, name or number. Check it, or type it in.")
REFUSED = {
    "level_stale": marked("The box has sent nothing for a while: wait for fresh data."),
    "level_turned": marked("The box was turned since: look again."),
    "not_level": marked("The box does not stand upright and still."),
    "superseded": marked("The box was moved or swapped after that moment."),
}
Typed = Annotated[str, Query(max_length=500)]


@router.get("")
def start(request: Request, caller: Installer, database: DatabaseOf, now: Now, code: Typed = "") -> Response:
    """Scan or type the code of a box, or choose one that waits."""
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        found = install.find_box(session, caller.organisation_id, code) if code else None
        waiting = install.waiting(session, caller.organisation_id, now=now)
    if found is not None:
        return RedirectResponse(f"/install/{found.id}", 303)
    context = {"code": code, "problem": NOT_FOUND if code else None, "waiting": waiting}
    page = answer(request, "install.html", caller, "install", change, context)
    page.headers["Permissions-Policy"] = CAMERA
    return page


@router.get("/{device_id}")
def box(request: Request, device_id: str, caller: Installer, database: DatabaseOf, now: Now, q: Typed = "") -> Response:
    """Which vehicle the box sits in, and which way it is to be installed."""
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        found = install.candidate(session, caller.organisation_id, device_id, now=now)
        vehicles = install.vehicles(session, caller.organisation_id, q.strip())
    context = {"box": found, "vehicles": vehicles, "q": q, "shown": install.SHOWN, "classes": CLASSES}
    return answer(request, "install-box.html", caller, "install", change, context)


@router.post("/{device_id}/vehicle")
def choose_vehicle(
    device_id: str,
    caller: Installer,
    database: DatabaseOf,
    now: Now,
    vehicle_id: Annotated[str, Form(min_length=1, max_length=32)],
) -> Response:
    """Put the box into a vehicle."""
    with database.transaction() as session:
        put_into_vehicle(session, caller.organisation_id, device_id, vehicle_id, at=None, now=now)
        audit.record(
            session,
            caller,
            ACTION,
            subject(device_id),
            now=now,
            detail={"vehicle_id": vehicle_id},
        )
    return RedirectResponse(f"/install/{device_id}", 303)


@router.get("/{device_id}/drive")
def drive(request: Request, device_id: str, caller: Installer, database: DatabaseOf, now: Now) -> HTMLResponse:
    """How far the box has come while somebody drives, and what is still missing."""
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        found = install.candidate(session, caller.organisation_id, device_id, now=now)
    return answer(request, "install-drive.html", caller, "install", change, {"box": found})


@router.get("/{device_id}/level")
def by_level(
    request: Request, device_id: str, caller: Installer, database: DatabaseOf, store: StoreOf, now: Now
) -> HTMLResponse:
    """The level, live, and the four orientations to choose from."""
    return _level_page(request, caller, database, store, device_id, now=now)


@router.post("/{device_id}/level")
def confirm_level(
    request: Request,
    device_id: str,
    caller: Installer,
    database: DatabaseOf,
    store: StoreOf,
    now: Now,
    sits: Annotated[str, Form(pattern=r"^[xyz][+-][0-3]$")],
    reason: Annotated[str, Form(min_length=1, max_length=400)],
) -> Response:
    """Set the mounting that the installer chose, if the box still stands as it did when he looked."""
    axis, sign, choice = "xyz".index(sits[0]), 1 if sits[1] == "+" else -1, int(sits[2])
    with database.reading() as session:
        install.candidate(session, caller.organisation_id, device_id, now=now)
        found = level.sources(session, device_id)
    felt = level.feel(store, found)
    try:
        R_va = level.confirmed(
            None if felt is None else level.level_of(felt), axis=axis, sign=sign, choice=choice, now=now
        )
        with database.transaction() as session:
            installations.set_manual(
                session,
                caller.organisation_id,
                device_id,
                R_va.tolist(),
                reason=reason.strip() or "by level",
                sigma_deg=dict(level.SIGMA_DEG),
                since=now,
                now=now,
            )
            detail = {"by": "level", "orientation": sits}
            audit.record(session, caller, ACTION, subject(device_id), now=now, detail=detail)
    except (ConflictError, InvalidError) as error:
        return _level_page(request, caller, database, store, device_id, now=now, problem=error)
    return RedirectResponse(f"/devices/{device_id}/certificate", 303)


def _level_page(
    request: Request,
    caller: Caller,
    database: Database,
    store: BlobStore,
    device_id: str,
    *,
    now: dt.datetime,
    problem: ConflictError | InvalidError | None = None,
) -> HTMLResponse:
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        found = install.candidate(session, caller.organisation_id, device_id, now=now)
        sources = level.sources(session, device_id)
    felt = level.feel(store, sources)
    seen = None if felt is None else level.level_of(felt)
    vehicle_class = "car" if found.vehicle is None else found.vehicle.vehicle_class
    context: dict[str, Any] = {
        "box": found,
        "felt": felt,
        "fresh": felt is not None and now - felt.received_at <= level.FRESH_FOR,
        "level": seen,
        "bubble": None if seen is None else install.bubble(seen),
        "tolerance": largest_tilt(),
        "choices": [] if seen is None else install.choices(seen, vehicle_class),
        "problem": None if problem is None else REFUSED.get(problem.code, problem.detail),
    }
    page = answer(request, "install-level.html", caller, "install", change, context)
    page.status_code = 200 if problem is None else problem.status
    return page
