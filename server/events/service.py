"""What people do with events: review, legal hold; and how two revisions differ."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from server.events.queries import event_of
from server.live.changes import announce
from server.models import Device, Event, EventAction


def review(
    session: Session,
    organisation_id: str,
    event_id: str,
    verdict: str | None,
    note: str | None,
    *,
    actor: str,
    now: dt.datetime,
) -> Event:
    """Say what an event was; every word stays in its history."""
    event = event_of(session, organisation_id, event_id, lock=True)
    event.verdict, event.note, event.reviewed_at = verdict, note, now
    _record(session, event, verdict or "reopened", note, actor=actor, now=now)
    return event


def hold(
    session: Session, organisation_id: str, event_id: str, *, held: bool, reason: str, actor: str, now: dt.datetime
) -> Event:
    """Begin or end a legal hold: while it lasts nothing that the event rests on may be erased."""
    device_id = event_of(session, organisation_id, event_id).device_id
    # First the box's row, as whoever erases its data does: what is not marked by then stays.
    session.execute(select(Device.id).where(Device.id == device_id).with_for_update())
    event = event_of(session, organisation_id, event_id, lock=True)
    event.held_at, event.hold_reason = ((event.held_at or now), reason) if held else (None, None)
    _record(session, event, "held" if held else "released", reason, actor=actor, now=now)
    return event


def _record(session: Session, event: Event, action: str, note: str | None, *, actor: str, now: dt.datetime) -> None:
    session.add(EventAction(event_id=event.id, at=now, actor=actor, action=action, note=note))
    announce(
        session,
        "event",
        at=now,
        organisation_id=event.organisation_id,
        device_id=event.device_id,
        vehicle_id=event.vehicle_id,
        data={"event_id": event.id, "event_kind": event.kind, "action": action},
    )


def differences(before: Any, after: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Where two documents differ: path, value before, value after; long lists are told by their length."""
    if before == after:
        return
    if isinstance(before, dict) and isinstance(after, dict):
        for name in sorted({**before, **after}):
            yield from differences(before.get(name), after.get(name), f"{path}.{name}" if path else name)
    elif isinstance(before, list) and isinstance(after, list) and max(len(before), len(after)) > 12:
        yield path, f"{len(before)} values", f"{len(after)} values"
    else:
        yield path, before, after
