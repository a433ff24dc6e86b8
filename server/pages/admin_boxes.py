"""The administration's pages of boxes: making, tokens and claim codes, quota, configuration."""

from __future__ import annotations

import datetime as dt
import json
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Form, Query, Request
from sqlalchemy import ColumnElement, func, or_, select
from sqlalchemy.orm import Session
from starlette.responses import HTMLResponse, Response

from server.accounts import audit
from server.accounts.access import Administrator, Caller, Installer
from server.database import Database
from server.devices import provisioning, service
from server.devices.queries import device_of
from server.devices.schemas import DeviceIn, DeviceSettings
from server.edge import DatabaseOf, Now, SettingsOf
from server.errors import InvalidError, ProblemError
from server.models import ClaimCode, Device, Vehicle
from server.pages import queries
from server.pages.admin import over_quota
from server.pages.forms import Text, back, checked
from server.pages.qr import qr_code
from server.pages.routes import answer
from server.pages.words import SILENT_AFTER
from server.settings import Settings
from server.wording import marked

router = APIRouter(prefix="/admin/boxes", include_in_schema=False, default_response_class=HTMLResponse)

SHOWN = 50
MEGABYTE = 1_000_000
Show = Literal["all", "silent", "new", "full", "revoked"]
SHOWS: dict[Show, str] = {
    "all": marked("In use"),
    "new": marked("Never heard of"),
    "silent": marked("Silent"),
    "full": marked("Over quota"),
    "revoked": marked("Revoked"),
}


@dataclass(frozen=True)
class Line:
    """A box in the list."""

    device: Device
    vehicle: Vehicle | None
    used_bytes: int
    """Today."""
    allowed_bytes: int

    @property
    def share(self) -> float:
        return self.used_bytes / self.allowed_bytes

    @property
    def configuration_waits(self) -> bool:
        device = self.device
        return device.configuration_version > 0 and device.configuration_seen != device.configuration_version


def _line(device: Device, vehicle: Vehicle | None, settings: Settings, now: dt.datetime) -> Line:
    used = device.quota_bytes if device.quota_day == now.astimezone(dt.UTC).date() else 0
    allowed = settings.device_bytes_per_day if device.bytes_per_day is None else device.bytes_per_day
    return Line(device, vehicle, used, max(allowed, 1))


def _conditions(show: Show, settings: Settings, now: dt.datetime) -> list[ColumnElement[bool]]:
    if show == "revoked":
        return [Device.revoked_at.is_not(None)]
    more: dict[str, list[ColumnElement[bool]]] = {
        "new": [Device.last_seen_at.is_(None)],
        "silent": [Device.last_seen_at < now - SILENT_AFTER],
        "full": list(over_quota(settings, now)),
    }
    return [Device.revoked_at.is_(None), *more.get(show, [])]


@router.get("")
def boxes(
    request: Request,
    caller: Administrator,
    settings: SettingsOf,
    database: DatabaseOf,
    now: Now,
    show: Show = "all",
    q: Annotated[str, Query(max_length=100)] = "",
    page: Annotated[int, Query(ge=1, le=100_000)] = 1,
) -> HTMLResponse:
    """Every box and how it shows who it is."""
    return _list(request, caller, settings, database, now, show=show, q=q.strip(), page=page)


