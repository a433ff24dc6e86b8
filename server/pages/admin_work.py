"""The administration's pages of work that waits or fails, and of the algorithm's versions and re-runs."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, cast

from fastapi import APIRouter, Query, Request
from sqlalchemy import func, select
from sqlalchemy.orm import Session
from starlette.responses import HTMLResponse, Response

from server.accounts import audit
from server.accounts.access import JobManager
from server.edge import DatabaseOf, Now
from server.errors import NotFoundError
from server.ingest.queries import backlog
from server.installations.service import ALGORITHM, MANUAL_ALGORITHM
from server.jobs import failures, remount, rerun
from server.models import Batch, Device, Event, EventRevision, Installation, JobFailure, Rerun, RerunItem, Vehicle
from server.operations.routes import ask_for_mountings, replay
from server.operations.schemas import RerunIn
from server.pages import queries
from server.pages.admin import OLD_WORK, outdated
from server.pages.forms import Text, back
from server.pages.routes import answer
from server.pages.words import KINDS
from server.wording import marked

router = APIRouter(prefix="/admin", include_in_schema=False, default_response_class=HTMLResponse)

BOXES_SHOWN, ITEMS_SHOWN = 20, 100
OUTCOMES = {
    "same": marked("the same"),
    "revised": marked("revised"),
    "gone": marked("no longer there"),
    "erased": marked("erased"),
    "contended": marked("busy, tried again"),
    "failed": marked("failed"),
}
STATUSES = {"running": marked("running"), "done": marked("finished"), "cancelled": marked("cancelled")}
FIGURES: dict[str, tuple[str, str]] = {
    "delta_v_resultant_kmh": (marked("Delta-V, resultant"), "km/h"),
    "delta_v_longitudinal_kmh": (marked("Delta-V, longitudinal"), "km/h"),
    "delta_v_lateral_kmh": (marked("Delta-V, lateral"), "km/h"),
    "pdof_deg": (marked("Direction of force"), "°"),
    "impact_speed_kmh": (marked("Speed before impact"), "km/h"),
    "peak_g": (marked("Peak"), "g"),
    "t0_s": (marked("Time zero"), "s"),
}


# --- what waits and what fails


@router.get("/work")
def work(request: Request, caller: JobManager, database: DatabaseOf, now: Now) -> HTMLResponse:
    """Dead letters, what fails, what waits."""
    depths = cast("Callable[[], dict[str, float] | None] | None", getattr(request.app.state, "queue_depths", None))
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        due = backlog(session)
        waiting = (
            select(Device, func.count(), func.min(Batch.received_at))
            .join(Batch, Batch.device_id == Device.id)
            .where(Batch.processed_at.is_(None))
            .group_by(Device.id)
            .order_by(func.min(Batch.received_at))
            .limit(BOXES_SHOWN)
        )
        context = {
            "failing": failures.failing(session),
            "due": due,
            "late": due.oldest_at is not None and now - due.oldest_at > OLD_WORK,
            "waiting": [tuple(row) for row in session.execute(waiting)],
            "depths": None if depths is None else depths(),
        }
    return answer(request, "admin-work.html", caller, "admin", change, context)


@router.post("/work/replay")
def replay_all(request: Request, caller: JobManager, database: DatabaseOf, now: Now) -> Response:
    """Try all dead letters again at once."""
    with database.reading() as session:
        dead = sorted(failures.dead(session))
    replay(request, caller, database, dead, now)
    return back("/admin/work")


@router.post("/work/{device_id}/replay")
def replay_one(request: Request, device_id: str, caller: JobManager, database: DatabaseOf, now: Now) -> Response:
    """Try one box again at once."""
    with database.reading() as session:
        if session.get(JobFailure, device_id) is None:
            raise NotFoundError(f"No work of a box {device_id!r} fails")
    replay(request, caller, database, [device_id], now)
    return back("/admin/work")


# --- versions and re-runs


@dataclass(frozen=True)
class Version:
    """A version of an algorithm, and how much of what is shown rests on it."""

    what: str
    name: str
    count: int
    current: bool


def versions(session: Session, organisation_id: str) -> list[Version]:
    """Of the severe events' newest revisions, and of the mountings in use."""
    of_events = (
        select(EventRevision.algorithm, func.count())
        .join(Event, (EventRevision.event_id == Event.id) & (EventRevision.number == Event.revision))
        .where(Event.organisation_id == organisation_id, Event.severe)
        .where(Event.withdrawn_at.is_(None), Event.erased_at.is_(None))
        .group_by(EventRevision.algorithm)
        .order_by(EventRevision.algorithm)
    )
    of_mountings = (
        select(Installation.algorithm, func.count())
        .join(Device, Device.id == Installation.device_id)
        .where(Device.organisation_id == organisation_id, Installation.ended_at.is_(None))
        .group_by(Installation.algorithm)
        .order_by(Installation.algorithm)
    )
    found = [Version(marked("Crashes"), n, count, n == rerun.ALGORITHM) for n, count in session.execute(of_events)]
    ours = (ALGORITHM, MANUAL_ALGORITHM)
    return found + [Version(marked("Mountings"), n, count, n in ours) for n, count in session.execute(of_mountings)]


