"""`application/vnd.scatola.batch`: a body that a small box can write with a few copies (docs/device-protocol.md).

Blocks of rows that were sampled together, each with its own clock steps; in a block one array of
integers for each column, times a scale.  Little endian, closed by a CRC32.  Decoding is array code: the
only loops run over blocks and columns, of which a body holds at most 8 and 21.
"""

from __future__ import annotations

import itertools
import math
import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from server.errors import InvalidError
from server.formats.columns import NAMES, Columns, Floats, check_size

MAGIC = b"SCTB"
VERSION = 1
MAX_BLOCKS = 8

# magic, version, number of blocks, flags, length of the body, ticks per second
HEAD = struct.Struct("<4sBBHII")
# rows, columns, kind of time, reserved, tick of the first row, ticks from row to row, reserved
BLOCK = struct.Struct("<IBBHqII")
# number of the column, type, reserved, reserved, scale, offset
COLUMN = struct.Struct("<BBHIdd")
CRC = struct.Struct("<I")
ALIGNMENT = 8

EVEN, STEPS_16, STEPS_32 = 0, 2, 4
INT8, INT16, INT32 = 1, 2, 4
_STEPS = {STEPS_16: np.dtype("<u2"), STEPS_32: np.dtype("<u4")}
_VALUES = {INT8: np.dtype("<i1"), INT16: np.dtype("<i2"), INT32: np.dtype("<i4")}
# So far from the ends that adding every step of a body cannot wrap around.
_MAX_TICK = 2**62

Ticks = NDArray[np.int64]


def read(body: bytes, *, max_decoded_bytes: int | None) -> Columns:
    """Columns of a compact body; rows of all blocks in the order of time."""
    blocks, ticks_per_s = _check(body)
    cursor = _Cursor(body)
    layouts = [_layout(cursor, number) for number in range(blocks)]
    if cursor.at != len(body) - CRC.size:
        raise _bad(f"{len(body) - CRC.size - cursor.at} bytes stand between the last block and the CRC")
    rows = sum(layout.rows for layout in layouts)
    names = {column.name for layout in layouts for column in layout.columns}
    check_size(rows, len(names) + 1, max_decoded_bytes)
    ticks, places = _merged(np.concatenate([layout.ticks(body) for layout in layouts]))
    t = ticks / ticks_per_s
    del ticks  # as large as a column
    values = dict(zip(names, np.full((len(names), rows), np.nan), strict=True))
    ends = itertools.accumulate(layout.rows for layout in layouts)
    for layout, end in zip(layouts, ends, strict=True):
        block = slice(end - layout.rows, end)
        for column in layout.columns:
            values[column.name][block if places is None else places[block]] = column.values(body, layout.rows)
    return Columns({"t": t, **values})


def _merged(ticks: Ticks) -> tuple[Ticks, NDArray[np.int32] | None]:
    """The ticks of all blocks in the order of time, and which place each row has there; None for its own."""
    if (ticks[1:] >= ticks[:-1]).all():
        return ticks, None
    order = np.argsort(ticks, kind="stable").astype(np.int32)  # no body holds so many rows
    places = np.empty_like(order)
    places[order] = np.arange(order.size, dtype=np.int32)
    return ticks[order], places


def _bad(what: str) -> InvalidError:
    return InvalidError(f"Not a readable compact batch: {what}", code="compact")


def _check(body: bytes) -> tuple[int, int]:
    """Number of blocks and ticks per second of a body that arrived whole."""
    if len(body) < HEAD.size + CRC.size:
        raise _bad(f"{len(body)} bytes are less than a header and a CRC")
    magic, version, blocks, flags, length, ticks_per_s = HEAD.unpack_from(body)
    if magic != MAGIC:
        raise _bad("it does not begin with SCTB")
    if version != VERSION:
        raise _bad(f"version {version}; this service reads version {VERSION}")
    if length != len(body):
        raise _bad(f"the header tells of {length} bytes, {len(body)} came")
    told, found = CRC.unpack_from(body, len(body) - CRC.size)[0], zlib.crc32(memoryview(body)[: -CRC.size])
    if told != found:
        raise _bad(f"its CRC is {found:08x}, it says {told:08x}")
    if flags:
        raise _bad("flags are set that version 1 does not know")
    if not 1 <= blocks <= MAX_BLOCKS:
        raise _bad(f"{blocks} blocks; 1 to {MAX_BLOCKS} are allowed")
    if ticks_per_s == 0:
        raise _bad("0 ticks per second")
    return blocks, ticks_per_s


