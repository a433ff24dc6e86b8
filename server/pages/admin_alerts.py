"""The administration's pages of alert rules and channels."""

from __future__ import annotations

import datetime as dt
from typing import Any, Literal

from fastapi import APIRouter, Request
from sqlalchemy import func, select
from sqlalchemy.orm import Session
from starlette.responses import HTMLResponse, Response

from server.accounts.access import Administrator, Caller
from server.alerts import queries, service
from server.alerts.routes import note_channel, note_rule, tested
from server.alerts.schemas import ChannelIn, ChannelMade, ChannelOut, RuleIn, TestOut
from server.alerts.webhook import Guard
from server.database import Database
from server.edge import DatabaseOf, Now, SettingsOf
from server.errors import InvalidError, ProblemError
from server.models import AlertChannel, AlertDelivery, AlertRule, Vehicle
from server.pages import queries as page_queries
from server.pages.alerts import CONDITIONS
from server.pages.forms import Typed, back, checked
from server.pages.frame import measures_of
from server.pages.routes import answer
from server.wording import marked

router = APIRouter(prefix="/admin/alerts", include_in_schema=False, default_response_class=HTMLResponse)

RuleKind = Literal["crash", "moved", "silent", "calibration", "harsh", "geofence", "theft"]
ChannelKind = Literal["email", "webhook"]
CHANNELS: dict[ChannelKind, str] = {"email": marked("E-mail"), "webhook": marked("Webhook")}
_NUMBERS = ("min_angle_deg", "hours", "count", "margin_m")
MINUTE_S = 60.0


@router.get("")
def overview(request: Request, caller: Administrator, database: DatabaseOf) -> HTMLResponse:
    """Rules, channels, and how delivery goes."""
    with database.reading() as session:
        change = page_queries.last_change(session, caller.organisation_id)
        channels = queries.channels(session, caller.organisation_id)
        counted = (
            select(AlertDelivery.channel_id, AlertDelivery.state, func.count())
            .where(AlertDelivery.organisation_id == caller.organisation_id)
            .group_by(AlertDelivery.channel_id, AlertDelivery.state)
        )
        context = {
            "rules": queries.rules(session, caller.organisation_id),
            "channels": channels,
            "channel_names": {channel.id: channel.name for channel in channels},
            "vehicle_names": {row.id: row.name for row in _vehicles(session, caller)},
            "deliveries": {(channel, state): count for channel, state, count in session.execute(counted)},
            "conditions": CONDITIONS,
            "channel_kinds": CHANNELS,
        }
    return answer(request, "admin-alerts.html", caller, "admin", change, context)


def _first(typed: dict[str, list[str]]) -> dict[str, str]:
    return {name: (values or [""])[0] for name, values in typed.items()}


def _vehicles(session: Session, caller: Caller) -> list[Vehicle]:
    of_organisation = select(Vehicle).where(Vehicle.organisation_id == caller.organisation_id)
    return list(session.scalars(of_organisation.order_by(Vehicle.name, Vehicle.id)))


# --- rules


@router.get("/rules/new")
def new_rule(request: Request, caller: Administrator, database: DatabaseOf, kind: RuleKind = "crash") -> HTMLResponse:
    """The form of a new rule."""
    return _rule(request, caller, database, None, {"kind": [kind], "enabled": ["yes"]})


@router.get("/rules/{rule_id}")
def one_rule(request: Request, rule_id: str, caller: Administrator, database: DatabaseOf) -> HTMLResponse:
    """The form of a rule that there is."""
    with database.reading() as session:
        typed = _as_typed(queries.rule_of(session, caller.organisation_id, rule_id), _per_kmh(request))
    return _rule(request, caller, database, rule_id, typed)


def _per_kmh(request: Request) -> float:
    """From km/h to the unit in which the reader types speeds."""
    return measures_of(request).per_mps / 3.6


