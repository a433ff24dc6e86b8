"""Commands that run the service: `serve`, `worker`, `viewer`, `migrate`, `warm-up`."""

from __future__ import annotations

import argparse
import functools
import os
import sys
import tempfile
import threading
from pathlib import Path

from server.settings import Settings, set_numba_cache_dir, share_figures

say = functools.partial(print, flush=True)


def serve(args: argparse.Namespace) -> int:
    """`scatola serve`."""
    del args
    settings = Settings()
    if settings.embedded:
        share_figures()
    from server.serve import serve as run

    run(settings, say=say)
    return 0


def worker(args: argparse.Namespace) -> int:
    """`scatola worker`."""
    del args
    set_numba_cache_dir()
    from server.jobs.worker import run
    from server.logs import configure_logging
    from server.tracing import configure_tracing

    settings = Settings()
    configure_logging(as_json=settings.log_json, level=settings.log_level)
    flush = configure_tracing(settings, "worker")
    try:
        run(settings)
    finally:
        flush()
    return 0


def viewer(args: argparse.Namespace) -> int:
    """`scatola viewer`."""
    from server.jobs.supervise import follow_parent
    from server.logs import configure_logging
    from server.view3d.viewer import run_viewer

    settings = Settings()
    configure_logging(as_json=settings.log_json, level=settings.log_level)
    stop = threading.Event()
    follow_parent(stop.set)
    run_viewer(settings, host=args.host, port=args.port, stop=stop)
    return 0


def analysis(args: argparse.Namespace) -> int:
    """`scatola analysis`: one attempt at an analysis, ended with the worker that started it."""
    set_numba_cache_dir()
    from server.database import Database
    from server.jobs.analyses import NICENESS, work_off
    from server.jobs.supervise import follow_parent
    from server.logs import configure_logging
    from server.moments import utc_now
    from server.store import open_store

    settings = Settings()
    configure_logging(as_json=settings.log_json, level=settings.log_level)
    # What it would have written no longer counts, so that nothing need be put in order.
    follow_parent(lambda: os._exit(1))
    os.nice(NICENESS)
    database = Database(settings)
    try:
        work_off(database, open_store(settings), args.id, args.attempt, clock=utc_now)
    finally:
        database.dispose()
    return 0


def migrate(args: argparse.Namespace) -> int:
    """`scatola migrate`; with `--check`, on a database of its own."""
    from server.migrations import differences, upgrade

    if not args.check:
        upgrade(Settings())
        return 0
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(data_dir=Path(folder), database_url=None)
        upgrade(settings)
        found = differences(settings)
    for difference in found:
        print(difference, file=sys.stderr)
    return 1 if found else 0


def warm_up(args: argparse.Namespace) -> int:
    """`scatola warm-up`: run what service and commands compile once, on a short drive, so that nobody waits for it."""
    del args
    set_numba_cache_dir()
    from nav_core.crash import reconstruct_drive
    from nav_core.mounting import estimate_mounting
    from nav_core.navigation import navigate, navigate_without_gyro
    from nav_core.sensors import identify
    from nav_core.simulate import Impact, Scenario, simulate

    drive, truth = simulate(Scenario(duration=60.0, accel_rate=50.0, with_gyro=True), seed=0)
    for method in ("whole-drive", "online", "mekf"):
        estimate_mounting(drive, method=method)
    navigate(drive, truth.R_va)
    navigate_without_gyro(drive, truth.R_va)
    identify(drive.inertial.f[:, 0].copy(), 50.0)
    blow = Impact(t=170.0, delta_v=8.0, speed=12.0)
    struck, _ = simulate(Scenario(duration=180.0, accel_rate=100.0, impacts=(blow,)), seed=0)
    reconstruct_drive(struck, estimate_mounting(struck))
    return 0
