"""CSV: a header, comma and decimal point, nothing where not sampled."""

from __future__ import annotations

import pyarrow as pa
from pyarrow import csv

from server.errors import InvalidError
from server.formats.columns import NAMES, Columns, check_names, check_size, lines_of
from server.formats.tables import column_of

_MAX_HEADER_BYTES = 4096
_BOM = b"\xef\xbb\xbf"


def header_of(body: bytes) -> tuple[str, ...]:
    """Column names of the first line."""
    line = body[:_MAX_HEADER_BYTES].removeprefix(_BOM).split(b"\n", 1)[0]
    return tuple(name.strip().strip('"') for name in line.decode("utf-8", "replace").strip().split(","))


def read(body: bytes, *, max_decoded_bytes: int | None) -> Columns:
    """Columns of a CSV text."""
    names = header_of(body)
    if len(set(names)) != len(names) or len(names) > len(NAMES):
        raise InvalidError("A column is there twice, or there are too many", code="columns")
    check_names(names)
    check_size(lines_of(body), len(names), max_decoded_bytes)
    try:
        table = csv.read_csv(
            pa.BufferReader(body),
            # One block and one thread: only then can an error name its row.
            read_options=csv.ReadOptions(
                use_threads=False, block_size=max(len(body), 1), column_names=list(names), skip_rows=1
            ),
            parse_options=csv.ParseOptions(newlines_in_values=False),
            convert_options=csv.ConvertOptions(
                column_types=dict.fromkeys(names, pa.float64()),
                null_values=[""],
                strings_can_be_null=True,
                check_utf8=True,
            ),
        )
    except pa.ArrowInvalid as error:
        raise InvalidError(f"Not readable CSV: {str(error)[:200]}", code="csv") from error
    return Columns({name: column_of(name, table.column(name)) for name in names})