def _as_typed(row: AlertRule, per_kmh: float) -> dict[str, list[str]]:
    """A rule as its form would send it."""
    parameters = row.parameters
    typed = {name: [f"{parameters[name]:g}"] for name in _NUMBERS if name in parameters}
    if "min_delta_v_kmh" in parameters:
        typed["min_delta_v"] = [f"{parameters['min_delta_v_kmh'] * per_kmh:.6g}"]
    typed |= {name: [str(parameters[name])] for name in ("per", "on") if name in parameters}
    fence: dict[str, Any] = parameters.get("fence") or {}
    if fence.get("shape") == "circle":
        typed |= {name: [f"{fence[name]:.10g}"] for name in ("lat_deg", "lon_deg", "radius_m")}
    elif fence:
        typed["corners"] = ["\n".join(f"{lat:.10g} {lon:.10g}" for lat, lon in fence["corners"])]
    return typed | {
        "kind": [row.kind],
        "name": [row.name],
        "enabled": ["yes"] if row.enabled else [],
        "vehicle_id": [row.vehicle_id or ""],
        "channels": list(row.channels),
        "cooldown": [f"{row.cooldown_s / MINUTE_S:g}"],
    }


def _rule(
    request: Request,
    caller: Caller,
    database: Database,
    rule_id: str | None,
    typed: dict[str, list[str]],
    problem: ProblemError | None = None,
) -> HTMLResponse:
    with database.reading() as session:
        change = page_queries.last_change(session, caller.organisation_id)
        context: dict[str, Any] = {
            "vehicles": _vehicles(session, caller),
            "channels": queries.channels(session, caller.organisation_id),
        }
    context |= {
        "rule_id": rule_id,
        "typed": typed,
        "one": _first(typed),
    }
    context |= {"conditions": CONDITIONS, "error": None if problem is None else problem.detail}
    page = answer(request, "admin-rule.html", caller, "admin", change, context)
    page.status_code = 200 if problem is None else problem.status
    return page


@router.post("/rules")
def add_rule(request: Request, caller: Administrator, database: DatabaseOf, now: Now, typed: Typed) -> Response:
    """Make a rule."""
    return _set_rule(request, caller, database, now, None, typed)


@router.post("/rules/{rule_id}")
def change_rule(
    request: Request, rule_id: str, caller: Administrator, database: DatabaseOf, now: Now, typed: Typed
) -> Response:
    """The whole rule anew; its kind stays."""
    with database.reading() as session:
        typed["kind"] = [queries.rule_of(session, caller.organisation_id, rule_id).kind]
    return _set_rule(request, caller, database, now, rule_id, typed)


def _set_rule(
    request: Request,
    caller: Caller,
    database: Database,
    now: dt.datetime,
    rule_id: str | None,
    typed: dict[str, list[str]],
) -> Response:
    kind = typed.setdefault("kind", ["crash"])[0]
    if kind not in CONDITIONS:
        raise InvalidError(f"There is no rule of the kind {kind[:20]!r}")
    try:
        wanted: RuleIn = checked(RuleIn, **_fields(typed, _per_kmh(request)))
        with database.transaction() as session:
            made = service.set_rule(session, caller.organisation_id, rule_id, wanted, now=now)
            row = queries.rule_of(session, caller.organisation_id, made)
            note_rule(session, caller, "rule.changed" if rule_id else "rule.added", row, now=now)
    except ProblemError as error:
        return _rule(request, caller, database, rule_id, typed, problem=error)
    return back("/admin/alerts#rules")


def _fields(typed: dict[str, list[str]], per_kmh: float) -> dict[str, Any]:
    """A rule as the API takes it, from what was typed; empty fields keep their defaults."""
    one = {name: values[0].strip() for name, values in typed.items() if values and values[0].strip()}
    condition: dict[str, Any] = {"kind": one["kind"]}
    condition |= {name: _decimal(one[name]) for name in _NUMBERS if name in one}
    condition |= {name: one[name] for name in ("per", "on") if name in one}
    if "min_delta_v" in one:
        condition["min_delta_v_kmh"] = _decimal(one["min_delta_v"]) / per_kmh
    if condition["kind"] == "geofence":
        condition["fence"] = _fence(one)
    cooldown = _decimal(one["cooldown"]) if "cooldown" in one else None
    return {
        "name": one.get("name", ""),
        "enabled": "enabled" in one,
        "vehicle_id": one.get("vehicle_id"),
        "condition": condition,
        "channels": typed.get("channels", []),
        "cooldown_s": None if cooldown is None else cooldown * MINUTE_S,
    }


