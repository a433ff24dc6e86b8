"""Appending to the change table, last in the transaction that made the change.

Ids must increase in the order of commit, or a reader that remembers the last id it saw skips rows.
A sequence alone does not promise that, so the rows are inserted just before the commit, under one
lock that the transaction keeps until it ends.  SQLite has a single writer and needs none.
"""

from __future__ import annotations

import datetime as dt
from typing import Any

from sqlalchemy import event, text
from sqlalchemy.orm import Session

from server.database import CHANGE_LOCK
from server.models import Change

_PENDING = "pending_changes"


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
    if _PENDING not in session.info:
        session.info[_PENDING] = []
        event.listen(session, "before_commit", _append)
        event.listen(session, "after_rollback", _forget)
    session.info[_PENDING].append(
        Change(
            kind=kind,
            at=at,
            organisation_id=organisation_id,
            device_id=device_id,
            vehicle_id=vehicle_id,
            data=data or {},
        )
    )


def _append(session: Session) -> None:
    pending: list[Change] = session.info[_PENDING]
    if not pending:
        return
    session.flush()
    if session.get_bind().dialect.name == "postgresql":
        session.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": CHANGE_LOCK})
    session.add_all(pending)
    session.flush()
    pending.clear()


def _forget(session: Session) -> None:
    session.info[_PENDING].clear()
