"""Teltonika Codec 8 Extended: AVL records with position, a few inputs, and the crash trace (AVL 257).

Packets as the boxes send them over TCP, one after the other, as bytes or as hexadecimal text; what a
gateway that speaks the vendor's protocol forwards.  Layout: the vendor's wiki, "Codec" and "Crash trace".
The clock of these records is UTC, so `t` is Unix time.  Accelerometer readings are thousandths of g along the
box's own axes, +1000 on the axis that points up: specific force already, no sign to change.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from nav_core.records import Remark
from server.errors import InvalidError, TooLargeError
from server.formats.columns import Columns, Floats, check_size

_CODEC = 0x8E
_FRAME = struct.Struct(">II")
# Timestamp ms, priority, longitude and latitude 1e-7 deg, altitude m, angle deg, satellites, speed km/h
_RECORD = struct.Struct(">QBiihHBH")
_IMEI = re.compile(rb"\x00\x0f[0-9]{15}")
_HEX = re.compile(rb"[0-9A-Fa-f\s]+")
_BLANKS = b" \t\n\r\v\f"
_MAX_BYTES = 2 * 1024 * 1024  # the checksum is computed byte by byte

_IGNITION, _GNSS_STATUS, _SUPPLY_MV, _BATTERY_MV, _HDOP, _CRASH_TRACE = 239, 69, 66, 67, 182, 257
_AXES = (17, 18, 19)
_IN_COLUMNS = frozenset({_IGNITION, _GNSS_STATUS, _SUPPLY_MV, _HDOP, _CRASH_TRACE, *_AXES})
_GNSS_FIXED = 1
_MILLI_G = 9.80665e-3
_PERIODS_S = (0.001, 0.002, 0.0025, 0.005, 0.01, 0.02, 0.04, 0.1)
_ASSUMED_PERIOD_S = 0.01


@dataclass(slots=True)
class _Record:
    t: float
    position: tuple[int, int, int, int, int, int]
    """Longitude, latitude, altitude, angle, satellites, speed as sent."""
    numbers: dict[int, int] = field(default_factory=dict[int, int])
    trace: Floats | None = None


def is_codec8e(body: bytes) -> bool:
    """Whether a file begins like such packets, in bytes or in hexadecimal text."""
    begin = body[:64]
    if _HEX.fullmatch(begin):
        text = b"".join(begin.split())
        begin = bytes.fromhex(text[: len(text) // 2 * 2].decode())
    if _IMEI.match(begin):
        begin = begin[17:]
    return len(begin) > 8 and begin[:4] == bytes(4) and begin[8] == _CODEC


def read(body: bytes, *, max_decoded_bytes: int | None) -> Columns:
    """Columns of one or more packets."""
    if len(body) > 4 * _MAX_BYTES:  # digits, and blanks between them
        raise _too_large(len(body))
    if _HEX.fullmatch(body):
        text = body.translate(None, _BLANKS)
        if len(text) % 2:
            raise _bad("an odd number of hexadecimal digits", len(text) // 2)
        body = bytes.fromhex(text.decode())
    if len(body) > _MAX_BYTES:
        raise _too_large(len(body))
    records: list[_Record] = []
    at = 17 if _IMEI.match(body) else 0
    while at < len(body):
        at = _packet(body, at, records)
    if not records:
        raise InvalidError("There are no records", code="empty")
    samples = sum(len(record.trace) for record in records if record.trace is not None)
    check_size(len(records) + samples, 14, max_decoded_bytes)
    return _columns(records)


def _too_large(size: int) -> TooLargeError:
    return TooLargeError(f"{size} bytes of Codec 8E; at most {_MAX_BYTES} at once")


def _bad(what: str, at: int) -> InvalidError:
    return InvalidError(f"Not readable Codec 8E: {what}, at byte {at}", code="codec8e", byte=at)


def _packet(body: bytes, at: int, records: list[_Record]) -> int:
    """Take one packet's records; where the next one begins."""
    if len(body) < at + _FRAME.size + 7:
        raise _bad("a packet is cut off", at)
    preamble, length = _FRAME.unpack_from(body, at)
    begin, end = at + _FRAME.size, at + _FRAME.size + length
    if preamble:
        raise _bad("a packet does not begin with four zeros", at)
    if length < 3 or end + 4 > len(body):
        raise _bad(f"a packet of {length} bytes does not fit", at)
    if body[begin] != _CODEC:
        raise _bad(f"codec {body[begin]:#04x}; only 0x8e carries crash traces and is read", begin)
    told = struct.unpack_from(">I", body, end)[0]
    if told != (found := _crc16(memoryview(body)[begin:end])):
        raise _bad(f"CRC {found:04x}, the packet says {told:04x}", end)
    count, cursor = body[begin + 1], _Cursor(body, begin + 2, end - 1)
    records.extend(_record(cursor) for _ in range(count))
    if cursor.at != end - 1 or body[end - 1] != count:
        raise _bad(f"{count} records announced, the packet ends otherwise", cursor.at)
    return end + 4


class _Cursor:
    """Reads on to the end of a packet and not past it."""

    def __init__(self, body: bytes, at: int, end: int) -> None:
        self.body, self.at, self._end = body, at, end

    def take(self, size: int) -> bytes:
        """The next `size` bytes."""
        begin = self.at
        if begin + size > self._end:
            raise _bad("a record is cut off", begin)
        self.at += size
        return self.body[begin : self.at]

    def number(self, size: int) -> int:
        """The next unsigned number."""
        return int.from_bytes(self.take(size))


