"""An event's recorded replay over HTTP; the viewer process makes it."""

from __future__ import annotations

import datetime as dt
from typing import Any

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from server.accounts.access import Caller, LocationReader
from server.database import Database
from server.edge import DatabaseOf, Now
from server.events import queries
from server.events.routes import EventId
from server.view3d import permission
from server.view3d.proxy import forward
from server.view3d.tickets import ViewTicketOut

router = APIRouter(prefix="/api/v1/events", tags=["events"])

_FILE: dict[int | str, dict[str, Any]] = {
    200: {"content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}}
}


@router.get("/{event_id}/scene.viser", response_class=Response, responses=_FILE)
async def read_scene(
    request: Request, event_id: EventId, caller: LocationReader, database: DatabaseOf, now: Now
) -> Response:
    """The vehicle moving along its path and the force that hit it, for viser's player."""

    def ticket() -> permission.Ticket:
        return _ticket(database, caller, event_id, now=now)

    issued = await run_in_threadpool(ticket)
    answer = await forward(request, f"{issued.url}events/{event_id}.viser")
    if answer.status_code == 200:
        answer.headers["Content-Disposition"] = f'attachment; filename="{event_id[:8]}-scene.viser"'
        if "Content-Security-Policy" in answer.headers:
            del answer.headers["Content-Security-Policy"]  # the viewer page's; a file needs none
    return answer


@router.post("/{event_id}/view-ticket", status_code=201)
def issue_ticket(event_id: EventId, caller: LocationReader, database: DatabaseOf, now: Now) -> ViewTicketOut:
    """A path under which the event's replay opens for ten minutes, and the 3D view of its box."""
    issued = _ticket(database, caller, event_id, now=now)
    return ViewTicketOut(url=issued.url, expires_at=issued.expires_at)


def _ticket(database: Database, caller: Caller, event_id: str, *, now: dt.datetime) -> permission.Ticket:
    with database.transaction() as session:
        event = queries.event_of(session, caller.organisation_id, event_id)
        return permission.issue(session, caller.organisation_id, event.device_id, now=now, event_id=event.id)
