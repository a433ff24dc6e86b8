"""Appending to the change table, last in the transaction that made the change.

Ids must increase in the order of commit, or a reader that remembers the last id it saw skips rows.
A sequence alone does not promise that, so the rows are inserted just before the commit, under one
lock that the transaction keeps until it ends.  SQLite has a single writer and needs none.
"""

from __future__ import annotations

import datetime as dt
from typing import Any, cast

from sqlalchemy import Table, bindparam, event, func, insert, select
from sqlalchemy.orm import Session

from server.database import CHANGE_LOCK
from server.models import Change

_PENDING = "pending_changes"
_CHANGES = cast("Table", Change.__table__)
_INSERT = insert(_CHANGES)
_NAMES = ["kind", "at", "organisation_id", "device_id", "vehicle_id", "data"]
# In one statement: the row is made of what the lock gave, so its id is drawn when the lock is held.
_HELD = select(func.pg_advisory_xact_lock(CHANGE_LOCK).label("held")).cte("held").prefix_with("MATERIALIZED")
_INSERT_HELD = insert(_CHANGES).from_select(
    _NAMES, select(*(bindparam(name, type_=_CHANGES.c[name].type) for name in _NAMES)).select_from(_HELD)
)


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
    statement = _INSERT_HELD if connection.dialect.name == "postgresql" else _INSERT
    # One by one: a statement of many rows need not number them in their order.
    for change in pending:
        connection.execute(statement, change)


def _forget(session: Session) -> None:
    session.info.pop(_PENDING, None)


event.listen(Session, "before_commit", _append)
event.listen(Session, "after_rollback", _forget)
