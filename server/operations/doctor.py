"""`scatola doctor`: looks at everything an installation rests on, and says what an operator should do."""

from __future__ import annotations

import datetime as dt
import os
import shutil
import stat
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Literal

from sqlalchemy import func, select, text
from sqlalchemy.exc import SQLAlchemyError

from server.database import Database
from server.evidence.audit import audit
from server.ingest.queries import backlog, failing
from server.migrations import head, is_current, serves
from server.models import Batch, Change, Device
from server.settings import Settings, set_numba_cache_dir
from server.store import BlobStore, has_row, open_store

Status = Literal["ok", "warning", "fault"]

MIN_FREE_BYTES, LOW_FREE_BYTES = 200e6, 2e9
OLD_WORK_S = 900.0
CLOCK_S = 5.0
ORPHANS_LOOKED_AT = 2_000
BLOBS_LOOKED_AT = 50
CHAINS, LINKS = 3, 2_000
CERTIFICATE_DAYS = 30


@dataclass(frozen=True, slots=True)
class Finding:
    """What one look found."""

    check: str
    status: Status
    detail: str


class Doctor:
    """One round through an installation; each look is on its own, so that one that fails hides no other."""

    def __init__(self, settings: Settings, now: dt.datetime) -> None:
        self._settings, self._now = settings, now
        self._database = Database(settings)

    def findings(self) -> Iterator[Finding]:
        """All looks, one after the other."""
        looks: tuple[tuple[str, Callable[[], Iterator[tuple[Status, str]]]], ...] = (
            ("settings", self._look_at_settings),
            ("database", self._look_at_database),
            ("migrations", self._look_at_migrations),
            ("disk", self._look_at_disk),
            ("store", self._look_at_store),
            ("blobs", self._look_at_blobs),
            ("broker", self._look_at_broker),
            ("work", self._look_at_work),
            ("clock", self._look_at_clock),
            ("numba cache", self._look_at_numba),
            ("secrets", self._look_at_secrets),
            ("evidence", self._look_at_chains),
        )
        try:
            for name, look in looks:
                try:
                    for status, detail in look():
                        yield Finding(name, status, detail)
                except SQLAlchemyError as error:
                    yield Finding(name, "fault", f"the database cannot be asked ({type(error).__name__})")
                except OSError as error:
                    yield Finding(name, "fault", f"{type(error).__name__}: {error}")
        finally:
            self._database.dispose()

    def _look_at_settings(self) -> Iterator[tuple[Status, str]]:
        settings = self._settings
        mode = "embedded" if settings.embedded else "production"
        given = sorted(name for name in settings.model_fields_set if name != "data_dir")
        yield "ok", f"{mode}; data in {settings.data_dir}; set: {', '.join(given) or 'nothing'}"
        if not settings.embedded and settings.database_url is None:
            yield "fault", "a broker is set, but SCATOLA_DATABASE_URL is not: workers on other hosts would see nothing"
        if not settings.embedded and settings.blob_url is None:
            yield "warning", "a broker is set, but SCATOLA_BLOB_URL is not: all processes must share the data folder"

    def _look_at_database(self) -> Iterator[tuple[Status, str]]:
        began = time.perf_counter()
        dialect = self._database.engine.dialect.name
        question = "SELECT sqlite_version()" if dialect == "sqlite" else "SHOW server_version"
        with self._database.reading() as session:
            version = session.scalar(text(question))
        yield "ok", f"{dialect} {version}, answers in {1e3 * (time.perf_counter() - began):.0f} ms"

    def _look_at_migrations(self) -> Iterator[tuple[Status, str]]:
        if is_current(self._database.engine):
            yield "ok", f"at revision {head()}"
        elif serves(self._database.engine):
            yield "warning", f"ahead of this version's revision {head()}: a newer version has migrated; update this one"
        else:
            yield "fault", f"not at revision {head()}: run `scatola migrate`"

    def _look_at_disk(self) -> Iterator[tuple[Status, str]]:
        folder = self._settings.data_dir
        while not folder.exists():
            folder = folder.parent
        usage = shutil.disk_usage(folder)
        status: Status = "fault" if usage.free < MIN_FREE_BYTES else "warning" if usage.free < LOW_FREE_BYTES else "ok"
        yield status, f"{usage.free / 1e9:.1f} GB of {usage.total / 1e9:.1f} GB free under {folder}"

    def _look_at_store(self) -> Iterator[tuple[Status, str]]:
        store, key, data = self._store(), f"doctor/{uuid.uuid4().hex}.probe", os.urandom(4096)
        began = time.perf_counter()
        store.put(key, data)
        try:
            came_back = store.get(key) == data
        finally:
            store.delete_stale(key, dt.datetime.now(dt.UTC) + dt.timedelta(days=1))
        if came_back:
            yield "ok", f"4 kB there and back in {1e3 * (time.perf_counter() - began):.0f} ms"
        else:
            yield "fault", "a blob came back as other bytes than were put"

    def _look_at_blobs(self) -> Iterator[tuple[Status, str]]:
        store = self._store()
        with self._database.reading() as session:
            newest = select(Batch.blob_key).order_by(Batch.received_at.desc()).limit(BLOBS_LOOKED_AT)
            keys = list(session.scalars(newest))
        lost = [key for key in keys if not store.exists(key)]
        for key in lost:
            yield "fault", f"blob {key} is named by a batch, but is not in the store"
        if not lost:
            yield "ok", f"the newest {len(keys)} batches have their blobs"
        old = list(islice(store.stale(self._now - dt.timedelta(days=1)), ORPHANS_LOOKED_AT))
        orphans = sum(not has_row(self._database, key) for key in old)
        if orphans:
            yield "warning", f"{orphans} of {len(old)} blobs older than a day have no row; workers collect them hourly"

    def _look_at_broker(self) -> Iterator[tuple[Status, str]]:
        if self._settings.embedded:
            yield "ok", "none is set: `serve` runs its own worker"
            return
        from server.jobs.broker import BrokerUnreachableError, Queues

        try:
            depths = Queues(self._settings).depths()
        except BrokerUnreachableError as error:
            yield "fault", f"does not answer ({error}); uploads go on and wait in the database"
            return
        yield "ok", ", ".join(f"{name}: {count}" for name, count in depths.items()) or "no queue was used yet"

    def _look_at_work(self) -> Iterator[tuple[Status, str]]:
        with self._database.reading() as session:
            due, (boxes, dead) = backlog(session), failing(session)
        age_s = 0.0 if due.oldest_at is None else (self._now - due.oldest_at).total_seconds()
        late = age_s > OLD_WORK_S
        said = f"{due.batches} batches of {due.devices} boxes wait, the oldest for {age_s:.0f} s"
        yield "warning" if late else "ok", said + ("; are workers running, and enough of them?" if late else "")
        if dead:
            yield "fault", f"the work of {dead} boxes keeps failing: `scatola dead-letters` tells why"
        elif boxes:
            yield "warning", f"the work of {boxes} boxes failed last time; it is tried again by itself"

    def _look_at_clock(self) -> Iterator[tuple[Status, str]]:
        with self._database.reading() as session:
            if self._database.engine.dialect.name == "postgresql":
                theirs = session.scalar(select(func.clock_timestamp()))
                assert isinstance(theirs, dt.datetime)
                apart_s = (dt.datetime.now(dt.UTC) - theirs).total_seconds()
                status: Status = "ok" if abs(apart_s) <= CLOCK_S else "fault"
                yield status, f"{apart_s:+.2f} s from the database's"
            newest = session.scalar(select(func.max(Change.at)))
        ahead_s = 0.0 if newest is None else (newest - self._now).total_seconds()
        if ahead_s > CLOCK_S:
            yield "fault", f"the newest change is {ahead_s:.0f} s in the future: a clock was set back"
        else:
            yield "ok", "nothing stored is from the future"

    def _look_at_numba(self) -> Iterator[tuple[Status, str]]:
        set_numba_cache_dir()
        named = os.environ.get("NUMBA_CACHE_DIR")
        folder = None if named is None else Path(named)
        if folder is None or not folder.is_dir() or not os.access(folder, os.W_OK):
            yield "warning", f"{named or 'no folder'} cannot be written: each worker compiles anew, a minute each"
            return
        kernels = sum(1 for _ in folder.rglob("*.nbc"))
        detail = f"{kernels} compiled kernels in {folder}"
        yield ("ok", detail) if kernels else ("warning", f"{detail}: run `scatola warm-up`")

    def _look_at_secrets(self) -> Iterator[tuple[Status, str]]:
        settings, faults = self._settings, 0
        named = os.environ.get("SCATOLA_SECRETS_DIR")
        files = [path for path in Path(named).iterdir() if path.is_file()] if named and Path(named).is_dir() else []
        if settings.signing_key_file is not None:
            files.append(settings.signing_key_file)
        if self._database.engine.dialect.name == "sqlite":
            files.append(settings.data_dir)
        for path in files:
            if not path.exists():
                faults += 1
                yield "fault", f"{path} is not there"
            elif stat.S_IMODE(path.stat().st_mode) & stat.S_IRWXO:
                faults += 1
                yield "fault", f"{path} is open to everybody on this machine: chmod o-rwx"
        if settings.timestamp_root_file is not None:
            yield self._certificate(settings.timestamp_root_file)
        if not faults:
            yield "ok", f"{len(files)} files and folders are closed to others"

    def _certificate(self, path: Path) -> tuple[Status, str]:
        from cryptography.x509 import load_pem_x509_certificate

        try:
            ends = load_pem_x509_certificate(path.read_bytes()).not_valid_after_utc
        except ValueError as error:
            return "fault", f"{path} is no certificate: {error}"
        days = (ends - self._now).days
        status: Status = "fault" if days < 0 else "warning" if days < CERTIFICATE_DAYS else "ok"
        return status, f"the time-stamping authority's root is valid until {ends:%Y-%m-%d}"

    def _look_at_chains(self) -> Iterator[tuple[Status, str]]:
        store = self._store()
        with self._database.reading() as session:
            query = select(Device.id).where(Device.chain_length.between(1, LINKS))
            chosen = list(session.scalars(query.order_by(Device.last_seen_at.desc()).limit(CHAINS)))
        links = 0
        for device_id in chosen:
            found = audit(self._database, store, device_id)
            links += found.links
            for fault in found.faults[:5]:
                yield "fault", f"{found.name}: {fault}"
        yield "ok", f"sample of {len(chosen)} boxes, {links} links looked at; `scatola verify` looks at all"

    def _store(self) -> BlobStore:
        return open_store(self._settings)
