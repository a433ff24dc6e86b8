"""Child processes of `scatola serve`: started, started again when they die, stopped together.

Each child's standard input is a pipe from the supervisor.  A byte in it wakes the child; its end tells that the
supervisor is gone, however it went, and the child exits by itself.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence

import structlog

from server.tracing import carried

SUPERVISED = "SCATOLA_SUPERVISED"
"""Tells a child that it is one, and whose: the process id of its supervisor."""
RESTART_S = (0.5, 30.0)
"""Pause before a dead child is started again: first, and at most; it doubles from death to death."""
HEALTHY_S = 60.0
"""A child that ran this long starts with the first pause again."""
LOOK_S = 0.1
ORPHAN_S = 1.0
"""So often a busy child looks whether its supervisor still lives."""
STOP_S = 8.0
"""Time to stop by themselves; after that children are killed, within the ten seconds that are promised."""

log = structlog.stdlib.get_logger("scatola.supervisor")


def scatola(*arguments: str) -> list[str]:
    """Command line of a `scatola` command in this interpreter."""
    return [sys.executable, "-m", "server.cli.main", *arguments]


class Child:
    """A process that is kept alive."""

    def __init__(self, name: str, command: Sequence[str], *, environment: Mapping[str, str] | None = None) -> None:
        self.name = name
        self._command = list(command)
        self._environment = {**os.environ, **(environment or {}), SUPERVISED: str(os.getpid())}
        self._process: subprocess.Popen[bytes] | None = None
        self._started = 0.0
        self._deaths = 0
        self._restart_at = 0.0

    @property
    def pid(self) -> int | None:
        """Of the running process."""
        return None if self._process is None or self._process.poll() is not None else self._process.pid

    def look(self, now: float) -> None:
        """Start the process when it does not run and its pause is over."""
        if self._process is not None:
            if self._process.poll() is None:
                return
            self._bury(self._process, now)
        if now >= self._restart_at:
            # A session of its own: Ctrl-C in the terminal reaches the supervisor alone, which stops all in order.
            self._process = subprocess.Popen(  # noqa: S603  our own interpreter and arguments
                self._command, stdin=subprocess.PIPE, env=self._environment, start_new_session=True
            )
            assert self._process.stdin is not None
            os.set_blocking(self._process.stdin.fileno(), False)
            self._started = now

    def _bury(self, process: subprocess.Popen[bytes], now: float) -> None:
        _close(process)
        self._process = None
        self._deaths = 0 if now - self._started >= HEALTHY_S else self._deaths + 1
        pause = min(RESTART_S[0] * 2.0 ** max(0, self._deaths - 1), RESTART_S[1])
        self._restart_at = now + pause
        log.warning("child died", child=self.name, status=process.returncode, restart_in_s=pause)

    def wake(self, line: bytes = b"\n") -> None:
        """Write a line into the pipe; a full pipe wakes as well as one more line would."""
        process = self._process
        if process is None or process.stdin is None:
            return
        try:
            os.write(process.stdin.fileno(), line)  # shorter than PIPE_BUF: whole, or not at all
        except (BlockingIOError, BrokenPipeError, ValueError, OSError):
            return  # full, or the child just died: it looks by itself when it is back

    def terminate(self) -> None:
        """Ask to stop."""
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()

    def finish(self, timeout_s: float) -> None:
        """Wait for the end, and bring it about when the time is over."""
        if self._process is None:
            return
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            log.warning("child killed", child=self.name)
            self._process.kill()
            self._process.wait()
        _close(self._process)
        self._process = None


class Supervisor:
    """Keeps its children alive until it is stopped."""

    def __init__(self, children: Sequence[Child], *, wakes: str = "worker") -> None:
        self.children = list(children)
        self._woken = next((child for child in children if child.name == wakes), None)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="supervisor", daemon=True)

    def start(self) -> None:
        """Start all children."""
        for child in self.children:
            child.look(time.monotonic())
        self._thread.start()

    def wake(self, device_id: str) -> None:
        """Tell the worker that a device is due, and for which request."""
        if self._woken is not None:
            self._woken.wake(json.dumps({"device_id": device_id, **carried()}).encode() + b"\n")

    def alive(self) -> dict[str, bool]:
        """Which children run."""
        return {child.name: child.pid is not None for child in self.children}

    def stop(self, timeout_s: float = STOP_S) -> None:
        """Stop all children, those that do not stop in time by force."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()
        for child in self.children:
            child.terminate()
        deadline = time.monotonic() + timeout_s
        for child in self.children:
            child.finish(max(0.0, deadline - time.monotonic()))

    def _run(self) -> None:
        while not self._stopping.wait(LOOK_S):
            for child in self.children:
                try:
                    child.look(time.monotonic())
                except OSError:
                    log.exception("child cannot be started", child=child.name)


def parent_fd() -> int | None:
    """Descriptor of the supervisor's pipe in a supervised child, else None."""
    return sys.stdin.fileno() if os.environ.get(SUPERVISED) else None


def follow_parent(gone: Callable[[], None]) -> None:
    """In a supervised child that is not woken through the pipe: call `gone` when the supervisor is no more."""
    descriptor = parent_fd()
    if descriptor is None:
        return

    def watch() -> None:
        while os.read(descriptor, 4096):
            pass
        gone()

    threading.Thread(target=watch, name="parent", daemon=True).start()


def end_with_parent() -> None:
    """In a supervised child that may be busy for long: end soon after the supervisor, wherever the work is.

    The pipe tells of its end only who reads it; a worker in the middle of a round does not.
    """
    if parent_fd() is None:
        return
    # Not `getppid` for this too: a supervisor that is gone before its child gets here has left it to another parent.
    parent, pause = int(os.environ[SUPERVISED]), threading.Event()

    def watch() -> None:
        while os.getppid() == parent:
            pause.wait(ORPHAN_S)
        os._exit(1)

    threading.Thread(target=watch, name="orphan", daemon=True).start()


def _close(process: subprocess.Popen[bytes]) -> None:
    if process.stdin is not None:
        process.stdin.close()
