"""Parquet in and out.  Whatever a file claims, its pages are measured before they are unpacked."""

from __future__ import annotations

import io

import pyarrow as pa
import pyarrow.parquet as pq

from server.errors import InvalidError
from server.formats.columns import NAMES, Columns, check_names, check_size
from server.formats.parquet_pages import unpacked_bytes
from server.formats.tables import column_of, table_of

_PHYSICAL_TYPES = frozenset({"DOUBLE", "FLOAT", "INT32", "INT64", "BOOLEAN"})
# The footer is unpacked before it can be looked at.
_MAX_FOOTER_STRING = 1 << 20
_MAX_FOOTER_LIST = 10_000


def write(columns: Columns) -> bytes:
    """Columns as Parquet: zstd, null where not sampled, the same bytes for the same columns and library."""
    sink = io.BytesIO()
    pq.write_table(
        table_of(columns), sink, compression="zstd", compression_level=3, write_statistics=False, store_schema=False
    )
    return sink.getvalue()


def read(body: bytes, *, max_decoded_bytes: int | None) -> Columns:
    """Columns of a Parquet file."""
    try:
        file = pq.ParquetFile(
            pa.BufferReader(body),
            thrift_string_size_limit=_MAX_FOOTER_STRING,
            thrift_container_size_limit=_MAX_FOOTER_LIST,
        )
        names = _check(file, body, max_decoded_bytes)
        table = file.read(use_threads=False)
        return Columns({name: column_of(name, table.column(name)) for name in names})
    except (pa.ArrowException, OSError) as error:
        raise InvalidError(f"Not a readable Parquet file: {str(error)[:200]}", code="parquet") from error


def _check(file: pq.ParquetFile, body: bytes, max_decoded_bytes: int | None) -> tuple[str, ...]:
    metadata = file.metadata
    if metadata.num_columns > len(NAMES):
        raise InvalidError(
            f"{metadata.num_columns} columns; there are only {len(NAMES)} to choose from", code="columns"
        )
    names: list[str] = []
    for index in range(metadata.num_columns):
        column = metadata.schema.column(index)
        if column.physical_type not in _PHYSICAL_TYPES or column.max_repetition_level or "." in column.path:
            raise InvalidError(f"Column {column.path[:40]!r} is not a column of numbers", code="columns")
        names.append(str(column.name))
    if len(set(names)) != len(names):
        raise InvalidError("A column is there twice", code="columns")
    check_names(tuple(names))
    check_size(metadata.num_rows, metadata.num_columns, max_decoded_bytes)
    if max_decoded_bytes is not None:
        check_size(unpacked_bytes(metadata, body, max_decoded_bytes) // 8, 1, max_decoded_bytes)
    return tuple(names)
