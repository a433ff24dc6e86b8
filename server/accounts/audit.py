"""The log of who did and saw what; it only grows."""

from __future__ import annotations

import datetime as dt
import threading
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from server.accounts.caller import Caller
from server.models import AuditEntry

REPEAT = dt.timedelta(minutes=1)
_MANY = 10_000
LOOKS = ("location.read", "raw.read")
"""Actions that change nothing: somebody saw something."""


def record(
    session: Session,
    caller: Caller,
    action: str,
    subject: str,
    *,
    now: dt.datetime,
    detail: dict[str, Any] | None = None,
) -> None:
    """Write an entry in the transaction of what it tells of."""
    session.add(
        AuditEntry(
            at=now,
            organisation_id=caller.organisation_id,
            actor_kind=caller.kind,
            actor_id=caller.user_id or caller.key_id or caller.session_id,
            actor_name=caller.name[:254],
            action=action,
            subject=subject[:200],
            detail=detail or {},
            address=caller.address[:64],
        )
    )


class RecentLooks:
    """What was looked at lately: a page that renews itself every other second is one look a minute."""

    def __init__(self) -> None:
        self._seen: dict[tuple[str | None, ...], dt.datetime] = {}
        self._lock = threading.Lock()

    def is_new(self, key: tuple[str | None, ...], now: dt.datetime) -> bool:
        """Whether this look is worth an entry of its own."""
        with self._lock:
            last = self._seen.get(key)
            if last is not None and last <= now < last + REPEAT:
                return False
            if len(self._seen) >= _MANY:
                self._seen = {key: at for key, at in self._seen.items() if now < at + REPEAT}
                if len(self._seen) >= _MANY:
                    self._seen.clear()  # more entries than needed are better than none
            self._seen[key] = now
            return True


def entries(
    session: Session,
    organisation_id: str,
    *,
    before: int | None,
    action: str | None,
    looks: bool | None = None,
    limit: int,
) -> list[AuditEntry]:
    """The newest entries first; with `looks` only what was seen, without it only what was done."""
    wanted = select(AuditEntry).where(AuditEntry.organisation_id == organisation_id)
    if before is not None:
        wanted = wanted.where(AuditEntry.id < before)
    if action is not None:
        wanted = wanted.where(AuditEntry.action == action)
    if looks is not None:
        wanted = wanted.where(AuditEntry.action.in_(LOOKS) if looks else AuditEntry.action.not_in(LOOKS))
    return list(session.scalars(wanted.order_by(AuditEntry.id.desc()).limit(limit)))
