"""Works off the workbench's analyses, each in a process of its own.

A file that an engineer uploads may be anything: a process can be given a time, ended when the analysis is
cancelled, and takes nobody with it when it dies.  The worker holds a lease on the row meanwhile; when it is gone as
well, the lease lapses and another worker begins anew.  What a process writes counts only for the attempt it is.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import os
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from importlib import metadata
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import orjson
import structlog

from server.analyses import queries, service
from server.database import Database
from server.errors import ProblemError
from server.events.window import Part, between, merged
from server.formats.columns import Columns
from server.formats.drive import read_columns
from server.jobs.supervise import SUPERVISED, scatola
from server.models import Analysis, Batch, Boot, Device
from server.moments import Clock
from server.settings import Settings
from server.store import BlobStore, raw_columns

if TYPE_CHECKING:
    from nav_core.typing import Floats
    from server.analyses.kinds import Kind

Command = Callable[[str, int], Sequence[str]]

LOOK_S = 0.5
WATCH_S = 0.1
RENEW_S = 5.0
"""So often a running analysis is looked at: its lease renewed, and whether it is still wanted."""
LIMIT_S = 1800.0
TELL_S = 0.5
"""Progress is told at most so often."""
STOP_S = 2.0
NICENESS = 5
MAX_DECODED_BYTES = 512 * 1024 * 1024
TOO_LONG = "The analysis took longer than {:.0f} minutes and was stopped; give a shorter recording"

log = structlog.stdlib.get_logger("scatola.analyses")


class StoppedError(Exception):
    """Nobody wants the analysis any more."""


# --- within the process


def work_off(database: Database, store: BlobStore, analysis_id: str, attempt: int, *, clock: Clock) -> None:
    """Do one attempt at an analysis and store how it ended; an error that is not the recording's is raised."""
    with database.reading() as session:
        row = session.get(Analysis, analysis_id)
    if row is None:
        return
    tell = _Teller(database, row, attempt, clock)
    try:
        values = _result(database, store, row, tell)
    except StoppedError:
        return
    except ProblemError as error:
        values = {"status": "failed", "error": error.detail[:1000]}
    except ValueError as error:
        values = {"status": "failed", "error": str(error)[:1000]}
    with database.transaction() as session:
        service.finish(session, row, attempt, values, now=clock())


class _Teller:
    """Writes progress to the row, and finds out there that it is no longer wanted."""

    def __init__(self, database: Database, row: Analysis, attempt: int, clock: Clock) -> None:
        self._database, self._row, self._attempt, self._clock = database, row, attempt, clock
        self._told = float("-inf")

    def __call__(self, stage: str, progress: float) -> None:
        if time.monotonic() - self._told < TELL_S:
            return
        with self._database.transaction() as session:
            if not service.report(session, self._row, self._attempt, stage, progress, now=self._clock()):
                raise StoppedError
        self._told = time.monotonic()


def _result(database: Database, store: BlobStore, row: Analysis, tell: _Teller) -> dict[str, Any]:
    # Here and not above: the numerics load when there is something to compute.
    from server.analyses.compute.run import analyse

    tell("reading", 0.0)
    recording, sha256, reference = _input(database, store, row)
    document = analyse(cast("Kind", row.kind), recording, row.name, row.parameters, reference=reference, progress=tell)
    algorithm = f"scatola {metadata.version('scatola')}"
    told = {"kind": row.kind, "parameters": row.parameters, "input_sha256": sha256, "algorithm": algorithm}
    body = orjson.dumps({**told, **document}, option=orjson.OPT_SERIALIZE_NUMPY)
    result_sha256 = hashlib.sha256(body).hexdigest()
    key = service.file_key(row.organisation_id, result_sha256, "json")
    store.put(key, body)
    return {
        "status": "done",
        "progress": 1.0,
        "algorithm": algorithm,
        "input_sha256": sha256,
        "result_key": key,
        "result_sha256": result_sha256,
    }


def _input(database: Database, store: BlobStore, row: Analysis) -> tuple[Columns, str, Floats | None]:
    """The recording, its hash, and the mounting that is known of it."""
    if row.input_key is not None:
        try:
            body = store.get(row.input_key)
        except KeyError:
            raise ValueError("The file is no longer there") from None
        if hashlib.sha256(body).hexdigest() != row.input_sha256:
            raise ValueError("The stored file is not the one that was uploaded")
        return read_columns(body, row.name, max_decoded_bytes=MAX_DECODED_BYTES), row.input_sha256, None
    with database.reading() as session:
        batches = queries.batches(session, row)
        device = session.get_one(Device, row.device_id)
        boot = session.get(Boot, (row.device_id, row.boot))
    if not batches:
        raise ValueError("The data of the trip are no longer there")
    if sum(batch.rows for batch in batches) * 24 * 8 > MAX_DECODED_BYTES:
        raise ValueError("The trip is too long for one analysis")
    assert row.t_first_s is not None
    assert row.t_last_s is not None
    whole = merged([_part(store, batch) for batch in batches])
    recording = between(whole, row.t_first_s, row.t_last_s)
    began = None if boot is None else boot.utc(row.t_first_s)
    return recording, recording.column_sha256(), _reference(device, began)


