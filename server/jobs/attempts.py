"""Boxes whose data kill workers: attempts are written down before the work where a worker may have died at them.

A worker that is killed says nothing of the box it was at.  To write each attempt down would cost every job two commits;
so only those are that have a sign of a death before them: a message that somebody had and did not answer, the boxes
that were due when a worker of the embedded mode began after one that did not end in order, and boxes that fail already.
One that kills workers always has such a sign, its first death apart.
"""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass

import structlog
from sqlalchemy import select
from sqlalchemy.orm import Session

from server.database import Database
from server.jobs.failures import Job, count_death, forget, left_alone_until
from server.models import Device, JobAttempt, JobFailure

DEATHS = 3
"""So many attempts in a row without an answer, and the box is a dead letter: anybody may be killed once."""
FORGOTTEN = dt.timedelta(minutes=10)
"""After so long an attempt under another message is a dead worker's as well; until then it may still be at work."""

log = structlog.stdlib.get_logger("scatola.jobs")


@dataclass(frozen=True, slots=True)
class Leave:
    """Whether a job may begin, and whether that was written down."""

    granted: bool
    written: bool


def begin(database: Database, job: Job, now: dt.datetime) -> Leave:
    """Ask to begin; hardly any box has something written down, and then this is one look."""
    if not job.again and not _is_noted(database, job.device_id):
        return Leave(True, False)
    with database.transaction() as session:
        return _begin(session, job, now)


def _is_noted(database: Database, device_id: str) -> bool:
    """Whether a box fails, or an attempt at it is written down."""
    failure = select(JobFailure.device_id).where(JobFailure.device_id == device_id)
    with database.glance() as connection:
        return (
            connection.execute(
                failure.union_all(select(JobAttempt.device_id).where(JobAttempt.device_id == device_id))
            ).first()
            is not None
        )


def _begin(session: Session, job: Job, now: dt.datetime) -> Leave:
    # Workers that are at one box at once take turns here.
    if session.get(Device, job.device_id, with_for_update={"key_share": True}) is None:
        return Leave(True, False)
    attempt = session.get(JobAttempt, job.device_id, with_for_update=True)
    if attempt is None:
        session.add(JobAttempt(device_id=job.device_id, unanswered=1, job_id=job.id, began_at=now))
        return Leave(True, True)
    failure = session.get(JobFailure, job.device_id, with_for_update=True)
    counted = failure is not None and failure.last_at > attempt.began_at
    dead = counted or job.alone or attempt.job_id == job.id or attempt.began_at < now - FORGOTTEN
    deaths = attempt.unanswered if dead else attempt.unanswered - 1
    if deaths >= DEATHS:
        if failure is None or not counted:
            count_death(session, job, deaths, now=now)
            log.error("box left alone: workers die at it", device_id=job.device_id, deaths=deaths)
            return Leave(False, False)
        if now < left_alone_until(failure):
            return Leave(False, False)
    if not dead:
        return Leave(True, False)
    attempt.unanswered += 1
    attempt.job_id, attempt.began_at = job.id, now
    return Leave(True, True)


def answered(database: Database, device_id: str) -> None:
    """A job is done: forget the failures and attempts of its box; asks first."""
    if _is_noted(database, device_id):
        with database.transaction() as session:
            forget(session, [device_id])


def withdraw(database: Database, device_id: str) -> None:
    """A worker that is told to stop leaves an attempt that was written down: that is no death."""
    with database.transaction() as session:
        attempt = session.get(JobAttempt, device_id, with_for_update=True)
        if attempt is None:
            return
        attempt.unanswered -= 1
        if attempt.unanswered == 0:
            session.delete(attempt)
