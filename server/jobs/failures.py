"""Boxes whose work keeps failing: how long each is left alone, and which count as dead letters.

A row per box, not per message: a message only says when, and what is due stays due in the database.  So nothing is
lost with a dead letter; it is tried again seldom by itself, and at once when somebody replays it.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable
from dataclasses import dataclass

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session

from server.database import Database
from server.logs import redact
from server.models import Batch, Device, JobFailure
from server.tracing import Carried

BACKOFF_S = (1.0, 300.0)
"""A box whose work fails is left alone for this long at first, and at most; it doubles each time."""
MAX_FAILURES = 9
"""In a row; then it is a dead letter."""
DEAD_AGAIN_S = 3600.0


def pause_s(failures: int) -> float:
    """How long a box is left alone after so many failures in a row."""
    if failures >= MAX_FAILURES:
        return DEAD_AGAIN_S
    return min(BACKOFF_S[0] * 2.0 ** (failures - 1), BACKOFF_S[1])


@dataclass(frozen=True, slots=True)
class Job:
    """One attempt at one box."""

    id: str
    device_id: str
    queue: str
    words: Carried


def note_failure(session: Session, job: Job, error: BaseException, *, now: dt.datetime) -> JobFailure | None:
    """Count a failure; None when the box is gone."""
    # Two workers that fail at one box at once take turns here.
    if session.get(Device, job.device_id, with_for_update={"key_share": True}) is None:
        return None
    row = session.get(JobFailure, job.device_id, with_for_update=True)
    if row is None:
        row = JobFailure(device_id=job.device_id, failures=0, first_at=now)
        session.add(row)
    row.failures += 1
    row.last_at, row.queue, row.job_id = now, job.queue, job.id
    row.request_id = job.words.get("request_id")
    row.error = redact(f"{type(error).__name__}: {error}")[:500]
    if row.failures >= MAX_FAILURES and row.dead_at is None:
        row.dead_at = now
    return row


def note_success(database: Database, device_id: str) -> None:
    """Forget the failures of a box; asks first, for hardly any box has some."""
    with database.reading() as session:
        failed = session.get(JobFailure, device_id) is not None
    if failed:
        with database.transaction() as session:
            forget(session, [device_id])


def forget(session: Session, device_ids: Iterable[str]) -> list[str]:
    """Let boxes be tried at once; which of them were failing."""
    rows = delete(JobFailure).where(JobFailure.device_id.in_(list(device_ids))).returning(JobFailure.device_id)
    return list(session.scalars(rows))


def left_alone(session: Session, now: dt.datetime) -> dict[str, bool]:
    """Boxes that are not tried now, and whether each is a dead letter."""
    rows = session.scalars(select(JobFailure).where(JobFailure.last_at > now - dt.timedelta(seconds=DEAD_AGAIN_S)))
    return {
        row.device_id: row.dead_at is not None
        for row in rows
        if now < row.last_at + dt.timedelta(seconds=pause_s(row.failures))
    }


def dead(session: Session) -> set[str]:
    """All dead letters' boxes."""
    return set(session.scalars(select(JobFailure.device_id).where(JobFailure.dead_at.is_not(None))))


@dataclass(frozen=True, slots=True)
class Failing:
    """A failing box as it is shown."""

    failure: JobFailure
    name: str
    waiting: int


def count(session: Session, *, only_dead: bool = False) -> int:
    """How many boxes fail."""
    query = select(func.count(JobFailure.device_id))
    return session.scalar(query.where(JobFailure.dead_at.is_not(None)) if only_dead else query) or 0


def failing(session: Session, *, only_dead: bool = False, page: tuple[str, int] | None = None) -> list[Failing]:
    """Failing boxes, the longest dead first, and how many batches of each wait.

    `page`: by id instead, so many after this one.
    """
    waiting = (
        select(func.count())
        .where(Batch.device_id == JobFailure.device_id, Batch.processed_at.is_(None))
        .correlate(JobFailure)
        .scalar_subquery()
    )
    query = select(JobFailure, Device.name, waiting).join(Device, Device.id == JobFailure.device_id)
    if only_dead:
        query = query.where(JobFailure.dead_at.is_not(None))
    if page is None:
        query = query.order_by(JobFailure.dead_at.is_(None), JobFailure.first_at, JobFailure.device_id)
    else:
        after, limit = page
        query = query.where(JobFailure.device_id > after).order_by(JobFailure.device_id).limit(limit)
    return [Failing(failure, name, count) for failure, name, count in session.execute(query)]
