"""Uploading: the contract of ``POST /api/v1/batches``, on both databases."""

from __future__ import annotations

import datetime as dt
import gzip
import hashlib
import json
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path

import httpx
import numpy as np
import pytest
import sqlalchemy as sa
import zstandard

from server.app import create_app
from server.devices.provisioning import ask_for_window
from server.devices.schemas import WindowIn
from server.errors import UnauthenticatedError
from server.formats.columns import Columns
from server.formats.tables import table_of
from server.ingest import queries, service, standing
from server.ingest.chain import instant, link
from server.models import Batch, Change, Device, SequenceRun
from server.store import open_store

MEGABYTE = 1024 * 1024


def columns(seed: int = 0, rows: int = 20) -> Columns:
    rng = np.random.default_rng(seed)
    force = {name: rng.normal(size=rows) for name in ("fx", "fy", "fz")}
    return Columns({"t": seed * 10.0 + np.arange(rows) * 0.05, **force})


def as_json(these: Columns) -> bytes:
    return json.dumps({"columns": {name: values.tolist() for name, values in these.values.items()}}).encode()


def as_arrow(these: Columns) -> bytes:
    import pyarrow as pa
    from pyarrow import ipc

    table = table_of(these)
    sink = pa.BufferOutputStream()
    with ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    return sink.getvalue().to_pybytes()


class Box:
    """A box that uploads."""

    def __init__(self, client: httpx.Client, device_id: str, token: str) -> None:
        self.client, self.device_id, self.token = client, device_id, token

    def send(self, sequence=0, body=None, *, boot="boot1", **headers) -> httpx.Response:
        named = {name.replace("_", "-"): value for name, value in headers.items() if value is not None}
        return self.client.post(
            "/api/v1/batches",
            content=as_json(columns(sequence if isinstance(sequence, int) else 0)) if body is None else body,
            headers={
                "Authorization": f"Bearer {self.token}",
                "Idempotency-Key": f"{boot}/{sequence}",
                "Content-Type": "application/json",
                **named,
            },
        )


@pytest.fixture
def box(client, make_device) -> Box:
    return Box(client, *make_device())


@pytest.mark.both_databases
def test_a_batch_is_stored_and_acknowledged(box, settings, database, clock):
    answer = box.send(0)
    assert answer.status_code == 202
    document = answer.json()
    assert set(document) == {"batch_id", "duplicate", "next_sequence", "missing", "server_time", "requests"}
    assert (document["duplicate"], document["next_sequence"]) == (False, 1)
    assert (document["missing"], document["requests"]) == ([], [])
    assert document["server_time"].startswith("2026-03-01T12:00:00")
    with database.reading() as session:
        batch = session.scalars(sa.select(Batch)).one()
        device = session.get_one(Device, box.device_id)
        change = session.scalars(sa.select(Change).where(Change.kind == "batch")).one()
    assert batch.id == document["batch_id"]
    assert (batch.stream, batch.boot, batch.sequence, batch.rows) == ("continuous", "boot1", 0, 20)
    assert (batch.t_first_s, batch.t_last_s) == (0.0, pytest.approx(0.95))
    assert batch.body_sha256 == hashlib.sha256(as_json(columns(0))).hexdigest()
    assert batch.column_sha256 == columns(0).column_sha256()
    assert batch.processed_at is None
    assert batch.body_key is None
    assert device.last_seen_at == clock()
    assert (change.device_id, change.data) == (box.device_id, {"stream": "continuous", "rows": 20})
    stored = Columns.from_parquet(open_store(settings).get(batch.blob_key))
    assert stored.column_sha256() == batch.column_sha256
    assert batch.blob_key == f"{device.organisation_id}/{device.id}/{batch.column_sha256}.parquet"


def test_all_media_types_and_encodings(box):
    csv = "t,fx,fy,fz\n0,0,0,-9.8\n0.1,,,\n"
    sent = [
        (as_json(columns(0)), "application/json", None),
        (gzip.compress(as_json(columns(1))), "application/json; charset=utf-8", "gzip"),
        (zstandard.compress(as_json(columns(2))), "application/json", "zstd"),
        (csv.encode(), "text/csv", "identity"),
        (columns(4).to_parquet(), "application/vnd.apache.parquet", None),
        (zstandard.compress(as_arrow(columns(5))), "application/vnd.apache.arrow.stream", "zstd"),
    ]
    for sequence, (body, media_type, encoding) in enumerate(sent):
        answer = box.send(sequence, body, Content_Type=media_type, Content_Encoding=encoding)
        assert answer.status_code == 202, answer.text
        assert answer.json()["next_sequence"] == sequence + 1


