"""Formats of other makers: Codec 8E, NMEA, MCAP, phone loggers; what they say, and what is wrong with them."""

from __future__ import annotations

import io
import json
import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Chunk
from mcap.writer import CompressionType, Writer

from nav_core.simulate import Scenario, simulate
from server.errors import InvalidError, TooLargeError
from server.formats.codec8e import _crc16
from server.formats.columns import Columns
from server.formats.decode import decode, load
from server.formats.drive import DriveFileError, from_drive, read_drive_columns, read_drive_file
from tests.recordings import corolla, folder, loose_phone

MEGABYTE = 1024 * 1024
CODEC8E, NMEA, MCAP = "application/vnd.scatola.codec8e", "application/vnd.scatola.nmea", "application/mcap"
THESIS = "application/vnd.scatola.thesis-line"


def read(media_type: str, body: bytes) -> Columns:
    return decode(media_type, body, max_decoded_bytes=8 * MEGABYTE)


def codes(columns: Columns) -> set[str]:
    return {remark.code for remark in columns.remarks}


@pytest.mark.parametrize("end", [b"\n", b"\r", b"\r\n"])
@pytest.mark.parametrize(
    ("media_type", "line"),
    [("text/csv", b"0,"), (NMEA, b"$GPGGA,"), (NMEA, b""), (THESIS, b"1 2 3 4 5 6 7 8 9 1 2")],
)
def test_lines_are_counted_before_they_are_made(media_type, line, end):
    """A body of nothing but lines unpacks from a thousandth of its size, and each would be an object."""
    begin = b"t,battery\n" if media_type == "text/csv" else b""
    body = begin + (line + end) * (2 * MEGABYTE)
    load()
    tracemalloc.start()
    with pytest.raises(TooLargeError):
        read(media_type, body)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < MEGABYTE


# --- Codec 8 Extended

# The vendor's example: one record without a fix.
VENDOR = bytes.fromhex(
    "000000000000004A8E010000016B412CEE000100000000000000000000000000000000010005000100010100010011001D00010010015E2C88"
    "0002000B000000003544C87A000E000000001DD7E06A00000100002994"
)
# The samples of the vendor's example of a crash trace, thousandths of g.
TRACE = ((29, 63, 1011), (30, 60, 1011), (38, 76, 1026), (34, 70, 1021))


def avl(time_ms, *, at=(0, 0, 0, 0, 0, 0), inputs=None, trace=None) -> bytes:
    lon, lat, alt, angle, sats, speed = at
    record = struct.pack(">QBiihHBH", time_ms, 1, lon, lat, alt, angle, sats, speed)
    sized = {1: b"", 2: b"", 4: b"", 8: b""}
    counts = dict.fromkeys(sized, 0)
    for name, (size, value) in (inputs or {}).items():
        sized[size] += struct.pack(">H", name) + (value & (2 ** (8 * size) - 1)).to_bytes(size)
        counts[size] += 1
    record += struct.pack(">HH", 0, sum(counts.values()) + (trace is not None))
    for size, data in sized.items():
        record += struct.pack(">H", counts[size]) + data
    if trace is None:
        return record + struct.pack(">H", 0)
    packed = trace if isinstance(trace, bytes) else b"".join(struct.pack(">hhh", *sample) for sample in trace)
    return record + struct.pack(">HHH", 1, 257, len(packed)) + packed


def packet(*records: bytes) -> bytes:
    data = bytes([0x8E, len(records)]) + b"".join(records) + bytes([len(records)])
    return struct.pack(">II", 0, len(data)) + data + struct.pack(">I", _crc16(memoryview(data)))


def test_the_vendors_example_is_read():
    columns = read(CODEC8E, VENDOR)
    assert columns.rows == 1
    assert columns.values["t"][0] == 1560166592.0  # 2019-06-10 11:36:32 UTC, says the vendor
    assert columns.values["fix"][0] == 0.0
    assert "lat" not in columns.values
    assert "fx" not in columns.values  # one axis alone is no vector


