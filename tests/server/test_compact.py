"""The compact body: the documented vectors, round trips, and everything that may be wrong with one."""

from __future__ import annotations

import json
import re
import shutil
import struct
import subprocess
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from server.errors import InvalidError, TooLargeError
from server.formats.columns import NAMES, Columns
from server.formats.compact import BLOCK, COLUMN, HEAD
from server.formats.compact_write import RESOLUTIONS, write
from server.formats.decode import decode

DOCS = Path(__file__).parents[2] / "docs"
MEDIA_TYPE = "application/vnd.scatola.batch"
LIMIT = 8 * 1024 * 1024


def read(body: bytes, limit: int = LIMIT) -> Columns:
    return decode(MEDIA_TYPE, body, max_decoded_bytes=limit)


def vectors() -> list[tuple[bytes, dict[str, list[float | None]]]]:
    text = (DOCS / "device-protocol.md").read_text()
    pairs = re.findall(r"```hex\n(.*?)```\n```json\n(.*?)```", text, re.DOTALL)
    return [(bytes.fromhex(body), json.loads(values)) for body, values in pairs]


def sealed(body: bytes | bytearray) -> bytes:
    """A body with its length and CRC put right again, where it is long enough to have any."""
    if len(body) < 16:
        return bytes(body)
    body = bytearray(body[:-4])
    struct.pack_into("<I", body, 8, len(body) + 4)
    return bytes(body) + struct.pack("<I", zlib.crc32(body))


def some_columns(rows: int = 400) -> Columns:
    rng = np.random.default_rng(3)
    t = 5.0 + np.cumsum(rng.integers(4900, 5100, rows)) * 1e-6
    values = {"t": t} | {name: np.round(rng.normal(size=rows), 3) for name in ("fx", "fy", "fz")}
    fixes = np.arange(rows) % 50 == 10
    for name, centre in {"lat": 45.4, "lon": 11.9, "alt": 12.0, "speed": 14.0, "utc": 1772366400.0}.items():
        values[name] = np.where(fixes, np.round(centre + 0.001 * np.arange(rows), 3), np.nan)
    return Columns(values)


@pytest.mark.parametrize(("body", "expected"), vectors())
def test_the_documented_vectors_decode_to_the_documented_values(body, expected):
    columns = read(body)
    assert set(columns.values) == set(expected)
    for name, values in expected.items():
        np.testing.assert_allclose(columns.values[name], np.array(values, dtype=float), rtol=1e-15, atol=0)


def test_the_writer_in_c_prints_the_first_vector(tmp_path):
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    program = tmp_path / "batch"
    source = str(DOCS / "scatola_batch.c")
    subprocess.run([compiler, "-std=c99", "-Wall", "-Wextra", "-Werror", "-o", program, source], check=True)
    printed = subprocess.run([program], check=True, capture_output=True, text=True).stdout
    assert bytes.fromhex(printed) == vectors()[0][0]


def test_what_is_written_reads_back_to_its_resolution():
    columns = some_columns()
    body = write(columns)
    assert body == write(columns)
    # A reading and its fix stand in rows of their own.
    read_back = read(body)
    fixes = np.flatnonzero(~np.isnan(columns.values["lat"]))
    assert read_back.rows == columns.rows + fixes.size
    for name, rows in {"fx": slice(None), "fz": slice(None), "lat": fixes, "speed": fixes, "utc": fixes}.items():
        found = read_back.values[name]
        kept = ~np.isnan(found)
        resolution = RESOLUTIONS[name][1]
        np.testing.assert_allclose(found[kept], columns.values[name][rows], rtol=0, atol=resolution * 0.5001)
        np.testing.assert_allclose(read_back.values["t"][kept], columns.values["t"][rows], rtol=0, atol=1e-6)


def test_a_reading_takes_few_bytes_and_is_decoded_fast():
    columns = some_columns(12_000)
    assert len(write(Columns({name: columns.values[name] for name in ("t", "fx", "fy", "fz")}))) < 8.1 * 12_000
    even = {**columns.values, "t": np.arange(12_000) / 200.0}
    assert len(write(Columns({name: even[name] for name in ("t", "fx", "fy", "fz")}))) < 6.1 * 12_000


@settings(max_examples=80, deadline=None)
@given(
    scale=st.floats(1e-6, 1e5),
    values=st.lists(st.none() | st.floats(-1.0, 1.0), min_size=1, max_size=40).filter(
        lambda v: any(x is not None for x in v)
    ),
    steps=st.lists(st.integers(0, 100_000), min_size=40, max_size=40),
)
def test_any_force_survives_to_one_part_in_32_thousand(scale, values, steps):
    column = np.array(values, dtype=float) * min(scale, 1e5)
    ticks = np.cumsum(steps[: column.size])
    columns = Columns({"t": ticks / 1000.0, "fx": column, "fy": column, "fz": column})
    back = read(write(columns, ticks_per_s=1000))
    kept = ~np.isnan(column)
    limit = max(0.001, 2.0 * np.abs(column[kept]).max() / 32767.0)
    np.testing.assert_array_equal(back.values["t"], ticks[kept] / 1000.0)
    np.testing.assert_allclose(back.values["fx"], column[kept], rtol=0, atol=0.5001 * limit)


