"""Large bodies of the formats that are bytes."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import zstandard
from pyarrow import ipc

from server.formats import arrow, compact
from server.formats.codec8e import _crc16
from server.formats.columns import NAMES

Shape = Callable[[int], bytes]
_FORCE = ("t", "fx", "fy", "fz")
_PLAIN = tuple(name for name in NAMES if name not in ("fix", "ignition"))

# --- the compact batch


def _block(rows: int, columns: tuple[int, ...], kind: int, steps: int, *, fill: bytes) -> bytes:
    body = compact.BLOCK.pack(rows, len(columns), steps, 0, 0, 1 if steps == compact.EVEN else 0, 0)
    body += b"".join(compact.COLUMN.pack(number, kind, 0, 0, 1.0, 0.0) for number in columns)
    for size, content in ((rows * steps, b"\0"), *(((rows * kind), fill) for _ in columns)):
        data = (content * (size // len(content) + 1))[:size]
        body += data + bytes(-size % compact.ALIGNMENT)
    return body


def _compact(
    columns: tuple[int, ...], kind: int, steps: int, *, blocks: int = 1, fill: bytes = b"\0", split: bool = False
) -> Shape:
    """As many rows as the limits allow; `split`: each block with columns of its own."""

    def make(size: int) -> bytes:
        rows = min(size // (8 * (len(columns) + 1)), size // (kind * len(columns) + steps)) - 128
        each = [columns[index::blocks] for index in range(blocks)] if split else [columns] * blocks
        made = [_block(max(1, rows // blocks), some, kind, steps, fill=fill) for some in each]
        body = b"".join(made)
        length = compact.HEAD.size + len(body) + 4
        whole = compact.HEAD.pack(compact.MAGIC, 1, blocks, 0, length, 1000) + body
        return whole + struct.pack("<I", zlib.crc32(whole))

    return make


_EVERY = tuple(range(1, len(NAMES)))
_COMPACT: dict[str, Shape] = {
    "one column, even": _compact((10,), 1, compact.EVEN),
    "one column of 32 bits": _compact((10,), 4, compact.STEPS_32),
    "one column, nothing sampled": _compact((10,), 1, compact.EVEN, fill=b"\x80"),
    "one column, half sampled": _compact((10,), 1, compact.EVEN, fill=b"\x80\x01"),
    "one column in eight blocks": _compact((10,), 1, compact.EVEN, blocks=8),
    "three columns, 16 bits": _compact((1, 2, 3), 2, compact.STEPS_16),
    "all columns": _compact(_EVERY, 1, compact.EVEN),
    "all columns, half sampled": _compact(_EVERY, 1, compact.EVEN, fill=b"\x80\0"),
    "all columns, of 32 bits": _compact(_EVERY, 4, compact.STEPS_32),
    "all columns in eight blocks": _compact(_EVERY, 1, compact.EVEN, blocks=8),
    "seven blocks of their own columns": _compact(_EVERY, 2, compact.STEPS_16, blocks=7, split=True),
    "two blocks of their own column": _compact((10, 13), 1, compact.EVEN, blocks=2, split=True),
    "values out of range": _compact((11, 12), 4, compact.EVEN, fill=b"\x7f"),
    "padding": lambda size: _compact((10,), 1, compact.EVEN)(4096)[:-4] + bytes(size - 8192),
}

# --- Codec 8 Extended

_CODEC_BYTES = 2 * 1024 * 1024 - 64


def _avl(record: bytes, count: int) -> bytes:
    data = bytes([0x8E, count]) + record * count + bytes([count])
    return struct.pack(">II", 0, len(data)) + data + struct.pack(">I", _crc16(memoryview(data)))


_POSITION = struct.pack(">QBiihHBH", 1_772_366_400_000, 1, 119_400_000, 454_100_000, 12, 90, 8, 36)
_NOTHING = _POSITION + struct.pack(">HHHHHHH", 0, 0, 0, 0, 0, 0, 0)
_TRACE = struct.pack(">6h", 29, 63, 1011, 30, 60, 1011) * 5000
_SHORT_TRACE = struct.pack(">3h", 29, 63, 1011) * 100


def _with(values: bytes, kinds: tuple[int, int, int, int, int]) -> bytes:
    """A record with values of 1, 2, 4, 8 and any number of bytes, all in `values` one after the other."""
    return _POSITION + struct.pack(">HH", 0, sum(kinds)) + values


def _bytes_inputs(count: int) -> bytes:
    inputs = b"".join(struct.pack(">HB", 1000 + index, 1) for index in range(count))
    return _with(struct.pack(">H", count) + inputs + struct.pack(">HHHH", 0, 0, 0, 0), (count, 0, 0, 0, 0))


def _trace_record(trace: bytes) -> bytes:
    return _with(struct.pack(">HHHHHHH", 0, 0, 0, 0, 1, 257, len(trace)) + trace, (0, 0, 0, 0, 1))


def _codec(packet: bytes, *, digits: str | None = None, begin: bytes = b"") -> Shape:
    def make(size: int) -> bytes:
        body = begin + packet * max(1, min(size, _CODEC_BYTES) // len(packet))
        return body if digits is None else body.hex(*digits).encode()

    return make


_CODEC8E: dict[str, Shape] = {
    "one packet a record": _codec(_avl(_NOTHING, 1)),
    "255 records a packet": _codec(_avl(_NOTHING, 255)),
    "no records": _codec(_avl(b"", 0)),
    "no records, in digits": _codec(_avl(b"", 0), digits=""),
    "traces": _codec(_avl(_trace_record(_TRACE[:60_000]), 1)),
    "short traces": _codec(_avl(_trace_record(_SHORT_TRACE), 100)),
    "empty traces": _codec(_avl(_trace_record(b""), 255)),
    "no records, in digits with blanks": _codec(_avl(b"", 0), digits=" "),
    "one trace a packet, in digits": _codec(_avl(_trace_record(_SHORT_TRACE), 1), digits=""),
    "many inputs": _codec(_avl(_bytes_inputs(20_000), 1)),
    "some inputs": _codec(_avl(_bytes_inputs(60), 100)),
    "an identity before": _codec(_avl(_NOTHING, 255), begin=b"\x00\x0f123456789012345"),
    "one long packet": lambda size: (
        struct.pack(">II", 0, min(size, 2_000_000)) + b"\x8e" + bytes(min(size, 2_000_000) + 3)
    ),
    "blanks": lambda size: b" \r\n" * (min(size, 4 * 1024 * 1024) // 3),
    "beyond its limit": bytes,
}

# --- MCAP

_MAGIC = b"\x89MCAP0\r\n"


def _record(kind: int, content: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(content)) + content


def _text(text: bytes) -> bytes:
    return struct.pack("<I", len(text)) + text


_HEADER = _record(1, _text(b"") + _text(b""))
_SCHEMA = _record(3, struct.pack("<H", 1) + _text(b"sensor_msgs/msg/Imu") + _text(b"ros2msg") + struct.pack("<I", 0))
_JSON = _record(4, struct.pack("<HH", 1, 0) + _text(b"/x") + _text(b"json") + struct.pack("<I", 0))
_IMU = _record(4, struct.pack("<HH", 2, 1) + _text(b"/i") + _text(b"cdr") + struct.pack("<I", 0))
_FOOT = _record(15, struct.pack("<I", 0)) + _record(2, struct.pack("<QQI", 0, 0, 0)) + _MAGIC
_CDR = b"\0\1\0\0" + struct.pack("<iII4s", 5, 6, 3, b"ab\0\0") + struct.pack("<37d", *range(37))


def _message(data: bytes, channel: int = 1) -> bytes:
    return _record(5, struct.pack("<HIQQ", channel, 0, 10**9, 10**9) + data)


def _chunk(content: bytes, *, compression: bytes = b"zstd") -> bytes:
    data = zstandard.compress(content, 1) if compression == b"zstd" else content
    head = struct.pack("<QQQI", 0, 0, len(content), 0) + _text(compression) + struct.pack("<Q", len(data))
    return _record(6, head + data)


def _whole(middle: bytes) -> bytes:
    return _MAGIC + _HEADER + _SCHEMA + _JSON + _IMU + _message(b'{"temp": 21.5}') + middle + _FOOT


def _mcap(piece: bytes, share: float = 1.0) -> Shape:
    """A record again and again; `share` of the size."""
    return lambda size: _whole(piece * max(1, int(size * share - 1000) // len(piece)))


def _counted(kind: int, head: bytes, item: Callable[[int], bytes], tail: bytes) -> Shape:
    """One record with as many items as the largest record may hold."""

    def make(size: int) -> bytes:
        count = min(size, 15_900_000) // len(item(0))
        items = b"".join(map(item, range(count)))
        return _whole(_record(kind, head + struct.pack("<I", len(items)) + items + tail))

    return make


def _pairs(index: int) -> bytes:
    return _text(b"%07x" % index) + _text(b"")


def _in_chunks(piece: bytes) -> Shape:
    """The record in chunks of the largest size."""

    def make(size: int) -> bytes:
        one = 8 * 1024 * 1024 - len(piece)
        content = piece * max(1, min(one, size // 9) // len(piece))
        return _whole(_chunk(content) * 7)

    return make


_MCAP: dict[str, Shape] = {
    "messages of JSON": _mcap(_message(b'{"temp":1}')),
    "as many messages as are read": lambda size: _whole(_message(b'{"temp":1}') * (size // (4 * 168) - 100)),
    "full messages": lambda size: _whole(
        _message(b"{" + b",".join(b'"%s":1.5' % name.encode() for name in NAMES) + b"}") * (size // (4 * 168) - 100)
    ),
    "messages of ROS": lambda size: _whole(_message(_CDR, 2) * (size // (4 * 168) - 100)),
    "empty messages": _mcap(_message(b"")),
    "messages of no object": _mcap(_message(b"1")),
    "unknown records": _mcap(_record(0x80, b"")),
    "records of no length": _mcap(_record(5, b"")),
    "headers": _mcap(_HEADER),
    "schemas": _mcap(_SCHEMA),
    "different schemas": lambda size: _whole(
        b"".join(
            _record(3, struct.pack("<H", n % 65536) + _text(b"n%d" % n) + _text(b"e" * 90) + _text(b"d" * 90))
            for n in range(size // 250)
        )
    ),
    "different channels": lambda size: _whole(
        b"".join(
            _record(4, struct.pack("<HH", n % 65536, 0) + _text(b"t%d" % n) + _text(b"kind %d" % n) + _text(b""))
            + _message(b"1", n % 65536)
            for n in range(size // 80)
        )
    ),
    "many chunks": _mcap(_chunk(_message(b'{"temp":1}'))),
    "empty chunks": _mcap(_chunk(b"")),
    "chunks of small messages": _in_chunks(_message(b"1")),
    "chunks of messages": _in_chunks(_message(b'{"temp":1}')),
    "chunks of unknown records": _in_chunks(_record(0x80, b"")),
    "chunks of schemas": _in_chunks(_SCHEMA),
    "one chunk of a message": lambda size: _whole(_chunk(_message(b'{"temp":1}' + b" " * min(size, 8_000_000)))),
    "a message of lists": lambda size: _whole(_message(b"[" + b"[]," * (min(size, 15_900_000) // 3) + b"1]")),
    "a message of numbers": lambda size: _whole(_message(b"[" + b"1.5," * (min(size, 15_900_000) // 4) + b"1]")),
    "a message of nulls": lambda size: _whole(_message(b'{"a":[' + b"0," * (min(size, 15_900_000) // 2) + b"1]}")),
    "a message of names": lambda size: _whole(
        _message(b"{" + b",".join(b'"%x":1' % n for n in range(min(size, 15_900_000) // 12)) + b"}")
    ),
    "a deep message": lambda size: _whole(_message(b"[" * min(size, 15_900_000))),
    "a long text": lambda size: _whole(_record(1, _text(b"a" * min(size, 15_900_000)) + _text(b""))),
    "a large attachment": lambda size: _whole(
        _record(9, bytes(16) + _text(b"a") + _text(b"b") + struct.pack("<Q", min(size, 15_900_000)) + bytes(15_900_004))
    ),
    "statistics": _counted(11, bytes(42), lambda n: struct.pack("<HQ", n % 65536, n * 10**9), b""),
    "indices": _counted(7, struct.pack("<H", 1), lambda n: struct.pack("<QQ", n + 10**15, n + 10**12), b""),
    "indices of chunks": _counted(8, bytes(32), lambda n: struct.pack("<HQ", n % 65536, n * 10**9), bytes(28)),
    "metadata": _counted(12, _text(b"m"), _pairs, b""),
    "metadata of a channel": _counted(4, struct.pack("<HH", 9, 0) + _text(b"t") + _text(b"json"), _pairs, b""),
    "metadata of channels": lambda size: _whole(
        b"".join(
            _record(
                4, struct.pack("<HH", n, 0) + _text(b"t") + _text(b"json") + _text(b"".join(map(_pairs, range(64))))
            )
            for n in range(min(60_000, size // 1050))
        )
    ),
}

# --- Parquet and Arrow


def _table(rows: int, names: tuple[str, ...], kind: str) -> Any:
    """A table of one kind of values."""
    rows = max(1, rows)
    match kind:
        case "zeros":
            values = pa.array(np.zeros(rows))
        case "bytes":
            values = pa.array(np.zeros(rows, dtype=np.int8))
        case "flags":
            values = pa.array(np.arange(rows) % 3 == 0)
        case "different":
            values = pa.array(np.arange(rows, dtype=np.float64) * 1e-6)
        case "few":
            values = pa.array(np.arange(rows, dtype=np.float64) % 200)
        case "nulls":
            values = pa.nulls(rows, pa.float64())
        case "nothing":
            values = pa.nulls(rows)
        case _:
            values = pa.array(np.zeros(rows), mask=np.arange(rows) % 2 == 1)
    time = values if kind not in ("nulls", "nothing", "half") else pa.array(np.zeros(rows, dtype=np.int32))
    return pa.Table.from_arrays([time] + [values] * (len(names) - 1), names=list(names))


def _parquet(names: tuple[str, ...], kind: str, *, most_rows: int = 1 << 40, **options: Any) -> Shape:
    def make(size: int) -> bytes:
        sink = pa.BufferOutputStream()
        rows = min(size // (8 * len(names)) - 8, most_rows)
        pq.write_table(_table(rows, names, kind), sink, **{"compression": "zstd", **options})
        return sink.getvalue().to_pybytes()

    return make


_PARQUET: dict[str, Shape] = {
    **{
        f"{kind}, {word}": _parquet(names, kind)
        for kind in ("zeros", "bytes", "flags", "different", "few", "nulls", "half")
        for word, names in (("t alone", ("t",)), ("force", _FORCE), ("all columns", _PLAIN))
    },
    "plain": _parquet(_FORCE, "different", use_dictionary=False, compression="none"),
    "snappy": _parquet(_FORCE, "different", compression="snappy"),
    "gzip": _parquet(_FORCE, "few", compression="gzip"),
    "brotli": _parquet(_FORCE, "few", compression="brotli"),
    "lz4": _parquet(_FORCE, "different", compression="lz4"),
    "steps between": _parquet(
        _FORCE, "bytes", use_dictionary=False, column_encoding=dict.fromkeys(_FORCE, "DELTA_BINARY_PACKED")
    ),
    "bytes by place": _parquet(
        _FORCE, "different", use_dictionary=False, column_encoding=dict.fromkeys(_FORCE, "BYTE_STREAM_SPLIT")
    ),
    "small pages": _parquet(_FORCE, "zeros", data_page_size=64, write_batch_size=64, use_dictionary=False),
    "pages of version 2": _parquet(_FORCE, "half", data_page_version="2.0"),
    "many groups": _parquet(("t",), "zeros", row_group_size=10, most_rows=3000),
    "many groups, all columns": _parquet(_PLAIN, "half", row_group_size=2, most_rows=80),
}


def _streamed(table: Any, batch_rows: int | None, compression: str | None) -> bytes:
    sink = pa.BufferOutputStream()
    options = ipc.IpcWriteOptions(compression=compression)
    with ipc.new_stream(sink, table.schema, options=options) as writer:
        writer.write_table(table, max_chunksize=batch_rows)
    return sink.getvalue().to_pybytes()


def _arrow(names: tuple[str, ...], kind: str, compression: str | None, batch_rows: int | None = None) -> Shape:
    def make(size: int) -> bytes:
        rows = size // (8 * len(names)) - 64
        return _streamed(_table(rows if batch_rows is None else rows // 16, names, kind), batch_rows, compression)

    return make


def _parts(names: tuple[str, ...], kind: str, rows: int) -> tuple[bytes, bytes]:
    """A stream's schema, and one batch of so many rows."""
    stream = _streamed(_table(max(1, rows), names, kind).slice(0, rows), None, None)
    size = struct.unpack_from("<I", stream, 4)[0]
    return stream[: 8 + size], stream[8 + size : -8]


