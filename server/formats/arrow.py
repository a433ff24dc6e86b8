"""Arrow's stream format; what its messages would unpack to is measured first."""

from __future__ import annotations

import struct
from typing import Any

import pyarrow as pa
from pyarrow import ipc

from server.errors import InvalidError
from server.formats.columns import NAMES, Columns, check_names, check_size
from server.formats.tables import column_of, is_numeric

# pyarrow ships no types.
Schema = Any
Message = Any
Buffer = Any

_BUFFER = struct.Struct("<qq")
# Positions of fields in Arrow's flatbuffer tables Message and RecordBatch (format/Message.fbs).
_MESSAGE_HEADER, _BATCH_LENGTH, _BATCH_BUFFERS, _BATCH_COMPRESSION = 2, 0, 2, 3


def read(body: bytes, *, max_decoded_bytes: int) -> Columns:
    """Columns of an Arrow stream."""
    try:
        messages = ipc.MessageReader.open_stream(pa.BufferReader(body))
        schema = ipc.read_schema(messages.read_next_message())
        _check(schema)
        batches: list[pa.RecordBatch] = []
        rows = unpacked = 0
        for message in messages:
            length, size = _measure(message)
            rows, unpacked = rows + length, unpacked + size
            check_size(rows, len(schema), max_decoded_bytes)
            check_size(unpacked // 8, 1, max_decoded_bytes)
            batch = ipc.read_record_batch(message, schema)
            batch.validate(full=True)
            batches.append(batch)
        table = pa.Table.from_batches(batches, schema)
        return Columns({name: column_of(name, table.column(name)) for name in schema.names})
    except (pa.ArrowException, OSError, ValueError, StopIteration, EOFError) as error:
        raise InvalidError(f"Not a readable Arrow stream: {str(error)[:200]}", code="arrow") from error


def _check(schema: Schema) -> None:
    if len(schema) > len(NAMES) or len(set(schema.names)) != len(schema):
        raise InvalidError("A column is there twice, or there are too many", code="columns")
    check_names(tuple(schema.names))
    for field in schema:
        if not is_numeric(field.type):
            raise InvalidError(f"Column {field.name!r} holds {str(field.type)[:40]}, not numbers", code="columns")


def _measure(message: Message) -> tuple[int, int]:
    """Rows of a record batch, and the bytes its buffers unpack to."""
    if message.type != "record batch":
        raise InvalidError(f"A {message.type} message: send plain columns", code="arrow")
    body_size = 0 if message.body is None else message.body.size
    try:
        metadata = message.metadata.to_pybytes()
        header = _table(metadata, _field(metadata, _table(metadata, 0), _MESSAGE_HEADER))
        length = _field(metadata, header, _BATCH_LENGTH)
        rows = struct.unpack_from("<q", metadata, length)[0] if length else 0
        buffers = _field(metadata, header, _BATCH_BUFFERS)
        if not _field(metadata, header, _BATCH_COMPRESSION) or not buffers or not body_size:
            return rows, body_size
        vector = _table(metadata, buffers)
        count = struct.unpack_from("<I", metadata, vector)[0]
        sizes = [
            _unpacked(message.body, *_BUFFER.unpack_from(metadata, vector + 4 + index * _BUFFER.size))
            for index in range(count)
        ]
    except struct.error as error:
        raise InvalidError("An Arrow message is cut off", code="arrow") from error
    return rows, sum(sizes)


def _table(data: bytes, at: int) -> int:
    """Where the offset at `at` points."""
    return at + struct.unpack_from("<I", data, at)[0]


def _field(data: bytes, table: int, index: int) -> int:
    """Position of a table's field; 0 where it is left out."""
    vtable = table - struct.unpack_from("<i", data, table)[0]
    if vtable < 0:
        raise struct.error
    size = struct.unpack_from("<H", data, vtable)[0]
    slot = 4 + 2 * index
    offset = struct.unpack_from("<H", data, vtable + slot)[0] if slot + 2 <= size else 0
    return table + offset if offset else 0


def _unpacked(body: Buffer, offset: int, length: int) -> int:
    """A packed buffer begins with its unpacked size; -1 says that it is not packed after all."""
    if length < 8:
        return max(length, 0)
    if offset < 0 or offset + 8 > body.size:
        raise struct.error
    size = struct.unpack("<q", body.slice(offset, 8).to_pybytes())[0]
    return length if size < 0 else size
