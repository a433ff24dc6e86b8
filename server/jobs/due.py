"""What is due: the database's answer, which no queue can lose."""

from __future__ import annotations

import datetime as dt

from sqlalchemy import select, union
from sqlalchemy.orm import Session

from server.models import Batch, DeviceState


def due_devices(session: Session, limit: int, *, now: dt.datetime, after: str = "") -> list[str]:
    """Devices with batches not worked off, or whose review is due, in the order of id after `after`.

    Going round by id keeps one busy box from starving the others.
    """
    waiting = select(Batch.device_id.label("id")).where(Batch.processed_at.is_(None), Batch.device_id > after)
    review = select(DeviceState.device_id.label("id")).where(
        DeviceState.review_at <= now, DeviceState.device_id > after
    )
    return list(session.scalars(union(waiting, review).order_by("id").limit(limit)))


def burst_devices(session: Session, limit: int) -> list[str]:
    """Devices with a burst that waits: somebody wants to know what happened."""
    waiting = select(Batch.device_id).where(Batch.processed_at.is_(None), Batch.stream == "burst")
    return list(session.scalars(waiting.distinct().order_by(Batch.device_id).limit(limit)))
