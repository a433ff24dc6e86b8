"""Is a Parquet file what its structure says, and how large once unpacked?  Asked before it is opened.

The footer states sizes, but a reader allocates by the headers of the pages, and a hostile file may
let the two differ: so the pages are walked and their sizes added.  Fields are numbered as in
Parquet's parquet.thrift.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from server.errors import InvalidError, TooLargeError
from server.formats.columns import NAMES, check_names, check_size
from server.formats.thrift import Struct, ThriftReader, Value

_MAGIC = b"PAR1"
_MAX_FOOTER_BYTES = 256 * 1024
_MAX_FOOTER_VALUES = 20_000
_MAX_PAGE_HEADER_VALUES = 100
_MAX_PAGES = 100_000
# BOOLEAN, INT32, INT64, FLOAT, DOUBLE
_NUMBER_TYPES = frozenset({0, 1, 2, 4, 5})
_MAX_CODEC = 7


@dataclass(frozen=True, slots=True)
class _Leaf:
    name: str
    kind: int


def check(body: bytes, max_decoded_bytes: int | None) -> tuple[str, ...]:
    """Names of a Parquet file's columns.

    Raises
    ------
    InvalidError
        The file contradicts itself, or holds what is not a flat table of numbers.
    TooLargeError
        It unpacks to more than `max_decoded_bytes`.
    """
    footer = _footer(body)
    leaves = _leaves(_structs(footer.get(2)))
    groups = _structs(footer.get(4))
    rows = _count(footer.get(3))
    if rows != sum(_count(group.get(3)) for group in groups):
        raise _bad("its row groups do not add up")
    check_size(rows, len(leaves), max_decoded_bytes)
    unpacked = pages = 0
    for group in groups:
        chunks = _structs(group.get(1))
        if len(chunks) != len(leaves):
            raise _bad("a row group has other columns than the schema")
        for leaf, chunk in zip(leaves, chunks, strict=True):
            begin, end = _extent(leaf, chunk, _count(group.get(3)), len(body))
            while begin < end:
                size, begin = _page(body, begin)
                unpacked, pages = unpacked + size, pages + 1
                if max_decoded_bytes is not None and unpacked > max_decoded_bytes:
                    raise TooLargeError(f"The Parquet file unpacks to more than {max_decoded_bytes} bytes")
                if pages > _MAX_PAGES:
                    raise _bad("too many pages")
    return tuple(leaf.name for leaf in leaves)


def _bad(what: str) -> InvalidError:
    return InvalidError(f"Not readable Parquet: {what}", code="parquet")


def _structs(value: Value) -> list[Struct]:
    if not isinstance(value, list):
        raise _bad("a list is missing")
    found = [item for item in value if isinstance(item, dict)]
    if len(found) != len(value):
        raise _bad("a list holds what it should not")
    return found


def _count(value: Value) -> int:
    if not isinstance(value, int) or value < 0:
        raise _bad("a count is missing")
    return value


def _footer(body: bytes) -> Struct:
    if len(body) < 12 or not body.startswith(_MAGIC) or not body.endswith(_MAGIC):
        raise _bad("it does not begin and end as Parquet does")
    size = struct.unpack("<I", body[-8:-4])[0]
    if not 0 < size <= min(_MAX_FOOTER_BYTES, len(body) - 12):
        raise _bad("its footer is too long")
    return ThriftReader(body[-8 - size : -8], max_values=_MAX_FOOTER_VALUES).struct()


def _leaves(schema: list[Struct]) -> list[_Leaf]:
    if not schema or schema[0].get(5) != len(schema) - 1:
        raise InvalidError("The Parquet file is not a flat table", code="columns")
    if len(schema) - 1 > len(NAMES):
        raise InvalidError(f"{len(schema) - 1} columns; there are only {len(NAMES)} to choose from", code="columns")
    leaves: list[_Leaf] = []
    for element in schema[1:]:
        name, kind = element.get(4), element.get(1)
        if not isinstance(name, bytes):
            raise _bad("a column has no name")
        text = name.decode("utf-8", "replace")
        flat = not element.get(5) and element.get(3) in (0, 1)
        if not flat or not isinstance(kind, int) or kind not in _NUMBER_TYPES:
            raise InvalidError(f"Column {text[:40]!r} is not a column of numbers", code="columns")
        leaves.append(_Leaf(text, kind))
    names = tuple(leaf.name for leaf in leaves)
    if len(set(names)) != len(names):
        raise InvalidError("A column is there twice", code="columns")
    check_names(names)
    return leaves


def _extent(leaf: _Leaf, chunk: Struct, rows: int, size: int) -> tuple[int, int]:
    """Where a column's pages lie in the file."""
    meta = chunk.get(3)
    if not isinstance(meta, dict) or 1 in chunk or 8 in chunk or 9 in chunk:
        raise _bad("a column is encrypted or in another file")
    if meta.get(1) != leaf.kind or meta.get(3) != [leaf.name.encode()] or meta.get(5) != rows:
        raise _bad(f"column {leaf.name!r} is not what the schema says")
    if not 0 <= _count(meta.get(4)) <= _MAX_CODEC:
        raise _bad("an unknown compression")
    begin = _count(meta.get(9))
    if meta.get(11):
        begin = min(begin, _count(meta.get(11)))
    end = begin + _count(meta.get(7))
    if not len(_MAGIC) <= begin <= end <= size:
        raise _bad("a column lies outside the file")
    return begin, end


def _page(body: bytes, begin: int) -> tuple[int, int]:
    """Bytes that a page unpacks to, and where the next one begins."""
    reader = ThriftReader(body, begin, max_values=_MAX_PAGE_HEADER_VALUES)
    header = reader.struct()
    return _count(header.get(2)), reader.position + _count(header.get(3))
