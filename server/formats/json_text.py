"""JSON: ``{"columns": {"t": [...], ...}}`` with null where not sampled."""

from __future__ import annotations

import json
from types import NoneType
from typing import Any, cast

import numpy as np
import orjson

from server.errors import InvalidError
from server.formats.columns import NAMES, Columns, Floats, check_names, check_size, not_finite

_NUMBERS = frozenset({int, float, NoneType})


def read(body: bytes, *, max_decoded_bytes: int) -> Columns:
    """Columns of a JSON document."""
    # Every value but a list's first follows a comma: so many objects the parser will make.
    check_size(body.count(b","), 1, max_decoded_bytes)
    try:
        document = orjson.loads(body)
    except orjson.JSONDecodeError as error:
        _locate_not_finite(body)
        raise InvalidError(f"Not JSON: {error}", code="json") from None
    columns = _columns(document)
    # All that stands in quotes are the names: one that is there twice was dropped by the parser.
    if body.count(b'"') != 2 * (len(columns.values) + 1):
        raise InvalidError('A column, or "columns", is there twice', code="json")
    return columns


def _locate_not_finite(body: bytes) -> None:
    """Raise with the place of a NaN or infinity: many writers emit them as words that JSON does not have."""
    try:
        document = json.loads(body.decode())
    except (ValueError, RecursionError):
        return
    _columns(document)


def _columns(document: object) -> Columns:
    if not isinstance(document, dict) or set(cast("dict[str, Any]", document)) != {"columns"}:
        raise InvalidError('Expected an object with the one member "columns"', code="json")
    columns = cast("dict[str, Any]", document)["columns"]
    if not isinstance(columns, dict):
        raise InvalidError('"columns" is not an object', code="json")
    named = cast("dict[str, Any]", columns)
    check_names(named)
    return Columns({name: _column(name, named[name]) for name in NAMES if name in named})


def _column(name: str, values: object) -> Floats:
    if not isinstance(values, list):
        raise InvalidError(f"Column {name!r} is not a list", code="columns", column=name)
    listed = cast("list[Any]", values)
    if not set(map(type, listed)) <= _NUMBERS:
        row = next(index for index, value in enumerate(listed) if type(value) not in _NUMBERS)
        raise InvalidError(
            f"Column {name!r}, row {row} (from 0) is neither a number nor null", code="columns", column=name, row=row
        )
    try:
        column = np.array(listed, dtype=np.float64)  # None becomes NaN
    except OverflowError:
        row = next(index for index, value in enumerate(listed) if type(value) is int and abs(value) > 10**300)
        raise not_finite(name, row) from None
    bad = ~np.isfinite(column)
    if bad.any():
        for row in np.flatnonzero(bad):
            if listed[int(row)] is not None:
                raise not_finite(name, int(row))
    return column