@router.get("/versions")
def version_page(request: Request, caller: JobManager, database: DatabaseOf) -> HTMLResponse:
    """Which version computed what, and the runs by which it was computed again."""
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        runs = rerun.runs(session, caller.organisation_id)
        done = (
            select(RerunItem.rerun_id, func.count(RerunItem.done_at))
            .where(RerunItem.rerun_id.in_([run.id for run in runs]))
            .group_by(RerunItem.rerun_id)
        )
        devices = select(Device).where(Device.organisation_id == caller.organisation_id).order_by(Device.name)
        boxes = session.scalars(devices).all()
        context = {
            "versions": versions(session, caller.organisation_id),
            "outdated": outdated(session, caller.organisation_id),
            "mountings": remount.report(session, organisation_id=caller.organisation_id),
            "algorithm": rerun.ALGORITHM,
            "runs": runs,
            "done": {row.rerun_id: row[1] for row in session.execute(done)},
            "boxes": boxes,
            "box_names": {box.id: box.name for box in boxes},
        }
    return answer(request, "admin-versions.html", caller, "admin", change, context)


@router.post("/versions")
def begin(
    request: Request, caller: JobManager, database: DatabaseOf, now: Now, device_id: Text = "", what: Text = "events"
) -> Response:
    """Compute severe events or mountings again by this version."""
    if what == "mountings":
        ask_for_mountings(request, RerunIn(device_id=device_id or None), caller, database, now)
        return back("/admin/versions")
    with database.transaction() as session:
        if device_id and session.get(Device, device_id) is None:
            raise NotFoundError(f"There is no box {device_id!r}")
        run = rerun.begin(session, caller.organisation_id, device_id=device_id or None, by=caller.name, now=now)
        audit.record(session, caller, "rerun.begin", run.id, now=now)
        run_id = run.id
    return back(f"/admin/versions/{run_id}")


@dataclass(frozen=True)
class Item:
    """An event of a run, before and after."""

    row: RerunItem
    kind: str
    name: str
    at: dt.datetime

    @property
    def outcome(self) -> str:
        return OUTCOMES.get(self.row.outcome or "", "") if self.row.done_at else marked("waits")

    def figure(self, which: str, name: str) -> float | None:
        """Resultant delta-V, direction or peak, before or after."""
        told: dict[str, Any] | None = getattr(self.row, which)
        if not told or "kind" not in told:
            return None
        return told["delta_v_kmh"]["resultant"] if name == "delta_v" else told[name]


def _items(session: Session, rerun_id: str, after: int) -> tuple[Sequence[Item], int | None]:
    query = (
        select(RerunItem, Event, Device, Vehicle)
        .join(Event, Event.id == RerunItem.event_id)
        .join(Device, Device.id == Event.device_id)
        .outerjoin(Vehicle, Vehicle.id == Event.vehicle_id)
        .where(RerunItem.rerun_id == rerun_id, RerunItem.ordinal > after)
        .order_by(RerunItem.ordinal)
        .limit(ITEMS_SHOWN + 1)
    )
    found = [
        Item(row, KINDS[event.kind], vehicle.name if vehicle else device.name, event.at)
        for row, event, device, vehicle in session.execute(query)
    ]
    return found[:ITEMS_SHOWN], found[ITEMS_SHOWN - 1].row.ordinal if len(found) > ITEMS_SHOWN else None


@router.get("/versions/{rerun_id}")
def run_page(
    request: Request,
    rerun_id: str,
    caller: JobManager,
    database: DatabaseOf,
    after: Annotated[int, Query(ge=-1, le=2**31 - 1)] = -1,
) -> HTMLResponse:
    """How far a run has come, and what the version changed."""
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        report = rerun.report(session, rerun_id)
        items, following = _items(session, rerun_id, after)
        box = session.get(Device, report.device_id) if report.device_id else None
    context = {
        "run": report,
        "items": items,
        "next": following,
        "box": box,
        "figures": FIGURES,
        "outcomes": OUTCOMES,
        "run_statuses": STATUSES,
        "kinds": KINDS,
    }
    return answer(request, "admin-rerun.html", caller, "admin", change, context)


@router.post("/versions/{rerun_id}/cancel")
def cancel(rerun_id: str, caller: JobManager, database: DatabaseOf, now: Now) -> Response:
    """Take no further events of a run."""
    with database.transaction() as session:
        run = session.get(Rerun, rerun_id)
        if run is None:
            raise NotFoundError(f"There is no re-run {rerun_id!r}")
        if run.finished_at is None and run.cancelled_at is None:
            rerun.cancel(session, rerun_id, now=now)
            audit.record(session, caller, "rerun.cancel", rerun_id, now=now)
    return back(f"/admin/versions/{rerun_id}")
