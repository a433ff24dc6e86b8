"""An installation of its own: its folder, its database and its processes; run as a script, it is the API's process."""

from __future__ import annotations

import contextlib
import itertools
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import httpx
import sqlalchemy as sa
import uvicorn

from server.app import create_app
from server.database import make_engine
from server.migrations import upgrade
from server.settings import Settings
from tests.e2e.servers import OwnPostgres
from tests.e2e.service import eventually, free_port

TOKEN = "measure"  # noqa: S105  of a service that nobody else reaches
CORES = sorted(os.sched_getaffinity(0))
API_CORE, OTHERS = {CORES[0]}, set(CORES[1:]) or {CORES[0]}
TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")
ROOT = Path(__file__).resolve().parents[1]


@dataclass
class Api:
    """A running API process."""

    folder: Path
    port: int
    environment: dict[str, str]
    process: subprocess.Popen[bytes]
    database_url: str | None = None
    postgres_pid: int | None = None
    boxes: Iterator[int] = field(default_factory=itertools.count)

    @property
    def url(self) -> str:
        """Address."""
        return f"http://127.0.0.1:{self.port}"

    def cpu_s(self) -> float:
        """Processor time so far."""
        return cpu_s(self.process.pid)

    def all_cpu_s(self) -> float:
        """Processor time so far, with PostgreSQL's."""
        total = self.cpu_s()
        if self.postgres_pid is not None:
            # Its processes are its children; what ended was waited for by it.
            children = Path(f"/proc/{self.postgres_pid}/task/{self.postgres_pid}/children").read_text(encoding="utf-8")
            total += sum(cpu_s(int(pid)) for pid in (self.postgres_pid, *children.split()))
        return total

    def memory_mb(self) -> float:
        """Resident memory."""
        status = Path(f"/proc/{self.process.pid}/status").read_text(encoding="utf-8")
        return int(status.split("VmRSS:")[1].split()[0]) / 1024.0

    def stored_bytes(self) -> int:
        """On disk: blobs in whole blocks, and the tables of PostgreSQL."""
        files = (path for path in (self.folder / "data" / "blobs").rglob("*") if path.is_file())
        total = sum(512 * path.stat().st_blocks for path in files)
        engine = make_engine(Settings(data_dir=self.folder / "data", database_url=self.database_url))
        with engine.connect() as connection:
            tables = (
                "SELECT sum(pg_total_relation_size(oid)) FROM pg_class "
                "WHERE relkind = 'r' AND relnamespace = 'public'::regnamespace"
            )
            total += int(connection.scalar(sa.text(tables)))
        engine.dispose()
        return total

    def stop(self) -> None:
        """End the process; the data stay."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            self.process.wait(30)


def cpu_s(pid: int) -> float:
    """Processor time of a process and of those that it has waited for."""
    words = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()
    return TICK_S * sum(map(int, words[11:15]))


def start(arguments: list[str], environment: dict[str, str], cores: set[int]) -> subprocess.Popen[bytes]:
    """A Python process of ours on some cores."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith("SCATOLA_")}
    process = subprocess.Popen(  # noqa: S603  our own scripts
        [sys.executable, *arguments], env=clean | environment, cwd=ROOT, stdout=subprocess.DEVNULL
    )
    os.sched_setaffinity(process.pid, cores)
    return process


@contextlib.contextmanager
def installation(database: str, *, broker_url: str | None = None, whole: bool = False) -> Generator[Api]:
    """An API process on the first core; `whole` is `scatola serve` with its worker, which may use all."""
    folder = Path(tempfile.mkdtemp(prefix="scatola-bench-"))
    port = free_port()
    environment = {
        "SCATOLA_DATA_DIR": str(folder / "data"),
        "SCATOLA_PORT": str(port),
        "SCATOLA_ADMIN_TOKEN": TOKEN,
        "SCATOLA_DEVICE_REQUESTS_PER_MINUTE": "1000000",
        "SCATOLA_DEVICE_BYTES_PER_DAY": str(2**40),
        "SCATOLA_LOG_LEVEL": "warning",
    }
    with contextlib.ExitStack() as stack:
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        url = pid = None
        if database == "PostgreSQL":
            postgres = stack.enter_context(OwnPostgres(OTHERS))
            url = environment["SCATOLA_DATABASE_URL"] = postgres.url
            pid = postgres.process.pid
        upgrade(Settings(data_dir=folder / "data", database_url=url))
        arguments = ["-m", "server.cli.main", "serve"] if whole else [str(Path(__file__).resolve())]
        process = start(arguments, environment, set(CORES) if whole else API_CORE)
        if broker_url is not None:  # for the workers: the API alone needs none
            environment = environment | {"SCATOLA_BROKER_URL": broker_url}
        api = Api(folder, port, environment, process, url, pid)
        stack.callback(api.stop)
        eventually(lambda: is_ready(api), within_s=60, what="the API answers")
        yield api


def is_ready(api: Api) -> bool:
    """Whether it answers."""
    try:
        return httpx.get(f"{api.url}/healthz", timeout=2.0, trust_env=False).status_code == 200
    except httpx.TransportError:
        return False


if __name__ == "__main__":
    # The API process: as `scatola serve` runs it, without worker and viewer.
    from server.logs import configure_logging
    from server.serve import settle

    settings = Settings()
    configure_logging(as_json=True, level=settings.log_level)
    app = create_app(settings)
    settle()
    uvicorn.run(app, host="127.0.0.1", port=settings.port, log_config=None, access_log=False)
