"""Parquet as batches are stored: one page a column for each group of rows, made by array code.

A general writer spends its time on the levels of columns that are sampled now and then, and on a fresh compressor for
every page.  Here a column is a bitmap of where it was sampled, and its values: as numbers of a dictionary, in whole
bytes, which zstd packs better than packed bits, or sorted by the place of their bytes.  Fields are numbered as in
Parquet's parquet.thrift.
"""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import zstandard
from numpy.typing import NDArray

from nav_core.typing import Floats
from server.formats.columns import Columns
from server.formats.thrift import Long, Writable, packed, varint

_MAGIC = b"PAR1"
_GROUP_ROWS = 2**20
_LEVEL = 3
_MOST_DIFFERENT = 2**16
# Clocks tick evenly, so their bytes repeat when sorted by place; measured values repeat as a whole.
_CLOCKS = ("t", "utc")

_DOUBLE, _OPTIONAL, _ZSTD = 5, 1, 6
_DATA_PAGE, _DICTIONARY_PAGE = 0, 2
_PLAIN, _RLE, _RLE_DICTIONARY, _BYTE_STREAM_SPLIT = 0, 3, 8, 9

Fields = dict[int, Writable]


def write(columns: Columns) -> bytes:
    """Columns as Parquet: zstd, null where not sampled, the same bytes for the same columns and libraries."""
    out = io.BytesIO()
    out.write(_MAGIC)
    compressor = zstandard.ZstdCompressor(level=_LEVEL)
    groups: list[Writable] = []
    written = dict.fromkeys(columns.values, 0)
    for begin in range(0, columns.rows, _GROUP_ROWS):
        levels: dict[int, _Levels] = {}
        chunks: list[_Chunk] = []
        for name, samples in columns.samples.items():
            mask = columns.sampled[name]
            if id(mask) not in levels:
                levels[id(mask)] = _levels(mask[begin : begin + _GROUP_ROWS])
            level, done = levels[id(mask)], written[name]
            chunks.append(_chunk(out, compressor, name, samples[done : done + level.sampled], level))
            written[name] += level.sampled
        described: list[Writable] = [{2: Long(chunk.begin), 3: chunk.described()} for chunk in chunks]
        groups.append({1: described, 2: Long(sum(chunk.unpacked for chunk in chunks)), 3: Long(chunks[0].rows)})
    leaves: list[Writable] = [{1: _DOUBLE, 3: _OPTIONAL, 4: name.encode()} for name in columns.values]
    schema: list[Writable] = [{4: b"schema", 5: len(leaves)}, *leaves]
    footer = packed({1: 1, 2: schema, 3: Long(columns.rows), 4: groups, 6: b"scatola"})
    out.write(footer + struct.pack("<I", len(footer)) + _MAGIC)
    return out.getvalue()


@dataclass(slots=True)
class _Chunk:
    """A column of a group of rows, and where it lies in the file."""

    name: str
    rows: int
    encoding: int
    begin: int
    data_begin: int = 0
    unpacked: int = 0
    packed: int = 0

    def described(self) -> Fields:
        by_number = self.encoding == _RLE_DICTIONARY
        return {
            1: _DOUBLE,
            2: [_PLAIN, _RLE, _RLE_DICTIONARY] if by_number else [_RLE, self.encoding],
            3: [self.name.encode()],
            4: _ZSTD,
            5: Long(self.rows),
            6: Long(self.unpacked),
            7: Long(self.packed),
            9: Long(self.data_begin),
            **({11: Long(self.begin)} if by_number else {}),
        }


class _Levels(NamedTuple):
    """Which rows of a group have a value, as the file tells it; columns that were sampled together share it."""

    rows: int
    sampled: int
    content: bytes


def _chunk(
    out: io.BytesIO, compressor: zstandard.ZstdCompressor, name: str, present: Floats, levels: _Levels
) -> _Chunk:
    """Append a column's pages."""
    numbered = None if name in _CLOCKS else _numbered(present)
    made = _Chunk(name, levels.rows, _BYTE_STREAM_SPLIT if numbered is None else _RLE_DICTIONARY, out.tell())

    def page(content: bytes, kind: int, header: Fields) -> None:
        pressed = compressor.compress(content)
        head = packed({1: kind, 2: len(content), 3: len(pressed), **header})
        out.write(head)
        out.write(pressed)
        made.unpacked += len(head) + len(content)
        made.packed += len(head) + len(pressed)

    if numbered is None:
        content = present.view(np.uint8).reshape(present.size, 8).T.tobytes()
    else:
        dictionary, content = numbered
        page(dictionary.tobytes(), _DICTIONARY_PAGE, {7: {1: dictionary.size, 2: _PLAIN}})
    made.data_begin = out.tell()
    page(levels.content + content, _DATA_PAGE, {5: {1: levels.rows, 2: made.encoding, 3: _RLE, 4: _RLE}})
    return made


def _levels(sampled: NDArray[np.bool_]) -> _Levels:
    """One run where all rows have a value, else a bit a row."""
    count = int(np.count_nonzero(sampled))
    dense = count == sampled.size
    runs = varint(sampled.size << 1) + b"\x01" if dense else _unpacked_run(np.packbits(sampled, bitorder="little"), 1)
    return _Levels(sampled.size, count, struct.pack("<I", len(runs)) + runs)


def _unpacked_run(content: NDArray[Any], bits: int) -> bytes:
    """Numbers of so many bits each, as they stand; a run holds them in eights."""
    data = content.tobytes()
    eights = -(-len(data) // bits)
    return varint(eights << 1 | 1) + data.ljust(eights * bits, b"\0")


def _encoded(values: Floats) -> Any:
    """Arrow's dictionary encoding of the bits of values.

    From buffers and to them: Arrow's own ways from and to numpy load pandas where it is installed.
    """
    array: Any = pa.Array.from_buffers(pa.int64(), values.size, [None, pa.py_buffer(values)])
    return pc.dictionary_encode(array)  # pyright: ignore[reportAttributeAccessIssue]  made at import


def _numbered(values: Floats) -> tuple[NDArray[np.int64], bytes] | None:
    """Different values and each one's number, where that is shorter; equal is what has equal bits."""
    # Where the beginning has too many already, all of them are not asked for: that would take tens of megabytes.
    if values.size > 2 * _MOST_DIFFERENT and len(_encoded(values[: 2 * _MOST_DIFFERENT]).dictionary) > _MOST_DIFFERENT:
        return None
    encoded = _encoded(values)
    dictionary = np.frombuffer(encoded.dictionary.buffers()[1], np.int64, len(encoded.dictionary))
    bits = 8 if dictionary.size <= 2**8 else 16
    if dictionary.size > _MOST_DIFFERENT or 8 * dictionary.size + bits // 8 * values.size > 6 * values.size:
        return None
    numbers = np.frombuffer(encoded.indices.buffers()[1], np.int32, values.size)
    return dictionary, bytes([bits]) + _unpacked_run(numbers.astype(np.uint8 if bits == 8 else "<u2"), bits)
