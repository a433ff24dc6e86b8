"""Uploads by a box that means harm: refused with a reason or stored harmlessly, and the next good one is taken."""

from __future__ import annotations

import gzip
import json
import struct
import tracemalloc
import zlib

import httpx
import pytest
import sqlalchemy as sa
import zstandard

from server.formats.compact import BLOCK, COLUMN, HEAD
from server.models import Batch

pytestmark = pytest.mark.both_databases
MEGABYTE = 1024 * 1024
GOOD = json.dumps({"columns": {"t": [0.0], "temp": [20.0]}}).encode()


class Box:
    """Sends whatever it is told to."""

    def __init__(self, client: httpx.Client, token: str) -> None:
        self._client, self._token = client, token

    def send(self, body=GOOD, *, key="b/0", **headers) -> httpx.Response:
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        given = {"Authorization": f"Bearer {self._token}", "Idempotency-Key": key, "Content-Type": "application/json"}
        return self._client.post("/api/v1/batches", content=body, headers=given | named)


@pytest.fixture
def box(client, make_device) -> Box:
    return Box(client, make_device()[1])


def columns(**named) -> bytes:
    return json.dumps({"columns": named}).encode()


def huge_count() -> bytes:
    body = HEAD.pack(b"SCTB", 1, 1, 0, 0, 1000) + BLOCK.pack(2**32 - 1, 1, 0, 0, 0, 1, 0)
    body += COLUMN.pack(10, 1, 0, 0, 1.0, 0.0) + bytes(16)
    body = body[:8] + struct.pack("<I", len(body) + 4) + body[12:]
    return body + struct.pack("<I", zlib.crc32(body))


HOSTILE = {
    "gzip bomb": (gzip.compress(bytes(200 * MEGABYTE), 9), {"Content_Encoding": "gzip"}, 413),
    "zstd bomb": (zstandard.compress(bytes(200 * MEGABYTE)), {"Content_Encoding": "zstd"}, 413),
    "bomb in a bomb": (gzip.compress(gzip.compress(bytes(50 * MEGABYTE))), {"Content_Encoding": "gzip"}, 422),
    "deep JSON": (b'{"columns":' + b"[" * 200_000, {}, 422),
    "deep objects": (b'{"columns":{"t":' * 50_000, {}, 422),
    "many commas": (b"[" + b"," * (9 * MEGABYTE) + b"]", {}, 413),
    "many lines that end in CR": (
        gzip.compress(b"t\n" + b"0\r" * (30 * MEGABYTE)),
        {"Content_Encoding": "gzip", "Content_Type": "text/csv"},
        413,
    ),
    "many lists": (
        gzip.compress(b'{"columns":{"t":[' + (b"[" * 900 + b"]" * 900 + b",") * 35_000 + b"1]}}"),
        {"Content_Encoding": "gzip"},
        422,
    ),
    "many keys": (b'{"columns":{' + b",".join(b'"%x":1' % n for n in range(MEGABYTE)) + b"}}", {}, 422),
    "floats beyond what they take": (
        gzip.compress(b'{"columns":{"t":[' + b"1.5," * (8 * MEGABYTE) + b"1]}}"),
        {"Content_Encoding": "gzip"},
        413,
    ),
    "heads of gzip": (gzip.compress(b"") * (700 * 1024), {"Content_Encoding": "gzip"}, 422),
    "heads of zstd": (zstandard.compress(b"") * MEGABYTE, {"Content_Encoding": "zstd"}, 422),
    "one line": (
        gzip.compress(b"1 " * (30 * MEGABYTE)),
        {"Content_Encoding": "gzip", "Content_Type": "application/vnd.scatola.thesis-line"},
        422,
    ),
    "records of nothing": (
        gzip.compress(b"\x89MCAP0\r\n" + struct.pack("<BQ", 0x80, 0) * (7 * MEGABYTE)),
        {"Content_Encoding": "gzip", "Content_Type": "application/mcap"},
        413,
    ),
    "NaN": (b'{"columns": {"t": [NaN]}}', {}, 422),
    "infinity": (b'{"columns": {"t": [1e999]}}', {}, 422),
    "a number without end": (b'{"columns": {"t": [' + b"9" * 100_000 + b"]}}", {}, 422),
    "huge count": (huge_count(), {"Content_Type": "application/vnd.scatola.batch"}, 422),
    "a name of a megabyte": (columns(**{"x" * MEGABYTE: [1.0], "t": [1.0]}), {}, 422),
    "no such encoding": (GOOD, {"Content_Encoding": "gzip, gzip, gzip"}, 415),
    "a type with a line in it": (GOOD, {"Content_Type": "application/json\tx"}, 415),
    "a key that climbs": (GOOD, {"Idempotency_Key": "../../etc/0"}, 422),
    "a key with a null": (GOOD, {"Idempotency_Key": "a%00/0"}, 422),
    "a key that is negative": (GOOD, {"Idempotency_Key": "a/-1"}, 422),
    "a key beyond all numbers": (GOOD, {"Idempotency_Key": "a/" + "9" * 30}, 422),
    "time beyond all clocks": (columns(t=[1e300]), {}, 422),
    "UTC before time began": (columns(t=[0.0], utc=[-1.0]), {}, 422),
}


