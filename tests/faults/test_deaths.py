"""A box whose data kill every worker that comes to it: the others go on, and it ends as a dead letter, in both modes.

The kill is a real one: the worker sends itself SIGKILL in the middle of the job, as the kernel does for memory.
"""

from __future__ import annotations

import contextlib
import json
import os
import threading
from pathlib import Path

import httpx
import pytest
import sqlalchemy as sa

from nav_core.simulate import Scenario, simulate
from server.database import Database
from server.formats.columns import Columns
from server.formats.drive import from_drive
from server.jobs.attempts import DEATHS
from server.migrations import upgrade
from server.models import Batch, JobAttempt
from server.settings import Settings
from server.uploader import Uploader, batches
from tests.conftest import missing_service
from tests.e2e.servers import OwnPostgres, OwnRabbit, missing_servers
from tests.e2e.service import Service, eventually

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
ROOT = Path(__file__).parents[2]
MOST_DEATHS = DEATHS + 1
"""The first has no sign before it, so nothing was written down."""

# Loaded by every Python that is started with it in its path, before anything else.
POISON = """
import os, signal, sys
if "worker" in sys.orig_argv:
    from pathlib import Path
    from server.jobs import work
    real, poison = work.read_batch, Path(os.environ["POISON"])

    def read_batch(store, batch):
        if poison.exists() and batch.device_id == poison.read_text():
            with poison.with_suffix(".deaths").open("a") as deaths:
                deaths.write("x")
            os.kill(os.getpid(), signal.SIGKILL)
        return real(store, batch)

    work.read_batch = read_batch
"""


class Poisoned:
    """The box that kills, another one, and what became of them."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        (folder / "sitecustomize.py").write_text(POISON, encoding="utf-8")
        self._poison = folder / "poison"
        self.environment = {"PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)]), "POISON": str(self._poison)}

    @property
    def deaths(self) -> int:
        counted = self._poison.with_suffix(".deaths")
        return len(counted.read_text()) if counted.exists() else 0

    def upload(self, service: Service, admin: httpx.Client) -> tuple[str, str]:
        """A drive of each of two boxes; the first one's is poisoned from its beginning."""
        drive = from_drive(simulate(Scenario(duration=30.0, accel_rate=100.0), seed=1)[0])
        made = [admin.post("/api/v1/devices", json={"name": f"box {n}"}).raise_for_status().json() for n in range(2)]
        self._poison.write_text(made[0]["id"], encoding="utf-8")
        for box in made:
            self.send(service, box["token"], "b", drive)
        self.token = made[0]["token"]
        return made[0]["id"], made[1]["id"]

    def send(self, service: Service, token: str, boot: str, columns: Columns) -> None:
        with httpx.Client(base_url=service.url, timeout=20.0, trust_env=False) as client:
            uploader = Uploader(client, token, boot, wait=lambda s: threading.Event().wait(min(s, 0.3)))
            for sequence, part in enumerate(batches(columns, 10.0)):
                uploader.send(sequence, part)

    def heal(self) -> None:
        self._poison.unlink()


def check(settings: Settings, service: Service, admin: httpx.Client, poisoned: Poisoned) -> None:
    bad, good = poisoned.upload(service, admin)
    database = Database(settings)

    def waiting(device_id: str) -> int:
        with database.reading() as session:
            count = sa.select(sa.func.count()).where(Batch.device_id == device_id, Batch.processed_at.is_(None))
            return session.scalar(count) or 0

    def letters() -> list[dict[str, object]]:
        return admin.get("/api/v1/jobs/failures", params={"dead": True}).raise_for_status().json()["items"]

    (letter,) = eventually(letters, within_s=240, what="the box is a dead letter")
    assert letter["device_id"] == bad
    assert f"the worker died during the job, {DEATHS} times in a row" in json.dumps(letter)
    assert poisoned.deaths == MOST_DEATHS
    eventually(lambda: waiting(good) == 0, within_s=120, what="the other box is worked off")
    # What the box goes on to send costs no further worker.
    drive = from_drive(simulate(Scenario(duration=10.0, accel_rate=100.0), seed=2)[0])
    before = waiting(bad)
    poisoned.send(service, poisoned.token, "c", drive)
    other = admin.post("/api/v1/devices", json={"name": "later"}).raise_for_status().json()
    poisoned.send(service, other["token"], "b", drive)
    eventually(lambda: waiting(other["id"]) == 0, within_s=120, what="a later box is worked off")
    assert waiting(bad) > before
    assert poisoned.deaths == MOST_DEATHS
    # The cause is mended, and the letter replayed like any other.
    poisoned.heal()
    admin.post(f"/api/v1/jobs/failures/{bad}/replay").raise_for_status()
    eventually(lambda: waiting(bad) == 0, within_s=120, what="the box is worked off")
    assert not letters()
    with database.reading() as session:
        assert session.scalar(sa.select(sa.func.count()).select_from(JobAttempt)) == 0
    database.dispose()


def test_embedded(tmp_path):
    poisoned = Poisoned(tmp_path / "poison")
    with (
        Service(tmp_path / "data", "serve", environment=poisoned.environment) as service,
        service.client() as admin,
    ):
        check(Settings(data_dir=tmp_path / "data", database_url=None), service, admin, poisoned)
        assert service.stop() == 0


@pytest.mark.postgres
@pytest.mark.rabbitmq
def test_production(tmp_path):
    if lacking := missing_servers():
        missing_service(lacking)
    poisoned = Poisoned(tmp_path / "poison")
    with contextlib.ExitStack() as stack:
        postgres, rabbit = stack.enter_context(OwnPostgres()), stack.enter_context(OwnRabbit())
        settings = Settings(data_dir=tmp_path / "data", database_url=postgres.url)
        upgrade(settings)
        told = {"SCATOLA_DATABASE_URL": postgres.url, "SCATOLA_BROKER_URL": rabbit.url, **poisoned.environment}
        service = stack.enter_context(Service(Path(settings.data_dir), "serve", environment=told))
        stack.enter_context(restarted(Path(settings.data_dir), told))
        check(settings, service, stack.enter_context(service.client()), poisoned)


@contextlib.contextmanager
def restarted(data_dir: Path, told: dict[str, str]):
    """A worker that is started again when it dies, as its container would be."""
    ended = threading.Event()
    with Service(data_dir, "worker", environment=told, greets=False) as worker:

        def keep() -> None:
            while not ended.wait(0.2):
                if worker.process is not None and worker.process.poll() is not None:
                    worker.start()

        thread = threading.Thread(target=keep)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()
