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
    chunks = [_values(chunk) for chunk in numbers.cast(pa.float64(), safe=False).chunks]
    if len(chunks) == 1 and chunks[0][1] is None and np.isfinite(chunks[0][0].sum()):
        return chunks[0][0]  # a number in every row: the sum would show any that is not finite
    chunks = [(part, np.ones(part.size, dtype=np.bool_) if valid is None else valid) for part, valid in chunks]
    values = np.concatenate([part for part, _ in chunks]) if chunks else np.zeros(0)
    valid = np.concatenate([part for _, part in chunks]) if chunks else np.zeros(0, dtype=np.bool_)
    bad = ~np.isfinite(values) & valid
    if bad.any():
        raise not_finite(name, int(np.argmax(bad)))
    return np.where(valid, values, np.nan)


def _values(chunk: Array) -> tuple[Floats, np.ndarray[Any, np.dtype[np.bool_]] | None]:
    """Values of a float64 array, whatever stands at nulls, and where it is not null; None for everywhere."""
    count, offset = len(chunk), chunk.offset
    bitmap, data = chunk.buffers()
    if data is None or count == 0:
        return np.full(count, np.nan), np.zeros(count, dtype=np.bool_)
    values = np.frombuffer(data, dtype=np.float64, count=count, offset=offset * 8)
    if bitmap is None:
        return values, None
    bits = np.unpackbits(np.frombuffer(bitmap, dtype=np.uint8), bitorder="little")
    return values, bits[offset : offset + count].astype(np.bool_)


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
