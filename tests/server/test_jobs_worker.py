from __future__ import annotations

import os
import signal
import subprocess
import threading

import pytest
from fleet_world import Leg, World, cut, drive_of

from server.jobs import worker
from server.jobs.supervise import SUPERVISED, scatola
from server.jobs.worker import Rounds, run_worker
from server.models import Batch, DeviceState, JobFailure
from tests.e2e.service import eventually


@pytest.fixture
def world(database, settings, clock, organisation) -> World:
    return World(database, settings, clock, organisation)


@pytest.fixture
def batches():
    return cut(drive_of(Leg(60, 10.0)))


@pytest.fixture
def running(settings, clock):
    """A worker in a thread, and the pipe that wakes it."""
    reader, writer = os.pipe()
    stop = threading.Event()
    thread = threading.Thread(
        target=run_worker, args=(settings,), kwargs={"stop": stop, "wake_fd": reader, "clock": clock}
    )
    thread.start()
    yield thread, writer
    stop.set()
    thread.join(30.0)
    for descriptor in (reader, writer):
        try:
            os.close(descriptor)
        except OSError:
            continue
    assert not thread.is_alive()


def test_it_works_off_what_comes_with_and_without_a_wake(world, batches, running):
    world.put(batches[0], 0)
    eventually(lambda: world.unprocessed() == 0, within_s=60, what="all is worked off")
    world.put(batches[1], 1)
    os.write(running[1], b"\n")
    eventually(lambda: world.unprocessed() == 0, within_s=60, what="all is worked off")
    assert world.one(DeviceState).version == 2


def test_the_end_of_the_pipe_is_the_end_of_the_worker(running):
    thread, writer = running
    os.close(writer)
    thread.join(30.0)
    assert not thread.is_alive()


def test_one_box_that_fails_waits_longer_and_longer_and_the_others_go_on(world, batches, clock):
    other = world.new_device()
    world.put(batches[0], 0)
    world.put(batches[0], 0, device_id=other)
    rounds = Rounds(world.database, world.store, clock)
    tried, real = [], rounds._bring_up_to_date

    def fails(database, store, device_id, **options):
        tried.append(device_id)
        if device_id == world.device_id:
            raise RuntimeError("no luck")
        return real(database, store, device_id, **options)

    rounds._bring_up_to_date = fails
    stop = threading.Event()
    assert rounds.once(stop)
    assert sorted(tried) == sorted([world.device_id, other])
    assert [b.device_id for b in world.rows(Batch) if b.processed_at is None] == [world.device_id]
    assert not rounds.once(stop)  # it must not be tried again at once
    for pause in (1.0, 2.0, 4.0):
        clock.advance(seconds=pause - 0.01)
        assert not rounds.once(stop)
        clock.advance(seconds=0.02)
        assert rounds.once(stop)
    rounds._bring_up_to_date = real
    clock.advance(seconds=9.0)
    rounds.once(stop)
    assert world.unprocessed() == 0
    assert not world.rows(JobFailure)


def test_a_database_that_does_not_answer_does_not_end_the_loop(world, batches, clock, monkeypatch):
    world.put(batches[0], 0)
    rounds = Rounds(world.database, world.store, clock)
    with monkeypatch.context() as patch:
        patch.setattr(worker, "due_devices", lambda *_, **__: 1 / 0)
        assert not rounds.once(threading.Event())
    assert rounds.once(threading.Event())
    assert world.unprocessed() == 0


def test_more_devices_than_one_look_gives_are_all_reached(world, batches, clock, monkeypatch):
    monkeypatch.setattr(worker, "DEVICES", 2)
    devices = [world.device_id, *(world.new_device() for _ in range(4))]
    for device_id in devices:
        world.put(batches[0], 0, device_id=device_id)
    rounds = Rounds(world.database, world.store, clock)
    while rounds.once(threading.Event()):
        pass
    assert world.unprocessed() == 0


def test_blobs_without_a_row_are_collected_beside_the_work(world, batches, clock, monkeypatch):
    monkeypatch.setattr(worker, "COLLECT_EVERY_S", 0.02)
    world.put(batches[0], 0)
    orphan = f"{world.organisation.id}/{world.device_id}/{'0' * 64}.parquet"
    world.store.put(orphan, b"nobody's")
    old = clock().timestamp() - 2 * 86400.0
    for path in world.store._root.rglob("*.parquet"):
        os.utime(path, (old, old))
    stop = threading.Event()
    thread = worker.start_housekeeping(world.database, world.store, stop=stop, clock=clock)
    eventually(lambda: not world.store.exists(orphan), within_s=60, what="the blob without a row is gone")
    stop.set()
    thread.join(10.0)
    assert world.store.exists(world.one(Batch).blob_key)


@pytest.fixture
def process(settings):
    """A worker process as the supervisor starts it."""
    environment = {
        **{name: value for name, value in os.environ.items() if not name.startswith("SCATOLA_")},
        "SCATOLA_DATA_DIR": str(settings.data_dir),
        SUPERVISED: str(os.getpid()),
    }
    process = subprocess.Popen(scatola("worker"), stdin=subprocess.PIPE, stderr=subprocess.PIPE, env=environment)
    yield process
    process.kill()
    process.communicate()


@pytest.mark.parametrize("broker", [None, "amqp://guest:guest@127.0.0.1:1"])
def test_a_worker_refuses_a_database_that_is_not_migrated(tmp_path, broker):
    environment = {name: value for name, value in os.environ.items() if not name.startswith("SCATOLA_")}
    environment |= {"SCATOLA_DATA_DIR": str(tmp_path)} | ({} if broker is None else {"SCATOLA_BROKER_URL": broker})
    done = subprocess.run(scatola("worker"), env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "scatola migrate" in line


def test_a_real_process_works_and_stops_on_sigterm(world, batches, process):
    world.put(batches[0], 0)
    eventually(lambda: world.unprocessed() == 0, within_s=60, what="all is worked off")
    assert os.getpriority(os.PRIO_PROCESS, process.pid) >= 5
    process.send_signal(signal.SIGTERM)
    assert process.wait(10.0) == 0


def test_a_real_process_killed_in_the_middle_loses_nothing(world, batches, process):
    for k, batch in enumerate(batches):
        world.put(batch, k)
    eventually(lambda: world.rows(DeviceState), within_s=60, what="the first result")
    process.kill()
    process.wait()
    world.bring_up()
    assert world.unprocessed() == 0
    assert world.one(DeviceState).position_at is not None
