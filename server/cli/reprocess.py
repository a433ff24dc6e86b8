"""`scatola reprocess`: events again, by this version; in parallel, resumable, and compared at the end."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import threading
from concurrent.futures import ProcessPoolExecutor
from typing import TYPE_CHECKING, Any

from server.cli.progress import progress
from server.settings import Settings, set_numba_cache_dir

if TYPE_CHECKING:
    from server.database import Database
    from server.jobs.rerun import Report
    from server.models import RerunItem

POLL_S = 0.5


def reprocess(args: argparse.Namespace) -> int:
    """Begin a run over severe events, or resume or show one, and say what this version changed."""
    if args.mountings:
        from server.cli.remount import remount

        return remount(args)
    set_numba_cache_dir()
    from server.database import Database
    from server.jobs.rerun import begin_everywhere, report
    from server.models import Rerun
    from server.moments import utc_now

    database = Database(Settings())
    try:
        runs = [args.resume or args.report] if args.resume or args.report else []
        if not runs:
            with database.transaction() as session:
                runs = begin_everywhere(session, device_id=args.device, by="command line", now=utc_now())
        with database.reading() as session:
            unknown = [run for run in runs if session.get(Rerun, run) is None]
        if unknown:
            raise ValueError(f"there is no run {unknown[0]}")
        if not args.report:
            _work_off(database, runs, args.jobs)
        with database.reading() as session:
            reports = [report(session, run) for run in runs]
            _show(args, reports, [item for run in runs for item in _items(session, run)])
    finally:
        database.dispose()
    return 0


def _work_off(database: Database, runs: list[str], jobs: int) -> None:
    if jobs <= 1:
        work(runs, lambda: _tell(database, runs))
        progress("")
        return
    # Processes of their own: the work is computation.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        working = [pool.submit(work, runs) for _ in range(jobs)]
        pause = threading.Event()
        try:
            while not all(each.done() for each in working):
                _tell(database, runs)
                pause.wait(POLL_S)
        except KeyboardInterrupt:
            print(f"\nscatola: go on with: scatola reprocess --resume {runs[0]}", file=sys.stderr)
            raise
        for each in working:
            each.result()
    progress("")


def work(runs: list[str], tell: Any = None) -> None:
    """Take events of the runs until none is left; one that somebody else holds is waited for."""
    set_numba_cache_dir()
    from server.database import Database
    from server.jobs.rerun import Reruns, report
    from server.moments import utc_now
    from server.store import open_store

    settings = Settings()
    database = Database(settings)
    pause = threading.Event()
    try:
        reruns = Reruns(database, open_store(settings), utc_now, runs)
        while True:
            while reruns.once(wait=False):
                if tell is not None:
                    tell()
            with database.reading() as session:
                if all(report(session, run).status != "running" for run in runs):
                    return
            pause.wait(POLL_S)
    finally:
        database.dispose()


def _tell(database: Database, runs: list[str]) -> None:
    if not sys.stderr.isatty():
        return
    from server.jobs.rerun import counts

    with database.reading() as session:
        done, total = counts(session, runs)
    progress(f"{done} of {total} events")


def _items(session: Any, run: str) -> list[RerunItem]:
    from server.jobs.rerun import items

    found: list[RerunItem] = []
    while page := items(session, run, after=found[-1].ordinal if found else -1, limit=500):
        found += page
    return found


def _event_json(item: RerunItem) -> dict[str, Any]:
    before, after = item.before or {}, item.after or {}
    return {
        "event_id": item.event_id,
        "revision": after.get("revision"),
        "before_algorithm": before.get("algorithm"),
        "algorithm": after.get("algorithm"),
        "outcome": item.outcome,
        "error": item.error,
        "differences": item.differences,
    }


def _show(args: argparse.Namespace, reports: list[Report], items: list[RerunItem]) -> None:
    from server.jobs.rerun import told

    events = [_event_json(item) for item in items]
    if args.json:
        print(json.dumps({"reports": [told(each) for each in reports], "events": events}, default=str))
        return
    for each in events:
        said = f"revision {each['revision']}  {each['before_algorithm']} -> {each['algorithm']}"
        print(f"{each['event_id']}  {said}  {each['outcome']}")
        for path in each["differences"]:
            print(f"    {path}")
    for each in reports:
        outcomes = ", ".join(f"{count} {outcome}" for outcome, count in sorted(each.outcomes.items()))
        print(f"run {each.id}: {each.status}, {each.done} of {each.total} events by {each.algorithm}: {outcomes}")
        for change in each.kinds_changed:
            print(f"  {change['event_id']}: {change['before']} -> {change['after']}")
        for name, shift in each.shifts.items():
            print(
                f"  {name}: mean {shift.mean:+.3g}, 95 % within {shift.p95_abs:.3g}, "
                f"at most {shift.max_abs:.3g} ({shift.max_event_id})"
            )
