"""Asking for a ticket to a 3D view."""

from __future__ import annotations

import datetime as dt

from fastapi import APIRouter
from pydantic import BaseModel

from server.accounts.access import Reader
from server.edge import DatabaseOf, Now
from server.view3d import permission

router = APIRouter(tags=["3D view"])


class ViewTicketOut(BaseModel):
    url: str
    """Path of the view's page on this host; whoever knows it can open the view until it expires."""
    expires_at: dt.datetime


@router.post("/api/v1/devices/{device_id}/view-ticket", status_code=201)
def issue_ticket(device_id: str, caller: Reader, database: DatabaseOf, now: Now) -> ViewTicketOut:
    """A path under which the device's 3D view opens for ten minutes, in a frame or by itself."""
    with database.transaction() as session:
        ticket = permission.issue(session, caller.organisation_id, device_id, now=now)
    return ViewTicketOut(url=ticket.url, expires_at=ticket.expires_at)