def test_positions_inputs_and_the_crash_trace():
    here = (119_400_000, 454_100_000, 12, 270, 9, 36)
    inputs = {239: (1, 1), 66: (2, 12_650), 182: (2, 9), 17: (2, -250), 18: (2, 10), 19: (2, 990)}
    body = packet(avl(1_772_366_400_000, at=here, inputs=inputs)) + packet(
        avl(1_772_366_401_000, at=here, trace=TRACE), avl(1_772_366_401_040, at=here, trace=TRACE)
    )
    columns = read(CODEC8E, b"\x00\x0f" + b"356307042441013" + body)
    assert columns.rows == 3 + 8
    first = {name: values[0] for name, values in columns.values.items()}
    assert first["t"] == first["utc"] == 1772366400.0
    assert (first["lat"], first["lon"], first["alt"]) == pytest.approx((45.41, 11.94, 12.0))
    assert (first["speed"], first["course"], first["sats"], first["hdop"]) == pytest.approx((10.0, 270.0, 9.0, 0.9))
    assert (first["battery"], first["ignition"]) == (12.65, 1.0)
    assert (first["fx"], first["fz"]) == pytest.approx((-0.25 * 9.80665, 0.99 * 9.80665))
    trace = columns.values["t"] > 1772366400.5
    sampled = np.isfinite(columns.values["fx"]) & trace
    np.testing.assert_allclose(np.diff(columns.values["t"][sampled]), 0.01, atol=1e-6)
    np.testing.assert_allclose(
        columns.values["fz"][sampled][:4], [1.011 * 9.80665] * 2 + [1.026 * 9.80665, 1.021 * 9.80665]
    )
    assert codes(columns) == {"crash_trace_period_found"}
    assert read(CODEC8E, body.hex().encode()).rows == 11


def test_a_single_trace_does_not_tell_its_rate():
    columns = read(CODEC8E, packet(avl(1_772_366_401_000, trace=TRACE)))
    assert codes(columns) == {"crash_trace_period_assumed"}


@pytest.mark.parametrize(
    ("body", "says"),
    [
        (VENDOR[:-1], "does not fit, at byte 0"),
        (VENDOR[:10], "cut off"),
        (b"\1" + VENDOR[1:], "four zeros"),
        (VENDOR[:-1] + b"\0", "CRC 2994, the packet says 2900, at byte 82"),
        (VENDOR + b"\0", "cut off, at byte 86"),
        (packet(avl(0, trace=b"\0" * 7)), "7 bytes is not made of three axes of two"),
        (packet(avl(0)[:-1]), "record is cut off"),
        (packet(avl(0) + b"\0"), "announced"),
        (struct.pack(">II", 0, 3) + b"\x08\0\0" + struct.pack(">I", _crc16(memoryview(b"\x08\0\0"))), "codec 0x08"),
        (b"abc", "odd number"),
    ],
)
def test_what_is_wrong_with_a_packet_is_named(body, says):
    with pytest.raises(InvalidError, match=says) as refused:
        read(CODEC8E, body)
    assert refused.value.code == "codec8e"


# --- NMEA


def sentence(body: str) -> str:
    total = 0
    for character in body:
        total ^= ord(character)
    return f"${body}*{total:02X}"


LOG = [
    sentence("GPRMC,235958.00,A,4524.6000,N,01156.4000,E,19.44,84.4,280226,,,A"),
    sentence("GPGGA,235958.00,4524.6000,N,01156.4000,E,1,08,0.9,12.4,M,46.9,M,,"),
    sentence("GPGSV,1,1,00"),
    sentence("GNGGA,000001.00,4524.6000,S,01156.4000,W,0,,,,M,,M,,"),
    sentence("GPVTG,90.0,T,,M,10.0,N,36.0,K"),
    sentence("GNRMC,000002.00,V,,,,,,,010326,,,N"),
]


