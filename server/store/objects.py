"""Blobs in an object store: S3 and its kin in production, memory and files in tests.

Credentials and endpoint come from the usual AWS_* environment variables.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Generator, Iterator
from contextlib import contextmanager

from obstore.exceptions import BaseError
from obstore.store import from_url

RETRY_FOR = dt.timedelta(seconds=20)
"""A request of ours waits for the store; the library's three minutes are longer than any box does."""


class StoreUnavailableError(OSError):
    """The store does not answer, or does not let us in: nothing is known of the blob."""


@contextmanager
def _answering() -> Generator[None]:
    try:
        yield
    except BaseError as error:
        # What follows the first line is for the library's makers.
        raise StoreUnavailableError(f"the object store: {str(error).splitlines()[0]}") from error


class ObjectStore:
    """A bucket, or a prefix in one."""

    def __init__(self, url: str) -> None:
        with _answering():
            self._bucket = from_url(url, retry_config={"max_retries": 4, "retry_timeout": RETRY_FOR})

    def put(self, key: str, data: bytes) -> None:
        # Written again even when it is there: that is how an object's time is renewed.
        with _answering():
            self._bucket.put(key, data)

    def get(self, key: str) -> bytes:
        try:
            with _answering():
                return bytes(self._bucket.get(key).bytes())
        except FileNotFoundError:
            raise KeyError(key) from None

    def exists(self, key: str) -> bool:
        return self._modified(key) is not None

    def _modified(self, key: str) -> dt.datetime | None:
        try:
            with _answering():
                return self._bucket.head(key)["last_modified"]
        except FileNotFoundError:
            return None

    def stale(self, before: dt.datetime) -> Iterator[str]:
        with _answering():
            for page in self._bucket.list():
                for entry in page:
                    if entry["last_modified"] < before:
                        yield entry["path"]

    def delete_stale(self, key: str, before: dt.datetime) -> bool:
        modified = self._modified(key)
        if modified is not None and modified >= before:
            return False
        if modified is not None:
            with _answering():
                self._bucket.delete(key)
        return True

    def check(self) -> None:
        self.put("probe", b"")
