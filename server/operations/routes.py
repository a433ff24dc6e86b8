"""Work that keeps failing, and re-runs by another version, over HTTP."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Sequence
from typing import Annotated, cast

from fastapi import APIRouter, Path, Query, Request

from server.accounts import audit
from server.accounts.access import Caller, JobManager
from server.database import Database
from server.edge import DatabaseOf, Now, Wake, place_of
from server.errors import NotFoundError
from server.jobs import failures, remount, rerun
from server.models import Device, JobFailure, Rerun
from server.operations.schemas import (
    FailureList,
    ItemPage,
    MountingReportOut,
    ReplayOut,
    ReportOut,
    RerunIn,
    RerunList,
    failure_out,
    item_out,
    report_out,
    rerun_out,
)

router = APIRouter(prefix="/api/v1", tags=["operations"])

DeviceId = Annotated[str, Path(max_length=32)]
RerunId = Annotated[str, Path(max_length=32)]


@router.get("/jobs/failures")
def list_failures(
    caller: JobManager,
    database: DatabaseOf,
    dead: Annotated[bool, Query(description="dead letters alone")] = False,
    after: Annotated[str, Query(max_length=32, description="`next` of the page before")] = "",
    limit: Annotated[int, Query(ge=1, le=500)] = 200,
) -> FailureList:
    """Boxes whose work keeps failing, by id, a page at a time; their batches stay due and are not lost."""
    del caller
    with database.reading() as session:
        found = failures.failing(session, only_dead=dead, page=(after, limit + 1))
        total = failures.count(session, only_dead=dead)
        items = [failure_out(each) for each in found[:limit]]
    return FailureList(items=items, total=total, next=items[-1].device_id if len(found) > limit else None)


@router.post("/jobs/failures/replay")
def replay_all(request: Request, caller: JobManager, database: DatabaseOf, now: Now) -> ReplayOut:
    """Try all dead letters again at once."""
    with database.reading() as session:
        dead = sorted(failures.dead(session))
    return replay(request, caller, database, dead, now)


@router.post("/jobs/failures/{device_id}/replay")
def replay_one(request: Request, device_id: DeviceId, caller: JobManager, database: DatabaseOf, now: Now) -> ReplayOut:
    """Try a failing box again at once."""
    with database.reading() as session:
        if session.get(JobFailure, device_id) is None:
            raise NotFoundError(f"No work of a box {device_id!r} fails")
    return replay(request, caller, database, [device_id], now)


def replay(
    request: Request, caller: Caller, database: Database, device_ids: Sequence[str], now: dt.datetime
) -> ReplayOut:
    """Try boxes again at once, and say so to the audit log."""
    state = request.app.state
    with database.transaction() as session:
        replayed = failures.forget(session, device_ids)
        if replayed:
            detail = {"devices": replayed[:100]}
            audit.record(session, caller, "jobs.replay", "dead letters", now=now, detail=detail)
    drop = cast("Callable[[set[str]], None] | None", getattr(state, "drop_letters", None))
    if drop is not None and replayed:
        drop(set(replayed))
    for device_id in replayed:
        cast("Wake", state.wake)(device_id)
    return ReplayOut(replayed=replayed)


@router.post("/reruns", status_code=201)
def begin_rerun(wanted: RerunIn, caller: JobManager, database: DatabaseOf, now: Now) -> ReportOut:
    """Compute all severe events again by this version; the workers share them out when nothing else is due."""
    with database.transaction() as session:
        if wanted.device_id is not None and session.get(Device, wanted.device_id) is None:
            raise NotFoundError(f"There is no box {wanted.device_id!r}")
        run = rerun.begin(session, caller.organisation_id, device_id=wanted.device_id, by=caller.name, now=now)
        audit.record(session, caller, "rerun.begin", run.id, now=now)
        session.flush()
        return report_out(rerun.report(session, run.id))


@router.get("/reruns")
def list_reruns(
    caller: JobManager,
    database: DatabaseOf,
    before: Annotated[str | None, Query(max_length=100)] = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 50,
) -> RerunList:
    """The newest runs first, a page at a time."""
    place = None if before is None else place_of(before)
    with database.reading() as session:
        rows = rerun.runs(session, caller.organisation_id, before=place, limit=limit + 1)
    last = rows[limit - 1] if len(rows) > limit else None
    return RerunList(
        items=[rerun_out(row) for row in rows[:limit]],
        next=None if last is None else f"{last.created_at.isoformat()}~{last.id}",
    )


@router.post("/reruns/mountings", status_code=202)
def ask_for_mountings(
    request: Request, wanted: RerunIn, caller: JobManager, database: DatabaseOf, now: Now
) -> MountingReportOut:
    """Estimate every mounting of another version anew by this one; the workers share them out.  Again goes on."""
    with database.reading() as session:
        if wanted.device_id is not None and session.get(Device, wanted.device_id) is None:
            raise NotFoundError(f"There is no box {wanted.device_id!r}")
    boxes = remount.ask(database, now=now, organisation_id=caller.organisation_id, device_id=wanted.device_id)
    with database.transaction() as session:
        detail = {"boxes": len(boxes)}
        audit.record(session, caller, "rerun.mountings", "mountings", now=now, detail=detail)
    for device_id in boxes:
        cast("Wake", request.app.state.wake)(device_id)
    return _mountings(database, caller, wanted.device_id)


@router.get("/reruns/mountings")
def read_mountings(
    caller: JobManager, database: DatabaseOf, device: Annotated[str | None, Query(max_length=32)] = None
) -> MountingReportOut:
    """How many mountings are of another version or wait, and what this version changed of the others."""
    return _mountings(database, caller, device)


def _mountings(database: Database, caller: Caller, device_id: str | None) -> MountingReportOut:
    with database.reading() as session:
        found = remount.report(session, organisation_id=caller.organisation_id, device_id=device_id)
    return MountingReportOut.model_validate(found, from_attributes=True)


@router.get("/reruns/{rerun_id}")
def read_rerun(rerun_id: RerunId, caller: JobManager, database: DatabaseOf) -> ReportOut:
    """How far a run has come, and what this version changed so far."""
    del caller
    with database.reading() as session:
        return report_out(rerun.report(session, rerun_id))


@router.get("/reruns/{rerun_id}/events")
def read_rerun_events(
    rerun_id: RerunId,
    caller: JobManager,
    database: DatabaseOf,
    after: Annotated[int, Query(ge=-1, le=2**31 - 1)] = -1,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
) -> ItemPage:
    """Each event of a run before and after, a page at a time."""
    del caller
    with database.reading() as session:
        if session.get(Rerun, rerun_id) is None:
            raise NotFoundError(f"There is no re-run {rerun_id!r}")
        rows = rerun.items(session, rerun_id, after=after, limit=limit + 1)
        last = rows[limit - 1].ordinal if len(rows) > limit else None
        return ItemPage(items=[item_out(row) for row in rows[:limit]], next=last)


@router.post("/reruns/{rerun_id}/cancel")
def cancel_rerun(rerun_id: RerunId, caller: JobManager, database: DatabaseOf, now: Now) -> ReportOut:
    """Take no further events of a run; what is done stays done."""
    with database.transaction() as session:
        found = rerun.report(session, rerun_id)
        if found.status == "running":
            rerun.cancel(session, rerun_id, now=now)
            audit.record(session, caller, "rerun.cancel", rerun_id, now=now)
            session.flush()
            session.expire_all()
        return report_out(rerun.report(session, rerun_id))
