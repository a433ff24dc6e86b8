"""Arrow columns as float64."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from server.errors import InvalidError
from server.formats.columns import Columns, Floats, not_finite

# pyarrow ships no types.
DataType = Any
Column = Any
Table = Any


def is_numeric(kind: DataType) -> bool:
    """Whether a type holds numbers, flags or nothing at all."""
    return bool(
        pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind) or pa.types.is_null(kind)
    )


def column_of(name: str, column: Column) -> Floats:
    """Values with NaN for null; a NaN or infinity that was sent is refused."""
    if not is_numeric(column.type):
        raise InvalidError(f"Column {name!r} holds {str(column.type)[:40]}, not numbers", code="columns", column=name)
    numbers = column.cast(pa.uint8()) if pa.types.is_boolean(column.type) else column
    values: Floats = np.asarray(numbers.cast(pa.float64(), safe=False).to_numpy(), dtype=np.float64)
    bad = ~np.isfinite(values)
    if bad.any():
        bad &= np.asarray(column.is_valid().to_numpy(), dtype=np.bool_)
        if bad.any():
            raise not_finite(name, int(np.argmax(bad)))
    return values


def table_of(columns: Columns) -> Table:
    """An Arrow table with null where not sampled."""
    arrays = [pa.array(values, from_pandas=True) for values in columns.values.values()]
    return pa.Table.from_arrays(arrays, names=list(columns.values))
