"""Thrift structs in the compact protocol, as Parquet writes its footer and page headers.

Parquet's own readers take a file's structure on trust in places and end the process when it lies;
so a file from outside is first looked at with `ThriftReader`, which can only raise.
"""

from __future__ import annotations

from typing import TypeAlias, Union

from server.errors import InvalidError

Value: TypeAlias = Union[int, bytes, float, "list[Value]", "dict[int, Value]", None]
Struct: TypeAlias = dict[int, Value]

# Wire types of the compact protocol.
_STOP, _TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(13)
_MAX_DEPTH = 12


class Long(int):
    """A number that is written as 64 bits, not 32."""


Writable: TypeAlias = Union[int, bytes, "list[Writable]", "dict[int, Writable]"]
_WIRES: dict[type, int] = {int: _I32, Long: _I64, bytes: _BINARY, list: _LIST, dict: _STRUCT}


def varint(value: int) -> bytes:
    """Seven bits a byte, the lowest first."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def packed(fields: dict[int, Writable]) -> bytes:
    """A struct, whose field numbers rise by less than 16; lists hold values of one type, and no number is negative."""
    out = bytearray()
    _pack(fields, out)
    return bytes(out)


def _pack(fields: dict[int, Writable], out: bytearray) -> None:
    before = 0
    for number, value in fields.items():
        out.append((number - before) << 4 | _WIRES[type(value)])
        _pack_value(value, out)
        before = number
    out.append(_STOP)


def _pack_value(value: Writable, out: bytearray) -> None:
    if isinstance(value, int):
        if value < 0x40:
            out.append(value << 1)
        else:
            out += varint(value << 1)
    elif isinstance(value, dict):
        _pack(value, out)
    elif isinstance(value, bytes):
        out += varint(len(value))
        out += value
    else:
        wire = _WIRES[type(value[0])] if value else _STRUCT
        out += bytes([len(value) << 4 | wire]) if len(value) < 15 else bytes([0xF0 | wire]) + varint(len(value))
        for item in value:
            _pack_value(item, out)


class ThriftReader:
    """Reads structs from `data`, beginning at `position`.

    Parameters
    ----------
    max_values : int
        How many values all structs together may hold.
    """

    def __init__(self, data: bytes, position: int = 0, *, max_values: int) -> None:
        self._data = data
        self._values_left = max_values
        self.position = position

    def struct(self) -> Struct:
        """The next struct, by field number; `position` is then behind it."""
        try:
            return self._struct(0)
        except IndexError:
            raise InvalidError("Not readable Parquet: a header is cut off", code="parquet") from None

    def _bad(self, what: str) -> InvalidError:
        return InvalidError(f"Not readable Parquet: {what} in a header", code="parquet")

    def _byte(self) -> int:
        value = self._data[self.position]
        self.position += 1
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
                raise self._bad("a number without end")

    def _integer(self) -> int:
        coded = self._varint()
        return (coded >> 1) ^ -(coded & 1)

    def _bytes(self, count: int) -> bytes:
        taken = self._data[self.position : self.position + count]
        if len(taken) < count:
            raise IndexError
        self.position += count
        return taken

    def _struct(self, depth: int) -> Struct:
        if depth > _MAX_DEPTH:
            raise self._bad("too deep a nesting")
        fields: Struct = {}
        number = 0
        while (head := self._byte()) != _STOP:
            step, wire = head >> 4, head & 0x0F
            number = number + step if step else self._integer()
            if number in fields:
                raise self._bad("a field twice")
            fields[number] = int(wire == _TRUE) if wire in (_TRUE, _FALSE) else self._value(wire, depth)
        return fields

    def _value(self, wire: int, depth: int) -> Value:
        if depth > _MAX_DEPTH:
            raise self._bad("too deep a nesting")
        self._values_left -= 1
        if self._values_left < 0:
            raise self._bad("too many values")
        if wire in (_I16, _I32, _I64):
            return self._integer()
        if wire in (_TRUE, _FALSE, _BYTE):  # in a list, flags take a byte
            return self._byte()
        if wire == _BINARY:
            return self._bytes(self._varint())
        if wire == _DOUBLE:
            self._bytes(8)
            return None  # no field that matters here is one
        if wire in (_LIST, _SET):
            head = self._byte()
            count = self._varint() if head >> 4 == 15 else head >> 4
            return [self._value(head & 0x0F, depth + 1) for _ in range(count)]
        if wire == _STRUCT:
            return self._struct(depth + 1)
        raise self._bad("an unknown type")  # Parquet's structs hold no maps
