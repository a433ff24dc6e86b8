"""The worker process: works off what the database says is due."""

from __future__ import annotations

import datetime as dt
import os
import select
import signal
import threading
from collections.abc import Callable
from types import FrameType

import structlog

from server.database import Database
from server.jobs.analyses import start_analyses
from server.jobs.due import burst_devices, due_devices
from server.jobs.supervise import parent_fd
from server.migrations import is_current
from server.settings import Settings, set_numba_cache_dir
from server.store import BlobStore, collect, open_store

Clock = Callable[[], dt.datetime]

LOOK_S = 0.25
"""So often the embedded worker looks by itself."""
DEVICES = 32
BACKOFF_S = (1.0, 300.0)
"""A device whose work fails is left alone for this long at first, and at most; it doubles each time."""
NICENESS = 5
COLLECT_EVERY_S = 3600.0
SEAL_EVERY_S = 20.0
COLLECT_AGE = dt.timedelta(days=1)

log = structlog.stdlib.get_logger("scatola.worker")


def utc_now() -> dt.datetime:
    """The time."""
    return dt.datetime.now(dt.UTC)


def run(settings: Settings) -> None:
    """Be a worker until SIGTERM, SIGINT, or the end of the supervisor."""
    _check_schema(settings)
    set_numba_cache_dir()
    os.nice(NICENESS)
    stop = threading.Event()

    def leave(number: int, frame: FrameType | None) -> None:
        # At once, wherever the work is: an unfinished round leaves nothing behind, and the next worker repeats it.
        del number, frame
        stop.set()
        raise SystemExit(0)

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, leave)
    if settings.broker_url is None:
        run_worker(settings, stop=stop, wake_fd=parent_fd())
    else:
        from server.jobs.broker import run_consumer

        run_consumer(settings, stop=stop, clock=utc_now)


def _check_schema(settings: Settings) -> None:
    database = Database(settings)
    try:
        if not is_current(database.engine):
            raise ValueError("the database is not at this version's schema: run `scatola migrate` first")
    finally:
        database.dispose()


def run_worker(
    settings: Settings, *, stop: threading.Event, wake_fd: int | None = None, clock: Clock = utc_now
) -> None:
    """Work off due devices until told to stop; the embedded mode's loop."""
    database, store = Database(settings), open_store(settings)
    keeper = start_housekeeping(database, store, stop=stop, clock=clock)
    sealer = start_sealing(database, settings, stop=stop, clock=clock)
    analyst = start_analyses(settings, database, stop=stop, clock=clock)
    rounds = Rounds(database, store, clock)
    try:
        while not stop.is_set():
            if not rounds.once(stop):
                _wait(stop, wake_fd)
    finally:
        stop.set()
        keeper.join()
        analyst.join()
        if sealer is not None:
            sealer.join()
        database.dispose()


class Rounds:
    """Goes round the due devices; one that fails waits, and the others do not."""

    def __init__(self, database: Database, store: BlobStore, clock: Clock) -> None:
        # Imported here: the numerics and their compiled kernels, once, before the first box waits for them.
        from server.jobs.work import bring_up_to_date

        self._bring_up_to_date = bring_up_to_date
        self._database = database
        self._store = store
        self._clock = clock
        self._after = ""
        self._failures: dict[str, tuple[int, dt.datetime]] = {}

    def once(self, stop: threading.Event) -> bool:
        """Work off a handful of devices; whether there was anything to do."""
        try:
            devices = self._due()
        except Exception:
            log.exception("cannot ask what is due")
            return False
        for device_id in devices:
            # A burst that came meanwhile is not kept waiting by the others' backlogs.
            for urgent in (*self._bursts(), device_id):
                if stop.is_set():
                    return True
                self._work(urgent)
        return bool(devices)

    def _bursts(self) -> list[str]:
        try:
            with self._database.reading() as session:
                waiting = burst_devices(session, DEVICES)
        except Exception:
            log.exception("cannot ask for bursts")
            return []
        return [device_id for device_id in waiting if self._may_try(device_id, self._clock())]

    def _due(self) -> list[str]:
        now = self._clock()
        with self._database.reading() as session:
            devices = due_devices(session, DEVICES, now=now, after=self._after)
            if not devices and self._after:
                devices = due_devices(session, DEVICES, now=now)
        self._after = devices[-1] if len(devices) == DEVICES else ""
        return [device_id for device_id in devices if self._may_try(device_id, now)]

    def _may_try(self, device_id: str, now: dt.datetime) -> bool:
        return device_id not in self._failures or self._failures[device_id][1] <= now

    def _work(self, device_id: str) -> None:
        try:
            self._bring_up_to_date(self._database, self._store, device_id, clock=self._clock)
        except Exception:
            count = self._failures.get(device_id, (0, utc_now()))[0] + 1
            pause = min(BACKOFF_S[0] * 2.0 ** min(count - 1, 30), BACKOFF_S[1])
            self._failures[device_id] = count, self._clock() + dt.timedelta(seconds=pause)
            log.exception("work failed", device_id=device_id, failures=count, again_in_s=pause)
        else:
            self._failures.pop(device_id, None)


def start_housekeeping(
    database: Database, store: BlobStore, *, stop: threading.Event, clock: Clock
) -> threading.Thread:
    """Collect blobs without a row, hourly, beside the work."""

    def keep() -> None:
        while not stop.wait(COLLECT_EVERY_S):
            try:
                deleted = collect(store, database, clock() - COLLECT_AGE)
            except Exception:
                log.exception("blobs cannot be collected")
            else:
                log.info("blobs collected", deleted=deleted)

    thread = threading.Thread(target=keep, name="housekeeping", daemon=True)
    thread.start()
    return thread


def start_sealing(
    database: Database, settings: Settings, *, stop: threading.Event, clock: Clock
) -> threading.Thread | None:
    """Sign and timestamp the chains that events rest on, beside the work; None where the operator wants no seals."""
    from server.evidence.seal import is_on, seal_waiting

    if not is_on(settings):
        return None

    def keep() -> None:
        while not stop.wait(SEAL_EVERY_S):
            try:
                seal_waiting(database, settings, now=clock())
            except Exception:
                log.exception("chains cannot be sealed")

    thread = threading.Thread(target=keep, name="sealing", daemon=True)
    thread.start()
    return thread


def _wait(stop: threading.Event, wake_fd: int | None) -> None:
    """Wait for a byte in the pipe, or a moment; the pipe's end is the supervisor's."""
    if wake_fd is None:
        stop.wait(LOOK_S)
        return
    ready, _, _ = select.select([wake_fd], [], [], LOOK_S)
    if ready and not os.read(wake_fd, 65536):
        stop.set()
