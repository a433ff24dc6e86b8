"""How large a Parquet file's pages are once unpacked, from the headers of the pages themselves.

The footer states sizes too, but a reader allocates by the page headers, and a hostile file may let
the two differ.  Page headers are Thrift structs in the compact protocol; only their first fields
matter here, the rest is stepped over.
"""

from __future__ import annotations

from typing import Any

from server.errors import InvalidError

Metadata = Any  # pyarrow ships no types

# Wire types of the compact protocol.
_STOP, _TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(13)
_UNPACKED_SIZE, _PACKED_SIZE = 2, 3
_MAX_DEPTH = 8


def unpacked_bytes(metadata: Metadata, body: bytes, limit: int) -> int:
    """Sum of the unpacked sizes of all pages; stops adding once it is over the limit.

    Raises
    ------
    InvalidError
        A page lies outside the file, or its header cannot be read.
    """
    total = 0
    for group in range(metadata.num_row_groups):
        row_group = metadata.row_group(group)
        for index in range(row_group.num_columns):
            chunk = row_group.column(index)
            begin = chunk.data_page_offset
            if chunk.has_dictionary_page and chunk.dictionary_page_offset is not None:
                begin = min(begin, chunk.dictionary_page_offset)
            end = begin + chunk.total_compressed_size
            if not 0 <= begin <= end <= len(body):
                raise InvalidError("A Parquet column lies outside the file", code="parquet")
            while begin < end and total <= limit:
                header = _PageHeader(body, begin)
                total += header.unpacked
                begin = header.end + header.packed
    return total


class _PageHeader:
    """One page header, read from `body` at `begin`."""

    def __init__(self, body: bytes, begin: int) -> None:
        self._body = body
        self.end = begin
        self.unpacked = self.packed = -1
        try:
            self._struct(0)
        except (IndexError, RecursionError):
            raise InvalidError("A Parquet page header is cut off", code="parquet") from None
        if self.unpacked < 0 or self.packed < 0:
            raise InvalidError("A Parquet page has no size", code="parquet")

    def _byte(self) -> int:
        value = self._body[self.end]
        self.end += 1
        return value

    def _varint(self) -> int:
        value = shift = 0
        while True:
            byte = self._byte()
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value
            shift += 7
            if shift > 63:
                raise InvalidError("A Parquet page header holds no number where one is due", code="parquet")

    def _integer(self) -> int:
        coded = self._varint()
        return (coded >> 1) ^ -(coded & 1)

    def _struct(self, depth: int) -> None:
        if depth > _MAX_DEPTH:
            raise InvalidError("A Parquet page header is nested too deep", code="parquet")
        field = 0
        while (head := self._byte()) != _STOP:
            wire = head & 0x0F
            field = field + (head >> 4) if head >> 4 else self._integer()
            if depth == 0 and wire == _I32 and field in (_UNPACKED_SIZE, _PACKED_SIZE):
                size = self._integer()
                if field == _UNPACKED_SIZE:
                    self.unpacked = size
                else:
                    self.packed = size
            else:
                self._step_over(wire, depth)

    def _step_over(self, wire: int, depth: int) -> None:
        if wire in (_TRUE, _FALSE):
            return
        if wire in (_I16, _I32, _I64):
            self._varint()
        elif wire == _BYTE:
            self.end += 1
        elif wire == _DOUBLE:
            self.end += 8
        elif wire == _BINARY:
            self.end += self._varint()
        elif wire == _STRUCT:
            self._struct(depth + 1)
        else:  # page headers hold no lists, sets or maps
            raise InvalidError("A Parquet page header holds what it should not", code="parquet")
