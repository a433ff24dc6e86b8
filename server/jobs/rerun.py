"""Re-running a fleet's events by this version: shared out over any number of workers, resumable, compared at the end.

A run is a list of events in the database.  Whoever has time takes the next one under a lease; a worker that dies
lets its lease run out and another takes the event again.  Computing again is idempotent, so nothing is done twice
that matters.
"""

from __future__ import annotations

import datetime as dt
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import structlog
from sqlalchemy import exists, func, insert, or_, select, tuple_, update
from sqlalchemy.orm import Session

from nav_core.events.record import ALGORITHM
from server.database import Database
from server.errors import NotFoundError
from server.events.queries import severe
from server.logs import redact
from server.models import Event, Organisation, Rerun, RerunItem
from server.moments import Clock
from server.store import BlobStore

if TYPE_CHECKING:
    from server.jobs.reprocess import Again


LEASE = dt.timedelta(minutes=10)
ATTEMPTS = 5
"""An event whose box is worked on all the time, or that fails, is tried so often."""
LOOK_S = 2.0
"""So often an idle worker asks whether there is a run."""

log = structlog.stdlib.get_logger("scatola.rerun")


def begin(session: Session, organisation_id: str, *, device_id: str | None, by: str, now: dt.datetime) -> Rerun:
    """Write down a run over the organisation's severe events, or those of one box."""
    run = Rerun(
        organisation_id=organisation_id,
        device_id=device_id,
        created_at=now,
        created_by=by[:254],
        algorithm=ALGORITHM,
        total=0,
    )
    session.add(run)
    session.flush()
    wanted = severe(device_id).where(Event.organisation_id == organisation_id)
    rows = [
        {"rerun_id": run.id, "event_id": event_id, "ordinal": k, "attempts": 0, "differences": []}
        for k, event_id in enumerate(session.scalars(wanted))
    ]
    if rows:
        session.execute(insert(RerunItem), rows)
    else:
        run.finished_at = now
    run.total = len(rows)
    return run


def begin_everywhere(session: Session, *, device_id: str | None, by: str, now: dt.datetime) -> list[str]:
    """A run for each organisation that has severe events; their ids."""
    found: list[str] = []
    for organisation_id in session.scalars(select(Organisation.id).order_by(Organisation.created_at)):
        run = begin(session, organisation_id, device_id=device_id, by=by, now=now)
        if run.total:
            found.append(run.id)
        else:
            session.delete(run)
    return found


def claim(session: Session, *, now: dt.datetime, runs: Sequence[str] | None = None) -> tuple[str, str] | None:
    """Take the next event of the oldest run of this version, or of these: its run's id and its own."""
    open_runs = select(Rerun).where(
        Rerun.finished_at.is_(None), Rerun.cancelled_at.is_(None), Rerun.algorithm == ALGORITHM
    )
    if runs is not None:
        open_runs = open_runs.where(Rerun.id.in_(runs))
    for run in session.scalars(open_runs.order_by(Rerun.created_at, Rerun.id)):
        item = session.scalar(
            select(RerunItem)
            .where(
                RerunItem.rerun_id == run.id,
                RerunItem.done_at.is_(None),
                or_(RerunItem.claimed_until.is_(None), RerunItem.claimed_until < now),
            )
            .order_by(RerunItem.ordinal)
            .limit(1)
            .with_for_update(skip_locked=True)
        )
        if item is not None:
            item.claimed_until = now + LEASE
            item.attempts += 1
            return run.id, item.event_id
        if not session.scalar(select(_left(run.id))):
            run.finished_at = now
    return None


def finish(session: Session, run_id: str, event_id: str, result: Again | Exception, *, now: dt.datetime) -> None:
    """Write down how an event came out; one that is to be tried again becomes free."""
    item = session.get(RerunItem, (run_id, event_id), with_for_update=True)
    if item is None or item.done_at is not None:
        return
    if isinstance(result, Exception):
        item.outcome, item.error = "failed", redact(f"{type(result).__name__}: {result}")[:500]
    else:
        item.outcome, item.error = result.outcome, None
        item.differences = list(result.differences)
        item.before = {"algorithm": result.before_algorithm, **(result.before or {})}
        item.after = {"algorithm": result.algorithm, "revision": result.revision, **(result.after or {})}
    # Tried again a little later, after the events that come next.
    again = item.outcome in ("failed", "contended") and item.attempts < ATTEMPTS
    item.claimed_until = now + dt.timedelta(seconds=item.attempts) if again else None
    item.done_at = None if again else now