@pytest.mark.both_databases
def test_the_same_columns_hash_alike_whatever_carries_them(box, database):
    for sequence, (body, media_type) in enumerate(
        [
            (as_json(columns(3)), "application/json"),
            (columns(3).to_parquet(), "application/vnd.apache.parquet"),
            (as_arrow(columns(3)), "application/vnd.apache.arrow.stream"),
        ]
    ):
        assert box.send(sequence, body, Content_Type=media_type).status_code == 202
    with database.reading() as session:
        assert len(set(session.scalars(sa.select(Batch.column_sha256)))) == 1
        assert len(set(session.scalars(sa.select(Batch.body_sha256)))) == 3


@pytest.mark.both_databases
def test_a_repeat_is_acknowledged_and_another_body_refused(box, database):
    first = box.send(0).json()
    for encoding, body in (("gzip", gzip.compress(as_json(columns(0)))), (None, as_json(columns(0)))):
        again = box.send(0, body, Content_Encoding=encoding)
        assert again.status_code == 202
        assert again.json()["duplicate"] is True
        assert again.json()["batch_id"] == first["batch_id"]
        assert again.json()["next_sequence"] == 1
    other = box.send(0, as_json(columns(1)))
    assert (other.status_code, other.json()["code"]) == (409, "sequence_reused")
    retyped = box.send(0, b"t\n0\n", Content_Type="text/csv")
    assert retyped.status_code == 409
    assert box.send(0, b"not json").status_code == 409
    with database.reading() as session:
        assert session.scalar(sa.select(sa.func.count()).select_from(Batch)) == 1


@pytest.mark.both_databases
def test_the_key_belongs_to_boot_stream_and_device(box, client, make_device):
    other = Box(client, *make_device(name="other"))
    ids = {
        box.send(0).json()["batch_id"],
        box.send(0, boot="boot2").json()["batch_id"],
        box.send(0, Scatola_Stream="burst").json()["batch_id"],
        other.send(0).json()["batch_id"],
    }
    assert len(ids) == 4


@pytest.mark.both_databases
def test_bursts_keep_the_body_as_it_came(box, settings, database):
    body = as_json(columns(7))
    assert box.send(0, gzip.compress(body), Scatola_Stream="burst", Content_Encoding="gzip").status_code == 202
    with database.reading() as session:
        batch = session.scalars(sa.select(Batch)).one()
    assert batch.stream == "burst"
    assert open_store(settings).get(batch.body_key) == body
    assert batch.body_key.endswith(f"/{hashlib.sha256(body).hexdigest()}.body")


@pytest.mark.both_databases
def test_gaps_are_reported_and_filled(box):
    box.send(0)
    answer = box.send(5).json()
    assert (answer["next_sequence"], answer["missing"]) == (1, [[1, 4]])
    answer = box.send(2).json()
    assert (answer["next_sequence"], answer["missing"]) == (1, [[1, 1], [3, 4]])
    for sequence in (1, 3):
        box.send(sequence)
    answer = box.send(4).json()
    assert (answer["next_sequence"], answer["missing"]) == (6, [])
    late_start = box.send(3, boot="boot2").json()
    assert (late_start["next_sequence"], late_start["missing"]) == (0, [[0, 2]])


@pytest.mark.both_databases
def test_runs_agree_with_the_batches_whatever_the_order(box, database):
    order = np.random.default_rng(5).permutation(40)[:30].tolist()
    for count, sequence in enumerate(order, start=1):
        answer = box.send(sequence).json()
        stored = set(order[:count])
        absent = [n for n in range(max(stored)) if n not in stored]
        assert [n for first, last in answer["missing"] for n in range(first, last + 1)] == absent
        assert all(later[0] > earlier[1] + 1 for earlier, later in pairwise(answer["missing"]))
        assert answer["next_sequence"] == next(n for n in range(41) if n not in stored)
    with database.reading() as session:
        runs = session.execute(sa.select(SequenceRun.first, SequenceRun.last).order_by(SequenceRun.first)).all()
    assert sorted(n for first, last in runs for n in range(first, last + 1)) == sorted(order)


