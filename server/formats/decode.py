"""From a request's body to checked columns, by media type."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Protocol

from server.errors import UnsupportedMediaError
from server.formats.columns import Columns, check_size, check_values


class _Reader(Protocol):
    def __call__(self, body: bytes, *, max_decoded_bytes: int) -> Columns: ...


def _json() -> _Reader:
    from server.formats.json_text import read

    return read


def _csv() -> _Reader:
    from server.formats.csv_text import read

    return read


def _parquet() -> _Reader:
    from server.formats.parquet import read

    return read


def _arrow() -> _Reader:
    from server.formats.arrow import read

    return read


def _compact() -> _Reader:
    from server.formats.compact import read

    return read


def _codec8e() -> _Reader:
    from server.formats.codec8e import read

    return read


def _mcap() -> _Reader:
    from server.formats.mcap_log import read

    return read


def _nmea() -> _Reader:
    from server.formats.nmea import read

    return read


def _thesis_line() -> _Reader:
    from server.formats.thesis_line import read

    return read


_READERS: dict[str, Callable[[], _Reader]] = {
    "application/json": _json,
    "text/csv": _csv,
    "application/vnd.apache.parquet": _parquet,
    "application/vnd.apache.arrow.stream": _arrow,
    "application/vnd.scatola.batch": _compact,
    "application/vnd.scatola.codec8e": _codec8e,
    "application/vnd.scatola.nmea": _nmea,
    "application/vnd.scatola.thesis-line": _thesis_line,
    "application/mcap": _mcap,
}
MEDIA_TYPES = tuple(_READERS)


def load() -> None:
    """Import what reads and writes batches, or the first of each kind waits for it."""
    importlib.import_module("server.formats.parquet_write")
    for reader in _READERS.values():
        reader()


def media_type_of(content_type: str) -> str:
    """The media type without its parameters; refused when we cannot read it."""
    essence, *parameters = (part.strip().lower() for part in content_type.split(";"))
    if essence not in _READERS:
        raise UnsupportedMediaError(f"Send one of {', '.join(_READERS)}; not {essence[:100]!r}")
    for parameter in parameters:
        name, _, value = parameter.partition("=")
        if name == "charset" and value.strip('"') not in ("utf-8", "us-ascii"):
            raise UnsupportedMediaError(f"Send UTF-8, not {value[:40]!r}")
    return essence


def decode(media_type: str, body: bytes, *, max_decoded_bytes: int) -> Columns:
    """Checked columns of a body.

    Raises
    ------
    InvalidError, TooLargeError
        The body does not say what the contract allows, or unpacks to too much.
    """
    columns = _READERS[media_type]()(body, max_decoded_bytes=max_decoded_bytes)
    check_size(columns.rows, len(columns.values), max_decoded_bytes)  # whatever a reader overlooked goes no further
    check_values(columns)
    return columns