def _batches(names: tuple[str, ...], kind: str, rows: int) -> Shape:
    def make(size: int) -> bytes:
        schema, batch = _parts(names, kind, 1)
        if rows == 0:
            batch = _patched(batch, 0)
        return schema + batch * ((size - len(schema)) // len(batch))

    return make


def _patched(batch: bytes, rows: int) -> bytes:
    """A batch that says another number of rows."""
    data = bytearray(batch)
    metadata = memoryview(data)[8:]
    header = arrow._child(metadata, arrow._table(metadata, 0), 2)
    at = arrow._field(metadata, header, 0)
    struct.pack_into("<q", metadata, at, rows)
    return bytes(data)


def _buffers(size: int) -> bytes:
    """Batches whose metadata tell of as many buffers as fit."""
    schema, batch = _parts(("t",), "zeros", 1)
    length = struct.unpack_from("<I", batch, 4)[0]
    metadata, body = bytearray(batch[8 : 8 + length]), batch[8 + length :]
    header = arrow._child(memoryview(metadata), arrow._table(memoryview(metadata), 0), 2)
    at = arrow._field(memoryview(metadata), header, 2)
    count = 16_000
    struct.pack_into("<I", metadata, at, len(metadata) - at)
    metadata += struct.pack("<I", count) + bytes(16 * count)
    metadata += bytes(-len(metadata) % 8)
    whole = struct.pack("<II", 0xFFFFFFFF, len(metadata)) + bytes(metadata) + body
    return schema + whole * max(1, (size - len(schema)) // len(whole))


def _claims(size: int) -> bytes:
    """A batch of nothing but nulls, which takes no bytes however many rows it says."""
    schema, batch = _parts(("t", "temp"), "nothing", 1)
    return schema + _patched(batch, size // 16 - 1)


_ARROW: dict[str, Shape] = {
    **{
        f"{kind}, {word}, {compression}": _arrow(names, kind, compression)
        for kind in ("zeros", "bytes", "flags", "different", "half")
        for word, names in (("t alone", ("t",)), ("all columns", _PLAIN))
        for compression in (None, "zstd", "lz4")
    },
    "batches of a row": _arrow(("t",), "zeros", None, 1),
    "batches of a row, all columns": _arrow(_PLAIN, "half", "zstd", 1),
    "empty batches": _batches(("t",), "zeros", 0),
    "empty batches, all columns": _batches(_PLAIN, "zeros", 0),
    "the same row": _batches(("t",), "zeros", 1),
    "the same row, all columns": _batches(_PLAIN, "zeros", 1),
    "many buffers": _buffers,
    "rows that are nothing": _claims,
    "continuations": lambda size: struct.pack("<I", 0xFFFFFFFF) * (size // 4),
    "schemas": lambda size: _parts(("t",), "zeros", 1)[0] * (size // 200),
}

SHAPES: dict[str, dict[str, Shape]] = {
    "application/vnd.scatola.batch": _COMPACT,
    "application/vnd.scatola.codec8e": _CODEC8E,
    "application/mcap": _MCAP,
    "application/vnd.apache.parquet": _PARQUET,
    "application/vnd.apache.arrow.stream": _ARROW,
}
