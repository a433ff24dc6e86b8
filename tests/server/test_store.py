"""Blobs: durable when put, never half there, and collected only when nothing speaks of them."""

from __future__ import annotations

import contextlib
import datetime as dt
import os
import stat
import threading
import time

import pytest
import sqlalchemy as sa
from pydantic import SecretStr

from server.models import Batch, Device
from server.store import blob_key, collect, open_store
from server.store.blobs import FolderStore
from server.store.objects import ObjectStore, StoreUnavailableError
from tests.e2e.service import free_port

KEY = blob_key("o" * 32, "d" * 32, "a" * 64, "parquet")
OTHER = blob_key("o" * 32, "d" * 32, "b" * 64, "body")


@pytest.fixture(params=["folder", "memory", "file"])
def store(request, tmp_path):
    if request.param == "folder":
        return FolderStore(tmp_path / "blobs")
    if request.param == "memory":
        return ObjectStore("memory:///")
    (tmp_path / "bucket").mkdir()
    return ObjectStore(f"file://{tmp_path}/bucket")


def in_an_hour() -> dt.datetime:
    return dt.datetime.now(dt.UTC) + dt.timedelta(hours=1)


def test_what_is_put_is_there(store):
    assert not store.exists(KEY)
    with pytest.raises(KeyError):
        store.get(KEY)
    store.put(KEY, b"one")
    store.put(OTHER, b"")
    store.put(KEY, b"one")
    assert (store.get(KEY), store.get(OTHER)) == (b"one", b"")
    assert store.exists(KEY)
    store.check()


def test_stale_blobs_are_deleted_and_renewed_ones_kept(store):
    store.put(KEY, b"one")
    assert list(store.stale(dt.datetime.now(dt.UTC) - dt.timedelta(hours=1))) == []
    assert [key for key in store.stale(in_an_hour()) if key != "probe"] == [KEY]
    assert not store.delete_stale(KEY, dt.datetime.now(dt.UTC) - dt.timedelta(hours=1))
    assert store.get(KEY) == b"one"
    assert store.delete_stale(KEY, in_an_hour())
    assert not store.exists(KEY)
    assert store.delete_stale(KEY, in_an_hour())


def test_the_settings_choose_the_store(settings, tmp_path):
    assert isinstance(open_store(settings), FolderStore)
    chosen = settings.model_copy(update={"blob_url": SecretStr(f"file://{tmp_path}")})
    assert isinstance(open_store(chosen), ObjectStore)


def test_keys_cannot_leave_the_folder(tmp_path):
    store = FolderStore(tmp_path / "blobs")
    for key in ("../secret", "/etc/passwd", "a/../../b", "a//b", "", ".partial/x", "a/.probe", "a\x00b", "a/b\n"):
        with pytest.raises(KeyError):
            store.put(key, b"")
        with pytest.raises(KeyError):
            store.get(key)


def test_a_put_of_what_is_there_renews_its_time(tmp_path):
    store = FolderStore(tmp_path)
    store.put(KEY, b"one")
    os.utime(tmp_path / KEY, (0, 0))
    assert list(store.stale(dt.datetime.now(dt.UTC) - dt.timedelta(hours=1))) == [KEY]
    store.put(KEY, b"one")
    assert list(store.stale(dt.datetime.now(dt.UTC) - dt.timedelta(hours=1))) == []


def test_a_blob_is_on_disk_before_it_has_its_name(tmp_path, monkeypatch):
    """The order of the system calls is the promise: data, name, folder."""
    calls: list[str] = []
    fsync, rename = os.fsync, os.rename

    def watched_fsync(descriptor: int) -> None:
        kind = "folder" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else "file"
        calls.append(f"fsync {kind}")
        fsync(descriptor)

    def watched_rename(source, target) -> None:
        calls.append("rename")
        rename(source, target)

    monkeypatch.setattr(os, "fsync", watched_fsync)
    monkeypatch.setattr(os, "rename", watched_rename)
    FolderStore(tmp_path).put(KEY, b"one")
    assert calls[-3:] == ["fsync file", "rename", "fsync folder"]
    assert calls[:-3] == ["fsync folder"] * 2  # the new folders' own entries


def test_a_write_that_fails_leaves_nothing(tmp_path, monkeypatch):
    store = FolderStore(tmp_path)

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        store.put(KEY, b"one")
    monkeypatch.undo()
    assert not store.exists(KEY)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_what_a_killed_process_left_is_swept(tmp_path):
    store = FolderStore(tmp_path)
    store.put(KEY, b"one")
    partial = tmp_path / ".partial" / "half"
    partial.write_bytes(b"ha")
    assert list(store.stale(in_an_hour())) == [KEY]
    assert not partial.exists()


def test_readers_never_see_half_a_blob(tmp_path):
    store = FolderStore(tmp_path)
    content = bytes(200_000)
    seen: set[int] = set()
    done = threading.Event()

    def read() -> None:
        while not done.is_set():
            if store.exists(KEY):
                seen.add(len(store.get(KEY)))

    reader = threading.Thread(target=read)
    reader.start()
    for _ in range(20):
        store.put(KEY, content)
        assert store.get(KEY) == content
    done.set()
    reader.join()
    assert seen <= {len(content)}


