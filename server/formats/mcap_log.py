"""MCAP recordings: JSON messages, and ROS 2's Imu, MagneticField and NavSatFix.

A JSON message gives a row: members named like the drive file's columns, or Foxglove's LocationFix. `t` is the
time at which the recorder got the message.  Chunks are unpacked here, not by the library, which would unpack as
much as a frame says.
"""

from __future__ import annotations

import io
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from typing import cast

import numpy as np
import orjson
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from nav_core.records import Remark
from server.errors import InvalidError, TooLargeError
from server.formats.columns import NAMES, Columns, check_size
from server.formats.encoding import unpack

MAGIC = b"\x89MCAP0\r\n"
_MAX_CHUNK_BYTES = 8 * 1024 * 1024
_MAX_RECORD_BYTES = 16 * 1024 * 1024
_CDR_LITTLE = b"\x00\x01"
_TESLA_UT = 1e6

Row = dict[str, float]
Decode = Callable[[bytes], Row]


def read(body: bytes, *, max_decoded_bytes: int | None) -> Columns:
    """Columns of a recording; messages of kinds that are not read are counted in a remark."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    rows: list[Row] = []
    left_out: Counter[str] = Counter()
    try:
        for record in _records(body, max_decoded_bytes):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                # While they are read, rows are objects, several times as large as in columns.
                check_size(4 * len(rows), len(NAMES), max_decoded_bytes)
                _take(record, channels, schemas, rows, left_out)
    except (McapError, struct.error, UnicodeDecodeError, EOFError, ValueError, OverflowError) as error:
        raise InvalidError(f"Not readable MCAP: {type(error).__name__} {str(error)[:200]}", code="mcap") from error
    if not rows:
        kinds = ", ".join(sorted(left_out)) or "none"
        raise InvalidError(f"No message that is read; kinds that are there: {kinds[:300]}", code="mcap")
    remarks = [
        Remark("mcap_messages_left_out", f"{count} messages left out: {kind}")
        for kind, count in sorted(left_out.items())
    ]
    names = {name for row in rows for name in row}
    rows.sort(key=lambda row: row["t"])
    return Columns({name: np.array([row.get(name, np.nan) for row in rows]) for name in names}, tuple(remarks))


def _records(body: bytes, max_decoded_bytes: int | None) -> Iterator[object]:
    """The records of a recording, those in chunks among them."""
    unpacked = 0
    reader = StreamReader(io.BytesIO(body), emit_chunks=True, validate_crcs=True, record_size_limit=_MAX_RECORD_BYTES)
    for record in reader.records:
        if not isinstance(record, Chunk):
            yield record
            continue
        unpacked += record.uncompressed_size
        if record.uncompressed_size > _MAX_CHUNK_BYTES:
            raise TooLargeError(f"A chunk unpacks to {record.uncompressed_size} bytes; at most {_MAX_CHUNK_BYTES}")
        if max_decoded_bytes is not None and unpacked > max_decoded_bytes:
            raise TooLargeError(f"The chunks unpack to more than {max_decoded_bytes} bytes")
        if record.compression not in ("", "zstd"):
            raise InvalidError(f"Chunks packed with {record.compression[:20]!r} are not read; use zstd", code="mcap")
        record.data = unpack(record.data, record.compression, max_bytes=record.uncompressed_size)
        record.compression = ""
        yield from breakup_chunk(record, validate_crc=True)


def _take(
    message: Message,
    channels: dict[int, Channel],
    schemas: dict[int, Schema],
    rows: list[Row],
    left_out: Counter[str],
) -> None:
    channel = channels.get(message.channel_id)
    if channel is None:
        raise InvalidError(f"A message of channel {message.channel_id}, which is not announced", code="mcap")
    schema = schemas.get(channel.schema_id)
    kind = f"{channel.message_encoding} {schema.name if schema is not None else 'without schema'}"[:100]
    decode = _json if channel.message_encoding == "json" else _CDR.get(kind)
    row = {} if decode is None else decode(message.data)
    if row:
        rows.append({"t": message.log_time / 1e9} | row)
    elif kind in left_out or len(left_out) < 100:
        left_out[kind] += 1


def _json(data: bytes) -> Row:
    """Members that are columns; Foxglove's LocationFix by its own names."""
    try:
        said: object = orjson.loads(data)
    except orjson.JSONDecodeError as error:
        raise InvalidError(f"A message is not JSON: {error}", code="mcap") from None
    if not isinstance(said, dict):
        return {}
    members = cast("dict[str, object]", said)
    row = {name: float(value) for name in NAMES if isinstance(value := members.get(name), int | float)}
    if {"latitude", "longitude"} <= members.keys():
        for name, member in (("lat", "latitude"), ("lon", "longitude"), ("alt", "altitude")):
            value = members.get(member)
            if isinstance(value, int | float):
                row[name] = float(value)
        row["fix"] = 1.0
    return row


class _Cdr:
    """ROS 2's wire format: values aligned by their size, from behind the four bytes that tell it."""

    def __init__(self, data: bytes) -> None:
        if data[:2] != _CDR_LITTLE:
            raise InvalidError("A CDR message that is not little endian", code="mcap")
        self._data, self._at = memoryview(data)[4:], 0
        self._pass(8)  # the stamp of the sensor's driver
        (length,) = self.take("I")
        self._pass(int(length))  # the frame's name

    def _pass(self, size: int) -> None:
        if size > len(self._data) - self._at:
            raise InvalidError("A CDR message is cut off", code="mcap")
        self._at += size

    def take(self, kinds: str) -> tuple[float, ...]:
        """Values of one type."""
        reader = struct.Struct(f"<{kinds}")
        size = struct.calcsize(f"<{kinds[-1]}")
        self._at = -(-self._at // size) * size
        values = reader.unpack_from(self._data, self._at)
        self._at += reader.size
        return values


def _imu(data: bytes) -> Row:
    # An orientation and three covariances stand between; a first covariance of -1 says "not measured".
    values = _Cdr(data).take("37d")
    rate, rate_given, force, force_given = values[13:16], values[16] != -1.0, values[25:28], values[28] != -1.0
    row: Row = {}
    if force_given:
        row |= dict(zip(("fx", "fy", "fz"), force, strict=True))
    if rate_given:
        row |= dict(zip(("wx", "wy", "wz"), rate, strict=True))
    return row


def _field(data: bytes) -> Row:
    return {name: value * _TESLA_UT for name, value in zip(("mx", "my", "mz"), _Cdr(data).take("3d"), strict=True)}


def _navsat(data: bytes) -> Row:
    reader = _Cdr(data)
    (status,) = reader.take("b")
    reader.take("H")
    lat, lon, alt = reader.take("3d")
    if status < 0:
        return {"fix": 0.0}
    return {"fix": 1.0, "lat": lat, "lon": lon} | ({"alt": alt} if np.isfinite(alt) else {})


_CDR: dict[str, Decode] = {
    "cdr sensor_msgs/msg/Imu": _imu,
    "cdr sensor_msgs/msg/MagneticField": _field,
    "cdr sensor_msgs/msg/NavSatFix": _navsat,
}
