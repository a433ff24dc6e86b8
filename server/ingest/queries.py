"""What is stored of a boot's batches, and what is still to be worked off."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass

from sqlalchemy import Connection, bindparam, func, select
from sqlalchemy.orm import Session

from server.models import Batch, JobFailure, SequenceRun

MAX_RANGES = 100
Runs = list[tuple[int, int]]
"""First and last sequence of each, in their order."""
# Built once: building a statement and its key in the compiler's cache costs more than running it.
OF_BOOT = (
    select(SequenceRun.first, SequenceRun.last)
    .where(
        SequenceRun.device_id == bindparam("device_id"),
        SequenceRun.stream == bindparam("stream"),
        SequenceRun.boot == bindparam("boot"),
    )
    .order_by(SequenceRun.first)
)
_RUNS = OF_BOOT.limit(MAX_RANGES + 1)


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


def failing(session: Session) -> tuple[int, int]:
    """Boxes whose work failed last time, and how many of them are dead letters."""
    counts = session.execute(select(func.count(), func.count(JobFailure.dead_at)).select_from(JobFailure)).one()
    return counts[0], counts[1]


def runs(connection: Connection, device_id: str, stream: str, boot: str) -> Runs:
    """The first `MAX_RANGES` + 1 runs of stored sequences; as many rows are read, however long the stream is."""
    rows = connection.execute(_RUNS, {"device_id": device_id, "stream": stream, "boot": boot})
    return [(first, last) for first, last in rows]


def progress(runs: Runs) -> Progress:
    """Gaps between runs, the first `MAX_RANGES` of them."""
    missing: list[tuple[int, int]] = []
    wanted = 0
    for first, last in runs:
        if first > wanted:
            missing.append((wanted, first - 1))
        wanted = last + 1
    return Progress(missing[0][0] if missing else wanted, missing[:MAX_RANGES])
