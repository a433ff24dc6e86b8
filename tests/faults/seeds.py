"""A small valid body for every reader: what the fuzzer begins from."""

from __future__ import annotations

import io
import json
import struct

import numpy as np
from mcap.writer import CompressionType, Writer

from server.formats.codec8e import _crc16
from server.formats.columns import Columns
from server.formats.compact_write import write as write_compact
from server.formats.decode import MEDIA_TYPES
from server.formats.tables import write_arrow, write_csv
from tests.faults.large import PHONE

_NMEA = b"$GPRMC,120000.00,A,4524.6,N,01156.4,E,19.4,84.4,280226,,,A\r\n$GPVTG,90,T,,M,1,N,2,K\n"
_THESIS = b"1 10 11.9 45.4 12 36 270 1 1 2 100\n2 20 11.9 45.4 12 36 270 1 1 2 100\n"
_PHONE = (
    b"Time (s);Acceleration x (g);Acceleration y (g);Acceleration z (g);Latitude;Longitude;Speed;Satellites\n"
    + b"".join(b"%d,5;0,01;0,02;%s;45,%03d;11,5;3,6;3 / 19\n" % (n, b"-1" if n % 3 else b"", n) for n in range(40))
)


def _columns() -> Columns:
    t = np.arange(20) * 0.05
    some = np.where(np.arange(20) % 5 == 0, 45.0, np.nan)
    force = {name: np.sin(t + index) for index, name in enumerate(("fx", "fy", "fz"))}
    return Columns({"t": t, **force, "lat": some, "lon": some, "fix": some / 45.0})


def _codec8e() -> bytes:
    record = struct.pack(">QBiihHBH", 1_772_366_400_000, 1, 119_400_000, 454_100_000, 12, 90, 8, 36)
    record += struct.pack(">HHHHBHHHHHHHH", 247, 3, 1, 239, 1, 1, 66, 12_650, 0, 0, 1, 257, 12)
    record += struct.pack(">6h", 29, 63, 1011, 30, 60, 1011)
    data = bytes([0x8E, 1]) + record + bytes([1])
    return struct.pack(">II", 0, len(data)) + data + struct.pack(">I", _crc16(memoryview(data)))


def _mcap() -> bytes:
    sink = io.BytesIO()
    writer = Writer(sink, compression=CompressionType.ZSTD)
    writer.start()
    schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", b"")
    imu, plain = writer.register_channel("/imu", "cdr", schema), writer.register_channel("/x", "json", 0)
    message = b"\0\1\0\0" + struct.pack("<iII4s", 5, 6, 3, b"ab\0\0") + struct.pack("<37d", *range(37))
    writer.add_message(imu, 10**9, message, 10**9)
    writer.add_message(plain, 2 * 10**9, b'{"temp": 21.5}', 2 * 10**9)
    writer.finish()
    return sink.getvalue()


def seeds() -> dict[str, bytes]:
    """A body for each media type that is read, and for the reader of loggers' CSV."""
    columns = _columns()
    named = {name: [None if np.isnan(v) else v for v in values] for name, values in columns.values.items()}
    found = {
        "application/json": json.dumps({"columns": named}).encode(),
        "text/csv": write_csv(columns),
        "application/vnd.apache.parquet": columns.to_parquet(),
        "application/vnd.apache.arrow.stream": write_arrow(columns),
        "application/vnd.scatola.batch": write_compact(columns),
        "application/vnd.scatola.codec8e": _codec8e(),
        "application/vnd.scatola.nmea": _NMEA,
        "application/vnd.scatola.thesis-line": _THESIS,
        "application/mcap": _mcap(),
    }
    assert set(found) == set(MEDIA_TYPES), "a new media type needs a seed"
    found[PHONE] = _PHONE
    return found
