"""Between Arrow's columns and ours, by their buffers: Arrow's own ways to numpy load pandas where it is installed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv, ipc

from server.errors import InvalidError
from server.formats.columns import Columns, Floats, not_finite

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
    numbers = column.cast(pa.uint8()) if pa.types.is_boolean(column.type) else column
    chunks: list[Floats] = [np.zeros(0)]
    for chunk in numbers.cast(pa.float64(), safe=False).chunks:
        chunks.append(_told(name, chunk, sum(part.size for part in chunks)))
    return chunks[1] if len(chunks) == 2 else np.concatenate(chunks)


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
