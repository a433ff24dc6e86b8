"""The worker process: works off what the database says is due."""

from __future__ import annotations

import json
import os
import select
import signal
import threading
import uuid
from types import FrameType

import structlog
from prometheus_client import start_http_server

from server.database import Database
from server.jobs.analyses import start_analyses
from server.jobs.due import burst_devices, due_devices
from server.jobs.failures import Job, left_alone
from server.jobs.rerun import Reruns
from server.jobs.run import FIGURES, Tally, run_job
from server.jobs.supervise import end_with_parent, parent_fd
from server.memory import keep_freed_memory
from server.migrations import serves
from server.moments import Clock, utc_now
from server.settings import Settings, set_numba_cache_dir
from server.store import COLLECT_AGE, BlobStore, collect, open_store
from server.tracing import Carried, known

LOOK_S = 0.25
"""So often the embedded worker looks by itself."""
DEVICES = 32
RUNNING = "worker.running"
"""A file that is there while the embedded worker runs, and after one that did not end in order."""
NICENESS = 5
COLLECT_EVERY_S = 3600.0
SEAL_EVERY_S = 20.0
PRIVACY_EVERY_S = 20.0
RETENTION_EVERY_S = 3600.0
STOP_TELLING_S = 1.0
"""A message that is under way when the worker stops is sent again when its lease runs out."""

log = structlog.stdlib.get_logger("scatola.worker")


def run(settings: Settings) -> None:
    """Be a worker until SIGTERM, SIGINT, or the end of the supervisor."""
    end_with_parent()
    _check_schema(settings)
    set_numba_cache_dir()
    keep_freed_memory()
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

        if settings.metrics_port is not None:
            start_http_server(settings.metrics_port, settings.metrics_host, registry=FIGURES)
        run_consumer(settings, stop=stop, clock=utc_now)


def _check_schema(settings: Settings) -> None:
    database = Database(settings)
    try:
        if not serves(database.engine):
            raise ValueError("the database is not at this version's schema: run `scatola migrate` first")
    finally:
        database.dispose()


def run_worker(
    settings: Settings, *, stop: threading.Event, wake_fd: int | None = None, clock: Clock = utc_now
) -> None:
    """Work off due devices until told to stop; the embedded mode's loop."""
    database, store = Database(settings), open_store(settings)
    keeper = start_housekeeping(database, store, stop=stop, clock=clock)
    eraser = start_erasing(database, store, stop=stop, clock=clock)
    sealer = start_sealing(database, settings, stop=stop, clock=clock)
    tellers = start_telling(database, settings, stop=stop, clock=clock)
    analyst = start_analyses(settings, database, stop=stop, clock=clock)
    rounds = Rounds(database, store, clock, wary=_left_in_disorder(settings))
    reruns = Reruns(database, store, clock)
    try:
        while not stop.is_set():
            rounds.told.update(_listen(stop, wake_fd, 0.0))
            # Re-runs take what is left: after each event it is asked again what is due.
            if not rounds.once(stop) and not reruns.once():
                rounds.told.update(_listen(stop, wake_fd, LOOK_S))
    finally:
        stop.set()
        for teller in tellers:
            teller.join(STOP_TELLING_S)
        keeper.join()
        eraser.join()
        analyst.join()
        if sealer is not None:
            sealer.join()
        database.dispose()
        (settings.data_dir / RUNNING).unlink(missing_ok=True)


def _left_in_disorder(settings: Settings) -> bool:
    """Whether the worker before this one died; from now on, this one is the one that runs."""
    running = settings.data_dir / RUNNING
    try:
        settings.data_dir.mkdir(parents=True, exist_ok=True)
        died = running.exists()
        running.touch()
    except OSError:
        log.exception("cannot note that a worker runs: each start is taken for one after a death")
        return True
    return died