def test_a_log_becomes_one_row_for_each_moment():
    columns = read(NMEA, "\r\n".join(LOG).encode())
    np.testing.assert_array_equal(columns.values["utc"], 1772323198.0 + np.array([0.0, 3.0, 4.0]))
    np.testing.assert_array_equal(columns.values["t"], columns.values["utc"])
    np.testing.assert_array_equal(columns.values["fix"], [1.0, 0.0, 0.0])
    np.testing.assert_allclose(columns.values["lat"], [45.41, -45.41, np.nan])
    np.testing.assert_allclose(columns.values["lon"], [11.94, -11.94, np.nan])
    np.testing.assert_allclose(columns.values["speed"], [10.0, 10.0, np.nan], atol=2e-3)
    np.testing.assert_allclose(columns.values["course"], [84.4, 90.0, np.nan])
    assert (columns.values["alt"][0], columns.values["sats"][0], columns.values["hdop"][0]) == (12.4, 8.0, 0.9)
    assert codes(columns) == {"nmea_clock"}


def test_stamps_of_the_logger_are_its_clock():
    lines = [f"{100.25 + index} {line}" for index, line in enumerate(LOG)]
    columns = read(NMEA, "\n".join(lines).encode())
    np.testing.assert_array_equal(columns.values["t"], [100.25, 103.25, 105.25])
    assert codes(columns) == set()


def test_lines_that_cannot_be_read_are_counted():
    broken = LOG[0][:-1] + ("0" if LOG[0][-1] != "0" else "1")
    columns = read(
        NMEA, "\n".join(["boot", broken, sentence("GPGGA,120000.00,4524.6,N,x,E,1,8,nan,1,M,1,M,,"), LOG[1]]).encode()
    )
    details = " ".join(remark.detail for remark in columns.remarks)
    assert columns.rows == 1
    assert "utc" not in columns.values
    for why in ("no NMEA sentence", "wrong checksum", "unreadable fields", "first bad one is line 1"):
        assert why in details
    assert "nmea_without_date" in codes(columns)
    with pytest.raises(InvalidError, match="line 1 is the first bad one"):
        read(NMEA, b"nothing")


# --- MCAP


def mcap(messages, *, compression=CompressionType.ZSTD, chunk_size=MEGABYTE) -> bytes:
    sink = io.BytesIO()
    writer = Writer(sink, compression=compression, chunk_size=chunk_size)
    writer.start()
    channels = {}
    for time_s, kind, encoding, data in messages:
        if kind not in channels:
            schema = writer.register_schema(kind, "jsonschema" if encoding == "json" else "ros2msg", b"")
            channels[kind] = writer.register_channel(f"/{kind}", encoding, schema)
        writer.add_message(channels[kind], int(time_s * 1e9), data, int(time_s * 1e9))
    writer.finish()
    return sink.getvalue()


def cdr(*parts) -> bytes:
    out = b""
    for kinds, *values in (("i", 5), ("I", 6), ("I", 3), ("3s", b"ab\0"), *parts):
        size = struct.calcsize(kinds[-1])
        out += bytes(-len(out) % size) + struct.pack(f"<{kinds}", *values)
    return b"\0\1\0\0" + out