def _fence(one: dict[str, str]) -> dict[str, Any]:
    if "corners" in one:
        lines = [line.replace(",", " ").split() for line in one["corners"].splitlines() if line.strip()]
        if any(len(line) != 2 for line in lines):
            raise InvalidError(marked("Each corner is a line of two numbers: latitude and longitude"))
        return {"shape": "polygon", "corners": [[_decimal(lat), _decimal(lon)] for lat, lon in lines]}
    sizes = ("lat_deg", "lon_deg", "radius_m")
    if not all(name in one for name in sizes):
        raise InvalidError(marked("Give latitude, longitude and radius of a circle, or the corners of an area"))
    return {"shape": "circle", **{name: _decimal(one[name]) for name in sizes}}


def _decimal(text: str) -> float:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        raise InvalidError(f"{text[:20]!r} is no number") from None


@router.post("/rules/{rule_id}/delete")
def remove_rule(rule_id: str, caller: Administrator, database: DatabaseOf, now: Now) -> Response:
    """Look for it no more; its alerts stay."""
    with database.transaction() as session:
        row = queries.rule_of(session, caller.organisation_id, rule_id)
        note_rule(session, caller, "rule.removed", row, now=now)
        service.remove_rule(session, caller.organisation_id, rule_id)
    return back("/admin/alerts#rules")


# --- channels


@router.get("/channels/new")
def new_channel(
    request: Request, caller: Administrator, database: DatabaseOf, kind: ChannelKind = "email"
) -> HTMLResponse:
    """The form of a new channel."""
    return _channel(request, caller, database, None, {"kind": [kind], "enabled": ["yes"]})


@router.get("/channels/{channel_id}")
def one_channel(request: Request, channel_id: str, caller: Administrator, database: DatabaseOf) -> HTMLResponse:
    """The form of a channel that there is."""
    return _channel(request, caller, database, channel_id, None)


def _channel(
    request: Request,
    caller: Caller,
    database: Database,
    channel_id: str | None,
    typed: dict[str, list[str]] | None,
    *,
    problem: ProblemError | None = None,
    secret: str | None = None,
    trial: TestOut | None = None,
) -> HTMLResponse:
    tries: list[AlertDelivery] = []
    with database.reading() as session:
        change = page_queries.last_change(session, caller.organisation_id)
        if channel_id is not None:
            row = queries.channel_of(session, caller.organisation_id, channel_id)
            typed = _channel_as_typed(row) if typed is None else typed
            sent = select(AlertDelivery).where(AlertDelivery.channel_id == channel_id)
            sent = sent.where(AlertDelivery.organisation_id == caller.organisation_id)
            tries = list(session.scalars(sent.order_by(AlertDelivery.created_at.desc()).limit(10)))
    typed = typed or {}
    context = {
        "channel_id": channel_id,
        "typed": typed,
        "one": _first(typed),
        "channel_kinds": CHANNELS,
        "error": None if problem is None else problem.detail,
        "secret": secret,
        "trial": trial,
        "tries": tries,
    }
    page = answer(request, "admin-channel.html", caller, "admin", change, context)
    page.status_code = 200 if problem is None else problem.status
    return page


def _channel_as_typed(row: AlertChannel) -> dict[str, list[str]]:
    return {
        "kind": [row.kind],
        "name": [row.name],
        "url": row.recipients[:1] if row.kind == "webhook" else [],
        "recipients": ["\n".join(row.recipients)] if row.kind == "email" else [],
        "emergency": ["yes"] if row.emergency else [],
        "enabled": ["yes"] if row.enabled else [],
    }


