"""Arrow's stream format, read with bounds at every step.

Arrow's own reader takes offsets in a stream's metadata on trust and ends the process where they lie (the fuzzer in
tests/faults shows it).  A stream of plain numbers needs little of it: so the metadata are walked here, what the
buffers would unpack to is measured before anything is made, and only the packed blocks go to the libraries.  Fields
are numbered as in Arrow's format/Message.fbs and Schema.fbs.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from server.errors import InvalidError, TooLargeError
from server.formats.columns import NAMES, Columns, Floats, check_names, check_size, not_finite
from server.formats.encoding import unpack

_CONTINUATION = 0xFFFFFFFF
_MAX_METADATA_BYTES = 256 * 1024
_MAX_BATCHES = 10_000
_BUFFER = struct.Struct("<qq")
_SCHEMA, _RECORD_BATCH = 1, 3
_HEADER_KINDS = {2: "dictionary batch", 4: "tensor", 5: "sparse tensor"}
_NULL, _INT, _FLOAT, _BOOL = 1, 2, 3, 6
_FLOATS = {0: np.dtype("<f2"), 1: np.dtype("<f4"), 2: np.dtype("<f8")}
_LZ4, _ZSTD = 0, 1


@dataclass(frozen=True, slots=True)
class _Field:
    """A column of the schema; `dtype` None for one of nothing but nulls."""

    name: str
    dtype: np.dtype[np.generic] | None
    is_flag: bool = False

    @property
    def buffers(self) -> int:
        return 0 if self.dtype is None else 2


@dataclass(frozen=True, slots=True)
class _Batch:
    """A record batch: rows, where its buffers lie in `body`, and how they are packed."""

    rows: int
    buffers: list[tuple[int, int]]
    codec: int | None
    body: memoryview


def read(body: bytes, *, max_decoded_bytes: int) -> Columns:
    """Columns of an Arrow stream."""
    try:
        fields, batches = _stream(memoryview(body), max_decoded_bytes)
        columns = {field.name: np.empty(sum(batch.rows for batch in batches)) for field in fields}
        first = 0
        for batch in batches:
            at = 0
            for field in fields:
                buffers = batch.buffers[at : at + field.buffers]
                _fill(columns[field.name][first : first + batch.rows], field, batch, buffers, first)
                at += field.buffers
            first += batch.rows
    except struct.error:
        raise _bad("a message is cut off") from None
    return Columns(columns)


def _bad(what: str) -> InvalidError:
    return InvalidError(f"Not a readable Arrow stream: {what}", code="arrow")


def _stream(data: memoryview, max_decoded_bytes: int) -> tuple[list[_Field], list[_Batch]]:
    """The schema's columns and all batches, none of them unpacked yet."""
    fields: list[_Field] | None = None
    batches: list[_Batch] = []
    at = rows = unpacked = 0
    while at < len(data):
        (size,) = struct.unpack_from("<I", data, at)
        at += 4
        if size == _CONTINUATION:  # streams of before 2020 have none
            (size,) = struct.unpack_from("<I", data, at)
            at += 4
        if size == 0:
            break
        if size > min(_MAX_METADATA_BYTES, len(data) - at):
            raise _bad(f"a message of {size} bytes does not fit")
        metadata = data[at : at + size]
        message = _table(metadata, 0)
        kind, body_size = _number(metadata, message, 1, "<B"), _number(metadata, message, 3, "<q")
        at += size
        if not 0 <= body_size <= len(data) - at:
            raise _bad("a message's body is cut off")
        header = _child(metadata, message, 2)
        if kind == _SCHEMA and fields is None:
            fields = _schema(metadata, header)
        elif kind == _RECORD_BATCH and fields is not None:
            if len(batches) == _MAX_BATCHES:
                raise TooLargeError(f"A stream of more than {_MAX_BATCHES} batches")
            batch = _batch(metadata, header, data[at : at + body_size], sum(field.buffers for field in fields))
            rows, unpacked = rows + batch.rows, unpacked + _measure(batch)
            check_size(rows, len(fields), max_decoded_bytes)
            check_size(unpacked // 8, 1, max_decoded_bytes)
            batches.append(batch)
        else:
            raise _bad(f"a {_HEADER_KINDS.get(kind, 'message that is')} out of place: send plain columns")
        at += body_size
    if fields is None:
        raise _bad("it has no schema")
    return fields, batches


# --- flatbuffers


def _table(data: memoryview, at: int) -> int:
    """Where the offset at `at` points."""
    return at + struct.unpack_from("<I", data, at)[0]


def _field(data: memoryview, table: int, index: int) -> int:
    """Position of a table's field; 0 where it is left out."""
    vtable = table - struct.unpack_from("<i", data, table)[0]
    if vtable < 0:
        raise struct.error
    size = struct.unpack_from("<H", data, vtable)[0]
    slot = 4 + 2 * index
    offset = struct.unpack_from("<H", data, vtable + slot)[0] if slot + 2 <= size else 0
    return table + offset if offset else 0


def _number(data: memoryview, table: int, index: int, kind: str) -> int:
    """A scalar; 0 where it is left out."""
    at = _field(data, table, index)
    return int(struct.unpack_from(kind, data, at)[0]) if at else 0


def _child(data: memoryview, table: int, index: int) -> int:
    """A table or vector that must be there."""
    at = _field(data, table, index)
    if not at:
        raise _bad("a part of a message is missing")
    return _table(data, at)


def _vector(data: memoryview, at: int, item_bytes: int) -> tuple[int, int]:
    """Where a vector's items begin, and how many there are; all of them lie in the message."""
    (count,) = struct.unpack_from("<I", data, at)
    if count * item_bytes > len(data) - at - 4:
        raise struct.error
    return at + 4, count


# --- schema and batches


def _schema(data: memoryview, schema: int) -> list[_Field]:
    if _number(data, schema, 0, "<h"):
        raise _bad("its numbers are big endian")
    begin, count = _vector(data, _child(data, schema, 1), 4)
    if count > len(NAMES):
        raise InvalidError("A column is there twice, or there are too many", code="columns")
    fields = [_column(data, _table(data, begin + 4 * index)) for index in range(count)]
    names = tuple(field.name for field in fields)
    if len(set(names)) != len(names):
        raise InvalidError("A column is there twice, or there are too many", code="columns")
    check_names(names)
    return fields


def _column(data: memoryview, field: int) -> _Field:
    begin, size = _vector(data, _child(data, field, 0), 1)
    name = bytes(data[begin : begin + size]).decode("utf-8", "replace")
    kind = _number(data, field, 2, "<B")
    if _field(data, field, 4):
        kind = 0  # a dictionary of values
    if kind == _NULL:
        return _Field(name, None)
    if kind == _BOOL:
        return _Field(name, np.dtype("u1"), is_flag=True)
    dtype = None
    if kind in (_INT, _FLOAT):
        described = _child(data, field, 3)
        if kind == _FLOAT:
            dtype = _FLOATS.get(_number(data, described, 0, "<h"))
        else:
            bits, signed = _number(data, described, 0, "<i"), _number(data, described, 1, "<B")
            dtype = np.dtype(f"<{'i' if signed else 'u'}{bits // 8}") if bits in (8, 16, 32, 64) else None
    if dtype is None:
        raise InvalidError(f"Column {name[:40]!r} does not hold numbers", code="columns", column=name[:40])
    return _Field(name, dtype)


def _batch(data: memoryview, header: int, body: memoryview, expected: int) -> _Batch:
    rows = _number(data, header, 0, "<q")
    if rows < 0:
        raise _bad(f"a batch of {rows} rows")
    begin, count = _vector(data, _child(data, header, 2), _BUFFER.size)
    if count != expected:
        raise _bad(f"a batch has {count} buffers, its columns {expected}")
    buffers = [_BUFFER.unpack_from(data, begin + index * _BUFFER.size) for index in range(count)]
    for offset, length in buffers:
        if offset < 0 or length < 0 or offset + length > len(body):
            raise _bad("a buffer lies outside its message")
    codec = None
    if _field(data, header, 3):
        codec = _number(data, _child(data, header, 3), 0, "<b")
        if codec not in (_LZ4, _ZSTD):
            raise _bad("buffers are packed in an unknown way")
    return _Batch(rows, buffers, codec, body)


def _measure(batch: _Batch) -> int:
    """Bytes that a batch's buffers unpack to; what is packed stays beside them and counts too."""
    if batch.codec is None:
        return len(batch.body)
    return len(batch.body) + sum(_unpacked_size(batch, offset, length) for offset, length in batch.buffers)


def _unpacked_size(batch: _Batch, offset: int, length: int) -> int:
    """A packed buffer begins with its unpacked size; -1 says that it is not packed after all."""
    if length < 8:
        return length
    (size,) = struct.unpack_from("<q", batch.body, offset)
    if size < -1:
        raise _bad("a buffer of negative size")
    return length - 8 if size < 0 else int(size)


def _bytes(batch: _Batch, buffer: tuple[int, int]) -> bytes | memoryview:
    """A buffer, unpacked."""
    offset, length = buffer
    data = batch.body[offset : offset + length]
    if batch.codec is None or length < 8:
        return data
    size = _unpacked_size(batch, offset, length)
    if struct.unpack_from("<q", data)[0] < 0:
        return data[8:]
    if batch.codec == _ZSTD:
        unpacked = unpack(bytes(data[8:]), "zstd", max_bytes=size)
    else:
        try:
            unpacked = pa.Codec("lz4").decompress(pa.py_buffer(data[8:]), decompressed_size=size, asbytes=True)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise _bad(str(error)[:100]) from None
    if len(unpacked) != size:
        raise _bad("a buffer unpacks to another size than it says")
    return unpacked


def _fill(out: Floats, field: _Field, batch: _Batch, buffers: list[tuple[int, int]], first: int) -> None:
    """Put a batch's column where it belongs, NaN for null; a NaN or infinity that was sent is refused."""
    rows = batch.rows
    if field.dtype is None or rows == 0:
        out.fill(np.nan)
        return
    validity, data = (_bytes(batch, buffer) for buffer in buffers)
    if field.is_flag:
        out[:] = _bits(data, rows)
    else:
        if len(data) < rows * field.dtype.itemsize:
            raise _bad(f"column {field.name!r} has fewer values than rows")
        out[:] = np.frombuffer(data, field.dtype, rows)
    del data  # as large as the column
    bad = np.isfinite(out)
    np.logical_not(bad, out=bad)
    if validity:
        valid = _bits(validity, rows)
        out[~valid] = np.nan
        bad &= valid
    if bad.any():
        raise not_finite(field.name, first + int(np.argmax(bad)))


def _bits(data: bytes | memoryview, rows: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    if len(data) * 8 < rows:
        raise _bad("a bitmap is shorter than its rows")
    return np.unpackbits(np.frombuffer(data, np.uint8), count=rows, bitorder="little").astype(np.bool_)