class _Cursor:
    """Takes what comes next, and refuses to go past the CRC."""

    def __init__(self, body: bytes) -> None:
        self.body = body
        self.at = HEAD.size

    def take(self, size: int, what: str) -> int:
        """Where the next `size` bytes begin; the padding behind them is passed and must be zero."""
        begin, end = self.at, self.at + size
        padded = -(-end // ALIGNMENT) * ALIGNMENT
        if padded > len(self.body) - CRC.size:
            raise _bad(f"{what} is cut off")
        if any(self.body[end:padded]):
            raise _bad(f"the padding behind {what} is not zero")
        self.at = padded
        return begin


@dataclass(frozen=True, slots=True)
class _Column:
    """A column of a block, and where its integers stand."""

    name: str
    kind: int
    scale: float
    offset: float
    begin: int

    def values(self, body: bytes, rows: int) -> Floats:
        raw = np.frombuffer(body, _VALUES[self.kind], rows, self.begin)
        # A scale may be so large that a value is infinite: the check of ranges then names it.
        with np.errstate(over="ignore"):
            scaled = raw.astype(np.float64) * self.scale
            if self.offset:
                scaled += self.offset
        missing = raw == np.iinfo(raw.dtype).min
        if missing.any():
            scaled[missing] = np.nan
        return scaled


@dataclass(frozen=True, slots=True)
class _Layout:
    """What a block's header says, and where its arrays stand."""

    rows: int
    first: int
    step: int
    steps_kind: int
    steps_begin: int
    columns: list[_Column]

    def ticks(self, body: bytes) -> Ticks:
        if self.steps_kind == EVEN:
            return self.first + self.step * np.arange(self.rows, dtype=np.int64)
        steps = np.frombuffer(body, _STEPS[self.steps_kind], self.rows, self.steps_begin)
        if steps[0]:
            raise _bad(f"the first step of a block is {steps[0]}, not 0")
        return self.first + np.cumsum(steps, dtype=np.int64)


def _layout(cursor: _Cursor, number: int) -> _Layout:
    """A block's header, its columns and where their arrays lie."""
    where = f"block {number} (from 0)"
    begin = cursor.take(BLOCK.size, f"the header of {where}")
    rows, count, steps_kind, reserved, first, step, reserved_too = BLOCK.unpack_from(cursor.body, begin)
    if reserved or reserved_too:
        raise _bad(f"{where} sets reserved bytes")
    if rows == 0 or not 1 <= count < len(NAMES):
        raise _bad(f"{where} has {rows} rows and {count} columns")
    if steps_kind != EVEN and (steps_kind not in _STEPS or step):
        raise _bad(f"{where} has time of kind {steps_kind} with step {step}")
    if abs(first) > _MAX_TICK:
        raise _bad(f"{where} begins at tick {first}")
    described = [_described(cursor, f"column {index} of {where}") for index in range(count)]
    if len({name for name, *_ in described}) != count:
        raise _bad(f"{where} has a column twice")
    steps_begin = cursor.take(0 if steps_kind == EVEN else rows * steps_kind, f"the time of {where}")
    columns = [
        _Column(name, kind, scale, offset, cursor.take(rows * kind, f"column {name} of {where}"))
        for name, kind, scale, offset in described
    ]
    return _Layout(rows, first, step, steps_kind, steps_begin, columns)


def _described(cursor: _Cursor, where: str) -> tuple[str, int, float, float]:
    """Name, type, scale and offset of a column."""
    begin = cursor.take(COLUMN.size, f"the description of {where}")
    number, kind, reserved, reserved_too, scale, offset = COLUMN.unpack_from(cursor.body, begin)
    if reserved or reserved_too:
        raise _bad(f"{where} sets reserved bytes")
    if not 1 <= number < len(NAMES):
        raise _bad(f"{where} has number {number}; 1 to {len(NAMES) - 1} have a meaning")
    if kind not in _VALUES:
        raise _bad(f"{where} has type {kind}")
    if not (math.isfinite(scale) and math.isfinite(offset)) or scale == 0.0:
        raise _bad(f"{where} has scale {scale:g} and offset {offset:g}")
    return NAMES[number], kind, scale, offset