@pytest.mark.both_databases
@pytest.mark.parametrize("lost_every", [None, 50])
def test_progress_among_a_hundred_thousand_batches_is_found_quickly(box, database, lost_every):
    count = 100_000
    box.send(0)
    with database.transaction() as session:
        first = session.scalars(sa.select(Batch)).one()
        names = [column.name for column in Batch.__table__.columns]
        other = {"id": "printf('%032d', n)" if session.bind.dialect.name == "sqlite" else "lpad(n::text, 32, '0')"}
        other |= {"sequence": "n", "chain_index": "n"}
        session.execute(
            sa.text(
                "WITH RECURSIVE numbers(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM numbers WHERE n < :count) "
                f"INSERT INTO batch ({', '.join(names)}) SELECT {', '.join(other.get(name, name) for name in names)} "
                "FROM batch, numbers WHERE :every = 0 OR n % :every <> 0"
            ),
            {"count": count, "every": lost_every or 0},
        )
        session.get_one(Device, box.device_id).chain_length = count + 1
        session.execute(sa.delete(SequenceRun))
        step = lost_every or count + 1
        runs = [
            {"device_id": first.device_id, "stream": "continuous", "boot": "boot1", "first": begin, "last": end}
            for begin, end in (
                (n + 1 if n else 0, min(n + step - 1, count)) for n in range(0, count + 1, step) if n < count
            )
        ]
        session.execute(sa.insert(SequenceRun), runs)
    answer = box.send(count + 1).json()
    missing = [] if lost_every is None else [[n, n] for n in range(lost_every, 100 * lost_every + 1, lost_every)]
    assert answer["missing"] == missing
    assert answer["next_sequence"] == (missing[0][0] if missing else count + 2)
    taken = []
    for _ in range(5):
        began = time.perf_counter()
        with database.glance() as connection:
            queries.progress(queries.runs(connection, box.device_id, "continuous", "boot1"))
        taken.append(time.perf_counter() - began)
    assert min(taken) < 0.05


@pytest.mark.parametrize(
    ("headers", "status", "code"),
    [
        ({"Idempotency_Key": "boot1"}, 422, "idempotency_key"),
        ({"Idempotency_Key": "boot1/-1"}, 422, "idempotency_key"),
        ({"Idempotency_Key": "boot1/01"}, 422, "idempotency_key"),
        ({"Idempotency_Key": "boot1/1.0"}, 422, "idempotency_key"),
        ({"Idempotency_Key": "boot 1/1"}, 422, "idempotency_key"),
        ({"Idempotency_Key": "b" * 65 + "/1"}, 422, "idempotency_key"),
        ({"Idempotency_Key": "../../1/1"}, 422, "idempotency_key"),
        ({"Idempotency_Key": f"boot1/{2**53}"}, 422, "idempotency_key"),
        ({"Scatola_Stream": "crash"}, 422, "stream"),
        ({"Content_Type": "text/plain"}, 415, "unsupported_media_type"),
        ({"Content_Type": "application/vnd.scatola.other"}, 415, "unsupported_media_type"),
        ({"Content_Type": "text/csv; charset=latin-1"}, 415, "unsupported_media_type"),
        ({"Content_Encoding": "br"}, 415, "unsupported_media_type"),
        ({"Content_Encoding": "gzip"}, 422, "gzip"),
        ({"Content_Encoding": "zstd"}, 422, "zstd"),
    ],
)
def test_headers_that_are_refused(box, headers, status, code):
    answer = box.send(0, **headers)
    assert (answer.status_code, answer.json()["code"]) == (status, code)
    assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.both_databases
def test_extremes_of_the_key_are_taken(box):
    assert box.send(2**53 - 1, as_json(columns(0)), boot="a.B-c_9" * 9 + "x").status_code == 202


