"""A real service in processes of its own, as `scatola serve` and `scatola demo` start it."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Self

import httpx

ADMIN = "end-to-end-administrator-token"
_SIGN_IN = re.compile(r"http\S+/login\?code=\S+")


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


def eventually(condition: Callable[[], object], *, within_s: float, what: str):
    """The condition's first true value; polls."""
    deadline = time.monotonic() + within_s
    pause = threading.Event()
    while not (value := condition()):
        if time.monotonic() > deadline:
            raise AssertionError(f"not within {within_s:g} s: {what}")
        pause.wait(0.05)
    return value


class Service:
    """One `scatola` command that serves, restartable on the same port and data.

    `environment` is what it is told besides; what says nothing at its start has `greets` false.
    """

    def __init__(
        self,
        data_dir: Path,
        *command: str,
        port: int | None = None,
        environment: dict[str, str] | None = None,
        greets: bool = True,
    ) -> None:
        self.data_dir, self.command = data_dir, command
        self._environment, self._greets = environment or {}, greets
        self.port = port or free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self.lines: list[str] = []
        self.process: subprocess.Popen[str] | None = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *failure: object) -> None:
        """Leave nothing behind, however the test ended."""
        if self.process is not None and self.process.poll() is None:
            self.kill()

    def start(self) -> None:
        environment = {name: value for name, value in os.environ.items() if not name.startswith("SCATOLA_")}
        environment |= {
            "SCATOLA_DATA_DIR": str(self.data_dir),
            "SCATOLA_PORT": str(self.port),
            "SCATOLA_ADMIN_TOKEN": ADMIN,
            "SCATOLA_LOG_LEVEL": "warning",
        } | self._environment
        self.lines = []
        self.process = subprocess.Popen(
            [sys.executable, "-m", "server.cli.main", *self.command],
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        threading.Thread(target=self._read, args=(self.process,), daemon=True).start()
        if self._greets:
            eventually(lambda: any("serves" in line for line in self.lines), within_s=60, what="the service serves")

    def _read(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        with process.stdout:
            for line in process.stdout:
                self.lines.append(line)

    def client(self) -> httpx.Client:
        """Speaks as the administrator."""
        headers = {"Authorization": f"Bearer {ADMIN}"}
        return httpx.Client(base_url=self.url, headers=headers, timeout=20.0, trust_env=False)

    @property
    def sign_in(self) -> str:
        """The one-time link, which is said after the greeting."""

        def said() -> str | None:
            return next((match[0] for line in self.lines if (match := _SIGN_IN.search(line))), None)

        return eventually(said, within_s=30, what="the one-time link is said")

    def children(self) -> dict[str, int]:
        """Name of each supervised process, and its id."""
        assert self.process is not None
        found: dict[str, int] = {}
        for entry in Path("/proc").iterdir():
            if not entry.name.isdigit():
                continue
            try:
                parent = int((entry / "stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()[1])
                words = (entry / "cmdline").read_text(encoding="utf-8").split("\0")
            except (FileNotFoundError, ProcessLookupError):
                continue
            if parent == self.process.pid and "server.cli.main" in words:
                found[words[words.index("server.cli.main") + 1]] = int(entry.name)
        return found

    def kill(self) -> None:
        """As `kill -9` does; the children must notice by themselves."""
        assert self.process is not None
        children = self.children().values()
        self.process.kill()
        self.process.wait()
        for pid in children:
            eventually(lambda pid=pid: not alive(pid), within_s=30, what=f"child {pid} ends with its supervisor")

    def stop(self, number: int = signal.SIGTERM) -> int:
        """Ask to stop and return the exit status."""
        assert self.process is not None
        self.process.send_signal(number)
        return self.process.wait(30)


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
