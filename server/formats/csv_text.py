"""CSV: a header, comma and decimal point, nothing where not sampled."""

from __future__ import annotations

import pyarrow as pa
from pyarrow import csv

from server.errors import InvalidError
from server.formats.columns import NAMES, Columns, check_names, check_size
from server.formats.lines import check_lines, first_line, lines_of
from server.formats.tables import CSV_BLOCK_BYTES, Filled

_MAX_HEADER_BYTES = 4096
_BOM = b"\xef\xbb\xbf"


def header_of(body: bytes) -> tuple[str, ...]:
    """Column names of the first line."""
    line = first_line(body, _MAX_HEADER_BYTES).removeprefix(_BOM)
    return tuple(name.strip().strip('"') for name in line.decode("utf-8", "replace").strip().split(","))


def read(body: bytes, *, max_decoded_bytes: int | None) -> Columns:
    """Columns of a CSV text."""
    names = header_of(body)
    if len(set(names)) != len(names) or len(names) > len(NAMES):
        raise InvalidError("A column is there twice, or there are too many", code="columns")
    check_names(names)
    lines = lines_of(body)
    check_size(lines, len(names), max_decoded_bytes)
    check_lines(body, "csv")
    filled = {name: Filled(name, lines) for name in names}
    try:
        blocks = csv.open_csv(
            pa.BufferReader(body),
            # One thread: only then can an error name its row.
            read_options=csv.ReadOptions(
                use_threads=False, block_size=CSV_BLOCK_BYTES, column_names=list(names), skip_rows=1
            ),
            parse_options=csv.ParseOptions(newlines_in_values=False),
            convert_options=csv.ConvertOptions(
                column_types=dict.fromkeys(names, pa.float64()),
                null_values=[""],
                strings_can_be_null=True,
                check_utf8=True,
            ),
        )
        for block in blocks:
            for name, column in filled.items():
                column.add(block.column(name))
    except pa.ArrowInvalid as error:
        raise InvalidError(f"Not readable CSV: {str(error)[:200]}", code="csv") from error
    return Columns({name: column.values for name, column in filled.items()})