def imu(force, rate, *, covariance=0.0) -> bytes:
    return cdr(("37d", *[0.0] * 13, *rate, covariance, *[0.0] * 8, *force, covariance, *[0.0] * 8))


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.NONE])
def test_json_and_ros_messages_become_rows(compression):
    fix = cdr(("b", 0), ("H", 1), ("3d", 45.41, 11.94, 12.0), ("9d", *[0.0] * 9), ("B", 0))
    columns = read(
        MCAP,
        mcap(
            [
                (10.5, "sensor_msgs/msg/Imu", "cdr", imu((0.1, 0.2, 9.8), (0.01, 0.02, 0.03))),
                (10.0, "scatola.Columns", "json", json.dumps({"temp": 21.5, "ignition": True, "note": "x"}).encode()),
                (11.0, "sensor_msgs/msg/NavSatFix", "cdr", fix),
                (12.0, "sensor_msgs/msg/MagneticField", "cdr", cdr(("3d", 2e-5, 0.0, 4e-5), ("9d", *[0.0] * 9))),
                (13.0, "foxglove.LocationFix", "json", b'{"latitude": 1, "longitude": 2, "altitude": 3.5}'),
                (14.0, "sensor_msgs/msg/NavSatFix", "cdr", cdr(("b", -1), ("H", 1), ("3d", 0.0, 0.0, 0.0))),
                (15.0, "sensor_msgs/msg/Image", "cdr", b"\0\1"),
                (16.0, "sensor_msgs/msg/Imu", "cdr", imu((0, 0, 0), (0, 0, 0), covariance=-1.0)),
            ],
            compression=compression,
        ),
    )
    np.testing.assert_array_equal(columns.values["t"], [10.0, 10.5, 11.0, 12.0, 13.0, 14.0])
    assert [columns.values[name][1] for name in ("fx", "fy", "fz", "wx", "wy", "wz")] == [
        0.1,
        0.2,
        9.8,
        0.01,
        0.02,
        0.03,
    ]
    np.testing.assert_array_equal(columns.values["lat"][2:5], [45.41, np.nan, 1.0])
    np.testing.assert_allclose(columns.values["mx"][3], 20.0)
    np.testing.assert_array_equal(columns.values["fix"], [np.nan, np.nan, 1.0, np.nan, 1.0, 0.0])
    left_out = [remark.detail for remark in columns.remarks]
    assert left_out == [
        "1 messages left out: cdr sensor_msgs/msg/Image",
        "1 messages left out: cdr sensor_msgs/msg/Imu",
    ]


def test_a_recording_without_anything_that_is_read_says_what_is_there():
    with pytest.raises(InvalidError, match="kinds that are there: cdr sensor_msgs/msg/Image"):
        read(MCAP, mcap([(1.0, "sensor_msgs/msg/Image", "cdr", b"")]))
    for body in (b"", b"\x89MCAP0\r\n", mcap([(1.0, "x", "json", b"{}")])[:60]):
        with pytest.raises(InvalidError):
            read(MCAP, body)


def test_a_chunk_cannot_unpack_to_more_than_it_says(monkeypatch):
    # Half a megabyte of zeros that calls itself a hundred bytes, and one that says what it is.
    message = [(1.0, "x", "json", b'{"temp": 1, "pad": "' + b"0" * (9 * MEGABYTE) + b'"}')]
    honest = mcap(message)
    assert len(honest) < 10_000
    with pytest.raises(TooLargeError, match="chunk unpacks"):
        read(MCAP, honest)
    write = Chunk.write

    def lying(chunk, stream):
        chunk.uncompressed_size = 100
        write(chunk, stream)

    monkeypatch.setattr(Chunk, "write", lying)
    with pytest.raises(TooLargeError, match="more than 100 bytes"):
        read(MCAP, mcap(message))


# --- phone loggers


@pytest.mark.parametrize("header", ["time (s),ax (g),ay (g),az (g)", "seconds_elapsed,x,y,z"])
def test_a_number_beyond_all_numbers_is_left_out_with_a_remark(tmp_path, header):
    rows = [f"{0.01 * i:.2f},{'1e308' if i == 5 else '0.1'},0.1,1.0" for i in range(200)]
    path = tmp_path / "phone.csv"
    path.write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    columns = read_drive_columns(path)
    assert np.flatnonzero(np.isnan(columns.values["fx"])).tolist() == [5]
    assert "vectors_incomplete" in codes(columns)


def phone(
    drive: Columns, *, sign: float = 1.0, scale: float = 1.0, kmh: bool = True, units: bool = True, held: bool = False
) -> str:
    """A drive as AndroSensor or its like writes it."""
    unit = " (m/s²)" if units else ""
    names = ["Time since start in ms ", *[f"ACCELEROMETER {axis}{unit}" for axis in "XYZ"]]
    names += [
        "LOCATION Latitude : ",
        "LOCATION Longitude : ",
        f"LOCATION Speed{' ( Kmh)' if units else ''}",
        "LOCATION ORIENTATION (°)",
    ]
    names += ["Satellites in range", "LINEAR ACCELERATION X (m/s²)", "YYYY-MO-DD HH-MI-SS_SSS"]
    lines, last = [",".join(names)], [np.nan] * 4
    fixes = np.column_stack([drive.values[name] for name in ("lat", "lon", "speed", "course")])
    fixes[:, 2] *= 3.6 if kmh else 1.0
    force = scale * sign * np.column_stack([drive.values[name] for name in ("fx", "fy", "fz")])
    for t, f, fix in zip(drive.values["t"], force, fixes, strict=True):
        last = fix if np.isfinite(fix[0]) else (last if held else [np.nan] * 4)
        cells = [f"{1000 * t:.0f}", *[f"{v:.5f}" if np.isfinite(v) else "" for v in f]]
        cells += [f"{v:.7f}" if np.isfinite(v) else "" for v in last] + ["3 / 19", "0.1", "2026-03-01 12:00:00:000"]
        lines.append(",".join(cells))
    return "\n".join(lines) + "\n"