def _record(cursor: _Cursor) -> _Record:
    time_ms, _priority, *position = _RECORD.unpack(cursor.take(_RECORD.size))
    lon, lat, alt, angle, sats, speed = position
    record = _Record(time_ms / 1000.0, (lon, lat, alt, angle, sats, speed))
    cursor.take(2)  # which input caused the record
    total, seen = cursor.number(2), 0
    for size in (1, 2, 4, 8):
        for _ in range(cursor.number(2)):
            name = cursor.number(2)
            record.numbers[name] = cursor.number(size)
            seen += 1
    for _ in range(cursor.number(2)):
        name, size, begin = cursor.number(2), cursor.number(2), cursor.at
        value = cursor.take(size)
        seen += 1
        if name == _CRASH_TRACE:
            if size % 6:
                raise _bad(f"a crash trace of {size} bytes is not made of three axes of two", begin)
            record.trace = np.frombuffer(value, ">i2").reshape(-1, 3) * _MILLI_G
    if seen != total:
        raise _bad(f"{total} inputs announced, {seen} found", cursor.at)
    return record


def _columns(records: list[_Record]) -> Columns:
    remarks: list[Remark] = []
    rows = [_row(record) for record in records]
    count, total = len(rows), len(rows) + sum(len(record.trace) for record in records if record.trace is not None)
    names = {name for row in rows for name in row}
    columns = {name: np.full(total, np.nan) for name in names}
    for name in names:
        columns[name][:count] = [row.get(name, np.nan) for row in rows]
    traces = [record for record in records if record.trace is not None and len(record.trace)]
    if traces:
        period_s = _period_s(traces, remarks)
        for name in ("fx", "fy", "fz"):
            columns.setdefault(name, np.full(total, np.nan))
        begin = count
        for record in traces:
            assert record.trace is not None
            place = slice(begin, begin := begin + len(record.trace))
            columns["t"][place] = record.t + period_s * np.arange(len(record.trace))
            for name, axis in zip(("fx", "fy", "fz"), record.trace.T, strict=True):
                columns[name][place] = axis
    order = np.argsort(columns["t"], kind="stable")
    return Columns({name: column[order] for name, column in columns.items()}, tuple(remarks), _named(records))


def _named(records: list[_Record]) -> dict[str, tuple[Floats, Floats]]:
    """Inputs that the drive file has no column for, by the vendor's number: ``avl.113`` and so on, as sent."""
    found: dict[str, list[tuple[float, int]]] = {}
    for record in records:
        for name, value in record.numbers.items():
            if name not in _IN_COLUMNS:
                found.setdefault(f"avl.{name}", []).append((record.t, value))
    columns = {name: np.array(pairs, dtype=np.float64) for name, pairs in found.items()}
    return {name: (pairs[:, 0], pairs[:, 1]) for name, pairs in columns.items()}


def _row(record: _Record) -> dict[str, float]:
    """What a record says apart from its trace."""
    lon, lat, alt, angle, sats, speed = record.position
    status = record.numbers.get(_GNSS_STATUS)
    fixed = sats > 0 and (lon, lat) != (0, 0) if status is None else status == _GNSS_FIXED
    row = {"t": record.t, "fix": float(fixed), "sats": float(sats)}
    if fixed:
        row |= {"utc": record.t, "lat": lat * 1e-7, "lon": lon * 1e-7, "alt": float(alt)}
        row |= {"speed": speed / 3.6, "course": float(angle)}
    if _HDOP in record.numbers:
        row["hdop"] = record.numbers[_HDOP] / 10.0
    if _IGNITION in record.numbers:
        row["ignition"] = float(record.numbers[_IGNITION] != 0)
    battery_mv = record.numbers.get(_SUPPLY_MV, record.numbers.get(_BATTERY_MV))
    if battery_mv is not None:
        row["battery"] = battery_mv / 1000.0
    if record.trace is None and all(axis in record.numbers for axis in _AXES):
        for name, axis in zip(("fx", "fy", "fz"), _AXES, strict=True):
            milli_g = record.numbers[axis] & 0xFFFF
            row[name] = (milli_g - 0x10000 * (milli_g >= 0x8000)) * _MILLI_G
    return row


def _period_s(traces: list[_Record], remarks: list[Remark]) -> float:
    """Time from sample to sample of the crash traces: the records do not tell, but traces that follow each other do."""
    steps = [
        (after.t - before.t) / len(before.trace)
        for before, after in pairwise(traces)
        if before.trace is not None and after.t > before.t
    ]
    if steps:
        step = float(np.median(steps))
        nearest = min(_PERIODS_S, key=lambda period: abs(period - step))
        if abs(step - nearest) <= 0.1 * nearest:
            remarks.append(
                Remark("crash_trace_period_found", f"Samples every {1e3 * nearest:g} ms, from {len(steps)} steps")
            )
            return nearest
    remarks.append(
        Remark(
            "crash_trace_period_assumed",
            f"The records do not tell the rate of the crash trace; {1e3 * _ASSUMED_PERIOD_S:g} ms are assumed",
        )
    )
    return _ASSUMED_PERIOD_S


def _table() -> list[int]:
    table: list[int] = []
    for value in range(256):
        crc = value
        for _ in range(8):
            crc = (crc >> 1) ^ (0xA001 if crc & 1 else 0)
        table.append(crc)
    return table


_CRC_TABLE = _table()


def _crc16(data: memoryview) -> int:
    """CRC-16/IBM, reflected, from 0."""
    crc = 0
    for byte in data:
        crc = (crc >> 8) ^ _CRC_TABLE[(crc ^ byte) & 0xFF]
    return crc
