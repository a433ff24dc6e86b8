"""Appending to the change table, last in the transaction that made the change.

Ids must increase in the order of commit, or a reader that remembers the last id it saw skips rows.
A sequence alone does not promise that, so the rows are inserted just before the commit, under one
lock that the transaction keeps until it ends.  SQLite has a single writer and needs none.
"""

from __future__ import annotations

import datetime as dt
from typing import Any

from sqlalchemy import event, insert, text
from sqlalchemy.orm import Session

from server.database import CHANGE_LOCK
from server.models import Change

_PENDING = "pending_changes"
_LOCK = text("SELECT pg_advisory_xact_lock(:lock)")
_INSERT = insert(Change.__table__)  # pyright: ignore[reportArgumentType]  a mapped class has a Table


def announce(
    session: Session,
    kind: str,
    *,
    at: dt.datetime,
    organisation_id: str,
    device_id: str | None = None,
    vehicle_id: str | None = None,
    data: dict[str, Any] | None = None,
) -> None:
    """Append a change when the session's transaction commits; nothing is written when it rolls back."""
    session.info.setdefault(_PENDING, []).append(
        {
            "kind": kind,
            "at": at,
            "organisation_id": organisation_id,
            "device_id": device_id,
            "vehicle_id": vehicle_id,
            "data": data or {},
        }
    )


def _append(session: Session) -> None:
    pending: list[dict[str, Any]] | None = session.info.pop(_PENDING, None)
    if not pending:
        return
    session.flush()
    connection = session.connection()
    if connection.dialect.name == "postgresql":
        connection.execute(_LOCK, {"lock": CHANGE_LOCK})
    # One by one: a statement of many rows need not number them in their order.
    for change in pending:
        connection.execute(_INSERT, change)


def _forget(session: Session) -> None:
    session.info.pop(_PENDING, None)


event.listen(Session, "before_commit", _append)
event.listen(Session, "after_rollback", _forget)
