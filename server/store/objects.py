"""Blobs in an object store: S3 and its kin in production, memory and files in tests.

Credentials and endpoint come from the usual AWS_* environment variables.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator

from obstore.exceptions import BaseError
from obstore.store import from_url


class ObjectStore:
    """A bucket, or a prefix in one."""

    def __init__(self, url: str) -> None:
        self._bucket = from_url(url)

    def put(self, key: str, data: bytes) -> None:
        # Written again even when it is there: that is how an object's time is renewed.
        self._bucket.put(key, data)

    def get(self, key: str) -> bytes:
        try:
            return bytes(self._bucket.get(key).bytes())
        except FileNotFoundError:
            raise KeyError(key) from None

    def exists(self, key: str) -> bool:
        return self._modified(key) is not None

    def _modified(self, key: str) -> dt.datetime | None:
        try:
            return self._bucket.head(key)["last_modified"]
        except FileNotFoundError:
            return None

    def stale(self, before: dt.datetime) -> Iterator[str]:
        for page in self._bucket.list():
            for entry in page:
                if entry["last_modified"] < before:
                    yield entry["path"]

    def delete_stale(self, key: str, before: dt.datetime) -> bool:
        modified = self._modified(key)
        if modified is not None and modified >= before:
            return False
        if modified is not None:
            self._bucket.delete(key)
        return True

    def check(self) -> None:
        try:
            self._bucket.put("probe", b"")
        except BaseError as error:
            raise OSError(str(error)) from error
