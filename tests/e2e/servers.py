"""A PostgreSQL and a RabbitMQ of one's own on free loopback ports, to be killed at will and gone afterwards."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import tempfile
from pathlib import Path
from typing import Self

from tests.e2e.service import eventually, free_port

RABBIT = Path("/usr/lib/rabbitmq/bin/rabbitmq-server")


def _postgres_programs() -> Path | None:
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
    return found[-1].parent if found else None


def missing_servers() -> str | None:
    """What is not installed here, if anything."""
    if _postgres_programs() is None:
        return "no PostgreSQL server is installed"
    return None if RABBIT.exists() else "no RabbitMQ server is installed"


class Server:
    """A server in a process group and a folder of its own."""

    user: str | None = None
    """Whom it runs as where we are root."""

    def __init__(self, cores: set[int] | None = None) -> None:
        self.port = free_port()
        # Below /tmp and open to look through: the server's user must reach it.
        self.folder = Path(tempfile.mkdtemp(prefix="scatola-own-"))
        self.process: subprocess.Popen[bytes] | None = None
        self._cores = cores

    def command(self) -> tuple[list[str], dict[str, str]]:
        """Command line and what its environment has besides."""
        raise NotImplementedError

    def answers(self) -> bool:
        """Whether it takes connections."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *failure: object) -> None:
        with contextlib.suppress(ProcessLookupError):
            self.kill()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _as(self) -> dict[str, str]:
        return {"user": self.user, "group": self.user} if self.user and os.geteuid() == 0 else {}

    def start(self) -> None:
        command, environment = self.command()

        def up() -> bool:
            # A start may fail while what was killed is still on its way out.
            if self.process is None or self.process.poll() is not None:
                with (self.folder / "log").open("ab") as log:
                    self.process = subprocess.Popen(
                        command,
                        env=os.environ | environment,
                        stdout=log,
                        stderr=log,
                        start_new_session=True,
                        **self._as(),
                    )
                if self._cores:
                    os.sched_setaffinity(self.process.pid, self._cores)
            return self.answers()

        eventually(up, within_s=90, what=f"{command[0]} answers")

    def kill(self) -> None:
        """With -9, and all that it started."""
        assert self.process is not None
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()


class OwnPostgres(Server):
    user = "postgres"

    def __init__(self, cores: set[int] | None = None) -> None:
        super().__init__(cores)
        programs = _postgres_programs()
        assert programs is not None
        self._programs = programs
        self.url = f"postgresql://root@127.0.0.1:{self.port}/scatola"
        if self._as():
            shutil.chown(self.folder, self.user, self.user)
        initialise = [
            programs / "initdb",
            "-D",
            self.folder / "data",
            "-U",
            "root",
            "-A",
            "trust",
            "-E",
            "UTF8",
            "--no-sync",
        ]
        subprocess.run([*map(str, initialise), "--locale=C"], check=True, capture_output=True, cwd="/", **self._as())

    def command(self) -> tuple[list[str], dict[str, str]]:
        where = ["-D", str(self.folder / "data"), "-k", str(self.folder), "-p", str(self.port)]
        return [str(self._programs / "postgres"), *where, "-c", "listen_addresses=127.0.0.1"], {}

    def answers(self) -> bool:
        import psycopg

        try:
            with psycopg.connect(f"postgresql://root@127.0.0.1:{self.port}/postgres", autocommit=True) as connection:
                if not connection.execute("SELECT 1 FROM pg_database WHERE datname = 'scatola'").fetchone():
                    connection.execute("CREATE DATABASE scatola")
        except psycopg.OperationalError:
            return False
        return True


class OwnRabbit(Server):
    def __init__(self, cores: set[int] | None = None) -> None:
        super().__init__(cores)
        self.url = f"amqp://guest:guest@127.0.0.1:{self.port}/"
        self._names = {
            "HOME": str(self.folder),
            "RABBITMQ_NODENAME": f"scatola-{self.port}@localhost",
            "RABBITMQ_NODE_IP_ADDRESS": "127.0.0.1",
            "RABBITMQ_NODE_PORT": str(self.port),
            "RABBITMQ_DIST_PORT": str(free_port()),
            "RABBITMQ_MNESIA_BASE": str(self.folder / "mnesia"),
            "RABBITMQ_LOG_BASE": str(self.folder / "logs"),
            "RABBITMQ_ENABLED_PLUGINS_FILE": str(self.folder / "plugins"),
            "RABBITMQ_CONF_ENV_FILE": "/dev/null",
            "RABBITMQ_CONFIG_FILE": str(self.folder / "none"),
            # What is paused by a full disk is another test.
            "RABBITMQ_SERVER_ADDITIONAL_ERL_ARGS": "-rabbit disk_free_limit 1000000 +S 1:1",
        }
        (self.folder / "plugins").write_text("[].\n")

    def command(self) -> tuple[list[str], dict[str, str]]:
        return [str(RABBIT)], self._names

    def answers(self) -> bool:
        try:
            with socket.create_connection(("127.0.0.1", self.port), 1.0) as connection:
                connection.settimeout(2.0)
                connection.sendall(b"AMQP\x00\x00\x09\x01")
                return connection.recv(1) == b"\x01"
        except OSError:
            return False
