"""Parquet in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from nav_core.typing import Floats
from server.errors import InvalidError
from server.formats.columns import Columns
from server.formats.parquet_check import check
from server.formats.tables import column_of


def read_columns(body: bytes, names: Sequence[str]) -> dict[str, Floats]:
    """The clock and some columns of a file of `parquet_write`, those that it has; NaN where not sampled."""
    file = pq.ParquetFile(pa.BufferReader(body))
    wanted = ["t", *(name for name in file.schema_arrow.names if name in names)]
    table = file.read(columns=wanted, use_threads=False)
    return {name: np.asarray(table.column(name).to_numpy(), dtype=np.float64) for name in wanted}


def read(body: bytes, *, max_decoded_bytes: int | None) -> Columns:
    """Columns of a Parquet file that anybody may have sent: looked through before it is opened."""
    names = check(body, max_decoded_bytes)
    try:
        file = pq.ParquetFile(pa.BufferReader(body))
        # One after the other: what is large is there twice for a column only.
        return Columns({name: _column(file, name) for name in names})
    except (pa.ArrowException, OSError, ValueError) as error:
        raise _bad(error) from error


def _column(file: pq.ParquetFile, name: str) -> Floats:
    table = file.read(columns=[name], use_threads=False)
    # The library may understand the names in the file's schema otherwise than we did.
    if table.column_names != [name]:
        raise ValueError(f"column {name!r} cannot be found by its name")
    return column_of(name, table.column(0))


def read_stored(body: bytes) -> Columns:
    """Columns of a file that `write` made; whoever needs to know that it is whole compares their hash."""
    try:
        table = pq.ParquetFile(pa.BufferReader(body)).read(use_threads=False)
        return Columns({name: column_of(name, table.column(name)) for name in table.column_names})
    except (pa.ArrowException, OSError, ValueError) as error:
        raise _bad(error) from error


def _bad(error: Exception) -> InvalidError:
    return InvalidError(f"Not readable Parquet: {str(error)[:200]}", code="parquet")