@pytest.fixture(scope="module")
def drive() -> Columns:
    scenario = Scenario(route="urban", duration=300.0, accel_rate=50.0, gnss_rate=1.0)
    return from_drive(simulate(scenario, seed=4)[0])


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("scale", "kmh", "units", "held"), [(1.0, True, True, True), (1 / 9.80665, False, False, False)]
)
def test_units_and_sign_are_detected(tmp_path, drive, sign, scale, kmh, units, held):
    path = tmp_path / "phone.csv"
    path.write_text(phone(drive, sign=sign, scale=scale, kmh=kmh, units=units, held=held), encoding="utf-8")
    columns = read_drive_columns(path)
    rows = np.isfinite(columns.values["fx"])
    np.testing.assert_allclose(
        columns.values["fz"][rows], drive.values["fz"][np.isfinite(drive.values["fx"])], atol=1e-3
    )
    fixed, true = np.isfinite(columns.values["speed"]), np.isfinite(drive.values["speed"])
    if not held:
        np.testing.assert_allclose(columns.values["speed"][fixed], drive.values["speed"][true], atol=1e-3)
    assert fixed.sum() == pytest.approx(true.sum(), rel=0.05)
    detected = codes(columns)
    assert "force_sign_detected" in detected
    assert ("speed_unit_detected" in detected) == ("force_unit_detected" in detected) == (not units)
    word = next(remark.detail for remark in columns.remarks if remark.code == "force_sign_detected")
    assert ("reversed" in word) == (sign < 0.0)
    assert {remark.code for remark in read_drive_file(path).remarks} >= detected


def test_a_real_drive_tells_its_sign(tmp_path):
    recording = from_drive(corolla())
    for sign, word in ((1.0, "kept"), (-1.0, "reversed")):
        path = tmp_path / "corolla.csv"
        path.write_text(phone(recording, sign=sign), encoding="utf-8")
        (remark,) = (remark for remark in read_drive_columns(path).remarks if remark.code.startswith("force_sign"))
        assert remark.code == "force_sign_detected", remark.detail
        assert word in remark.detail


def test_a_real_loggers_file_is_read_as_it_is():
    path = folder("sbussmann-boston-loose-phone") / "nickandroid_exp2.csv"
    drive, expected = read_drive_file(path), loose_phone()
    np.testing.assert_allclose(drive.inertial.f, expected.inertial.f)
    assert drive.inertial.w is not None
    assert drive.inertial.m is not None
    assert 20.0 < np.nanmedian(np.linalg.norm(drive.inertial.m, axis=1)) < 100.0  # µT, in a car
    # A report a second; the tests' own reader takes those that repeat a place for no reports.
    assert drive.gnss.t.size == pytest.approx(drive.inertial.t[-1] - drive.inertial.t[0], rel=0.01)
    assert drive.gnss.t.size >= expected.gnss.t.size
    assert np.nanmax(drive.gnss.speed) == pytest.approx(np.nanmax(expected.gnss.speed), rel=1e-6)