def _channel_in(typed: dict[str, list[str]]) -> Any:
    one = {name: values[0].strip() for name, values in typed.items() if values and values[0].strip()}
    wanted: dict[str, Any] = {
        "kind": one["kind"],
        "name": one.get("name", ""),
        "emergency": "emergency" in one,
        "enabled": "enabled" in one,
    }
    if wanted["kind"] == "webhook":
        wanted["url"] = one.get("url", "")
    else:
        wanted["recipients"] = one.get("recipients", "").replace(",", " ").replace(";", " ").split()
    return checked(ChannelIn, **wanted)


@router.post("/channels")
def add_channel(
    request: Request, caller: Administrator, settings: SettingsOf, database: DatabaseOf, now: Now, typed: Typed
) -> Response:
    """Make a channel; a webhook's secret is shown in the answer and never again."""
    guard = Guard(settings.webhook_networks)
    kind = typed.setdefault("kind", ["email"])[0]
    if kind not in CHANNELS:
        raise InvalidError(f"There is no channel of the kind {kind[:20]!r}")
    try:
        wanted = _channel_in(typed)
        with database.transaction() as session:
            made: ChannelMade = service.add_channel(session, caller.organisation_id, wanted, guard=guard, now=now)
            note_channel(session, caller, "channel.added", made, now)
    except ProblemError as error:
        return _channel(request, caller, database, None, typed, problem=error)
    if made.secret is None:
        return back(f"/admin/alerts/channels/{made.id}")
    return _channel(request, caller, database, made.id, None, secret=made.secret)


@router.post("/channels/{channel_id}")
def change_channel(
    request: Request,
    channel_id: str,
    caller: Administrator,
    settings: SettingsOf,
    database: DatabaseOf,
    now: Now,
    typed: Typed,
) -> Response:
    """The whole channel anew; its kind and its secret stay."""
    guard = Guard(settings.webhook_networks)
    with database.reading() as session:
        typed["kind"] = [queries.channel_of(session, caller.organisation_id, channel_id).kind]
    try:
        wanted = _channel_in(typed)
        with database.transaction() as session:
            row = service.change_channel(session, caller.organisation_id, channel_id, wanted, guard=guard)
            told = ChannelOut.model_validate(row, from_attributes=True)
            note_channel(session, caller, "channel.changed", told, now)
    except ProblemError as error:
        return _channel(request, caller, database, channel_id, typed, problem=error)
    return back("/admin/alerts#channels")


@router.post("/channels/{channel_id}/secret")
def new_secret(request: Request, channel_id: str, caller: Administrator, database: DatabaseOf, now: Now) -> Response:
    """Show another secret; the old one signs nothing more."""
    try:
        with database.transaction() as session:
            made = service.new_secret(session, caller.organisation_id, channel_id)
            note_channel(session, caller, "channel.secret", made, now)
    except ProblemError as error:
        return _channel(request, caller, database, channel_id, None, problem=error)
    return _channel(request, caller, database, channel_id, None, secret=made.secret)


@router.post("/channels/{channel_id}/test")
def try_channel(
    request: Request, channel_id: str, caller: Administrator, settings: SettingsOf, database: DatabaseOf, now: Now
) -> Response:
    """Send a test message and say what came of it."""
    trial = tested(channel_id, caller, settings, database, now)
    return _channel(request, caller, database, channel_id, None, trial=trial)


@router.post("/channels/{channel_id}/delete")
def remove_channel(channel_id: str, caller: Administrator, database: DatabaseOf, now: Now) -> Response:
    """Tell nobody there any more."""
    with database.transaction() as session:
        row = queries.channel_of(session, caller.organisation_id, channel_id)
        told = ChannelOut.model_validate(row, from_attributes=True)
        service.remove_channel(session, caller.organisation_id, channel_id)
        note_channel(session, caller, "channel.removed", told, now)
    return back("/admin/alerts#channels")
