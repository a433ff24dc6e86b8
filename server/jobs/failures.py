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

from server.logs import redact
from server.models import Batch, Device, JobAttempt, JobFailure
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


def left_alone_until(row: JobFailure) -> dt.datetime:
    """When a failing box is tried again."""
    return row.last_at + dt.timedelta(seconds=DEAD_AGAIN_S if row.dead_at is not None else pause_s(row.failures))


@dataclass(frozen=True, slots=True)
class Job:
    """One attempt at one box."""

    id: str
    device_id: str
    queue: str
    words: Carried
    again: bool = False
    """Whether somebody may have died at it: an attempt is then written down (server.jobs.attempts)."""
    alone: bool = False
    """Whether no other worker can be at the box: an attempt that nobody answered for is then a dead one's."""


class WorkerDiedError(Exception):
    """What killed a worker cannot be caught; this stands for it where failures are listed."""


def note_failure(session: Session, job: Job, error: BaseException, *, now: dt.datetime) -> JobFailure | None:
    """Count a failure; None when the box is gone."""
    row = _counted(session, job, error, now=now)
    if row is not None:
        # It failed, and said so: nobody died at it.
        session.execute(delete(JobAttempt).where(JobAttempt.device_id == job.device_id))
        if row.failures >= MAX_FAILURES and row.dead_at is None:
            row.dead_at = now
    return row


def count_death(session: Session, job: Job, deaths: int, *, now: dt.datetime) -> None:
    """Make a box a dead letter at which so many workers in a row died: each try costs all other boxes a worker."""
    error = WorkerDiedError(f"the worker died during the job, {deaths} times in a row")
    row = _counted(session, job, error, now=now)
    if row is not None and row.dead_at is None:
        row.failures += deaths - 1
        row.dead_at = now


def _counted(session: Session, job: Job, error: BaseException, *, now: dt.datetime) -> JobFailure | None:
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
    return row


def forget(session: Session, device_ids: Iterable[str]) -> list[str]:
    """Let boxes be tried at once; which of them were failing."""
    device_ids = list(device_ids)
    session.execute(delete(JobAttempt).where(JobAttempt.device_id.in_(device_ids)))
    rows = delete(JobFailure).where(JobFailure.device_id.in_(device_ids)).returning(JobFailure.device_id)
    return list(session.scalars(rows))


def left_alone(session: Session, now: dt.datetime) -> dict[str, bool]:
    """Boxes that are not tried now, and whether each is a dead letter."""
    rows = session.scalars(select(JobFailure).where(JobFailure.last_at > now - dt.timedelta(seconds=DEAD_AGAIN_S)))
    return {row.device_id: row.dead_at is not None for row in rows if now < left_alone_until(row)}


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
