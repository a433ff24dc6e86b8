"""MCAP recordings: JSON messages, and ROS 2's Imu, MagneticField and NavSatFix.

A JSON message gives a row: members named like the drive file's columns, or Foxglove's LocationFix. `t` is the
time at which the recorder got the message.  The records are walked here, not by the library: it would unpack as much
as a chunk says, and make objects of indices, names and texts that nobody asks for.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections import Counter
from collections.abc import Callable, Iterator
from typing import cast

import numpy as np
import orjson

from nav_core.records import Remark
from server.errors import InvalidError, TooLargeError
from server.formats.columns import NAMES, Columns, Floats, check_size
from server.formats.encoding import unpack

MAGIC = b"\x89MCAP0\r\n"
_MAX_CHUNK_BYTES = 8 * 1024 * 1024
_MAX_CHUNKS = 10_000
_RECORD_BYTES = 256
"""What a record counts as of what may be decoded, for the time that it takes."""
_MAX_JSON_BYTES = 64 * 1024
"""Of one message: the parser makes objects of many times its length."""
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 2, 3, 4, 5, 6, 15
_RECORD = struct.Struct("<BQ")
# Channel, sequence number, times of logging and of publishing in ns
_MESSAGE_HEAD = struct.Struct("<HIQQ")
# Times of the first and the last message in ns, bytes unpacked, CRC of these
_CHUNK_HEAD = struct.Struct("<QQQI")
_CDR_LITTLE = b"\x00\x01"
_TESLA_UT = 1e6

Row = dict[str, float]
Decode = Callable[[memoryview], Row]


def read(body: bytes, *, max_decoded_bytes: int | None) -> Columns:
    """Columns of a recording; messages of kinds that are not read are counted in a remark."""
    schemas: dict[int, str] = {}
    channels: dict[int, tuple[int, str]] = {}
    rows = _Rows(max_decoded_bytes)
    left_out: Counter[str] = Counter()
    try:
        for count, (kind, content) in enumerate(_records(body, max_decoded_bytes)):
            if max_decoded_bytes is not None and count * _RECORD_BYTES > max_decoded_bytes:
                raise TooLargeError(f"A recording of more than {count} records")
            if kind == _SCHEMA:
                schemas[_u16(content, 0)] = _text(content, 2)[0]
            elif kind == _CHANNEL:
                channels[_u16(content, 0)] = _u16(content, 2), _text(content, _text(content, 4)[1])[0]
            elif kind == _MESSAGE:
                _take(content, channels, schemas, rows, left_out)
    except struct.error as error:
        raise _bad(f"a record is cut off: {error}") from error
    if not rows.times:
        kinds = ", ".join(sorted(left_out)) or "none"
        raise InvalidError(f"No message that is read; kinds that are there: {kinds[:300]}", code="mcap")
    remarks = [
        Remark("mcap_messages_left_out", f"{count} messages left out: {kind}")
        for kind, count in sorted(left_out.items())
    ]
    return Columns(rows.columns(), tuple(remarks))


class _Rows:
    """Rows as they come, kept by columns: as dicts they would take ten times as much."""

    def __init__(self, max_decoded_bytes: int | None) -> None:
        self.times = array("d")
        self._cells: dict[str, tuple[array[int], array[float]]] = {}
        self._max_decoded_bytes = max_decoded_bytes

    def add(self, t: float, row: Row) -> None:
        """Append a row that was logged at `t`, unless it tells a time of its own."""
        place = len(self.times)
        self.times.append(row.pop("t", t))
        for name, value in row.items():
            places, values = self._cells.setdefault(name, (array("q"), array("d")))
            places.append(place)
            values.append(value)
        check_size(place + 1, len(self._cells) + 1, self._max_decoded_bytes)

    def columns(self) -> dict[str, Floats]:
        """Columns in the order of time."""
        times = np.array(self.times)
        order = np.argsort(times, kind="stable")
        columns = {"t": times[order]}
        for name, (places, values) in self._cells.items():
            column = np.full(times.size, np.nan)
            column[np.array(places)] = values
            columns[name] = column[order]
        return columns


# --- records


def _bad(what: str) -> InvalidError:
    return InvalidError(f"Not readable MCAP: {what}", code="mcap")


def _u16(content: memoryview, at: int) -> int:
    return int(struct.unpack_from("<H", content, at)[0])


def _text(content: memoryview, at: int) -> tuple[str, int]:
    """A text, cut to what a remark shows, and where it ends."""
    begin = at + 4
    end = begin + int(struct.unpack_from("<I", content, at)[0])
    if end > len(content):
        raise _bad("a text is cut off")
    return str(content[begin : min(end, begin + 100)], "utf-8", "replace"), end


def _records(body: bytes, max_decoded_bytes: int | None) -> Iterator[tuple[int, memoryview]]:
    """Kind and content of the records of a recording, those in chunks among them."""
    unpacked = chunks = 0
    whole = memoryview(body)
    if not body.startswith(MAGIC):
        raise _bad("it does not begin as MCAP does")
    for begin, kind, content in _walked(whole, len(MAGIC)):
        yield kind, content
        if kind == _FOOTER:
            if not body.startswith(MAGIC, begin + _RECORD.size + len(content)):
                raise _bad("it does not end as MCAP does")
            return
        if kind == _DATA_END:
            (told,) = struct.unpack_from("<I", content)
            if told and told != zlib.crc32(whole[:begin]):
                raise _bad("the CRC of its data is another")
        elif kind == _CHUNK:
            inner = _unpacked(content)
            unpacked, chunks = unpacked + len(inner), chunks + 1
            if chunks > _MAX_CHUNKS:
                raise TooLargeError(f"A recording of more than {_MAX_CHUNKS} chunks")
            if max_decoded_bytes is not None and unpacked > max_decoded_bytes:
                raise TooLargeError(f"The chunks unpack to more than {max_decoded_bytes} bytes")
            yield from ((kind, record) for _, kind, record in _walked(inner, 0))
    raise _bad("it has no footer")


def _walked(data: memoryview, at: int) -> Iterator[tuple[int, int, memoryview]]:
    """Where each record begins, its kind and its content."""
    size = len(data)
    while at < size:
        kind, length = _RECORD.unpack_from(data, at)
        begin, at = at, at + _RECORD.size + length
        if at > size:
            raise _bad(f"a record of {length} bytes is cut off")
        yield begin, kind, data[begin + _RECORD.size : at]


def _unpacked(chunk: memoryview) -> memoryview:
    """What a chunk holds."""
    _, _, size, crc = _CHUNK_HEAD.unpack_from(chunk)
    compression, end = _text(chunk, _CHUNK_HEAD.size)
    (length,) = struct.unpack_from("<Q", chunk, end)
    data = chunk[end + 8 : end + 8 + length]
    if len(data) < length:
        raise _bad("a chunk is cut off")
    if size > _MAX_CHUNK_BYTES:
        raise TooLargeError(f"A chunk unpacks to {size} bytes; at most {_MAX_CHUNK_BYTES}")
    if compression not in ("", "zstd"):
        raise InvalidError(f"Chunks packed with {compression[:20]!r} are not read; use zstd", code="mcap")
    inner = unpack(bytes(data), compression, max_bytes=size)
    if crc and crc != zlib.crc32(inner):
        raise _bad("the CRC of a chunk is another")
    return memoryview(inner)


# --- messages


def _take(
    message: memoryview,
    channels: dict[int, tuple[int, str]],
    schemas: dict[int, str],
    rows: _Rows,
    left_out: Counter[str],
) -> None:
    number, _, logged_ns, _ = _MESSAGE_HEAD.unpack_from(message)
    channel = channels.get(number)
    if channel is None:
        raise InvalidError(f"A message of channel {number}, which is not announced", code="mcap")
    schema, encoding = channel
    kind = f"{encoding} {schemas.get(schema, 'without schema')}"[:100]
    data = message[_MESSAGE_HEAD.size :]
    decode = _json if encoding == "json" else _CDR.get(kind)
    if decode is _json and len(data) > _MAX_JSON_BYTES:
        decode, kind = None, f"{kind}, longer than {_MAX_JSON_BYTES} bytes"
    row = {} if decode is None else decode(data)
    if row:
        rows.add(logged_ns / 1e9, row)
    elif kind in left_out or len(left_out) < 100:
        left_out[kind] += 1


def _json(data: memoryview) -> Row:
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

    def __init__(self, data: memoryview) -> None:
        if bytes(data[:2]) != _CDR_LITTLE:
            raise InvalidError("A CDR message that is not little endian", code="mcap")
        self._data, self._at = data[4:], 0
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


def _imu(data: memoryview) -> Row:
    # An orientation and three covariances stand between; a first covariance of -1 says "not measured".
    values = _Cdr(data).take("37d")
    rate, rate_given, force, force_given = values[13:16], values[16] != -1.0, values[25:28], values[28] != -1.0
    row: Row = {}
    if force_given:
        row |= dict(zip(("fx", "fy", "fz"), force, strict=True))
    if rate_given:
        row |= dict(zip(("wx", "wy", "wz"), rate, strict=True))
    return row


def _field(data: memoryview) -> Row:
    return {name: value * _TESLA_UT for name, value in zip(("mx", "my", "mz"), _Cdr(data).take("3d"), strict=True)}


def _navsat(data: memoryview) -> Row:
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
