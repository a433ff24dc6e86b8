"""The reference client of the device protocol: cut a recording into batches, send, retry, resume."""

from __future__ import annotations

import gzip
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import httpx
import numpy as np
import orjson

from server.formats.columns import Columns
from server.formats.tables import write_arrow, write_csv

Encoding = Literal["parquet", "json", "csv", "arrow"]

_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.5, 30.0


class UploadRefusedError(ValueError):
    """The service will not take this batch, however often it is sent."""

    def __init__(self, status: int, answer: str) -> None:
        self.status = status
        super().__init__(f"the service refused the batch with status {status}: {answer}")


@dataclass(frozen=True, slots=True)
class Acknowledgement:
    """What the service said of a batch."""

    batch_id: str
    duplicate: bool
    next_sequence: int
    missing: tuple[tuple[int, int], ...]


def batches(columns: Columns, seconds: float) -> Iterator[Columns]:
    """Cut a recording every `seconds` from its first row on; empty stretches give nothing."""
    t = columns.values["t"]
    number = np.floor((t - t[0]) / seconds).astype(np.int64)
    edges = np.flatnonzero(np.diff(number)) + 1
    for rows in np.split(np.arange(t.size), edges):
        if rows.size:
            yield Columns({name: values[rows] for name, values in columns.values.items()})


def encode(columns: Columns, encoding: Encoding) -> tuple[bytes, dict[str, str]]:
    """Body and headers of a batch."""
    if encoding == "parquet":
        return columns.to_parquet(), {"Content-Type": "application/vnd.apache.parquet"}
    if encoding == "arrow":
        return write_arrow(columns), {"Content-Type": "application/vnd.apache.arrow.stream"}
    if encoding == "csv":
        body, media_type = write_csv(columns), "text/csv"
    else:
        document = {
            "columns": {
                name: [None if value != value else value for value in values.tolist()]  # noqa: PLR0124  NaN is null
                for name, values in columns.values.items()
            }
        }
        body, media_type = orjson.dumps(document), "application/json"
    return gzip.compress(body, 6), {"Content-Type": media_type, "Content-Encoding": "gzip"}


class Uploader:
    """Sends the batches of one boot and stream of a box, and keeps trying while that can help."""

    def __init__(
        self,
        client: httpx.Client,
        token: str,
        boot: str,
        *,
        wait: Callable[[float], object],
        say: Callable[[str], object] = lambda line: None,  # noqa: ARG005  silent unless somebody listens
        stream: str = "continuous",
        encoding: Encoding = "parquet",
    ) -> None:
        self._client = client
        self._headers = {"Authorization": f"Bearer {token}", "Scatola-Stream": stream}
        self._boot = boot
        self._wait = wait
        self._say = say
        self._encoding: Encoding = encoding

    def send(self, sequence: int, columns: Columns) -> Acknowledgement:
        """Send one batch until it is acknowledged; the key makes repeating harmless."""
        body, headers = encode(columns, self._encoding)
        headers |= self._headers | {"Idempotency-Key": f"{self._boot}/{sequence}"}
        pause, told = _FIRST_WAIT_S, False
        while True:
            try:
                answer = self._client.post("/api/v1/batches", content=body, headers=headers)
            except httpx.TransportError as error:
                retry_after, trouble = 0.0, f"the service does not answer ({type(error).__name__})"
            else:
                if answer.status_code == 202:
                    return _acknowledgement(answer.json())
                if answer.status_code != 429 and answer.status_code < 500:
                    raise UploadRefusedError(answer.status_code, answer.text[:500])
                retry_after = _seconds(answer.headers.get("Retry-After"))
                trouble = f"the service answers {answer.status_code}"
            if not told:
                self._say(f"{trouble}; trying again until it takes the batch")
                told = True
            # Full jitter: boxes that lost the same server do not come back at the same moment.
            self._wait(max(retry_after, random.uniform(0.0, pause)))  # noqa: S311  not a secret
            pause = min(2.0 * pause, _LONGEST_WAIT_S)


def _seconds(text: str | None) -> float:
    try:
        return float(text) if text is not None else 0.0
    except ValueError:
        return 0.0


def _acknowledgement(answer: dict[str, Any]) -> Acknowledgement:
    return Acknowledgement(
        batch_id=answer["batch_id"],
        duplicate=answer["duplicate"],
        next_sequence=answer["next_sequence"],
        missing=tuple((first, last) for first, last in answer["missing"]),
    )