def test_a_key_is_needed(box):
    headers = {"Authorization": f"Bearer {box.token}", "Content-Type": "application/json"}
    answer = box.client.post("/api/v1/batches", content=as_json(columns(0)), headers=headers)
    assert (answer.status_code, answer.json()["code"]) == (422, "idempotency_key")
    headers = {"Authorization": f"Bearer {box.token}", "Idempotency-Key": "a/0"}
    assert box.client.post("/api/v1/batches", content=b"{}", headers=headers).status_code == 415


@pytest.mark.parametrize(
    ("body", "code"),
    [
        (b'{"columns": {"t": [0, 1], "temp": [1, NaN]}}', "not_finite"),
        (b'{"columns": {"t": [0, 1], "temp": [1]}}', "invalid"),
        (b'{"columns": {"t": [0], "lat": [91], "lon": [0]}}', "out_of_range"),
        (b'{"columns": {"x": [0]}}', "columns"),
        (b'{"columns": {"t": []}}', "empty"),
        (b"[" * 100_000, "json"),
        (b"", "json"),
    ],
)
def test_content_that_is_refused_leaves_nothing(box, database, settings, body, code):
    answer = box.send(0, body)
    assert (answer.status_code, answer.json()["code"]) == (422, code)
    with database.reading() as session:
        assert session.scalar(sa.select(sa.func.count()).select_from(Batch)) == 0
    assert not list((settings.data_dir / "blobs").rglob("*.parquet"))


@pytest.mark.both_databases
def test_time_that_goes_back_is_remarked_not_refused(box, database):
    assert box.send(0, b'{"columns": {"t": [0, 2, 1], "temp": [1, 2, 3]}}').status_code == 202
    with database.reading() as session:
        batch = session.scalars(sa.select(Batch)).one()
    assert [remark["code"] for remark in batch.remarks] == ["rows_out_of_order"]
    assert (batch.t_first_s, batch.t_last_s) == (0.0, 2.0)


def test_bodies_that_are_too_large(settings, clock, serve, box):
    small = settings.model_copy(update={"max_body_bytes": 1000, "max_decoded_bytes": 2000})
    with httpx.Client(base_url=serve(create_app(small, clock=clock)), timeout=30) as client:
        tight = Box(client, box.device_id, box.token)

        def unannounced():
            for _ in range(20):
                yield b" " * 500

        for body in (b" " * 1001, unannounced()):
            answer = tight.send(0, body)
            assert (answer.status_code, answer.json()["code"]) == (413, "too_large")
        for encoding, pack in (("gzip", gzip.compress), ("zstd", zstandard.compress)):
            answer = tight.send(0, pack(b" " * 2001), Content_Encoding=encoding)
            assert (answer.status_code, answer.json()["code"]) == (413, "too_large")
        many = b'{"columns": {"t": [' + b",".join(b"%d" % i for i in range(260)) + b"]}}"
        assert tight.send(0, gzip.compress(many), Content_Encoding="gzip").status_code == 413
        parquet = Columns({"t": np.zeros(300)}).to_parquet()
        assert len(parquet) < 1000
        assert tight.send(0, parquet, Content_Type="application/vnd.apache.parquet").status_code == 413
        assert tight.send(0, as_json(columns(0, rows=5))).status_code == 202


def test_bombs_stop_early(box):
    zeros = bytes(64 * MEGABYTE)
    gzip_bomb = gzip.compress(zeros + zeros, 9)
    zstd_bomb = zstandard.compress(zeros + zeros)
    for encoding, bomb in (("gzip", gzip_bomb), ("zstd", zstd_bomb)):
        answer = box.send(0, bomb, Content_Encoding=encoding)
        assert (answer.status_code, answer.json()["code"]) == (413, "too_large")


@pytest.mark.both_databases
def test_a_connection_that_ends_within_the_body_stores_nothing(box, database, address):
    host, port = address.removeprefix("http://").split(":")
    head = (
        "POST /api/v1/batches HTTP/1.1\r\nHost: x\r\n"
        f"Authorization: Bearer {box.token}\r\nIdempotency-Key: a/0\r\n"
        "Content-Type: application/json\r\nContent-Length: 1000\r\n\r\n"
    )
    with socket.create_connection((host, int(port))) as connection:
        connection.sendall(head.encode() + b'{"columns"')
    assert box.send(0).status_code == 202
    with database.reading() as session:
        assert session.scalar(sa.select(sa.func.count()).select_from(Batch)) == 1


