"""JSON: ``{"columns": {"t": [...], ...}}`` with null where not sampled."""

from __future__ import annotations

import re
from types import NoneType
from typing import Any, cast

import numpy as np
import orjson

from server.errors import InvalidError
from server.formats.columns import NAMES, Columns, Floats, check_names, check_size, not_finite

_NUMBERS = frozenset({int, float, NoneType})
_NUMBER_BYTES, _NULL_BYTES = 32, 16
"""What a value takes while it is read: its place in a list, the object, and its place in a column."""
_MAX_MARKS = 1000
"""Quotes, and lists and objects, of a body; an honest one has less than a tenth of that."""
_MAX_NAME_BYTES = 100
_WORDS = re.compile(rb"NaN|Infinity")
_NAME_BEFORE = re.compile(rb'"([^"\\]*)"\s*:\s*\Z')


def read(body: bytes, *, max_decoded_bytes: int) -> Columns:
    """Columns of a JSON document."""
    _check_parts(body, max_decoded_bytes)
    try:
        document = orjson.loads(body)
    except orjson.JSONDecodeError as error:
        _locate_not_finite(body, error)
        raise InvalidError(f"Not JSON: {error}", code="json") from None
    columns = _columns(document)
    # All that stands in quotes are the names: one that is there twice was dropped by the parser.
    if body.count(b'"') != 2 * (len(columns.values) + 1):
        raise InvalidError('A column, or "columns", is there twice', code="json")
    return columns


def _check_parts(body: bytes, max_decoded_bytes: int) -> None:
    """Raise before the parser makes objects that would not fit: each value but a list's first follows a comma."""
    commas = body.count(b",")
    if commas * _NUMBER_BYTES > max_decoded_bytes:
        # A null in a text between quotes has a comma too, and so does not hide a number.
        nulls = body.count(b",null") + body.count(b", null")
        told = commas * _NULL_BYTES + (commas - nulls) * (_NUMBER_BYTES - _NULL_BYTES)
        check_size(told // 8, 1, max_decoded_bytes)
    if max(body.count(b'"'), body.count(b"[") + body.count(b"{")) > _MAX_MARKS:
        raise InvalidError("More names, lists or objects than columns could have", code="json")
    begin = -1
    while (begin := body.find(b'"', begin + 1)) >= 0:
        end = body.find(b'"', begin + 1)
        if not 0 <= end - begin <= _MAX_NAME_BYTES:
            raise InvalidError(f"A name without end, or of more than {_MAX_NAME_BYTES} bytes", code="json")
        begin = end


def _locate_not_finite(body: bytes, error: orjson.JSONDecodeError) -> None:
    """Raise with the place of a NaN or infinity: many writers emit them as words that JSON does not have."""
    at = error.pos
    if not body.isascii() or not ("infinity" in error.msg or _WORDS.match(body, at)):
        return
    begin = body.rfind(b"[", 0, at)
    name = _NAME_BEFORE.search(body, max(0, begin - 2 * _MAX_NAME_BYTES), max(0, begin))
    if name is not None:
        raise not_finite(name[1].decode(), body.count(b",", begin, at))


def _columns(document: object) -> Columns:
    if not isinstance(document, dict) or set(cast("dict[str, Any]", document)) != {"columns"}:
        raise InvalidError('Expected an object with the one member "columns"', code="json")
    columns = cast("dict[str, Any]", document)["columns"]
    if not isinstance(columns, dict):
        raise InvalidError('"columns" is not an object', code="json")
    named = cast("dict[str, Any]", columns)
    check_names(named)
    # Each list is let go when it has become a column.
    return Columns({name: _column(name, named.pop(name)) for name in NAMES if name in named})


def _column(name: str, values: object) -> Floats:
    if not isinstance(values, list):
        raise InvalidError(f"Column {name!r} is not a list", code="columns", column=name)
    listed = cast("list[Any]", values)
    if not set(map(type, listed)) <= _NUMBERS:
        row = next(index for index, value in enumerate(listed) if type(value) not in _NUMBERS)
        raise InvalidError(
            f"Column {name!r}, row {row} (from 0) is neither a number nor null", code="columns", column=name, row=row
        )
    return np.array(listed, dtype=np.float64)  # None becomes NaN; the parser makes no other, and no infinity
