from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import uuid

import pika
import pytest
from dramatiq.common import dq_name, xq_name
from fleet_world import Leg, World, cut, drive_of

from server.jobs import broker as jobs_broker
from server.jobs import failures
from server.jobs import work as jobs_work
from server.jobs.broker import Sender, Sweep, make_broker, run_consumer
from server.models import Batch, BatchDigest, DeviceState, Installation
from server.settings import Settings
from tests.conftest import missing_service
from tests.e2e.service import eventually

URL = "amqp://guest:guest@127.0.0.1:5672/"
pytestmark = pytest.mark.rabbitmq


def bursts_of(queue: str) -> str:
    return f"{queue}-bursts"


@pytest.fixture
def queue():
    """Name of a queue of the test's own, gone afterwards with its kin."""
    name = f"scatola-test-{uuid.uuid4().hex[:12]}"
    try:
        connection = pika.BlockingConnection(pika.URLParameters(URL))
    except pika.exceptions.AMQPError as error:
        missing_service(f"no RabbitMQ at 127.0.0.1:5672: {type(error).__name__}")
    yield name
    channel = connection.channel()
    for one in (name, bursts_of(name)):
        for each in (one, dq_name(one), xq_name(one)):
            channel.queue_delete(each)
    connection.close()


@pytest.fixture
def settings(settings) -> Settings:
    return settings.model_copy(update={"broker_url": Settings(broker_url=URL).broker_url})


@pytest.fixture
def world(database, settings, clock, organisation) -> World:
    return World(database, settings, clock, organisation)


@pytest.fixture
def batches():
    return cut(drive_of(Leg(60, 10.0), Leg(20, 0.0)))


@pytest.fixture
def consume(settings, clock, queue, monkeypatch):
    """Run a consumer in a thread until the test ends."""
    monkeypatch.setattr(jobs_broker, "SWEEP_S", 0.05)
    with contextlib.ExitStack() as running:

        def start() -> None:
            stop = threading.Event()
            options = {"stop": stop, "clock": clock, "queue": queue, "bursts": bursts_of(queue)}
            thread = threading.Thread(target=run_consumer, args=(settings,), kwargs=options)
            thread.start()
            running.callback(thread.join, 30.0)
            running.callback(stop.set)

        yield start


@pytest.fixture
def send(settings, queue):
    sender = Sender(settings, queue=queue)
    yield sender
    sender.close()


@pytest.mark.both_databases
def test_a_message_brings_a_device_up_to_date(world, batches, send, consume, monkeypatch):
    monkeypatch.setattr(Sweep, "once", lambda _sweep: 0)
    consume()
    for k, batch in enumerate(batches):
        world.put(batch, k)
        send(world.device_id)
    eventually(lambda: world.unprocessed() == 0, within_s=90, what="all is worked off")
    assert len(world.rows(BatchDigest)) == len(batches)


def test_bursts_have_a_queue_of_their_own(world, batches, settings, queue, consume, monkeypatch):
    monkeypatch.setattr(Sweep, "once", lambda _sweep: 0)
    world.put(batches[0], 0, stream="burst")
    sender = Sender(settings, queue=bursts_of(queue), actor=jobs_broker.BURST_ACTOR)
    sender(world.device_id)
    consume()
    eventually(lambda: world.unprocessed() == 0, within_s=90, what="all is worked off")
    sender.close()


def test_a_burst_does_not_wait_for_the_backlog_of_another_box(settings, queue, send, consume, monkeypatch):
    monkeypatch.setattr(Sweep, "once", lambda _sweep: 0)
    first_round, burst_done = threading.Event(), threading.Event()

    def bring_up_to_date(database, store, device_id, *, clock):
        del database, store, clock
        if device_id == "crashed":
            burst_done.set()
            return jobs_work.Outcome(batches=1)
        first_round.set()
        return jobs_work.Outcome(batches=1, more=not burst_done.is_set())  # a backlog without end

    monkeypatch.setattr(jobs_work, "bring_up_to_date", bring_up_to_date)
    consume()
    send("backlog")
    assert first_round.wait(90.0)
    sender = Sender(settings, queue=bursts_of(queue), actor=jobs_broker.BURST_ACTOR)
    sender("crashed")
    try:
        assert burst_done.wait(30.0)
    finally:
        burst_done.set()
        sender.close()


def test_the_sweep_finds_what_no_message_told(world, batches, consume):
    world.put(batches[0], 0)
    consume()
    eventually(lambda: world.unprocessed() == 0, within_s=90, what="all is worked off")


def test_the_sweep_sends_once_and_not_into_a_waiting_queue(world, batches, clock, queue):
    world.put(batches[0], 0)
    broker = make_broker(URL)
    broker.declare_queue(queue, ensure=True)
    sweep = Sweep(world.database, broker, queue, clock)
    assert sweep.once() == 1
    eventually(lambda: broker.get_queue_message_counts(queue)[0] == 1, within_s=90, what="one message waits")
    assert sweep.once() == 0
    clock.advance(seconds=jobs_broker.RESEND_S)
    assert sweep.once() == 0  # it still waits
    broker.flush(queue)
    eventually(lambda: broker.get_queue_message_counts(queue)[0] == 0, within_s=90, what="no message waits")
    assert sweep.once() == 1
    assert sweep.once() == 0
    broker.close()


