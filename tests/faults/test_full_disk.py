"""No room, no database: a clear problem, nothing half stored, and all goes on once there is room again."""

from __future__ import annotations

import os
import shutil
import subprocess

import numpy as np
import psycopg
import pytest
import sqlalchemy as sa

from server.app import create_app
from server.database import Database
from server.formats.columns import Columns
from server.models import Batch
from server.settings import Settings
from server.store import open_store
from tests.conftest import ADMIN_TOKEN, missing_service
from tests.e2e.servers import OwnPostgres, missing_servers

MEGABYTE = 1024 * 1024


@pytest.fixture
def small_disk(tmp_path):
    """A file system of a few megabytes."""
    folder = tmp_path / "small"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=8m", "none", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("a small file system can be mounted by root alone")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def noise(seed: int, rows: int = 12_000) -> bytes:
    """A batch that no compression makes small."""
    rng = np.random.default_rng(seed)
    force = {name: rng.normal(size=rows) for name in ("fx", "fy", "fz")}
    return Columns({"t": np.arange(rows) / 200.0, **force}).to_parquet()


class Box:
    def __init__(self, client, token: str) -> None:
        self._client, self._token = client, token

    def send(self, sequence: int, body: bytes):
        headers = {
            "Authorization": f"Bearer {self._token}",
            "Idempotency-Key": f"b/{sequence}",
            "Content-Type": "application/vnd.apache.parquet",
        }
        return self._client.post("/api/v1/batches", content=body, headers=headers)


def stored_whole(settings: Settings) -> int:
    """How many batches there are, each with all that belongs to it; nothing that was begun lies about."""
    database, store = Database(settings), open_store(settings)
    with database.reading() as session:
        batches = session.scalars(sa.select(Batch).order_by(Batch.chain_index)).all()
    assert [batch.sequence for batch in batches] == list(range(len(batches)))
    for batch in batches:
        assert Columns.from_parquet(store.get(batch.blob_key)).column_sha256() == batch.column_sha256
        assert batch.body_key is None or store.exists(batch.body_key)
    assert list((settings.data_dir / "blobs" / ".partial").iterdir()) == []
    database.dispose()
    return len(batches)


@pytest.mark.parametrize("full", ["blobs", "everything"])
def test_a_full_disk(small_disk, sqlite_template, serve, tmp_path, full):
    import httpx

    data = small_disk if full == "everything" else tmp_path / "data"
    data.mkdir(exist_ok=True)
    shutil.copy(sqlite_template, data / "scatola.sqlite3")
    if full == "blobs":
        (data / "blobs").symlink_to(small_disk)
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes(3 * MEGABYTE))
    settings = Settings(data_dir=data, database_url=None, admin_token=ADMIN_TOKEN)
    with httpx.Client(base_url=serve(create_app(settings)), timeout=30.0, trust_env=False) as client:
        admin = {"Authorization": f"Bearer {ADMIN_TOKEN}"}
        made = client.post("/api/v1/devices", json={"name": "box"}, headers=admin).raise_for_status().json()
        box = Box(client, made["token"])
        for sequence in range(100):
            answer = box.send(sequence, noise(sequence))
            if answer.status_code != 202:
                break
        assert sequence > 0
        assert (answer.status_code, answer.json()["code"]) == (507, "storage_full")
        assert answer.headers["content-type"] == "application/problem+json"
        assert int(answer.headers["retry-after"]) > 0
        assert box.send(sequence, noise(sequence)).status_code == 507
        assert stored_whole(settings) == sequence
        # What is small or already there is answered as ever.
        assert client.get("/healthz").status_code == 200
        assert box.send(0, noise(0)).json()["duplicate"] is True
        ballast.unlink()
        answer = box.send(sequence, noise(sequence))
        assert (answer.status_code, answer.json()["duplicate"]) == (202, False)
        assert stored_whole(settings) == sequence + 1


@pytest.mark.slow
@pytest.mark.postgres
def test_no_database(serve, tmp_path):
    import httpx

    from server.migrations import upgrade

    if lacking := missing_servers():
        missing_service(lacking)
    with OwnPostgres() as postgres:
        settings = Settings(data_dir=tmp_path, database_url=postgres.url, admin_token=ADMIN_TOKEN)
        upgrade(settings)
        with httpx.Client(base_url=serve(create_app(settings)), timeout=30.0, trust_env=False) as client:
            admin = {"Authorization": f"Bearer {ADMIN_TOKEN}"}
            made = client.post("/api/v1/devices", json={"name": "box"}, headers=admin).raise_for_status().json()
            box = Box(client, made["token"])
            assert box.send(0, noise(0, 100)).status_code == 202
            postgres.kill()
            for _ in range(3):
                answer = box.send(1, noise(1, 100))
                assert (answer.status_code, answer.json()["code"]) == (503, "unavailable"), answer.text
                assert int(answer.headers["retry-after"]) > 0
            postgres.start()
            assert box.send(1, noise(1, 100)).json()["duplicate"] is False
            assert stored_whole(settings) == 2
            with psycopg.connect(postgres.url, autocommit=True) as connection:
                connection.execute(
                    "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE pid <> pg_backend_pid()"
                )
            # A connection that was used a moment ago is not asked first: at most one answer each is 503.
            while (answer := box.send(2, noise(2, 100))).status_code == 503:
                pass
            assert answer.json()["duplicate"] is False
            assert stored_whole(settings) == 3