def test_what_cannot_be_written_is_refused():
    with pytest.raises(InvalidError, match="Time goes back"):
        write(Columns({"t": np.array([1.0, 0.5]), "temp": np.array([1.0, 2.0])}))
    with pytest.raises(InvalidError, match="nothing to send"):
        write(Columns({"t": np.array([1.0])}))
    with pytest.raises(InvalidError, match="2\\^32"):
        write(Columns({"t": np.array([0.0, 5000.0]), "temp": np.array([1.0, 2.0])}))


def changed(offset: int, fmt: str, value: float) -> bytes:
    body = bytearray(vectors()[0][0])
    struct.pack_into(fmt, body, offset, value)
    return sealed(body)


FIRST_BLOCK = HEAD.size
FIRST_COLUMN = FIRST_BLOCK + BLOCK.size
FIRST_VALUES = FIRST_COLUMN + 4 * COLUMN.size
SECOND_BLOCK = FIRST_VALUES + 4 * 8


@pytest.mark.parametrize(
    ("body", "says"),
    [
        (b"", "less than a header"),
        (vectors()[0][0][:-1], "the header tells of 332 bytes, 331 came"),
        (vectors()[0][0][:-1] + b"\0", "its CRC is"),
        (changed(0, "<B", 0x54), "does not begin with SCTB"),
        (changed(4, "<B", 2), "version 2; this service reads version 1"),
        (changed(5, "<B", 0), "0 blocks"),
        (changed(5, "<B", 3), "the header of block 2 .from 0. is cut off"),
        (changed(5, "<B", 1), "between the last block and the CRC"),
        (changed(6, "<H", 1), "flags"),
        (changed(12, "<I", 0), "0 ticks per second"),
        (changed(FIRST_BLOCK, "<I", 0), "block 0 .from 0. has 0 rows"),
        (changed(FIRST_BLOCK, "<I", 2**32 - 1), "column fx of block 0 .from 0. is cut off"),
        (changed(FIRST_BLOCK + 4, "<B", 0), "0 columns"),
        (changed(FIRST_BLOCK + 4, "<B", 22), "22 columns"),
        (changed(FIRST_BLOCK + 5, "<B", 3), "time of kind 3"),
        (changed(FIRST_BLOCK + 6, "<H", 1), "reserved"),
        (changed(FIRST_BLOCK + 8, "<q", -(2**63)), "begins at tick"),
        (changed(FIRST_COLUMN, "<B", 0), "number 0"),
        (changed(FIRST_COLUMN, "<B", len(NAMES)), f"number {len(NAMES)}"),
        (changed(FIRST_COLUMN, "<B", 2), "has a column twice"),
        (changed(FIRST_COLUMN + 1, "<B", 8), "type 8"),
        (changed(FIRST_COLUMN + 2, "<H", 8), "reserved"),
        (changed(FIRST_COLUMN + 8, "<d", 0.0), "scale 0"),
        (changed(FIRST_COLUMN + 8, "<d", float("nan")), "scale nan"),
        (changed(FIRST_COLUMN + 16, "<d", float("inf")), "offset inf"),
        (changed(SECOND_BLOCK + BLOCK.size + 4 * COLUMN.size, "<H", 7), "first step of a block is 7"),
        (changed(SECOND_BLOCK + BLOCK.size + 4 * COLUMN.size + 5, "<B", 7), "padding behind the time of block 1"),
    ],
)
def test_what_is_wrong_is_named(body, says):
    with pytest.raises(InvalidError, match=says) as refused:
        read(body)
    assert refused.value.code == "compact"


def test_a_scale_without_measure_is_out_of_range():
    with pytest.raises(InvalidError) as refused:
        read(changed(FIRST_COLUMN + 8, "<d", 1e308))
    assert (refused.value.code, refused.value.extra["column"]) == ("out_of_range", "fx")


def test_many_sparse_columns_do_not_fill_the_memory():
    # Eight blocks of one narrow column each: every row costs a byte sent and 72 decoded.
    rows, numbers = 200_000, (16, 18, 21, 10, 13, 14, 15, 17)
    blocks = b"".join(
        BLOCK.pack(rows, 1, 0, 0, 0, 1, 0) + COLUMN.pack(number, 1, 0, 0, 1.0, 0.0) + bytes(rows) for number in numbers
    )
    body = sealed(HEAD.pack(b"SCTB", 1, 8, 0, 0, 1000) + blocks + bytes(4))
    tracemalloc.start()
    with pytest.raises(TooLargeError):
        read(body, limit=64 * 1024 * 1024)
    assert tracemalloc.get_traced_memory()[1] < 4 * 1024 * 1024
    tracemalloc.stop()


@settings(max_examples=300, deadline=None)
@given(data=st.data(), which=st.sampled_from(range(2)))
def test_no_body_does_worse_than_a_problem(data, which):
    body = bytearray(vectors()[which][0])
    for _ in range(data.draw(st.integers(1, 6))):
        body[data.draw(st.integers(0, len(body) - 5))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.none() | st.integers(0, len(body)))
    try:
        columns = read(sealed(body[:cut]) if data.draw(st.booleans()) else bytes(body[:cut]))
    except (InvalidError, TooLargeError):
        return
    assert columns.rows > 0