@pytest.mark.parametrize("name", sorted(HOSTILE))
def test_it_is_refused_and_the_next_good_batch_is_taken(name, box, database):
    body, headers, status = HOSTILE[name]
    tracemalloc.start()
    answer = box.send(body, **headers)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert answer.status_code == status, answer.text[:500]
    assert answer.headers["content-type"] == "application/problem+json"
    assert len(answer.content) < 5000
    assert peak < 150 * MEGABYTE
    assert box.send().status_code == 202
    with database.reading() as session:
        assert session.scalar(sa.select(sa.func.count(Batch.id))) == 1


def test_odd_but_allowed_names_stay_in_their_place(box, settings):
    for number, boot in enumerate(("..", ".", "...", "-", "CON", "a" * 64)):
        assert box.send(columns(t=[float(number)], temp=[1.0]), key=f"{boot}/0").status_code == 202
    outside = [path for path in settings.data_dir.parent.rglob("*") if not path.is_relative_to(settings.data_dir)]
    assert outside == []


def test_time_travel_is_stored_remarked_and_worked_off(box, database, app, clock):
    from server.jobs.work import bring_up_to_date

    place = {"lat": [45.0] * 4, "lon": [11.0] * 4, "speed": [9.0] * 4, "fix": [1] * 4}
    force = {name: [1.0, 2.0, 3.0, 4.0] for name in ("fx", "fy", "fz")}
    journeys = [
        columns(t=[5.0, 1.0, 9e9, 2.0], utc=[1.7e9, 5e9, 0.0, 1.8e9], **place, **force),
        columns(t=[-1e10, -1e9, 0.0, 1e10], utc=[1e11, 1e11, 0.0, 0.0], **place),
        columns(t=[1.0, 1.0, 1.0, 1.0], utc=[1e11] * 4, **place, **force),
    ]
    for number, body in enumerate(journeys):
        assert box.send(body, key=f"b{number}/0", Scatola_Sent_At="-1e10").status_code == 202
    assert box.send(key="b0/1").status_code == 202
    with database.reading() as session:
        first = session.scalars(sa.select(Batch.remarks).order_by(Batch.chain_index)).first()
        device_id = session.scalars(sa.select(Batch.device_id)).first()
    assert [remark["code"] for remark in first] == ["rows_out_of_order"]
    bring_up_to_date(database, app.state.store, device_id, clock=clock)
    with database.reading() as session:
        assert session.scalar(sa.select(sa.func.count(Batch.id)).where(Batch.processed_at.is_(None))) == 0
