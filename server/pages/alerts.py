"""The alerts page, its forms, and what other pages show of alerts."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Form, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from server.accounts.access import Administrator, Reader, look_at_places
from server.alerts import queries, service, words
from server.alerts.routes import arm
from server.edge import DatabaseOf, Now
from server.pages.alert_lines import dead_letters, lines
from server.pages.queries import last_change
from server.pages.routes import answer
from server.wording import marked

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)

CONDITIONS = {
    "crash": marked("Crash"),
    "moved": marked("Box moved"),
    "silent": marked("Box silent"),
    "calibration": marked("Calibration overdue"),
    "harsh": marked("Harsh driving"),
    "geofence": marked("Geofence"),
    "theft": marked("Movement without ignition"),
}


@router.get("/alerts")
def alert_list(
    request: Request, caller: Reader, database: DatabaseOf, show: Literal["waiting", "all"] = "waiting"
) -> HTMLResponse:
    """What somebody wanted to be told of, the rules behind it, and what could not be delivered."""
    look_at_places(request, caller)
    manages = caller.may("fleet.write")
    with database.reading() as session:
        change = last_change(session, caller.organisation_id)
        found = lines(session, caller.organisation_id, waiting=True if show == "waiting" else None)
        waiting = queries.waiting_count(session, caller.organisation_id)
        rules = queries.rules(session, caller.organisation_id)
        channels = queries.channels(session, caller.organisation_id) if manages else []
        dead_count, dead = dead_letters(session, caller.organisation_id) if manages else (0, [])
    context = {
        "lines": found,
        "waiting": waiting,
        "show": show,
        "rules": rules,
        "channels": channels,
        "channel_names": {channel.id: channel.name for channel in channels},
        "conditions": CONDITIONS,
        "dead": dead,
        "dead_count": dead_count,
        "kinds": words.KINDS,
    }
    return answer(request, "alerts.html", caller, "alerts", change, context)


@router.post("/alerts/{alert_id}/acknowledge")
def acknowledge(
    alert_id: str,
    caller: Administrator,
    database: DatabaseOf,
    now: Now,
    show: Annotated[Literal["waiting", "all"], Form()] = "waiting",
) -> Response:
    """The list's button."""
    with database.transaction() as session:
        service.acknowledge(session, caller.organisation_id, alert_id, actor=caller.name, now=now)
    return RedirectResponse("/alerts" if show == "waiting" else "/alerts?show=all", 303)


@router.post("/alert-deliveries/{delivery_id}/replay")
def replay(delivery_id: str, caller: Administrator, database: DatabaseOf, now: Now) -> Response:
    """The button beside a dead letter."""
    with database.transaction() as session:
        service.replay(session, caller.organisation_id, delivery_id, now=now)
    return RedirectResponse("/alerts", 303)


@router.post("/vehicles/{vehicle_id}/theft")
def theft(
    vehicle_id: str,
    caller: Administrator,
    database: DatabaseOf,
    now: Now,
    armed: Annotated[bool, Form()],
) -> Response:
    """The vehicle page's theft mode."""
    with database.transaction() as session:
        arm(session, caller, vehicle_id, armed=armed, now=now)
    return RedirectResponse(f"/vehicles/{vehicle_id}", 303)