def test_a_body_that_does_not_come_is_given_up(box, address, monkeypatch):
    monkeypatch.setattr("server.ingest.body.BODY_TIMEOUT_S", 0.2)
    host, port = address.removeprefix("http://").split(":")
    head = (
        "POST /api/v1/batches HTTP/1.1\r\nHost: x\r\n"
        f"Authorization: Bearer {box.token}\r\nIdempotency-Key: a/0\r\n"
        "Content-Type: application/json\r\nContent-Length: 1000\r\n\r\n"
    )
    with socket.create_connection((host, int(port)), timeout=10) as connection:
        connection.sendall(head.encode())
        assert b" 408 " in connection.recv(4096).split(b"\r\n")[0]


@pytest.mark.both_databases
def test_a_revoked_box_and_an_old_token_are_refused(box, admin):
    old = box.token
    box.token = admin.post(f"/api/v1/devices/{box.device_id}/token").json()["token"]
    assert box.send(0).status_code == 202
    assert box.client.post("/api/v1/batches", headers={"Authorization": f"Bearer {old}"}).status_code == 401
    admin.post(f"/api/v1/devices/{box.device_id}/revoke")
    assert box.send(1).status_code == 401


@pytest.mark.both_databases
def test_uploads_are_limited_per_device_before_the_body_is_read(settings, clock, serve, box, make_device):
    few = settings.model_copy(update={"device_requests_per_minute": 3})
    other_id, other_token = make_device(name="other")
    with httpx.Client(base_url=serve(create_app(few, clock=clock)), timeout=30) as client:
        limited = Box(client, box.device_id, box.token)
        assert [limited.send(n).status_code for n in range(4)] == [202, 202, 202, 429]
        answer = limited.send(3, b"x" * 100)
        assert (answer.status_code, answer.json()["code"]) == (429, "too_many_requests")
        assert answer.headers["retry-after"] == "21"
        assert Box(client, other_id, other_token).send(0).status_code == 202
        clock.advance(seconds=21)
        assert limited.send(3).status_code == 202


@pytest.mark.both_databases
def test_whoever_is_to_wake_is_told_of_the_device(app, client, make_device):
    woken: list[str] = []
    urgent: list[str] = []
    app.state.wake, app.state.wake_burst = woken.append, urgent.append
    box = Box(client, *make_device())
    box.send(0)
    box.send(0)
    assert (woken, urgent) == ([box.device_id], [])
    box.send(0, Scatola_Stream="burst")
    assert (woken, urgent) == ([box.device_id], [box.device_id])


@pytest.mark.both_databases
def test_the_chain_follows_from_what_is_stored(box, database, clock):
    for sequence in (0, 3, 1):
        box.send(sequence)
        clock.advance(seconds=1.5)
    box.send(0, Scatola_Stream="burst")
    with database.reading() as session:
        batches = session.scalars(sa.select(Batch).order_by(Batch.chain_index)).all()
        device = session.get_one(Device, box.device_id)
    previous = device.id
    for index, batch in enumerate(batches):
        assert batch.chain_index == index
        text = "\n".join(
            [
                "scatola-chain-1",
                previous,
                batch.body_sha256,
                batch.column_sha256,
                batch.stream,
                batch.boot,
                str(batch.sequence),
                batch.received_at.strftime("%Y-%m-%dT%H:%M:%S.%fZ"),
            ]
        )
        previous = hashlib.sha256(text.encode()).hexdigest()
        assert batch.chain_sha256 == previous
    assert (device.chain_length, device.chain_head) == (4, previous)
    assert instant(clock()).endswith(".500000Z")
    assert link("a", body_sha256="", column_sha256="", stream="", boot="", sequence=0, received_at=clock()) != previous


