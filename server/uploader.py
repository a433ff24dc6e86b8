"""The reference client of the device protocol: cut a recording into batches, encode, send until acknowledged."""

from __future__ import annotations

import datetime as dt
import gzip
import random
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from email.utils import parsedate_to_datetime
from typing import Any, Literal, get_args

import httpx
import numpy as np
import orjson

from server.accounts.secrets import hash_of
from server.accounts.signature import sign
from server.formats.columns import Columns
from server.formats.compact_write import write as write_compact
from server.formats.tables import write_arrow, write_csv

Encoding = Literal["parquet", "json", "csv", "arrow", "compact"]
Stream = Literal["continuous", "burst"]
ENCODINGS: tuple[Encoding, ...] = get_args(Encoding)

_FIRST_WAIT_S, _LONGEST_WAIT_S = 1.0, 300.0
# Worth another try; everything else from 400 to 499 would be refused again.
_PASSING = frozenset({408, 425, 429})


class UploadRefusedError(ValueError):
    """The service will not take this batch, however often it is sent."""

    def __init__(self, status: int, answer: str) -> None:
        self.status = status
        super().__init__(f"the service refused the batch with status {status}: {answer}")


class NotAdmittedError(UploadRefusedError):
    """The service refuses this box, whatever it sends."""


class UnreachableError(OSError):
    """The service did not take a batch for as long as the caller wanted to wait."""


@dataclass(frozen=True, slots=True)
class Parcel:
    """An encoded batch and the key that makes repeating it harmless."""

    stream: Stream
    boot: str
    sequence: int
    media_type: str
    content_encoding: str
    body: bytes


@dataclass(frozen=True, slots=True)
class Acknowledgement:
    """What the service said of a batch."""

    batch_id: str
    duplicate: bool
    next_sequence: int
    missing: tuple[tuple[int, int], ...]
    server_time: dt.datetime
    requests: tuple[dict[str, Any], ...]


def batches(columns: Columns, seconds: float) -> Iterator[Columns]:
    """Cut a recording every `seconds` from its first row on; empty stretches give nothing."""
    t = columns.values["t"]
    number = np.floor((t - t[0]) / seconds).astype(np.int64)
    edges = np.flatnonzero(np.diff(number)) + 1
    for rows in np.split(np.arange(t.size), edges):
        if rows.size:
            yield Columns({name: values[rows] for name, values in columns.values.items()})


def encode(columns: Columns, encoding: Encoding) -> tuple[str, str, bytes]:
    """Media type, content encoding and body of a batch; all but ``compact`` are exact."""
    if encoding == "parquet":
        return "application/vnd.apache.parquet", "", columns.to_parquet()
    if encoding == "arrow":
        return "application/vnd.apache.arrow.stream", "", write_arrow(columns)
    if encoding == "compact":
        return "application/vnd.scatola.batch", "gzip", gzip.compress(write_compact(columns), 6, mtime=0)
    if encoding == "csv":
        return "text/csv", "gzip", gzip.compress(write_csv(columns), 6, mtime=0)
    named = {
        name: [None if value != value else value for value in values.tolist()]  # noqa: PLR0124  NaN is null
        for name, values in columns.values.items()
    }
    return "application/json", "gzip", gzip.compress(orjson.dumps({"columns": named}), 6, mtime=0)


