from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from server.jobs import supervise
from server.jobs.supervise import Child, Supervisor
from tests.e2e.service import eventually

OBEDIENT = """
import os, sys
from pathlib import Path
log = Path(sys.argv[1])
with log.open("a") as file: file.write(f"start {os.getpid()}\\n")
while True:
    data = os.read(0, 100)
    with log.open("a") as file: file.write(f"{'wake' if data else 'end'} {os.getpid()}\\n")
    if not data: break
"""
STUBBORN = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN)\n" + OBEDIENT


@pytest.fixture
def log(tmp_path) -> Path:
    path = tmp_path / "log"
    path.touch()
    return path


def words(log: Path) -> list[str]:
    return [line.split()[0] for line in log.read_text().splitlines()]


def child(log: Path, code: str = OBEDIENT, name: str = "worker") -> Child:
    return Child(name, [sys.executable, "-c", code, str(log)])


@pytest.fixture
def supervise_all():
    running = []

    def start(*children: Child) -> Supervisor:
        supervisor = Supervisor(children)
        running.append(supervisor)
        supervisor.start()
        return supervisor

    yield start
    for supervisor in running:
        supervisor.stop(1.0)


def is_alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text()
    except FileNotFoundError:
        return False
    return state.rsplit(")", 1)[1].split()[0] != "Z"


def test_a_child_is_woken_through_its_pipe(log, supervise_all):
    supervisor = supervise_all(child(log), child(log.with_name("other"), name="viewer"))
    eventually(lambda: "start" in words(log), within_s=20, what="the child starts")
    supervisor.wake("some device")
    eventually(lambda: "wake" in words(log), within_s=20, what="the child is woken")


def test_a_full_pipe_and_a_dead_child_do_not_hold_up_the_waker(supervise_all):
    sleeper = Child("worker", [sys.executable, "-c", "import time; time.sleep(60)"])
    supervisor = supervise_all(sleeper)
    for _ in range(70_000):
        supervisor.wake("some device")
    os.kill(sleeper.pid, signal.SIGKILL)
    supervisor.wake("some device")


def test_a_child_that_dies_is_started_again_after_a_growing_pause(log, supervise_all, monkeypatch):
    monkeypatch.setattr(supervise, "RESTART_S", (0.05, 0.2))
    worker = child(log)
    supervise_all(worker)
    for deaths in range(1, 4):
        eventually(
            lambda deaths=deaths: words(log).count("start") == deaths and worker.pid is not None,
            within_s=20,
            what="the child starts again",
        )
        os.kill(worker.pid, signal.SIGKILL)
    eventually(lambda: words(log).count("start") == 4, within_s=20, what="the child starts a fourth time")
    assert worker._deaths == 3


def test_the_pause_doubles_up_to_its_limit_and_begins_anew_after_a_healthy_life():
    dying = Child("worker", [sys.executable, "-c", ""])
    now, pauses = 0.0, []
    for _ in range(9):
        dying.look(now)
        dying._process.wait()
        dying.look(now)
        pauses.append(dying._restart_at - now)
        now = dying._restart_at
    assert pauses == [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0, 30.0]
    dying.look(now)
    dying._process.wait()
    dying.look(now + 61.0)
    assert dying._restart_at == now + 61.5


def test_stopping_ends_all_and_starts_none_again(log, supervise_all):
    both = [child(log), child(log, name="viewer")]
    supervisor = supervise_all(*both)
    eventually(lambda: words(log).count("start") == 2, within_s=20, what="the child starts again")
    pids = [one.pid for one in both]
    supervisor.stop(5.0)
    assert not any(is_alive(pid) for pid in pids)
    assert [one.pid for one in both] == [None, None]
    assert words(log).count("start") == 2


def test_a_child_that_does_not_stop_is_killed(log, supervise_all):
    stubborn = child(log, STUBBORN)
    supervisor = supervise_all(stubborn)
    eventually(lambda: "start" in words(log), within_s=20, what="the child starts")
    pid, began = stubborn.pid, time.monotonic()
    supervisor.stop(0.3)
    assert time.monotonic() - began < 5.0
    assert not is_alive(pid)


def test_children_end_by_themselves_when_the_supervisor_is_killed(log):
    code = (
        "import sys, time\n"
        "from server.jobs.supervise import Child, Supervisor\n"
        "Supervisor([Child('worker', [sys.executable, '-c', sys.argv[2], sys.argv[1]])]).start()\n"
        "time.sleep(60)\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", code, str(log), OBEDIENT])
    eventually(lambda: "start" in words(log), within_s=20, what="the child starts")
    pid = int(log.read_text().split()[1])
    parent.kill()
    parent.wait()
    eventually(lambda: not is_alive(pid), within_s=20, what="the child ends")
    assert words(log)[-1] == "end"


def test_a_child_that_is_not_woken_follows_its_parent_too():
    code = (
        "import os, sys, threading\n"
        "from server.jobs.supervise import follow_parent\n"
        "gone = threading.Event()\n"
        "follow_parent(gone.set)\n"
        "sys.exit(0 if gone.wait(20.0) else 1)\n"
    )
    viewer = Child("viewer", [sys.executable, "-c", code])
    viewer.look(0.0)
    process = viewer._process
    process.stdin.close()
    assert process.wait(20.0) == 0


def test_what_is_not_supervised_has_no_parent_to_follow(monkeypatch):
    monkeypatch.delenv(supervise.SUPERVISED, raising=False)
    assert supervise.parent_fd() is None
    supervise.follow_parent(pytest.fail)


def test_a_busy_child_ends_soon_after_a_supervisor_that_was_killed(log):
    """One that never reads its pipe, as a worker in the middle of a long round."""
    busy = """
import os, sys, time
from pathlib import Path
from server.jobs.supervise import end_with_parent
end_with_parent()
Path(sys.argv[1]).write_text(f"start {os.getpid()}\\n")
while True: sum(range(10**6))
"""
    code = (
        "import sys, time; from server.jobs.supervise import Child, Supervisor\n"
        "Supervisor([Child('worker', [sys.executable, '-c', sys.argv[2], sys.argv[1]])]).start()\n"
        "time.sleep(60)"
    )
    supervisor = subprocess.Popen([sys.executable, "-c", code, str(log), busy])
    eventually(lambda: words(log) == ["start"], within_s=20, what="the child starts")
    pid = int(log.read_text().split()[1])
    supervisor.kill()
    supervisor.wait()
    eventually(lambda: not is_alive(pid), within_s=20, what="the child ends")


def test_a_busy_child_whose_supervisor_was_gone_before_it_looked_ends_too():
    """A new worker takes seconds to begin; its supervisor may be killed meanwhile."""
    code = "from server.jobs.supervise import end_with_parent; end_with_parent()\nwhile True: sum(range(10**6))"
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    environment = {**os.environ, supervise.SUPERVISED: str(gone.pid)}
    orphan = subprocess.Popen([sys.executable, "-c", code], env=environment)
    assert orphan.wait(20.0) == 1
