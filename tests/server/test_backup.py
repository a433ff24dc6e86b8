"""What a backup holds comes back: by either database, into either, taken while uploads go on."""

from __future__ import annotations

import datetime as dt
import json
import threading
import uuid

import httpx
import pytest
import sqlalchemy as sa

from server.backup.archive import BackupError, backup, restore
from server.backup.tables import BLOB_COLUMNS
from server.cli.main import main
from server.database import Database, make_engine
from server.migrations import upgrade
from server.models import Analysis, AuditEntry, Base, Batch, Change
from server.settings import Settings
from server.store import open_store
from tests.e2e.service import eventually

NOW = dt.datetime(2026, 3, 1, tzinfo=dt.UTC)


@pytest.fixture
def fresh(tmp_path, request):
    """Settings of an installation that was never started, by the kind of its database."""
    made = []

    def make(dialect: str) -> Settings:
        folder = tmp_path / uuid.uuid4().hex
        if dialect == "sqlite":
            return Settings(data_dir=folder, database_url=None)
        url = sa.make_url(request.getfixturevalue("postgres_url"))
        name = f"scatola_test_{uuid.uuid4().hex[:12]}"
        server = sa.create_engine(url.set(database="postgres"), isolation_level="AUTOCOMMIT")
        with server.connect() as connection:
            connection.execute(sa.text(f'CREATE DATABASE "{name}"'))
        made.append((server, name))
        return Settings(data_dir=folder, database_url=url.set(database=name).render_as_string(hide_password=False))

    yield make
    for server, name in made:
        with server.connect() as connection:
            connection.execute(sa.text(f'DROP DATABASE "{name}" WITH (FORCE)'))
        server.dispose()


def upload(address: str, token: str, k: int) -> None:
    columns = {"t": [k + 0.0, k + 0.5], "fx": [0.1 * k, -0.0], "fy": [0, 0], "fz": [-9.8, -20.0]}
    headers = {"Authorization": f"Bearer {token}", "Idempotency-Key": f"boot/{k}"}
    answer = httpx.post(f"{address}/api/v1/batches", json={"columns": columns}, headers=headers, timeout=60.0)
    answer.raise_for_status()


@pytest.fixture
def loaded(address, admin, make_device):
    """An installation that is uploaded to until the test ends."""
    _, token = make_device()
    admin.post("/api/v1/vehicles", json={"name": "Grün 1e22"}).raise_for_status()
    for k in range(5):
        upload(address, token, k)
    stop, sent = threading.Event(), [5]

    def go_on() -> None:
        while not stop.is_set():
            upload(address, token, sent[0])
            sent[0] += 1

    thread = threading.Thread(target=go_on)
    thread.start()
    yield sent
    stop.set()
    thread.join()


@pytest.mark.postgres
@pytest.mark.both_databases
@pytest.mark.parametrize("into", ["sqlite", "postgresql"])
def test_a_backup_taken_under_load_comes_back_equal(settings, loaded, fresh, tmp_path, into):
    eventually(lambda: loaded[0] > 5, within_s=30, what="uploads before the backup")
    before = loaded[0]
    taken = backup(settings, tmp_path / "out", now=NOW)
    eventually(lambda: loaded[0] > before, within_s=30, what="uploads go on after the backup")
    assert taken.lost_blobs == []
    other = fresh(into)
    restored = restore(other, tmp_path / "out")
    assert restored.content_sha256 == taken.content_sha256
    # Not by what it says of itself alone: a backup of the copy has the same content.
    again = backup(other, tmp_path / "again", now=NOW)
    assert again.content_sha256 == taken.content_sha256
    assert again.blobs == {**taken.blobs, "file_sha256": again.blobs["file_sha256"]}
    database, store = Database(other), open_store(other)
    with database.transaction() as session:
        batches = session.scalars(sa.select(Batch).order_by(Batch.chain_index)).all()
        assert [batch.sequence for batch in batches] == list(range(len(batches)))
        assert len(batches) >= before
        for batch in batches:
            store.get(batch.blob_key)
            assert batch.body_key is None or store.get(batch.body_key)
        # Numbers that the database gives go on after those that came back.
        highest = session.scalar(sa.select(sa.func.max(Change.id)))
        organisation = batches[0].organisation_id
        session.add(Change(at=NOW, organisation_id=organisation, kind="x"))
        session.add(
            AuditEntry(
                at=NOW,
                organisation_id=organisation,
                actor_kind="x",
                actor_name="x",
                action="x",
                subject="x",
                address="",
            )
        )
        session.flush()
        assert session.scalar(sa.select(sa.func.max(Change.id))) == highest + 1
    database.dispose()


def run(settings: Settings, monkeypatch, *arguments: str) -> int:
    monkeypatch.setenv("SCATOLA_DATA_DIR", str(settings.data_dir))
    return main(list(arguments))