def _part(store: BlobStore, batch: Batch) -> Part:
    try:
        columns = raw_columns(store, batch)
    except KeyError:
        raise ValueError("Data of the trip are no longer there") from None
    return Part(columns, batch.stream == "burst")


def _reference(device: Device, began: dt.datetime | None) -> Floats | None:
    """The mounting known from elsewhere as the trip began."""
    known = [
        entry["R_va"]
        for entry in device.reference_mountings
        if began is None or dt.datetime.fromisoformat(entry["from"]) <= began
    ]
    return np.array(known[-1], dtype=np.float64) if known else None


# --- beside it


def start_analyses(settings: Settings, database: Database, *, stop: threading.Event, clock: Clock) -> threading.Thread:
    """Work off analyses beside the boxes' data, one at a time, until told to stop."""
    runner = Runner(settings, database, clock)

    def keep() -> None:
        while not stop.wait(LOOK_S):
            try:
                while not stop.is_set() and runner.once(stop):
                    pass
            except Exception:
                log.exception("analyses cannot be worked off")

    thread = threading.Thread(target=keep, name="analyses", daemon=True)
    thread.start()
    return thread


def process_of(analysis_id: str, attempt: int) -> Sequence[str]:
    """Command line of the process for one attempt."""
    return scatola("analysis", analysis_id, str(attempt))


class Runner:
    """Starts a process for what is due, and watches over it."""

    def __init__(
        self,
        settings: Settings,
        database: Database,
        clock: Clock,
        *,
        command: Command = process_of,
        limit_s: float = LIMIT_S,
        renew_s: float = RENEW_S,
    ) -> None:
        self._database, self._clock, self._command = database, clock, command
        self._limit_s, self._renew_s = limit_s, renew_s
        self._environment = {**os.environ, **_environment(settings), SUPERVISED: str(os.getpid())}

    def once(self, stop: threading.Event) -> bool:
        """Work off the analysis that has waited longest; whether there was one."""
        with self._database.reading() as session:
            analysis_id = queries.due(session, now=self._clock())
        if analysis_id is None:
            return False
        with self._database.transaction() as session:
            row = service.claim(session, analysis_id, now=self._clock())
        if row is not None:
            self._watch(row, row.attempts, stop)
        return True

    def _watch(self, row: Analysis, attempt: int, stop: threading.Event) -> None:
        process = subprocess.Popen(  # noqa: S603  our own interpreter and arguments
            self._command(row.id, attempt),
            stdin=subprocess.PIPE,
            env=self._environment,
        )
        begun = looked = time.monotonic()
        ended: dict[str, Any] | None = None
        try:
            while process.poll() is None and ended is None:
                now = time.monotonic()
                if stop.wait(WATCH_S):
                    # Not the analysis' fault: the attempt does not count.
                    ended = {"status": "waiting", "attempts": attempt - 1, "finished_at": None}
                elif now - begun > self._limit_s:
                    ended = {"status": "failed", "error": TOO_LONG.format(self._limit_s / 60.0)}
                elif now - looked > self._renew_s:
                    looked = now
                    if not self._renewed(row.id, attempt):
                        return
        finally:
            _end(process)
        if ended is None and process.returncode != 0:
            log.warning("analysis died", analysis_id=row.id, attempt=attempt, status=process.returncode)
            ended = {"status": "waiting", "finished_at": None}
        if ended is not None:
            with self._database.transaction() as session:
                service.finish(session, row, attempt, ended, now=self._clock())

    def _renewed(self, analysis_id: str, attempt: int) -> bool:
        with self._database.transaction() as session:
            return service.renew(session, analysis_id, attempt, now=self._clock())


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    if process.stdin is not None:
        process.stdin.close()


def _environment(settings: Settings) -> dict[str, str]:
    """What the process must know of the settings; it reads the rest from the environment as this one did."""
    found = {"SCATOLA_DATA_DIR": str(settings.data_dir)}
    for name in ("database_url", "blob_url"):
        secret = getattr(settings, name)
        if secret is not None:
            found[f"SCATOLA_{name.upper()}"] = secret.get_secret_value()
    return found