def _list(
    request: Request,
    caller: Caller,
    settings: Settings,
    database: Database,
    now: dt.datetime,
    *,
    show: Show = "all",
    q: str = "",
    page: int = 1,
    problem: ProblemError | None = None,
    typed: dict[str, str] | None = None,
) -> HTMLResponse:
    query = (
        select(Device, Vehicle)
        .outerjoin(Vehicle, Vehicle.id == Device.vehicle_id)
        .where(Device.organisation_id == caller.organisation_id, *_conditions(show, settings, now))
    )
    for word in q.split():
        query = query.where(
            or_(*(column.icontains(word, autoescape=True) for column in (Device.name, Vehicle.name, Vehicle.plate)))
        )
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        found = session.scalar(select(func.count()).select_from(query.subquery())) or 0
        rows = session.execute(query.order_by(Device.name, Device.id).offset((page - 1) * SHOWN).limit(SHOWN))
        context: dict[str, Any] = {
            "lines": [_line(device, vehicle, settings, now) for device, vehicle in rows],
            "vehicles": _vehicles(session, caller),
        }
    context |= {"found": found, "page": page, "pages": max(-(-found // SHOWN), 1), "show": show, "q": q}
    context |= {"shows": SHOWS, "typed": typed or {}, "error": None if problem is None else problem.detail}
    shown = answer(request, "admin-boxes.html", caller, "admin", change, context)
    shown.status_code = 200 if problem is None else problem.status
    return shown


def _vehicles(session: Session, caller: Caller) -> list[Vehicle]:
    of_organisation = select(Vehicle).where(Vehicle.organisation_id == caller.organisation_id)
    return list(session.scalars(of_organisation.order_by(Vehicle.name, Vehicle.id)))


@router.post("")
def add(
    request: Request,
    caller: Administrator,
    settings: SettingsOf,
    database: DatabaseOf,
    now: Now,
    name: Text = "",
    vehicle_id: Text = "",
    by: Text = "code",
) -> Response:
    """Register a box and show what it needs to sign in: a claim code for an installer, or its token."""
    try:
        wanted = checked(DeviceIn, name=name, vehicle_id=vehicle_id or None)
        with database.transaction() as session:
            made, _ = service.register(session, caller.organisation_id, wanted, idempotency_key=None, now=now)
            audit.record(session, caller, "box.added", f"device={made.id}", now=now, detail={"name": wanted.name})
            by_token = by == "token"
            secret = _token_shown(made.token) if by_token else _new_code(session, request, caller, made.id, now)
    except ProblemError as error:
        typed = {"name": name, "vehicle_id": vehicle_id, "by": by}
        return _list(request, caller, settings, database, now, problem=error, typed=typed)
    return _box(request, caller, settings, database, now, made.id, secret=secret)


def _token_shown(token: str | None) -> dict[str, Any]:
    hint = marked("The box sends it as a bearer token. It cannot be shown again; a lost one is rotated.")
    return {"title": marked("Token of the box"), "value": token, "hint": hint, "until": None, "code": None}


def _new_code(session: Session, request: Request, caller: Caller, device_id: str, now: dt.datetime) -> dict[str, Any]:
    made = provisioning.new_claim_code(session, caller.organisation_id, device_id, now=now)
    audit.record(session, caller, "box.claim-code", f"device={device_id}", now=now)
    hint = marked("The box trades it for its token, once. Earlier codes of this box are void.")
    # The address of the assistant: any phone's camera opens it, and the assistant's own reads it too.
    code = qr_code(f"{request.base_url}install?code={made.code}")
    title = marked("Claim code of the box")
    return {"title": title, "value": made.code, "hint": hint, "until": made.expires_at, "code": code}


@router.get("/{device_id}")
def box(
    request: Request, device_id: str, caller: Administrator, settings: SettingsOf, database: DatabaseOf, now: Now
) -> HTMLResponse:
    """One box."""
    return _box(request, caller, settings, database, now, device_id)


def _box(
    request: Request,
    caller: Caller,
    settings: Settings,
    database: Database,
    now: dt.datetime,
    device_id: str,
    *,
    secret: dict[str, Any] | None = None,
    problem: ProblemError | None = None,
    typed: dict[str, str] | None = None,
) -> HTMLResponse:
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        device = device_of(session, caller.organisation_id, device_id)
        vehicle = session.get(Vehicle, device.vehicle_id) if device.vehicle_id else None
        codes = select(ClaimCode).where(ClaimCode.device_id == device_id, ClaimCode.expires_at > now)
        code = session.scalars(codes.order_by(ClaimCode.created_at.desc())).first()
        vehicles = _vehicles(session, caller)
    configuration = "" if device.configuration is None else json.dumps(device.configuration, indent=2)
    quota = "" if device.bytes_per_day is None else f"{device.bytes_per_day / MEGABYTE:g}"
    context = {
        "line": _line(device, vehicle, settings, now),
        "code": code,
        "vehicles": vehicles,
        "secret": secret,
        "error": None if problem is None else problem.detail,
        "typed": {"configuration": configuration, "megabytes": quota} | (typed or {}),
        "usual_bytes": settings.device_bytes_per_day,
    }
    page = answer(request, "admin-box.html", caller, "admin", change, context)
    page.status_code = 200 if problem is None else problem.status
    return page


@router.post("/{device_id}/claim-code")
def claim_code(
    request: Request, device_id: str, caller: Installer, settings: SettingsOf, database: DatabaseOf, now: Now
) -> Response:
    """Show a new code."""
    try:
        with database.transaction() as session:
            secret = _new_code(session, request, caller, device_id, now)
    except ProblemError as error:
        return _box(request, caller, settings, database, now, device_id, problem=error)
    return _box(request, caller, settings, database, now, device_id, secret=secret)


@router.post("/{device_id}/token")
def rotate(
    request: Request, device_id: str, caller: Administrator, settings: SettingsOf, database: DatabaseOf, now: Now
) -> Response:
    """Show a new token; the old one has ended."""
    try:
        with database.transaction() as session:
            made = service.rotate_token(session, caller.organisation_id, device_id, now=now)
            audit.record(session, caller, "box.token", f"device={device_id}", now=now)
    except ProblemError as error:
        return _box(request, caller, settings, database, now, device_id, problem=error)
    return _box(request, caller, settings, database, now, device_id, secret=_token_shown(made.token))


@router.post("/{device_id}/revoke")
def revoke(device_id: str, caller: Administrator, database: DatabaseOf, now: Now) -> Response:
    """Refuse a box from now on."""
    with database.transaction() as session:
        service.revoke(session, caller.organisation_id, device_id, now=now)
        audit.record(session, caller, "box.revoked", f"device={device_id}", now=now)
    return back(f"/admin/boxes/{device_id}")


@router.post("/{device_id}/vehicle")
def put_into_vehicle(
    request: Request,
    device_id: str,
    caller: Installer,
    settings: SettingsOf,
    database: DatabaseOf,
    now: Now,
    vehicle_id: Text = "",
) -> Response:
    """Swap a box to another vehicle, or take it out."""
    try:
        with database.transaction() as session:
            service.put_into_vehicle(session, caller.organisation_id, device_id, vehicle_id or None, at=None, now=now)
            detail = {"vehicle": vehicle_id or None}
            audit.record(session, caller, "box.vehicle", f"device={device_id}", now=now, detail=detail)
    except ProblemError as error:
        return _box(request, caller, settings, database, now, device_id, problem=error)
    return back(f"/admin/boxes/{device_id}")


@router.post("/{device_id}/settings")
def set_settings(
    request: Request,
    device_id: str,
    caller: Administrator,
    settings: SettingsOf,
    database: DatabaseOf,
    now: Now,
    signed_only: Text = "",
    megabytes: Text = "",
    configuration: Annotated[str, Form(max_length=5000)] = "",
) -> Response:
    """Signed requests alone, quota, configuration."""
    try:
        wanted = checked(
            DeviceSettings,
            signed_only=bool(signed_only),
            bytes_per_day=_bytes(megabytes),
            configuration=_configuration(configuration),
        )
        with database.transaction() as session:
            provisioning.set_settings(session, caller.organisation_id, device_id, wanted, now=now)
            told = wanted.model_dump(exclude={"configuration"})
            audit.record(session, caller, "box.settings", f"device={device_id}", now=now, detail=told)
    except ProblemError as error:
        typed = {"megabytes": megabytes, "configuration": configuration}
        return _box(request, caller, settings, database, now, device_id, problem=error, typed=typed)
    return back(f"/admin/boxes/{device_id}")


def _bytes(megabytes: str) -> int | None:
    text = megabytes.strip().replace(",", ".")
    if not text:
        return None
    try:
        return round(float(text) * MEGABYTE)
    except (ValueError, OverflowError):
        raise InvalidError(marked("The quota is a number of megabytes, or empty")) from None


def _configuration(text: str) -> dict[str, Any] | None:
    if not text.strip():
        return None
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidError(f"The configuration is no JSON: {error}") from None
    if not isinstance(found, dict):
        raise InvalidError(marked("The configuration is no JSON object"))
    return found