@pytest.mark.usefixtures("loaded")
def test_the_commands_and_the_chain_of_the_copy(settings, fresh, tmp_path, monkeypatch, capsys):
    out = str(tmp_path / "out")
    assert run(settings, monkeypatch, "backup", out, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    other = fresh("sqlite")
    assert run(other, monkeypatch, "restore", out, "--json") == 0
    assert json.loads(capsys.readouterr().out)["content_sha256"] == told["content_sha256"]
    assert run(other, monkeypatch, "verify", "--json") == 0
    assert json.loads(capsys.readouterr().out)["passed"]
    # Neither over what is there.
    assert run(settings, monkeypatch, "backup", out) == 1
    assert run(other, monkeypatch, "restore", out) == 1
    assert "not empty" in capsys.readouterr().err


@pytest.mark.parametrize("damage", ["blob", "table", "manifest", "missing"])
def test_a_damaged_backup_brings_back_nothing(settings, address, make_device, fresh, tmp_path, damage):
    _, token = make_device()
    for k in range(3):
        upload(address, token, k)
    out = tmp_path / "out"
    backup(settings, out, now=NOW)
    blob = next((out / "blobs").rglob("*.parquet"))
    if damage == "blob":
        blob.write_bytes(blob.read_bytes()[:-1] + b"x")
    elif damage == "missing":
        blob.unlink()
    elif damage == "table":
        path = out / "tables" / "batch.jsonl.zst"
        path.write_bytes(path.read_bytes()[:-5])
    else:
        manifest = json.loads((out / "manifest.json").read_text())
        manifest["tables"]["batch"]["rows"] += 1
        (out / "manifest.json").write_text(json.dumps(manifest))
    other = fresh("sqlite")
    with pytest.raises(BackupError):
        restore(other, out)
    engine = make_engine(other)
    with engine.connect() as connection:
        assert connection.execute(sa.text("SELECT count(*) FROM batch")).scalar() == 0
    engine.dispose()


def test_a_lost_blob_is_named_and_an_empty_or_newer_database_refused(settings, address, make_device, fresh, tmp_path):
    _, token = make_device()
    upload(address, token, 0)
    next((settings.data_dir / "blobs").rglob("*.parquet")).unlink()
    assert len(backup(settings, tmp_path / "out", now=NOW).lost_blobs) == 1
    with pytest.raises(BackupError, match="never migrated"):
        backup(fresh("sqlite"), tmp_path / "none", now=NOW)
    with pytest.raises(BackupError, match="no backup"):
        restore(fresh("sqlite"), tmp_path)
    manifest = tmp_path / "out" / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"revision": "', '"revision": "9'))
    with pytest.raises(BackupError, match="does not know"):
        restore(fresh("sqlite"), tmp_path / "out")


def test_an_older_backup_is_migrated_after_it_came_back(fresh, tmp_path, monkeypatch):
    old = fresh("sqlite")
    upgrade(old, "0005")
    engine = make_engine(old)
    with engine.begin() as connection:
        connection.execute(sa.text("INSERT INTO organisation VALUES ('o', 'n', '2026-01-01 00:00:00.000000')"))
    engine.dispose()
    assert run(old, monkeypatch, "backup", str(tmp_path / "out")) == 0
    other = fresh("sqlite")
    assert run(other, monkeypatch, "restore", str(tmp_path / "out")) == 0
    engine = make_engine(other)
    with engine.connect() as connection:
        assert connection.execute(sa.text("SELECT name FROM organisation")).scalar() == "n"
        assert connection.execute(sa.text("SELECT count(*) FROM job_failure")).scalar() == 0
    engine.dispose()


def test_every_column_that_names_a_blob_is_backed_up():
    names = {column.name for table in Base.metadata.tables.values() for column in table.columns}
    others = {"idempotency_key", "public_key"}
    assert {name for name in names if name.endswith("_key")} - others == set(BLOB_COLUMNS)


def test_the_workbenchs_files_come_back(settings, database, organisation, fresh, tmp_path):
    store = open_store(settings)
    keys = {"input_key": f"{organisation.id}/workbench/in.input", "result_key": f"{organisation.id}/workbench/out.json"}
    for key in keys.values():
        store.put(key, key.encode())
    with database.transaction() as session:
        analysis = Analysis(
            organisation_id=organisation.id, creator="ada", kind="allan", name="rest", parameters={}, created_at=NOW,
            status="done", **keys,
        )  # fmt: skip
        session.add(analysis)
    taken = backup(settings, tmp_path / "out", now=NOW)
    assert (taken.blobs["count"], taken.lost_blobs) == (2, [])
    other = fresh("sqlite")
    assert restore(other, tmp_path / "out").content_sha256 == taken.content_sha256
    assert [open_store(other).get(key) for key in keys.values()] == [key.encode() for key in keys.values()]
