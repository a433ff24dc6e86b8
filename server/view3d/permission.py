"""Permission to open one box's 3D view: a short-lived ticket, carried in the view's path.

The view's page and socket cannot carry a token of their own, so the path does.  Only the
ticket's hash is stored.
"""

from __future__ import annotations

import datetime as dt
import secrets
from dataclasses import dataclass

from sqlalchemy import delete, select, update
from sqlalchemy.orm import Session

from server.accounts.secrets import hash_of
from server.errors import NotFoundError
from server.models import Device, ViewTicket

LIFETIME = dt.timedelta(minutes=10)
"""How long a ticket opens its view; an open view renews it, so that a dropped connection can come back."""


@dataclass(frozen=True, slots=True)
class Ticket:
    """A fresh ticket; `url` is the only place where its secret appears."""

    url: str
    expires_at: dt.datetime


def issue(
    session: Session, organisation_id: str, device_id: str, *, now: dt.datetime, event_id: str | None = None
) -> Ticket:
    """Make a ticket for a box of the organisation and one event's replay; tickets that expired are cleared away."""
    device = session.get(Device, device_id)
    if device is None or device.organisation_id != organisation_id:
        raise NotFoundError(f"no device {device_id}")
    session.execute(delete(ViewTicket).where(ViewTicket.expires_at <= now))
    secret = secrets.token_urlsafe(24)
    expires_at = now + LIFETIME
    session.add(
        ViewTicket(
            ticket_hash=hash_of(secret),
            organisation_id=organisation_id,
            device_id=device_id,
            event_id=event_id,
            expires_at=expires_at,
        )
    )
    return Ticket(f"/view3d/{secret}/{device_id}/", expires_at)


def opens(session: Session, secret: str, device_id: str, *, now: dt.datetime, event_id: str | None = None) -> bool:
    """Whether this ticket opens the view of this box now; told an event, its replay."""
    query = select(ViewTicket.device_id).where(
        ViewTicket.ticket_hash == hash_of(secret), ViewTicket.device_id == device_id, ViewTicket.expires_at > now
    )
    if event_id is not None:
        query = query.where(ViewTicket.event_id == event_id)
    return session.scalar(query) is not None


def renew(session: Session, secret: str, *, now: dt.datetime) -> None:
    """Let a ticket that has not expired live its full time from now."""
    session.execute(
        update(ViewTicket)
        .where(ViewTicket.ticket_hash == hash_of(secret), ViewTicket.expires_at > now)
        .values(expires_at=now + LIFETIME)
    )
