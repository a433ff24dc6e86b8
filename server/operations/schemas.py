from __future__ import annotations

import datetime as dt
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from server.jobs.failures import Failing
from server.jobs.rerun import Report
from server.models import Rerun, RerunItem


class FailureOut(BaseModel):
    """A box whose work keeps failing."""

    device_id: str
    device_name: str
    dead: bool = Field(description="a dead letter: tried once an hour only, until it is replayed")
    failures: int = Field(description="in a row")
    first_at: dt.datetime
    last_at: dt.datetime
    dead_at: dt.datetime | None
    error: str
    queue: str
    job_id: str
    request_id: str | None = Field(description="of the upload that caused the job, where known")
    waiting_batches: int


class FailureList(BaseModel):
    items: list[FailureOut]
    total: int = Field(description="how many there are, shown or not")
    next: str | None = Field(description="`after` of the next page")


class ReplayOut(BaseModel):
    replayed: list[str] = Field(description="ids of the boxes that are tried again now")


class RerunIn(BaseModel):
    """What to compute again."""

    model_config = ConfigDict(extra="forbid")

    device_id: str | None = Field(default=None, max_length=32, description="one box alone")


class RerunOut(BaseModel):
    """A run in a list."""

    id: str
    created_at: dt.datetime
    created_by: str
    algorithm: str
    device_id: str | None
    total: int
    finished_at: dt.datetime | None
    cancelled_at: dt.datetime | None


class RerunList(BaseModel):
    items: list[RerunOut]
    next: str | None = Field(description="value of `before` for the next page")


class ShiftOut(BaseModel):
    """How far a figure moved, after minus before."""

    events: int
    mean: float
    median: float
    p95_abs: float
    max_abs: float
    max_event_id: str


class KindChanged(BaseModel):
    event_id: str
    before: str
    after: str


class ReportOut(BaseModel):
    """How far a run has come, and what the version changed."""

    id: str
    status: Literal["running", "done", "cancelled"]
    algorithm: str
    device_id: str | None
    created_at: dt.datetime
    created_by: str
    finished_at: dt.datetime | None
    total: int
    done: int
    outcomes: dict[str, int] = Field(description="same, revised, gone, erased, contended, failed")
    before_algorithms: dict[str, int]
    kinds_changed: list[KindChanged]
    changed_members: dict[str, int] = Field(description="members of the canonical JSON, and in how many events")
    shifts: dict[str, ShiftOut]


class TurnOut(BaseModel):
    """How far mountings were turned by the other version, degrees."""

    mountings: int
    median: float
    p95: float
    worst: float
    worst_installation_id: str


class MountingReportOut(BaseModel):
    """How the mountings stand, and what this version changed."""

    algorithm: str
    waiting: int = Field(description="of another version, asked for and not estimated yet")
    outdated: int = Field(description="of another version, not asked for, or without data that tell anything")
    done: int = Field(description="of this version now, of another before")
    before_algorithms: dict[str, int]
    statuses: dict[str, int] = Field(description="`before -> after`, of those that are done")
    turned: TurnOut | None
    sigma_ratio: float | None = Field(description="median of the largest sigma after over that before")


class ItemOut(BaseModel):
    """One event of a run."""

    event_id: str
    outcome: str | None
    error: str | None
    attempts: int
    done_at: dt.datetime | None
    before: dict[str, Any] | None
    after: dict[str, Any] | None
    differences: list[str]


class ItemPage(BaseModel):
    items: list[ItemOut]
    next: int | None


def failure_out(found: Failing) -> FailureOut:
    """A failing box as it is shown."""
    row = found.failure
    return FailureOut(
        device_id=row.device_id,
        device_name=found.name,
        dead=row.dead_at is not None,
        failures=row.failures,
        first_at=row.first_at,
        last_at=row.last_at,
        dead_at=row.dead_at,
        error=row.error,
        queue=row.queue,
        job_id=row.job_id,
        request_id=row.request_id,
        waiting_batches=found.waiting,
    )


def rerun_out(row: Rerun) -> RerunOut:
    """A run in a list."""
    return RerunOut.model_validate(row, from_attributes=True)


def report_out(found: Report) -> ReportOut:
    """A run's report."""
    return ReportOut.model_validate(found, from_attributes=True)


def item_out(row: RerunItem) -> ItemOut:
    """An event of a run."""
    return ItemOut.model_validate(row, from_attributes=True)