class Uploader:
    """Sends the batches of one box, and keeps trying while that can help.

    Parameters
    ----------
    wait
        Sleeps for so many seconds.
    patience_s
        Waiting in a row, after which a batch is given up with `UnreachableError`; None waits for ever.
    sign_as
        The box's id: sign each request instead of sending the token.
    """

    def __init__(
        self,
        client: httpx.Client,
        token: str,
        boot: str,
        *,
        wait: Callable[[float], object],
        say: Callable[[str], object] = lambda line: None,  # noqa: ARG005  silent unless somebody listens
        stream: Stream = "continuous",
        encoding: Encoding = "parquet",
        patience_s: float | None = None,
        sign_as: str | None = None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._client = client
        self._token = token
        self._boot = boot
        self._wait = wait
        self._say = say
        self._stream: Stream = stream
        self._encoding: Encoding = encoding
        self._patience_s = patience_s
        self._sign_as = sign_as
        self._clock = clock
        self._clock_offset_s = 0.0

    def send(self, sequence: int, columns: Columns) -> Acknowledgement:
        """Send one batch until it is acknowledged."""
        return self.deliver(Parcel(self._stream, self._boot, sequence, *encode(columns, self._encoding)))

    def deliver(self, parcel: Parcel) -> Acknowledgement:
        """Send one encoded batch until it is acknowledged; the key makes repeating harmless."""
        pause, waited_s, told, corrected = _FIRST_WAIT_S, 0.0, False, False
        while True:
            try:
                answer = self._client.post("/api/v1/batches", content=parcel.body, headers=self._headers(parcel))
            except httpx.TransportError as error:
                retry_after, trouble = 0.0, f"the service does not answer ({type(error).__name__})"
            else:
                if answer.status_code == 202:
                    return _acknowledgement(answer.json())
                if answer.status_code == 401 and not corrected and self._correct_clock(answer):
                    corrected = True
                    continue
                _raise_if_final(answer)
                retry_after = _retry_after_s(answer.headers)
                trouble = f"the service answers {answer.status_code}"
            if self._patience_s is not None and waited_s >= self._patience_s:
                raise UnreachableError(f"{trouble}; given up after {waited_s:.0f} s, the batch is kept")
            if not told:
                self._say(f"{trouble}; trying again until it takes the batch")
                told = True
            # Full jitter: boxes that lost the same server do not come back at the same moment.
            seconds = retry_after + random.uniform(0.0, pause)  # noqa: S311  not a secret
            if self._patience_s is not None:
                seconds = min(seconds, self._patience_s - waited_s)
            self._wait(seconds)
            waited_s += seconds
            pause = min(2.0 * pause, _LONGEST_WAIT_S)

    def _headers(self, parcel: Parcel) -> dict[str, str]:
        headers = {
            "Idempotency-Key": f"{parcel.boot}/{parcel.sequence}",
            "Scatola-Stream": parcel.stream,
            "Content-Type": parcel.media_type,
        }
        headers |= {"Content-Encoding": parcel.content_encoding} if parcel.content_encoding else {}
        if self._sign_as is None:
            return headers | {"Authorization": f"Bearer {self._token}"}
        authorization = sign(
            hash_of(self._token),
            method="POST",
            path="/api/v1/batches",
            device_id=self._sign_as,
            time_s=int(self._clock() + self._clock_offset_s),
            headers={name.lower(): value for name, value in headers.items()},
            body=parcel.body,
        )
        return headers | {"Authorization": authorization}

    def _correct_clock(self, answer: httpx.Response) -> bool:
        """Take over the service's time when that is what a signature failed for."""
        try:
            problem: dict[str, Any] = answer.json()
        except ValueError:
            return False
        if problem.get("code") != "clock_skew":
            return False
        self._clock_offset_s = dt.datetime.fromisoformat(problem["server_time"]).timestamp() - self._clock()
        return True


def _raise_if_final(answer: httpx.Response) -> None:
    """Raise when sending the same again would be refused again."""
    if answer.status_code in (401, 403):
        raise NotAdmittedError(answer.status_code, answer.text[:500])
    if answer.status_code < 500 and answer.status_code not in _PASSING:
        raise UploadRefusedError(answer.status_code, answer.text[:500])


def _retry_after_s(headers: httpx.Headers) -> float:
    """Seconds of a Retry-After in either form; a date is read against the answer's own, for our clock may be wrong."""
    given = headers.get("Retry-After", "").strip()
    try:
        if given.isdecimal():
            return float(given)
        begin = parsedate_to_datetime(headers["Date"])
        return max(0.0, (parsedate_to_datetime(given) - begin).total_seconds())
    except (KeyError, ValueError):
        return 0.0


def _acknowledgement(answer: dict[str, Any]) -> Acknowledgement:
    return Acknowledgement(
        batch_id=answer["batch_id"],
        duplicate=answer["duplicate"],
        next_sequence=answer["next_sequence"],
        missing=tuple((first, last) for first, last in answer["missing"]),
        server_time=dt.datetime.fromisoformat(answer["server_time"]),
        requests=tuple(answer["requests"]),
    )
