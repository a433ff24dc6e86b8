"""`scatola reprocess --mountings`: mountings again, by this version; in parallel, resumable, compared at the end."""

from __future__ import annotations

import argparse
import dataclasses
import json
import multiprocessing
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import TYPE_CHECKING

from server.cli.progress import progress
from server.settings import Settings, set_numba_cache_dir

if TYPE_CHECKING:
    from server.jobs.remount import MountingReport


def remount(args: argparse.Namespace) -> int:
    """Ask for every mounting of another version, work them off, and say what this version changed."""
    set_numba_cache_dir()
    from server.database import Database
    from server.jobs.remount import ask, report
    from server.moments import utc_now

    database = Database(Settings())
    try:
        boxes = ask(database, now=utc_now(), device_id=args.device)
        _work_off(boxes, args.jobs)
        with database.reading() as session:
            _show(args, report(session, device_id=args.device))
    finally:
        database.dispose()
    return 0


def _work_off(boxes: Sequence[str], jobs: int) -> None:
    """Boxes in processes of their own: the work is computation."""
    if jobs <= 1 or len(boxes) <= 1:
        for done, box in enumerate(boxes, 1):
            work([box])
            _tell(done, len(boxes))
    else:
        context = multiprocessing.get_context("spawn")
        parts = [boxes[k : k + 16] for k in range(0, len(boxes), 16)]
        with ProcessPoolExecutor(min(jobs, len(parts)), mp_context=context) as pool:
            done = 0
            for ended in as_completed([pool.submit(work, part) for part in parts]):
                done += ended.result()
                _tell(done, len(boxes))
    progress("")


def work(boxes: Sequence[str]) -> int:
    """Bring some boxes up to date; how many.  One that a worker has in hand is left to it."""
    set_numba_cache_dir()
    from server.database import Database
    from server.jobs.work import ContendedError, bring_up_to_date
    from server.moments import utc_now
    from server.store import open_store

    settings = Settings()
    database, store = Database(settings), open_store(settings)
    try:
        for box in boxes:
            try:
                while bring_up_to_date(database, store, box, clock=utc_now).more:
                    pass
            except ContendedError:
                print(f"scatola: {box} is being worked on; a worker goes on with it", file=sys.stderr)
    finally:
        database.dispose()
    return len(boxes)


def _tell(done: int, total: int) -> None:
    if sys.stderr.isatty():
        progress(f"{done} of {total} boxes")


def _show(args: argparse.Namespace, found: MountingReport) -> None:
    if args.json:
        print(json.dumps({"mountings": dataclasses.asdict(found)}))
        return
    print(f"mountings by {found.algorithm}: {found.done} of another version before, {found.waiting} wait")
    if found.outdated:
        print(f"  {found.outdated} stay as another version left them: their data tell nothing, or nobody asked")
    for change, count in sorted(found.statuses.items()):
        print(f"  {count:>6}  {change}")
    if found.turned is not None:
        turned = found.turned
        print(
            f"  turned by {turned.median:.2f}° (median), {turned.p95:.2f}° (95 %), at most {turned.worst:.2f}° "
            f"({turned.worst_installation_id})"
        )
    if found.sigma_ratio is not None:
        print(f"  largest sigma after over before: {found.sigma_ratio:.2f} (median)")
