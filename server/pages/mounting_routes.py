"""The pages about how a box sits: its mounting in 3D, and the certificate of its installation."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from nav_core.earth import STANDARD_GRAVITY
from server.accounts.access import Reader
from server.edge import DatabaseOf, Now, StoreOf
from server.errors import ConflictError
from server.installations.certificate import certificate_of
from server.installations.level import feel
from server.pages import queries
from server.pages.mounting import Arrow, force, mounting_page
from server.pages.routes import answer
from server.pages.words import BEGINNINGS, CLASSES
from server.view3d.axonometry import drawing
from server.view3d.uncertainty import widest_deg

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)

StepId = Annotated[str | None, Query(max_length=32)]


@router.get("/vehicles/{vehicle_id}/mounting")
def of_vehicle(vehicle_id: str, caller: Reader, database: DatabaseOf, now: Now) -> Response:
    """The mounting of the box in a vehicle that was heard last."""
    with database.reading() as session:
        page = queries.vehicle_page(session, caller.organisation_id, vehicle_id, now=now)
    target = f"/vehicles/{vehicle_id}" if page.box is None else f"/devices/{page.box.device.id}/mounting"
    return RedirectResponse(target, 303)


@router.get("/devices/{device_id}/mounting")
def of_device(
    request: Request,
    device_id: str,
    caller: Reader,
    database: DatabaseOf,
    store: StoreOf,
    step: StepId = None,
    before: bool = False,
) -> HTMLResponse:
    """Vehicle, box, cones and arrows in 3D, through the history, with every figure beside it."""
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        page = mounting_page(session, caller.organisation_id, device_id, step)
    felt = feel(store, page.sources)
    context = {
        "page": page,
        "felt": felt,
        "force": force(page, felt),
        "gravity": Arrow("g", (0.0, 0.0, STANDARD_GRAVITY)),
        "before": before,
        "beginnings": BEGINNINGS,
        "classes": CLASSES,
    }
    return answer(request, "mounting.html", caller, "vehicles", change, context)


@router.get("/devices/{device_id}/certificate")
def certificate(
    request: Request,
    device_id: str,
    caller: Reader,
    database: DatabaseOf,
    mounting: Annotated[str | None, Query(max_length=32)] = None,
    sha256: Annotated[str | None, Query(max_length=64)] = None,
) -> HTMLResponse:
    """The certificate, to look at; with the hash of a printed one, whether that is still what is stored."""
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        try:
            found = certificate_of(session, caller.organisation_id, device_id, mounting)
        except ConflictError:
            page = mounting_page(session, caller.organisation_id, device_id, None)
            nothing = {"found": None, "device": page.device, "vehicle": page.vehicle}
            return answer(request, "certificate.html", caller, "vehicles", change, nothing)
    mounted = found.document["mounting"]
    vehicle_class = "car" if found.vehicle is None else found.vehicle.vehicle_class
    context = {
        "found": found,
        "device": found.device,
        "vehicle": found.vehicle,
        "mounted": mounted,
        "cones": widest_deg(mounted["R_va"], mounted["sigma_deg"]) if mounted["sigma_deg"] else None,
        "picture": drawing(vehicle_class, mounted["R_va"]),
        "agrees": None if sha256 is None else sha256 == found.sha256,
        "beginnings": BEGINNINGS,
        "classes": CLASSES,
    }
    return answer(request, "certificate.html", caller, "vehicles", change, context)