class Reruns:
    """A worker's part in the runs."""

    def __init__(self, database: Database, store: BlobStore, clock: Clock, runs: Sequence[str] | None = None) -> None:
        # Here: the service that begins and shows runs needs none of the numerics.
        from server.jobs.reprocess import reprocess

        self._database, self._store, self._clock, self._runs = database, store, clock, runs
        self._looked = -LOOK_S
        self.reprocess = reprocess

    def once(self, *, wait: bool = True) -> bool:
        """Compute one event again; whether there was one.  While there is none, it asks every `LOOK_S` only."""
        if wait and time.monotonic() - self._looked < LOOK_S:
            return False
        try:
            with self._database.reading() as session:
                some = session.scalar(select(exists().where(Rerun.finished_at.is_(None), Rerun.cancelled_at.is_(None))))
            found = None
            if some:
                with self._database.transaction() as session:
                    found = claim(session, now=self._clock(), runs=self._runs)
        except Exception:
            log.exception("cannot ask for re-runs")
            found = None
        if found is None:
            self._looked = time.monotonic()
            return False
        self._compute(*found)
        return True

    def _compute(self, run_id: str, event_id: str) -> None:
        with structlog.contextvars.bound_contextvars(job_id=f"{run_id}/{event_id}"):
            try:
                result: Again | Exception = self.reprocess(self._database, self._store, event_id, clock=self._clock)
            except Exception as error:
                log.exception("event cannot be computed again")
                result = error
            try:
                with self._database.transaction() as session:
                    finish(session, run_id, event_id, result, now=self._clock())
            except Exception:
                log.exception("result of a re-run cannot be written")  # its lease ends


def start_reruns(
    database: Database, store: BlobStore, *, stop: threading.Event, clock: Clock, idle: Callable[[], bool]
) -> threading.Thread:
    """Take part in the runs whenever nothing waits in the queue."""
    reruns = Reruns(database, store, clock)

    def keep() -> None:
        while not stop.is_set():
            if not (idle() and reruns.once()):
                stop.wait(LOOK_S / 4.0)

    thread = threading.Thread(target=keep, name="reruns", daemon=True)
    thread.start()
    return thread


# --- the comparison


@dataclass(frozen=True, slots=True)
class Shift:
    """How far a figure moved, over the events that have it before and after."""

    events: int
    mean: float
    median: float
    p95_abs: float
    max_abs: float
    max_event_id: str


@dataclass(frozen=True, slots=True)
class Report:
    """A run as it stands."""

    id: str
    status: str
    """running, done, cancelled."""
    algorithm: str
    device_id: str | None
    created_at: dt.datetime
    created_by: str
    finished_at: dt.datetime | None
    total: int
    done: int
    outcomes: dict[str, int]
    before_algorithms: dict[str, int]
    kinds_changed: list[dict[str, Any]]
    """Events that are another kind of event now."""
    changed_members: dict[str, int]
    """Members of the canonical JSON that differ, and in how many events."""
    shifts: dict[str, Shift]
    """After minus before, by figure."""


_SHIFTS: dict[str, Callable[[dict[str, Any]], Any]] = {
    "delta_v_resultant_kmh": lambda event: event["delta_v_kmh"]["resultant"],
    "delta_v_longitudinal_kmh": lambda event: event["delta_v_kmh"]["longitudinal"],
    "delta_v_lateral_kmh": lambda event: event["delta_v_kmh"]["lateral"],
    "pdof_deg": lambda event: event["pdof_deg"],
    "impact_speed_kmh": lambda event: event["impact_speed_kmh"],
    "peak_g": lambda event: event["peak_g"],
    "t0_s": lambda event: event["t0_s"],
}