@pytest.mark.parametrize(
    ("header", "row", "expected"),
    [
        ("Time (s);Acceleration x (m/s^2);Acceleration y (m/s^2);Acceleration z (m/s^2)", "0,5;0,1;0,2;9,8", 9.8),
        ("time,seconds_elapsed,z,y,x", "1772366400000000000,0.5,9.8,0.2,0.1", 9.8),
        ("time,gFx,gFy,gFz", "0.5,0.01,0.02,1.0", 9.80665),
        (
            "loggingTime(txt),accelerometerTimestamp_sinceReboot(s),{0}X(G),{0}Y(G),{0}Z(G),motionUserAccelerationX(G)",
            "2026-03-01,0.5,0.01,0.02,-1.0,0.3",
            9.80665,
        ),
    ],
)
def test_headers_of_several_apps(tmp_path, header, row, expected):
    path = tmp_path / "phone.csv"
    path.write_text(header.format("accelerometerAcceleration") + f"\n{row}\n", encoding="utf-8")
    columns = read_drive_columns(path)
    assert columns.values["t"][0] == 0.5
    assert columns.values["fz"][0] == pytest.approx(expected)


def test_a_csv_that_is_neither_says_so(tmp_path):
    path = tmp_path / "phone.csv"
    path.write_text("time,ax,ay,az\n0,0.1,0.2,50\n0.1,0.1,0.2,50\n", encoding="utf-8")
    with pytest.raises(DriveFileError, match="neither m/s², g nor mg"):
        read_drive_columns(path)
    path.write_text("time,ax,ay,az\n0,0.1,0.2,high\n", encoding="utf-8")
    with pytest.raises(DriveFileError, match="'az'"):
        read_drive_columns(path)


# --- all of them


def test_files_are_known_by_their_content(tmp_path):
    from server.formats.compact_write import write

    some = Columns({"t": np.array([5.0]), "temp": np.array([20.0])})
    for body in (
        VENDOR,
        VENDOR.hex().encode(),
        "\n".join(LOG).encode(),
        mcap([(1e9, "x", "json", b'{"temp": 1}')]),
        write(some),
    ):
        path = tmp_path / "file"
        path.write_bytes(body)
        assert 0.0 <= read_drive_columns(path).values["t"][0] < 10.0


SEEDS = {
    CODEC8E: packet(avl(1_772_366_401_000, at=(1, 1, 1, 1, 5, 1), inputs={239: (1, 1)}, trace=TRACE)),
    NMEA: "\n".join(LOG).encode(),
    MCAP: mcap([(1.0, "sensor_msgs/msg/Imu", "cdr", imu((0, 0, 9), (0, 0, 0))), (2.0, "x", "json", b'{"temp": 1}')]),
    THESIS: b"1 10 11.9 45.4 12 36 270 1 1 2 100\n2 20 11.9 45.4 12 36 270 1 1 2 100\n",
}


@settings(max_examples=200, deadline=None)
@given(data=st.data(), media_type=st.sampled_from(sorted(SEEDS)))
def test_no_body_does_worse_than_a_problem(data, media_type):
    body = bytearray(SEEDS[media_type])
    for _ in range(data.draw(st.integers(1, 6))):
        body[data.draw(st.integers(0, len(body) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.none() | st.integers(0, len(body)))
    body = bytes(body[:cut])
    if media_type == CODEC8E and len(body) > 12:
        body = body[:-4] + struct.pack(">I", _crc16(memoryview(body)[8:-4]))
    try:
        columns = read(media_type, body)
    except (InvalidError, TooLargeError):
        return
    assert columns.rows > 0


@pytest.mark.both_databases
@pytest.mark.parametrize("media_type", sorted(SEEDS))
def test_a_gateway_may_send_them_and_remarks_are_kept(media_type, client, make_device, database):
    import sqlalchemy as sa

    from server.models import Batch

    _, token = make_device()
    headers = {"Authorization": f"Bearer {token}", "Idempotency-Key": "b/0", "Content-Type": media_type}
    answer = client.post("/api/v1/batches", content=SEEDS[media_type], headers=headers)
    assert answer.status_code == 202, answer.text
    with database.reading() as session:
        (remarks,) = session.scalars(sa.select(Batch.remarks)).all()
    expected = {CODEC8E: ["crash_trace_period_assumed"], NMEA: ["nmea_clock"]}.get(media_type, [])
    assert [remark["code"] for remark in remarks] == expected