class Rounds:
    """Goes round the due devices; one that fails waits, and the others do not.

    `wary`: the worker before died; one of the devices that are due now may be why.
    """

    def __init__(self, database: Database, store: BlobStore, clock: Clock, *, wary: bool = False) -> None:
        # Imported here: the numerics and their compiled kernels, once, before the first box waits for them.
        from server.jobs.work import bring_up_to_date

        self._bring_up_to_date = bring_up_to_date
        self._database = database
        self._store = store
        self._clock = clock
        self._after = ""
        self._wary = wary
        self._left_alone: dict[str, bool] = {}
        self.told: dict[str, Carried] = {}
        """What the pipe told of the requests behind what is due."""

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
        if not self._after:  # round: all that was due has had its turn
            self._wary = False
        return bool(devices)

    def _bursts(self) -> list[str]:
        try:
            with self._database.reading() as session:
                waiting = burst_devices(session, DEVICES)
        except Exception:
            log.exception("cannot ask for bursts")
            return []
        return [device_id for device_id in waiting if device_id not in self._left_alone]

    def _due(self) -> list[str]:
        now = self._clock()
        with self._database.reading() as session:
            self._left_alone = left_alone(session, now)
            devices = due_devices(session, DEVICES, now=now, after=self._after)
            if not devices and self._after:
                devices = due_devices(session, DEVICES, now=now)
        self._after = devices[-1] if len(devices) == DEVICES else ""
        return [device_id for device_id in devices if device_id not in self._left_alone]

    def _work(self, device_id: str) -> None:
        words = self.told.pop(device_id, {})
        job = Job(uuid.uuid4().hex, device_id, "devices", words, again=self._wary, alone=True)

        def work(tally: Tally) -> None:
            done = self._bring_up_to_date(self._database, self._store, device_id, clock=self._clock)
            tally.add(batches=done.batches, failed=done.failed, estimates=done.estimates)

        try:
            run_job(self._database, job, work, clock=self._clock)
        except Exception:  # noqa: BLE001  written down and logged there; the other boxes go on
            self._left_alone[device_id] = False


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


def start_erasing(database: Database, store: BlobStore, *, stop: threading.Event, clock: Clock) -> threading.Thread:
    """Carry out orders of erasure, and hourly what retention demands, beside the work; any number may do so at once."""
    from server.privacy.erasure import run_open
    from server.privacy.retention import apply_retention

    def keep() -> None:
        since_retention = 0.0
        while not stop.wait(PRIVACY_EVERY_S):
            since_retention += PRIVACY_EVERY_S
            try:
                run_open(database, store, clock=clock, stopped=stop.is_set)
                if since_retention >= RETENTION_EVERY_S:
                    since_retention = 0.0
                    apply_retention(database, store, now=clock(), stopped=stop.is_set)
            except Exception:
                log.exception("erasure or retention failed; it goes on with the next look")

    thread = threading.Thread(target=keep, name="erasing", daemon=True)
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


def start_telling(
    database: Database, settings: Settings, *, stop: threading.Event, clock: Clock
) -> list[threading.Thread]:
    """Send alerts, and look for what only the clock tells, beside the work."""
    from server.alerts import delivery, sweep

    return [*delivery.start(database, settings, stop=stop, clock=clock), sweep.start(database, stop=stop, clock=clock)]


def _listen(stop: threading.Event, wake_fd: int | None, seconds: float) -> dict[str, Carried]:
    """Wait so long for a line in the pipe; the pipe's end is the supervisor's.

    A line may name a device and the request behind it.  One that a full pipe cut short is none: the database says
    what is due, and only the log and the trace are the poorer for it.
    """
    if wake_fd is None:
        stop.wait(seconds)
        return {}
    ready, _, _ = select.select([wake_fd], [], [], seconds)
    if not ready:
        return {}
    said = os.read(wake_fd, 65536)
    if not said:
        stop.set()
    told: dict[str, Carried] = {}
    for line in said.splitlines():
        try:
            words = json.loads(line)
            told[str(words["device_id"])] = known(words)
        except (ValueError, TypeError, KeyError):
            continue
    return told