def test_work_that_keeps_failing_ends_in_the_dead_letters(world, batches, send, consume, queue, monkeypatch):
    monkeypatch.setattr(Sweep, "once", lambda _sweep: 0)
    monkeypatch.setattr(jobs_broker, "MAX_RETRIES", 2)
    monkeypatch.setattr(jobs_broker, "BACKOFF_MS", (1, 10))
    tried = []

    def fails(_database, _store, device_id, **_):
        tried.append(device_id)
        raise RuntimeError("no luck")

    monkeypatch.setattr(jobs_work, "bring_up_to_date", fails)
    world.put(batches[0], 0)
    consume()
    send(world.device_id)
    broker = make_broker(URL)
    broker.declare_queue(queue, ensure=True)
    eventually(lambda: broker.get_queue_message_counts(queue)[2] == 1, within_s=90, what="the message is a dead letter")
    broker.close()
    assert tried == [world.device_id] * 3
    assert world.unprocessed() == 1


def test_a_broker_that_is_away_fails_no_upload_and_is_found_again(world, settings, queue, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as probe:
        nobody = f"amqp://guest:guest@127.0.0.1:{probe.getsockname()[1]}/?connection_attempts=1"
    monkeypatch.setattr(jobs_broker, "RECONNECT_S", (0.01, 0.05))
    urls = iter([nobody])
    real = jobs_broker.RabbitmqBroker.enqueue
    failed = threading.Event()

    def enqueue(self, message, *, delay=None):
        if next(urls, None):
            failed.set()
            raise jobs_broker.dramatiq.errors.ConnectionClosed("gone")
        return real(self, message, delay=delay)

    monkeypatch.setattr(jobs_broker.RabbitmqBroker, "enqueue", enqueue)
    sender = Sender(settings, queue=queue)
    began = time.monotonic()
    sender(world.device_id)
    assert time.monotonic() - began < 1.0
    assert failed.wait(10.0)
    broker = make_broker(URL)
    broker.declare_queue(queue, ensure=True)
    eventually(lambda: broker.get_queue_message_counts(queue)[0] == 1, within_s=90, what="one message waits")
    broker.close()
    sender.close()
    dead = Sender(settings.model_copy(update={"broker_url": Settings(broker_url=nobody).broker_url}), queue=queue)
    dead(world.device_id)
    dead.close()


CONSUMER = """
import datetime as dt, os, sys, threading
from server.jobs import broker
from server.settings import Settings
broker.SWEEP_S = 0.2
broker.RESEND_S = 1.0
stop = threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), stop.set()), daemon=True).start()
now = dt.datetime.fromisoformat(sys.argv[2])
print("ready", flush=True)
broker.run_consumer(Settings(), stop=stop, clock=lambda: now, queue=sys.argv[1], bursts=sys.argv[1] + "-bursts")
"""


@pytest.fixture
def consumer_process(settings, clock, queue, postgres_url):
    """Start worker processes on the test's queue."""
    environment = {
        **{name: value for name, value in os.environ.items() if not name.startswith("SCATOLA_")},
        "SCATOLA_DATA_DIR": str(settings.data_dir),
        "SCATOLA_DATABASE_URL": postgres_url,
        "SCATOLA_BROKER_URL": URL,
    }
    processes = []

    def start() -> subprocess.Popen:
        process = subprocess.Popen(
            [sys.executable, "-c", CONSUMER, queue, clock().isoformat()],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        processes.append(process)
        return process

    yield start
    for process in processes:
        process.kill()
        process.communicate()


@pytest.mark.postgres
@pytest.mark.parametrize("dialect", ["postgresql"], indirect=True)
def test_two_worker_processes_race_and_one_is_killed(world, send, consumer_process):
    batches = cut(drive_of(Leg(200, 10.0), Leg(20, 0.0), Leg(20, 15.0)), seconds=5.0)
    doomed, other = consumer_process(), consumer_process()
    for process in (doomed, other):
        assert process.stdout.readline() == b"ready\n"
    for k, batch in enumerate(batches):
        world.put(batch, k)
        send(world.device_id)
        send(world.device_id)
        if k == len(batches) // 2:
            eventually(lambda: world.rows(DeviceState), within_s=90, what="the first result")
            doomed.send_signal(signal.SIGKILL)
    eventually(lambda: world.unprocessed() == 0, within_s=90, what="all is worked off")
    assert all(batch.failure is None for batch in world.rows(Batch))
    assert len(world.rows(BatchDigest)) == len(batches)
    (installation,) = world.rows(Installation)
    assert installation.beginning == "first"
    state = world.one(DeviceState)
    assert world.kinds().count("position") <= state.version
    other.stdin.close()
    other.stdin = None
    assert other.wait(15.0) == 0


# --- what travels with a message


@pytest.fixture(scope="session")
def spans():
    """What is recorded from now on; OpenTelemetry takes one provider for the life of a process."""
    from opentelemetry import trace
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.export import SimpleSpanProcessor
    from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

    exporter, provider = InMemorySpanExporter(), TracerProvider()
    provider.add_span_processor(SimpleSpanProcessor(exporter))
    trace.set_tracer_provider(provider)
    yield exporter
    exporter.shutdown()


def test_one_upload_is_one_trace_through_broker_and_worker(
    app, client, make_device, world, send, consume, spans, monkeypatch
):
    monkeypatch.setattr(Sweep, "once", lambda _sweep: 0)
    app.state.wake = send
    _, token = make_device()
    spans.clear()
    consume()
    columns = {"t": [0.0, 0.5], "fx": [0, 0], "fy": [0, 0], "fz": [-9.8, -9.8]}
    headers = {"Authorization": f"Bearer {token}", "Idempotency-Key": "b/0", "X-Request-ID": "upload-7"}
    client.post("/api/v1/batches", json={"columns": columns}, headers=headers).raise_for_status()
    eventually(lambda: world.unprocessed() == 0, within_s=90, what="all is worked off")
    eventually(
        lambda: "bring up to date" in {span.name for span in spans.get_finished_spans()},
        within_s=90,
        what="the round's span ended",
    )
    finished = {span.name: span for span in spans.get_finished_spans()}
    upload, job = finished["POST /api/v1/batches"], finished["bring up to date"]
    assert job.context.trace_id == upload.context.trace_id
    assert finished["commit row"].context.trace_id == upload.context.trace_id
    assert job.attributes["scatola.batches"] == 1
    assert token not in str([span.to_json() for span in spans.get_finished_spans()])


def test_a_dead_letter_is_shown_and_replayed(app, admin, world, batches, send, consume, queue, settings, monkeypatch):
    monkeypatch.setattr(Sweep, "once", lambda _sweep: 0)
    monkeypatch.setattr(jobs_broker, "MAX_RETRIES", 2)
    monkeypatch.setattr(failures, "MAX_FAILURES", 3)
    monkeypatch.setattr(jobs_broker, "BACKOFF_MS", (1, 10))
    queues = jobs_broker.Queues(settings, (queue, bursts_of(queue)))
    app.state.wake, app.state.drop_letters = send, queues.drop_letters
    luck = threading.Event()
    real = jobs_work.bring_up_to_date

    def fails(database, store, device_id, **options):
        if not luck.is_set():
            raise RuntimeError("no luck with amqp://user:hunter2@broker")
        return real(database, store, device_id, **options)

    monkeypatch.setattr(jobs_work, "bring_up_to_date", fails)
    world.put(batches[0], 0)
    consume()
    send(world.device_id)
    eventually(lambda: queues.depths().get(xq_name(queue)) == 1, within_s=90, what="one dead letter is told")
    (letter,) = admin.get("/api/v1/jobs/failures", params={"dead": True}).json()["items"]
    assert (letter["device_id"], letter["failures"], letter["waiting_batches"]) == (world.device_id, 3, 1)
    assert letter["error"] == "RuntimeError: no luck with amqp://user:[redacted]@broker"
    assert letter["job_id"]
    assert "scatola_dead_letters 1.0" in admin.get("/metrics").text
    luck.set()
    assert admin.post("/api/v1/jobs/failures/replay").json() == {"replayed": [world.device_id]}
    eventually(lambda: world.unprocessed() == 0, within_s=90, what="all is worked off")
    eventually(lambda: queues.depths()[xq_name(queue)] == 0, within_s=90, what="no dead letter is told")
    assert admin.get("/api/v1/jobs/failures").json() == {"items": [], "total": 0, "next": None}
    assert admin.post(f"/api/v1/jobs/failures/{world.device_id}/replay").status_code == 404
    actions = [entry["action"] for entry in admin.get("/api/v1/audit").json()["items"]]
    assert "jobs.replay" in actions


def test_the_sweep_leaves_failing_boxes_alone_for_their_pause(world, batches, clock, queue):
    world.put(batches[0], 0)
    broker = make_broker(URL)
    broker.declare_queue(queue, ensure=True)
    sweep = Sweep(world.database, broker, queue, clock)
    with world.database.transaction() as session:
        for _ in range(failures.MAX_FAILURES):
            failures.note_failure(session, failures.Job("j", world.device_id, queue, {}), ValueError("x"), now=clock())
    assert sweep.once() == 0
    clock.advance(seconds=failures.DEAD_AGAIN_S + 1.0)
    assert sweep.once() == 1
    broker.close()


def test_a_broker_that_does_not_answer_is_said_so(settings):
    with socket.create_server(("127.0.0.1", 0)) as probe:
        nobody = f"amqp://guest:guest@127.0.0.1:{probe.getsockname()[1]}/"
    dead = settings.model_copy(update={"broker_url": Settings(broker_url=nobody).broker_url})
    began = time.monotonic()
    with pytest.raises(jobs_broker.BrokerUnreachableError):
        jobs_broker.Queues(dead).check()
    assert time.monotonic() - began < 10.0
    jobs_broker.Queues(settings).check()