def test_puts_and_the_collector_may_race(tmp_path):
    """Whatever the order, after a put the blob is there: the collector sees the renewed time or finds it gone."""
    store = FolderStore(tmp_path)
    stop = time.monotonic() + 0.5
    border = dt.datetime.now(dt.UTC) - dt.timedelta(hours=1)

    def collect_always() -> None:
        while time.monotonic() < stop:
            store.delete_stale(KEY, border)

    collector = threading.Thread(target=collect_always)
    collector.start()
    rounds = 0
    while time.monotonic() < stop:
        store.put(KEY, b"one")
        path = tmp_path / KEY
        with contextlib.suppress(FileNotFoundError):
            os.utime(path, (0, 0))  # old again: fair game
        store.put(KEY, b"one")
        rounds += 1
    collector.join()
    assert store.exists(KEY)
    assert rounds > 10


@pytest.mark.both_databases
def test_only_blobs_without_a_row_are_collected(database, organisation, clock, tmp_path):
    store = FolderStore(tmp_path / "blobs")
    with database.transaction() as session:
        device = Device(organisation_id=organisation.id, name="box", token_hash="x" * 64, created_at=clock())
        session.add(device)
        session.flush()
        keys = [blob_key(organisation.id, device.id, letter * 64, "parquet") for letter in "abcd"]
        body = blob_key(organisation.id, device.id, "e" * 64, "body")
        session.add(_batch(device, 0, keys[0], body, clock()))
    for key in (*keys, body):
        store.put(key, b"content")
        os.utime(tmp_path / "blobs" / key, (0, 0))
    store.put(keys[3], b"content")  # put again: an upload is under way
    day_ago = dt.datetime.now(dt.UTC) - dt.timedelta(days=1)
    assert collect(store, database, day_ago) == 2
    assert [store.exists(key) for key in (*keys, body)] == [True, False, False, True, True]


@pytest.mark.both_databases
def test_a_row_that_comes_while_collecting_is_seen(database, organisation, clock, tmp_path):
    store = FolderStore(tmp_path / "blobs")
    with database.transaction() as session:
        device = Device(organisation_id=organisation.id, name="box", token_hash="x" * 64, created_at=clock())
        session.add(device)
    keys = [blob_key(organisation.id, device.id, letter * 64, "parquet") for letter in "ab"]
    for key in keys:
        store.put(key, b"content")
        os.utime(tmp_path / "blobs" / key, (0, 0))

    class Late(FolderStore):
        """While the first blob is being deleted, another process commits a row for the second."""

        def delete_stale(self, key: str, before: dt.datetime) -> bool:
            rest = next(other for other in keys if other != key)
            with database.transaction() as session:
                if session.scalar(sa.select(sa.func.count()).select_from(Batch)) == 0:
                    session.add(_batch(device, 0, rest, None, clock()))
            return super().delete_stale(key, before)

    assert collect(Late(tmp_path / "blobs"), database, dt.datetime.now(dt.UTC) - dt.timedelta(days=1)) == 1
    assert sum(store.exists(key) for key in keys) == 1


def _batch(device: Device, sequence: int, key: str, body_key: str | None, now: dt.datetime) -> Batch:
    return Batch(
        organisation_id=device.organisation_id,
        device_id=device.id,
        stream="continuous",
        boot="a",
        sequence=sequence,
        media_type="text/csv",
        body_sha256="",
        column_sha256="",
        blob_key=key,
        body_key=body_key,
        stored_bytes=1,
        rows=1,
        t_first_s=0.0,
        t_last_s=0.0,
        received_at=now,
        chain_index=sequence,
        chain_sha256="",
    )


@pytest.fixture
def absent(monkeypatch) -> ObjectStore:
    """A bucket of a store that is not there."""
    for name, value in {
        "AWS_ENDPOINT": f"http://127.0.0.1:{free_port()}",
        "AWS_ALLOW_HTTP": "true",
        "AWS_ACCESS_KEY_ID": "x",
        "AWS_SECRET_ACCESS_KEY": "y",
        "AWS_REGION": "us-east-1",
    }.items():
        monkeypatch.setenv(name, value)
    return ObjectStore("s3://scatola")


def test_a_store_that_does_not_answer_says_so_in_one_line(absent):
    for look in (lambda: absent.put(KEY, b""), lambda: absent.get(KEY), lambda: absent.exists(KEY), absent.check):
        with pytest.raises(StoreUnavailableError, match=r"^the object store: [^\n]*$"):
            look()


def test_a_box_keeps_its_batch_while_the_store_is_away(app, client, make_device, absent, settings):
    _, token = make_device()
    app.state.store = absent
    headers = {"Authorization": f"Bearer {token}", "Idempotency-Key": "b/0"}
    body = {"columns": {"t": [0.0], "temp": [20.0]}}
    answer = client.post("/api/v1/batches", json=body, headers=headers)
    assert (answer.status_code, answer.json()["code"]) == (503, "unavailable")
    assert int(answer.headers["retry-after"]) >= 1
    assert client.get("/readyz").json()["checks"]["store"] is False
    app.state.store = open_store(settings)
    answer = client.post("/api/v1/batches", json=body, headers=headers)
    assert (answer.status_code, answer.json()["duplicate"]) == (202, False)
