"""kill -9 at random moments under load, in both modes: no acknowledged batch is lost, none processed twice.

A few in the suite; ``make test-faults`` sets SCATOLA_KILLS to 200 for each mode.  SCATOLA_KILL_SEED repeats a run.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import threading
import time
from collections.abc import Callable, Generator, Mapping
from pathlib import Path

import httpx
import pytest
import sqlalchemy as sa

from nav_core.simulate import Scenario, simulate
from server.database import Database
from server.formats.columns import Columns
from server.formats.drive import from_drive
from server.migrations import upgrade
from server.models import Batch, BatchDigest, Trip
from server.settings import Settings
from server.uploader import Uploader, batches
from tests.conftest import missing_service
from tests.e2e.servers import OwnPostgres, OwnRabbit, missing_servers
from tests.e2e.service import Service, eventually

KILLS = int(os.environ.get("SCATOLA_KILLS", "0"))
FEW = 4
BOXES = 3
pytestmark = [pytest.mark.slow, pytest.mark.timeout(300 + 60 * KILLS)]

Kill = Callable[[], None]


class Box(threading.Thread):
    """Drives the same minutes again and again, a boot each, and remembers what was acknowledged."""

    def __init__(self, url: str, made: dict[str, str], seed: int) -> None:
        super().__init__(daemon=True)
        self.device_id, self._token = made["id"], made["token"]
        drive, truth = simulate(Scenario(duration=120.0, accel_rate=100.0), seed=seed)
        self.moved_m = float(abs(truth.v).sum() / 100.0)
        self._columns, self._url = from_drive(drive), url
        self.acknowledged: dict[tuple[str, int], str] = {}
        self.boots: list[str] = []
        self.enough = threading.Event()

    def run(self) -> None:
        pause = threading.Event()
        with httpx.Client(base_url=self._url, timeout=15.0, trust_env=False) as client:
            while not self.enough.is_set():
                boot = f"kill-{len(self.boots)}"
                uploader = Uploader(client, self._token, boot, wait=lambda s: pause.wait(min(s, 0.3)))
                for sequence, part in enumerate(batches(self._later(len(self.boots)), 10.0)):
                    self.acknowledged[boot, sequence] = uploader.send(sequence, part).batch_id
                    pause.wait(0.05)
                self.boots.append(boot)

    def _later(self, times: int) -> Columns:
        values = self._columns.values
        return Columns({**values, "utc": values["utc"] + 3600.0 * times})


def kill_at_random(boxes: list[Box], kills: Mapping[str, Kill], count: int) -> None:
    """Each kind once, then at random; between two, at least one more batch was acknowledged."""
    seed = int(os.environ.get("SCATOLA_KILL_SEED", time.time_ns() % 10**6))
    draw = random.Random(seed)
    order = [*kills, *draw.choices(list(kills), k=max(0, count - len(kills)))][:count]
    draw.shuffle(order)
    print(f"seed {seed}: {count} kills: " + ", ".join(f"{order.count(name)} of {name}" for name in kills))
    pause = threading.Event()
    for number, name in enumerate(order):
        before = sum(len(box.acknowledged) for box in boxes)
        eventually(
            lambda before=before: sum(len(box.acknowledged) for box in boxes) > before or not any_alive(boxes),
            within_s=120,
            what=f"uploads go on before kill {number} ({name})",
        )
        assert all(box.is_alive() for box in boxes), "a box gave up"
        pause.wait(draw.uniform(0.0, 1.0))
        kills[name]()


def any_alive(boxes: list[Box]) -> bool:
    return any(box.is_alive() for box in boxes)


def check(settings: Settings, boxes: list[Box]) -> None:
    """Everything acknowledged is there, was worked off, and counts once."""
    for box in boxes:
        box.enough.set()
    for box in boxes:
        box.join(240)
        assert not box.is_alive()
    database = Database(settings)

    def worked_off() -> bool:
        with database.reading() as session:
            return session.scalar(sa.select(sa.func.count()).where(Batch.processed_at.is_(None))) == 0

    eventually(worked_off, within_s=300, what="everything is worked off")
    expected = {
        (box.device_id, boot, sequence, batch_id)
        for box in boxes
        for (boot, sequence), batch_id in box.acknowledged.items()
    }
    with database.reading() as session:
        stored = session.execute(sa.select(Batch.device_id, Batch.boot, Batch.sequence, Batch.id)).all()
        assert {tuple(row) for row in stored} == expected
        assert len(stored) == len(expected)
        assert session.scalar(sa.select(sa.func.count()).where(Batch.failure.is_not(None))) == 0
        assert session.scalar(sa.select(sa.func.count()).select_from(BatchDigest)) == len(stored)
        for box in boxes:
            driven = dict.fromkeys(box.boots, 0.0)
            for boot, distance_m in session.execute(
                sa.select(Trip.boot, Trip.distance_m).where(Trip.device_id == box.device_id)
            ):
                driven[boot] += distance_m
            # What was counted twice or not at all would show in the way that was driven.
            assert driven == pytest.approx(dict.fromkeys(box.boots, box.moved_m), rel=0.05)
    database.dispose()
    print(f"{len(expected)} batches of {sum(len(box.boots) for box in boxes)} boots, each once")


@contextlib.contextmanager
def uploading(service: Service) -> Generator[list[Box]]:
    with service.client() as admin:
        boxes = [
            Box(service.url, admin.post("/api/v1/devices", json={"name": f"box {n}"}).raise_for_status().json(), seed=n)
            for n in range(BOXES)
        ]
    for box in boxes:
        box.start()
    try:
        yield boxes
    finally:
        for box in boxes:
            box.enough.set()


@pytest.mark.skipif(not KILLS, reason="tests/e2e/test_kill.py kills this mode in the suite; SCATOLA_KILLS does here")
def test_embedded(tmp_path):
    with Service(tmp_path / "data", "serve") as service, uploading(service) as boxes:

        def whole() -> None:
            service.kill()
            service.start()

        def child(name: str) -> None:
            # Between a death and the new start there is none to kill.
            pid = eventually(lambda: service.children().get(name), within_s=60, what=f"the {name} runs")
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

        kill_at_random(boxes, {"API and all": whole, "worker": lambda: child("worker")}, KILLS)
        check(Settings(data_dir=tmp_path / "data", database_url=None), boxes)


@pytest.mark.postgres
@pytest.mark.rabbitmq
def test_production(tmp_path):
    if lacking := missing_servers():
        missing_service(lacking)
    with contextlib.ExitStack() as stack:
        postgres, rabbit = stack.enter_context(OwnPostgres()), stack.enter_context(OwnRabbit())
        settings = Settings(data_dir=tmp_path / "data", database_url=postgres.url)
        upgrade(settings)
        told = {"SCATOLA_DATABASE_URL": postgres.url, "SCATOLA_BROKER_URL": rabbit.url}
        service = stack.enter_context(Service(Path(settings.data_dir), "serve", environment=told))
        worker = stack.enter_context(Service(Path(settings.data_dir), "worker", environment=told, greets=False))
        boxes = stack.enter_context(uploading(service))

        def again(one: Service | OwnPostgres | OwnRabbit) -> Kill:
            def kill() -> None:
                # A worker that finds no database when it starts may end, as its container would: it is started again.
                if not isinstance(one, Service) or (one.process is not None and one.process.poll() is None):
                    one.kill()
                one.start()
                if isinstance(one, OwnPostgres):
                    for other in (service, worker):
                        if other.process is not None and other.process.poll() is not None:
                            other.start()

            return kill

        kills = {"API": again(service), "worker": again(worker), "broker": again(rabbit), "database": again(postgres)}
        kill_at_random(boxes, kills, KILLS or FEW)
        if worker.process is not None and worker.process.poll() is not None:
            worker.start()
        check(settings, boxes)
