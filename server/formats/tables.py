"""Between Arrow's columns and ours, by their buffers: Arrow's own ways to numpy load pandas where it is installed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv, ipc

from server.errors import InvalidError
from server.formats.columns import Columns, Floats, not_finite

CSV_BLOCK_BYTES = 1 << 20
"""So much of a text is parsed at a time."""

# pyarrow ships no types.
DataType = Any
Array = Any
ChunkedArray = Any
Table = Any


def is_numeric(kind: DataType) -> bool:
    """Whether a type holds numbers, flags or nothing at all."""
    return bool(
        pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind) or pa.types.is_null(kind)
    )


def column_of(name: str, column: ChunkedArray) -> Floats:
    """Values with NaN for null; a NaN or infinity that was sent is refused."""
    if not is_numeric(column.type):
        raise InvalidError(f"Column {name!r} holds {str(column.type)[:40]}, not numbers", code="columns", column=name)
    if column.num_chunks == 1:
        return _told(name, _floats(column.chunk(0)), 0)
    filled = Filled(name, len(column))
    for chunk in column.chunks:
        filled.add(_floats(chunk))
    return filled.values


class Filled:
    """A column that is filled piece by piece: no more is there twice than a piece."""

    def __init__(self, name: str, most: int) -> None:
        self._name = name
        self._values = np.empty(most)
        self._rows = 0

    def add(self, array: Array) -> None:
        """Append a float64 array's values."""
        rows = self._rows + len(array)
        self._values[self._rows : rows] = _told(self._name, array, self._rows)
        self._rows = rows

    @property
    def values(self) -> Floats:
        """All that was added."""
        return self._values[: self._rows]


def _floats(array: Array) -> Array:
    """Numbers or flags as float64."""
    numbers = array.cast(pa.uint8()) if pa.types.is_boolean(array.type) else array
    return numbers.cast(pa.float64(), safe=False)


def _told(name: str, chunk: Array, first: int) -> Floats:
    """Values of a float64 array with NaN for null; `first` is the place of its own first row in the column."""
    count, offset = len(chunk), chunk.offset
    bitmap, data = chunk.buffers()
    if data is None or count == 0:
        return np.full(count, np.nan)
    values = np.frombuffer(data, dtype=np.float64, count=count, offset=offset * 8)
    valid = None
    if chunk.null_count:
        bits = np.unpackbits(np.frombuffer(bitmap, dtype=np.uint8), bitorder="little")
        valid = bits[offset : offset + count].view(np.bool_)
    told = values if valid is None else np.where(valid, values, np.nan)
    finite = np.isfinite(told)
    if np.count_nonzero(finite) < count - chunk.null_count:
        bad = ~finite if valid is None else valid & ~finite
        raise not_finite(name, first + int(np.argmax(bad)))
    return told


def table_of(columns: Columns) -> Table:
    """An Arrow table with null where not sampled."""
    arrays: list[Array] = []
    for values in columns.values.values():
        missing = np.isnan(values)
        bitmap = pa.py_buffer(np.packbits(~missing, bitorder="little")) if missing.any() else None
        arrays.append(pa.Array.from_buffers(pa.float64(), values.size, [bitmap, pa.py_buffer(values)]))
    return pa.Table.from_arrays(arrays, names=list(columns.values))


def write_arrow(columns: Columns) -> bytes:
    """Arrow's stream format, zstd inside."""
    sink = pa.BufferOutputStream()
    table = table_of(columns)
    with ipc.new_stream(sink, table.schema, options=ipc.IpcWriteOptions(compression="zstd")) as writer:
        writer.write_table(table)
    return sink.getvalue().to_pybytes()


def write_csv(columns: Columns) -> bytes:
    """Text of a drive file: numbers as short as they read back exactly, nothing where not sampled."""
    sink = pa.BufferOutputStream()
    csv.write_csv(table_of(columns), sink, csv.WriteOptions(quoting_style="none", quoting_header="none"))
    return sink.getvalue().to_pybytes()