@pytest.mark.both_databases
def test_many_at_once_are_each_stored_once_in_one_chain(box, database):
    def send(number: int) -> tuple[int, bool]:
        answer = box.send(number % 12)
        return answer.status_code, answer.json()["duplicate"]

    with ThreadPoolExecutor(12) as pool:
        answers = list(pool.map(send, range(36)))
    assert {status for status, _ in answers} == {202}
    assert sum(not duplicate for _, duplicate in answers) == 12
    with database.reading() as session:
        batches = session.scalars(sa.select(Batch).order_by(Batch.chain_index)).all()
        device = session.get_one(Device, box.device_id)
    assert [batch.chain_index for batch in batches] == list(range(12))
    assert sorted(batch.sequence for batch in batches) == list(range(12))
    assert device.chain_head == batches[-1].chain_sha256
    assert box.send(12).json()["next_sequence"] == 13


@pytest.mark.both_databases
def test_the_same_key_with_two_bodies_at_once_stores_one(box):
    barrier = threading.Barrier(2)

    def send(seed: int) -> int:
        barrier.wait()
        return box.send(0, as_json(columns(seed, rows=2000))).status_code

    with ThreadPoolExecutor(2) as pool:
        assert sorted(pool.map(send, (1, 2))) == [202, 409]


@pytest.mark.both_databases
def test_nothing_is_acknowledged_that_is_not_durable(app, client, make_device, database, monkeypatch):
    box = Box(client, *make_device())

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(app.state.store, "put", full)
    assert box.send(0).status_code == 507
    monkeypatch.undo()
    with database.reading() as session:
        assert session.scalar(sa.select(sa.func.count()).select_from(Batch)) == 0
    assert box.send(0).json()["duplicate"] is False


def test_the_documented_example_is_true(box):
    text = (Path(__file__).parents[2] / "docs" / "device-protocol.md").read_text(encoding="utf-8")
    body = text.split("echo '", 1)[1].split("' | gzip", 1)[0].encode()
    answer = box.send(0, gzip.compress(body), Content_Encoding="gzip", boot="boot-7")
    assert (answer.status_code, answer.json()["next_sequence"]) == (202, 1), answer.text


def test_a_standing_that_is_no_longer_true_is_read_again(box, database):
    """What was read before another batch came, or before the box was revoked, does not count."""
    assert box.send(0).status_code == 202
    with database.glance() as connection:
        key = service.BatchKey("continuous", "boot1", 1)
        old = standing.read(connection, box.device_id, key, service.BoxNotes(), now=dt.datetime.now(dt.UTC))
    assert box.send(2).status_code == 202
    late = columns(5)
    upload = service.Upload(key, "application/json", "0" * 64, late, late.column_sha256(), "0" * 64, "k", None, 1)
    with database.transaction() as session:
        accepted = service.accept(session, box.device_id, upload, now=dt.datetime.now(dt.UTC), before=old)
    assert not accepted.duplicate
    assert accepted.standing.runs == [(0, 2)]
    with database.transaction() as session:
        again = service.accept(session, box.device_id, upload, now=dt.datetime.now(dt.UTC), before=old)
        assert (again.batch_id, again.duplicate) == (accepted.batch_id, True)
    with database.reading() as session:
        links = session.scalars(sa.select(Batch.chain_index).where(Batch.device_id == box.device_id)).all()
        assert sorted(links) == [0, 1, 2]
    with database.transaction() as session:
        session.get_one(Device, box.device_id).revoked_at = dt.datetime.now(dt.UTC)
    with database.transaction() as session, pytest.raises(UnauthenticatedError):
        service.accept(session, box.device_id, upload, now=dt.datetime.now(dt.UTC), before=again.standing)


def test_what_a_box_is_asked_for_is_told_once_however_many_runs_its_boot_has(box, database):
    assert [box.send(sequence).status_code for sequence in (0, 2, 4)] == [202] * 3
    wanted = [WindowIn(boot="boot1", t_first_s=float(k), t_last_s=k + 1.0, reason="look") for k in range(2)]
    with database.transaction() as session:
        organisation_id = session.get_one(Device, box.device_id).organisation_id
        now = dt.datetime.now(dt.UTC)
        asked = [ask_for_window(session, organisation_id, box.device_id, each, now=now) for each in wanted]
    answer = box.send(6).json()
    assert sorted(item["id"] for item in answer["requests"]) == sorted(asked)
    assert answer["missing"] == [[1, 1], [3, 3], [5, 5]]