def report(session: Session, run_id: str) -> Report:
    """What a run found so far."""
    run = session.get(Rerun, run_id)
    if run is None:
        raise NotFoundError(f"There is no re-run {run_id!r}")
    done = session.scalar(
        select(func.count()).select_from(RerunItem).where(RerunItem.rerun_id == run_id, RerunItem.done_at.is_not(None))
    )
    status = "cancelled" if run.cancelled_at is not None else "done" if done == run.total else "running"
    outcomes: Counter[str] = Counter()
    algorithms: Counter[str] = Counter()
    members: Counter[str] = Counter()
    kinds: list[dict[str, Any]] = []
    moved: dict[str, list[tuple[float, str]]] = {name: [] for name in _SHIFTS}
    items = select(RerunItem).where(RerunItem.rerun_id == run_id, RerunItem.done_at.is_not(None))
    for item in session.scalars(items.order_by(RerunItem.ordinal).execution_options(yield_per=500)):
        outcomes[item.outcome or "failed"] += 1
        algorithms[(item.before or {}).get("algorithm") or "unknown"] += 1
        members.update({path.split("[")[0] for path in item.differences})
        if item.before and item.after and "kind" in item.before and "kind" in item.after:
            _compare(item, kinds, moved)
    return Report(
        id=run.id,
        status=status,
        algorithm=run.algorithm,
        device_id=run.device_id,
        created_at=run.created_at,
        created_by=run.created_by,
        finished_at=run.finished_at,
        total=run.total,
        done=done or 0,
        outcomes=dict(outcomes),
        before_algorithms=dict(algorithms),
        kinds_changed=kinds,
        changed_members=dict(members.most_common(50)),
        shifts={name: _shift(found) for name, found in moved.items() if found},
    )


def _compare(item: RerunItem, kinds: list[dict[str, Any]], moved: dict[str, list[tuple[float, str]]]) -> None:
    assert item.before is not None
    assert item.after is not None
    if item.before["kind"] != item.after["kind"]:
        kinds.append({"event_id": item.event_id, "before": item.before["kind"], "after": item.after["kind"]})
    for name, of in _SHIFTS.items():
        before, after = of(item.before), of(item.after)
        if before is not None and after is not None:
            step = after - before
            # Directions meet at ±180°.
            step = (step + 180.0) % 360.0 - 180.0 if name == "pdof_deg" else step
            moved[name].append((float(step), item.event_id))


def _shift(found: list[tuple[float, str]]) -> Shift:
    steps = np.array([step for step, _ in found])
    sizes = np.abs(steps)
    worst = int(np.argmax(sizes))
    return Shift(
        len(found),
        float(steps.mean()),
        float(np.median(steps)),
        float(np.percentile(sizes, 95)),
        float(sizes[worst]),
        found[worst][1],
    )


def counts(session: Session, run_ids: Sequence[str]) -> tuple[int, int]:
    """Events of some runs that are done, and all."""
    query = select(func.count(RerunItem.done_at), func.count()).where(RerunItem.rerun_id.in_(run_ids))
    done, total = session.execute(query).one()
    return done, total


def told(found: Report) -> dict[str, Any]:
    """A report for JSON."""
    return asdict(found)


def items(session: Session, run_id: str, *, after: int, limit: int) -> list[RerunItem]:
    """A page of a run's events in their order."""
    query = select(RerunItem).where(RerunItem.rerun_id == run_id, RerunItem.ordinal > after)
    return list(session.scalars(query.order_by(RerunItem.ordinal).limit(limit)))


def runs(
    session: Session, organisation_id: str, *, before: tuple[dt.datetime, str] | None = None, limit: int = 50
) -> list[Rerun]:
    """The newest runs first, from after `before` in that order."""
    query = select(Rerun).where(Rerun.organisation_id == organisation_id)
    if before is not None:
        query = query.where(tuple_(Rerun.created_at, Rerun.id) < before)
    return list(session.scalars(query.order_by(Rerun.created_at.desc(), Rerun.id.desc()).limit(limit)))


def cancel(session: Session, run_id: str, *, now: dt.datetime) -> None:
    """Take no further events of a run."""
    session.execute(update(Rerun).where(Rerun.id == run_id, Rerun.finished_at.is_(None)).values(cancelled_at=now))


def _left(run_id: str) -> Any:  # SQLAlchemy's own expression
    return exists().where(RerunItem.rerun_id == run_id, RerunItem.done_at.is_(None))
