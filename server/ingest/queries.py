"""What is stored of a boot's batches, and what is still to be worked off."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from server.models import Batch

MAX_RANGES = 100


@dataclass(frozen=True, slots=True)
class Backlog:
    """What is due."""

    batches: int
    devices: int
    oldest_at: dt.datetime | None


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a boot's stream has come: the lowest sequence not stored, and the gaps below the highest."""

    next_sequence: int
    missing: list[tuple[int, int]]


def backlog(session: Session) -> Backlog:
    """What is due over all devices; served by the index of unprocessed batches."""
    due = session.execute(
        select(func.count(), func.count(Batch.device_id.distinct()), func.min(Batch.received_at)).where(
            Batch.processed_at.is_(None)
        )
    ).one()
    return Backlog(batches=due[0], devices=due[1], oldest_at=due[2])


def progress(session: Session, device_id: str, stream: str, boot: str) -> Progress:
    """Gaps of a boot's stream, at most `MAX_RANGES` of them, found by the database in one pass over an index."""
    of_boot = Batch.device_id == device_id, Batch.stream == stream, Batch.boot == boot
    before = func.lag(Batch.sequence, 1, -1).over(order_by=Batch.sequence).label("before")
    steps = select(Batch.sequence.label("sequence"), before).where(*of_boot).subquery()
    gaps = session.execute(
        select(steps.c.before + 1, steps.c.sequence - 1)
        .where(steps.c.sequence > steps.c.before + 1)
        .order_by(steps.c.sequence)
        .limit(MAX_RANGES)
    ).all()
    missing = [(int(first), int(last)) for first, last in gaps]
    if missing:
        return Progress(next_sequence=missing[0][0], missing=missing)
    highest = session.scalar(select(func.max(Batch.sequence)).where(*of_boot))
    return Progress(next_sequence=0 if highest is None else int(highest) + 1, missing=[])
