"""Nothing that was acknowledged is lost or processed twice, whatever is killed (the embedded mode, real processes)."""

from __future__ import annotations

import os
import signal
import sqlite3
import threading
from collections import Counter

import httpx
import pytest

from nav_core.simulate import Scenario, simulate
from server.formats.drive import from_drive
from server.uploader import Acknowledgement, Uploader, batches
from tests.e2e.service import Service, eventually

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

BOXES, MINUTES = 3, 5.0


class Box(threading.Thread):
    """Uploads a drive and remembers what was acknowledged."""

    def __init__(self, url: str, device: dict[str, str], seed: int) -> None:
        super().__init__()
        self.device, self.acknowledged = device, dict[int, Acknowledgement]()
        drive, self.truth = simulate(Scenario(duration=60.0 * MINUTES, accel_rate=100.0), seed=seed)
        self._parts = list(batches(from_drive(drive), 10.0))
        self._url = url

    def run(self) -> None:
        pause = threading.Event()
        with httpx.Client(base_url=self._url, timeout=10.0, trust_env=False) as client:
            uploader = Uploader(client, self.device["token"], "kill-1", wait=lambda s: pause.wait(min(s, 0.3)))
            for sequence, part in enumerate(self._parts):
                self.acknowledged[sequence] = uploader.send(sequence, part)
                pause.wait(0.15)


def query(service: Service, sql: str):
    with sqlite3.connect(f"file:{service.data_dir}/scatola.sqlite3?mode=ro", uri=True, timeout=30) as connection:
        rows = connection.execute(sql).fetchall()
    connection.close()
    return rows


def test_kill_9_loses_nothing_and_doubles_nothing(tmp_path):
    with Service(tmp_path / "data", "serve") as service, service.client() as admin:
        walk(service, admin)


def walk(service: Service, admin: httpx.Client):
    boxes = [
        Box(service.url, admin.post("/api/v1/devices", json={"name": f"box {n}"}).raise_for_status().json(), seed=n)
        for n in range(BOXES)
    ]
    for box in boxes:
        box.start()

    def acknowledged() -> int:
        return sum(len(box.acknowledged) for box in boxes)

    # The service dies, then its worker alone, then the service again, all under load.
    eventually(lambda: acknowledged() >= 12, within_s=60, what="12 batches")
    service.kill()
    service.start()
    eventually(lambda: acknowledged() >= 30, within_s=60, what="30 batches")
    os.kill(service.children()["worker"], signal.SIGKILL)
    eventually(lambda: acknowledged() >= 50, within_s=60, what="50 batches")
    service.kill()
    service.start()
    for box in boxes:
        box.join(120)
        assert not box.is_alive()

    def due() -> int:
        return query(service, "SELECT count(*) FROM batch WHERE processed_at IS NULL")[0][0]

    eventually(lambda: due() == 0, within_s=60, what="everything is worked off")
    rows = query(service, "SELECT id, device_id, sequence, failure FROM batch")
    expected = {(box.device["id"], n, ack.batch_id) for box in boxes for n, ack in box.acknowledged.items()}
    assert {(device, sequence, batch) for batch, device, sequence, _ in rows} == expected
    assert len(rows) == len(expected) == sum(len(box.acknowledged) for box in boxes)
    assert all(failure is None for *_, failure in rows)

    # Nothing twice: one digest for each batch, one track point for each second, one open trip and installation.
    assert query(service, "SELECT count(*) FROM batch_digest") == [(len(rows),)]
    for table in ("trip", "installation"):
        counts = Counter(device for (device,) in query(service, f"SELECT device_id FROM {table}"))
        assert counts == {box.device["id"]: 1 for box in boxes}, table
    for box in boxes:
        state = admin.get(f"/api/v1/devices/{box.device['id']}/installation").raise_for_status().json()
        assert state["status"] in {"ready", "settling"}
        (trip,) = admin.get("/api/v1/trips", params={"device": box.device["id"]}).raise_for_status().json()["items"]
        moved = float(abs(box.truth.v).sum() / 100.0)
        assert trip["distance_m"] == pytest.approx(moved, rel=0.05)
    assert service.stop() == 0
