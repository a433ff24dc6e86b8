"""Where blobs live.  Keys are organisation/device/hash: content is addressed by its hash and never rewritten."""

from __future__ import annotations

import datetime as dt
import os
import re
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from server.settings import Settings
from server.store.objects import ObjectStore

_KEY = re.compile(r"[A-Za-z0-9_-]+(?:/[A-Za-z0-9_-]+)*(?:\.[a-z0-9]+)?")


class BlobStore(Protocol):
    """An immutable store of bytes."""

    def put(self, key: str, data: bytes) -> None:
        """Keep `data`; durable when this returns.  A put of what is there already renews its time."""
        ...

    def get(self, key: str) -> bytes:
        """Content; KeyError when there is none."""
        ...

    def exists(self, key: str) -> bool: ...

    def stale(self, before: dt.datetime) -> Iterator[str]:
        """Keys whose last put was before that time."""
        ...

    def delete_stale(self, key: str, before: dt.datetime) -> bool:
        """Delete unless it was put since; whether it is gone."""
        ...

    def check(self) -> None:
        """Raise OSError unless the store can be written."""
        ...


def blob_key(organisation_id: str, device_id: str, sha256: str, kind: str) -> str:
    """Key of a blob; `kind` is its suffix, ``parquet`` for columns, ``body`` for an upload as it came."""
    return f"{organisation_id}/{device_id}/{sha256}.{kind}"


def open_store(settings: Settings) -> BlobStore:
    """The store of the settings: a folder beside the database unless an object store is set."""
    if settings.blob_url is None:
        return FolderStore(settings.data_dir / "blobs")
    return ObjectStore(settings.blob_url.get_secret_value())


class FolderStore:
    """Blobs as files; a file appears under its name only when it is complete and on disk."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._partial = root / ".partial"

    def _path(self, key: str) -> Path:
        if _KEY.fullmatch(key) is None:
            raise KeyError(key)
        return self._root / key

    def put(self, key: str, data: bytes) -> None:
        path = self._path(key)
        try:
            os.utime(path)
        except FileNotFoundError:
            self._write(path, data)
        # Also when the file was there: whoever put it may have died before the folder was on disk.
        _sync_folder(path.parent)

    def _write(self, path: Path, data: bytes) -> None:
        _make_folder(path.parent)
        if not self._partial.is_dir():
            self._partial.mkdir(parents=True, exist_ok=True)
        partial = self._partial / uuid.uuid4().hex
        try:
            with partial.open("xb", buffering=0) as file:
                rest = memoryview(data)
                while rest:
                    rest = rest[file.write(rest) :]
                os.fsync(file.fileno())
            partial.rename(path)
        except OSError:
            partial.unlink(missing_ok=True)
            raise

    def get(self, key: str) -> bytes:
        try:
            return self._path(key).read_bytes()
        except FileNotFoundError:
            raise KeyError(key) from None

    def exists(self, key: str) -> bool:
        return self._path(key).is_file()

    def stale(self, before: dt.datetime) -> Iterator[str]:
        for path in self._root.rglob("*"):
            try:
                old = path.is_file() and path.stat().st_mtime < before.timestamp()
            except FileNotFoundError:
                continue
            if not old:
                continue
            if path.parent == self._partial:
                path.unlink(missing_ok=True)  # left by a process that died while writing
            else:
                yield path.relative_to(self._root).as_posix()

    def delete_stale(self, key: str, before: dt.datetime) -> bool:
        path = self._path(key)
        aside = self._partial / uuid.uuid4().hex
        self._partial.mkdir(parents=True, exist_ok=True)
        try:
            # Taken aside first and looked at there: a put before this renewed the time, which shows;
            # a put after this finds no file and writes a new one.  Neither is lost.
            path.rename(aside)
        except FileNotFoundError:
            return True
        if aside.stat().st_mtime >= before.timestamp():
            aside.rename(path)
            return False
        aside.unlink()
        return True

    def check(self) -> None:
        probe = self._root / ".probe"
        self._root.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink(missing_ok=True)


def _make_folder(folder: Path) -> None:
    """Make a folder and its parents, each entry on disk before the next is relied on."""
    missing: list[Path] = []
    while not folder.is_dir():
        missing.append(folder)
        folder = folder.parent
    for made in reversed(missing):
        made.mkdir(exist_ok=True)
        _sync_folder(made.parent)


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
