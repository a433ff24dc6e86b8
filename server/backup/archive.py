"""A backup: one consistent view of the database, and every blob that it names.

A folder with `manifest.json`, `tables/NAME.jsonl.zst`, `blobs.jsonl.zst` (key, size and hash of each) and `blobs/`.
It is taken beside a running service.  The view comes first and the blobs after: a blob is durable before its row
is, and is never rewritten, so what the view names is there; only an erasure may take it away meanwhile.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import io
import json
import os
import shutil
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import metadata
from itertools import islice
from pathlib import Path
from typing import Any

import orjson
import zstandard
from sqlalchemy import Connection, Engine

from server.backup.tables import ContentSum, Row, blob_keys, insert, line, rows, set_sequences, tables
from server.database import make_engine
from server.migrations import knows, migrating, revision_of, upgrade
from server.settings import Settings
from server.store import BlobStore, open_store
from server.store.blobs import FolderStore

FORMAT = "scatola-backup/1"
_BLOBS_AT_ONCE = 64
_THREADS = 8

Say = Callable[[str], None]


class BackupError(ValueError):
    """A backup that cannot be taken or restored: which part, and why."""


@dataclass(slots=True)
class Report:
    """What a backup holds, or a restore brought back."""

    revision: str
    tables: dict[str, dict[str, Any]] = field(default_factory=dict[str, dict[str, Any]])
    blobs: dict[str, Any] = field(default_factory=dict[str, Any])
    lost_blobs: list[str] = field(default_factory=list[str])
    """Named by rows, yet not in the store: the evidence chain of their boxes is broken."""
    erased_blobs: int = 0
    """Erased together with their rows while the backup was taken."""

    @property
    def content_sha256(self) -> str:
        """Of all rows and blobs; equal for equal content, whichever database holds it."""
        held = {name: {key: told[key] for key in ("rows", "sum")} for name, told in self.tables.items()}
        return hashlib.sha256(
            orjson.dumps([self.revision, held, self.blobs.get("sum")], option=orjson.OPT_SORT_KEYS)
        ).hexdigest()


@contextmanager
def snapshot(engine: Engine) -> Generator[Connection]:
    """A connection that sees the database as it is now, whatever is written meanwhile."""
    options: dict[str, Any] = {"writes": False}
    if engine.dialect.name == "postgresql":
        options = {"isolation_level": "REPEATABLE READ", "postgresql_readonly": True}
    with engine.execution_options(**options).connect() as connection, connection.begin():
        yield connection


def backup(settings: Settings, out: Path, *, now: dt.datetime, say: Say = lambda _: None) -> Report:
    """Take a backup into a folder that does not exist yet; it appears when it is complete."""
    if out.exists():
        raise BackupError(f"{out} is there already")
    partial = out.with_name(f"{out.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    (partial / "tables").mkdir(mode=0o700, parents=True)
    engine, store = make_engine(settings), open_store(settings)
    try:
        with snapshot(engine) as connection:
            found = tables(connection)
            revision = revision_of(connection)
            if revision is None:
                raise BackupError("the database is empty: it was never migrated")
            report = Report(revision)
            for table in found:
                say(f"{table.name} ...")
                report.tables[str(table.name)] = _dump(table.name, rows(connection, table), partial / "tables")
            keys = partial / "keys"
            with keys.open("w", encoding="utf-8") as file:
                file.writelines(f"{key}\n" for key in blob_keys(connection, found))
        _copy_blobs(store, keys, partial, report, say)
        keys.unlink()
        _settle_missing(engine, report)
    finally:
        engine.dispose()
    manifest = {
        "format": FORMAT,
        "made_at": now.isoformat(),
        "scatola": metadata.version("scatola"),
        "database": engine.dialect.name,
        "revision": report.revision,
        "tables": report.tables,
        "blobs": report.blobs,
        "lost_blobs": report.lost_blobs,
        "erased_blobs": report.erased_blobs,
        "content_sha256": report.content_sha256,
    }
    _write_durably(partial / "manifest.json", json.dumps(manifest, indent=1).encode())
    partial.rename(out)
    return report


def _dump(name: str, found: Iterator[Row], folder: Path) -> dict[str, Any]:
    content = ContentSum()
    path = folder / f"{name}.jsonl.zst"
    with path.open("wb") as file, zstandard.ZstdCompressor(level=6).stream_writer(file, closefd=False) as packed:
        for row in found:
            content.add(row)
            packed.write(line(row) + b"\n")
        packed.flush(zstandard.FLUSH_FRAME)
        file.flush()
        os.fsync(file.fileno())
    return {**content.told(), "file_sha256": _file_sha256(path)}


def _copy_blobs(store: BlobStore, keys: Path, folder: Path, report: Report, say: Say) -> None:
    target, content, size, done = FolderStore(folder / "blobs"), ContentSum(), 0, 0
    path = folder / "blobs.jsonl.zst"

    def copy(key: str) -> tuple[str, int, str] | None:
        try:
            data = store.get(key)
        except KeyError:
            return None
        target.put(key, data)
        return key, len(data), hashlib.sha256(data).hexdigest()

    with (
        keys.open(encoding="utf-8") as lines,
        path.open("wb") as file,
        zstandard.ZstdCompressor().stream_writer(file, closefd=False) as packed,
        ThreadPoolExecutor(_THREADS) as pool,
    ):
        names = (each.rstrip("\n") for each in lines)
        while page := list(islice(names, _BLOBS_AT_ONCE)):
            for key, copied in zip(page, pool.map(copy, page), strict=True):
                if copied is None:
                    report.lost_blobs.append(key)
                    continue
                told = line({"key": key, "bytes": copied[1], "sha256": copied[2]})
                content.add_bytes(told)
                packed.write(told + b"\n")
                size += copied[1]
            done += len(page)
            say(f"{done} blobs, {size / 1e6:.1f} MB")
    told = content.told()
    report.blobs = {"count": told["rows"], "bytes": size, "sum": told["sum"], "file_sha256": _file_sha256(path)}


def _settle_missing(engine: Engine, report: Report) -> None:
    """A blob that was not found is lost only if a row still names it."""
    if not report.lost_blobs:
        return
    with snapshot(engine) as connection:
        missing = set(report.lost_blobs)
        still = {key for key in blob_keys(connection, tables(connection)) if key in missing}
    report.erased_blobs = len(missing - still)
    report.lost_blobs = sorted(still)


def restore(settings: Settings, source: Path, *, say: Say = lambda _: None) -> Report:
    """Bring a backup back into an empty installation, at its revision; nothing of it when anything is wrong."""
    manifest = read_manifest(source)
    revision = manifest["revision"]
    if not knows(revision):
        raise BackupError(f"{source} is of revision {revision}, which this version does not know: take a newer one")
    upgrade(settings, revision)
    _refuse_rows(settings, revision)
    report = Report(revision, lost_blobs=manifest["lost_blobs"])
    report.blobs = _restore_blobs(open_store(settings), source, manifest["blobs"], say)
    with migrating(settings) as connection:
        found = tables(connection)
        unknown = set(manifest["tables"]) - {table.name for table in found}
        if unknown:
            raise BackupError(f"the manifest names tables that do not exist: {', '.join(sorted(unknown))}")
        for table in found:
            if table.name in manifest["tables"]:
                say(f"{table.name} ...")
                insert(connection, table, _table_lines(source, table.name, manifest["tables"][table.name]))
                set_sequences(connection, table)
        # Read back in the same transaction: what is committed is what was backed up, or nothing is.
        for table in found:
            content = ContentSum()
            for row in rows(connection, table):
                content.add(row)
            wanted = manifest["tables"].get(table.name, {"rows": 0})
            if content.rows != wanted["rows"] or content.told()["sum"] != wanted.get("sum", content.told()["sum"]):
                raise BackupError(f"table {table.name} reads back as other rows than were backed up")
            report.tables[str(table.name)] = content.told()
    if report.content_sha256 != manifest["content_sha256"]:
        raise BackupError("the content is not what the manifest says")
    return report


def _refuse_rows(settings: Settings, revision: str) -> None:
    engine = make_engine(settings)
    try:
        with snapshot(engine) as connection:
            if revision_of(connection) != revision:
                raise BackupError(f"the database is beyond revision {revision}, at which the backup was made: empty it")
            used = [table.name for table in tables(connection) if next(rows(connection, table), None) is not None]
    finally:
        engine.dispose()
    if used:
        raise BackupError(f"the database is not empty, nothing is restored: {', '.join(used)}")


def read_manifest(source: Path) -> dict[str, Any]:
    """The manifest of a backup."""
    try:
        manifest = json.loads((source / "manifest.json").read_bytes())
    except (OSError, ValueError) as error:
        raise BackupError(f"{source} is no backup: {error}") from error
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise BackupError(f"{source} is no backup of the form {FORMAT}")
    return manifest


def _restore_blobs(store: BlobStore, source: Path, told: dict[str, Any], say: Say) -> dict[str, Any]:
    held, content, size, done = FolderStore(source / "blobs"), ContentSum(), 0, 0

    def bring(entry: dict[str, Any]) -> None:
        try:
            data = held.get(entry["key"])
        except KeyError:
            raise BackupError(f"blob {entry['key']} is not in the backup") from None
        if hashlib.sha256(data).hexdigest() != entry["sha256"]:
            raise BackupError(f"blob {entry['key']} does not have the hash that was recorded")
        store.put(entry["key"], data)

    lines = _lines(source / "blobs.jsonl.zst", told["file_sha256"])
    with ThreadPoolExecutor(_THREADS) as pool:
        while page := list(islice(lines, _BLOBS_AT_ONCE)):
            entries = [orjson.loads(each) for each in page]
            for each, entry, _ in zip(page, entries, pool.map(bring, entries), strict=True):
                content.add_bytes(each)
                size += entry["bytes"]
            done += len(page)
            say(f"{done} of {told['count']} blobs, {size / 1e6:.1f} MB")
    return {"count": content.rows, "bytes": size, "sum": content.told()["sum"]}


def _table_lines(source: Path, name: str, told: dict[str, Any]) -> Iterable[Row]:
    return (orjson.loads(each) for each in _lines(source / "tables" / f"{name}.jsonl.zst", told["file_sha256"]))


def _lines(path: Path, sha256: str) -> Iterator[bytes]:
    try:
        if _file_sha256(path) != sha256:
            raise BackupError(f"{path} is damaged: it does not have the hash that was recorded")
        with path.open("rb") as file, zstandard.ZstdDecompressor().stream_reader(file) as stream:
            yield from (each.rstrip(b"\n") for each in io.BufferedReader(stream))
    except (OSError, zstandard.ZstdError) as error:
        raise BackupError(f"{path} cannot be read: {error}") from error


def _file_sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _write_durably(path: Path, data: bytes) -> None:
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
