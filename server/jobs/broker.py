"""Dramatiq on RabbitMQ: carries device ids to any number of workers.

A message only says *when*; what is due stands in the database.  So a message is acknowledged after the
commit, may come twice, and may be lost: the sweep of each worker sends again what stays due.  Devices with a
burst have a queue of their own, which each worker looks at first.
"""

from __future__ import annotations

import datetime as dt
import json
import threading
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from typing import Any

import dramatiq
import pika
import pika.exceptions
import structlog
from dramatiq.brokers.rabbitmq import RabbitmqBroker
from dramatiq.common import dq_name, xq_name
from dramatiq.middleware import CurrentMessage, Middleware, Retries, ShutdownNotifications

from server.database import Database
from server.jobs.due import due_devices
from server.jobs.failures import MAX_FAILURES, Job, dead, left_alone
from server.jobs.run import Tally, run_job
from server.moments import Clock
from server.settings import Settings
from server.store import open_store
from server.tracing import Carried, carried, known

QUEUE = "devices"
BURSTS = "bursts"
ACTOR = "bring_up_to_date"
BURST_ACTOR = "bring_up_to_date_first"
MAX_RETRIES = MAX_FAILURES - 1
BACKOFF_MS = (1_000, 300_000)
SWEEP_S = 5.0
SWEEP_DEVICES = 1000
RESEND_S = 60.0
"""The sweep sends one device again at most this often."""
RECONNECT_S = (0.5, 30.0)
STOP_MS = 7_000
LOOK_TIMEOUT_S = 2.0

log = structlog.stdlib.get_logger("scatola.broker")


def make_broker(url: str) -> RabbitmqBroker:
    """A broker with what is needed: retries with backoff, then the dead-letter queue."""
    retries = Retries(max_retries=MAX_RETRIES, min_backoff=BACKOFF_MS[0], max_backoff=BACKOFF_MS[1])
    middleware: list[Middleware] = [ShutdownNotifications(), CurrentMessage(), retries]
    return RabbitmqBroker(url=url, confirm_delivery=True, middleware=middleware)


def message_for(
    device_id: str, queue: str, actor: str = ACTOR, options: Mapping[str, object] | None = None
) -> dramatiq.Message[None]:
    """The message that a device is due; `options` are Dramatiq's, and the words that the job carries."""
    said = dict(options or {})
    return dramatiq.Message(queue_name=queue, actor_name=actor, args=(device_id,), kwargs={}, options=said)


class Sender:
    """Sends device ids from a thread of its own: no upload waits for the broker or fails with it.

    A device that is named again before it was sent is sent once.
    """

    def __init__(self, settings: Settings, *, queue: str = QUEUE, actor: str = ACTOR) -> None:
        if settings.broker_url is None:
            raise ValueError("SCATOLA_BROKER_URL is not set")
        self._url = settings.broker_url.get_secret_value()
        self._queue = queue
        self._actor = actor
        self._waiting: dict[str, Carried] = {}
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="sender", daemon=True)
        self._thread.start()

    def __call__(self, device_id: str) -> None:
        """Send a device's id soon."""
        with self._changed:
            self._waiting[device_id] = carried()
            self._changed.notify()

    def close(self) -> None:
        """Stop sending; what was not sent is found by the sweep."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join(10.0)

    def _next(self) -> str | None:
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closed)
            return None if self._closed else next(iter(self._waiting))

    def _run(self) -> None:
        broker = make_broker(self._url)
        broker.declare_queue(self._queue)
        pause = RECONNECT_S[0]
        while (device_id := self._next()) is not None:
            with self._changed:
                words = self._waiting.pop(device_id)
            try:
                broker.enqueue(message_for(device_id, self._queue, self._actor, words))
                pause = RECONNECT_S[0]
            except Exception:
                # Whatever the broker does, an upload must not feel it.
                log.warning("broker cannot be reached", again_in_s=pause, exc_info=True)
                with self._changed:
                    self._waiting.setdefault(device_id, words)
                    self._changed.wait_for(lambda: self._closed, timeout=pause)
                pause = min(2.0 * pause, RECONNECT_S[1])
        broker.close()


def run_consumer(
    settings: Settings, *, stop: threading.Event, clock: Clock, queue: str = QUEUE, bursts: str = BURSTS
) -> None:
    """Work off what the queue brings, and send again what stays due, until told to stop."""
    from server.jobs.analyses import start_analyses
    from server.jobs.rerun import start_reruns
    from server.jobs.work import bring_up_to_date
    from server.jobs.worker import (
        STOP_TELLING_S,
        start_erasing,
        start_housekeeping,
        start_sealing,
        start_telling,
    )

    assert settings.broker_url is not None
    database, store = Database(settings), open_store(settings)
    broker = make_broker(settings.broker_url.get_secret_value())

    def work(device_id: str) -> None:
        message = CurrentMessage.get_current_message()
        assert message is not None

        def rounds(tally: Tally) -> None:
            done = bring_up_to_date(database, store, device_id, clock=clock)
            tally.add(batches=done.batches, failed=done.failed, estimates=done.estimates)
            if done.more:
                # Behind the others: no box's crash waits for the backlog of another.
                broker.enqueue(message_for(device_id, queue, options=_said_of(message)))

        # Somebody had it and gave no answer: died at it, or with it waiting, or lost the broker.
        again = bool(getattr(message, "redelivered", False))
        job = Job(message.message_id, device_id, message.queue_name, known(message.options), again=again)
        run_job(database, job, rounds, clock=clock)

    # The lower number goes first among the messages that this worker has fetched.
    dramatiq.Actor(work, broker=broker, actor_name=BURST_ACTOR, queue_name=bursts, priority=0, options={})
    dramatiq.Actor(work, broker=broker, actor_name=ACTOR, queue_name=queue, priority=1, options={})
    # One thread: the work is computation, a host's further cores take further processes.
    worker = dramatiq.Worker(broker, queues={queue, bursts}, worker_threads=1)
    worker.start()
    keeper = start_housekeeping(database, store, stop=stop, clock=clock)
    eraser = start_erasing(database, store, stop=stop, clock=clock)
    sealer = start_sealing(database, settings, stop=stop, clock=clock)
    tellers = start_telling(database, settings, stop=stop, clock=clock)
    analyst = start_analyses(settings, database, stop=stop, clock=clock)
    sweep = Sweep(database, broker, queue, clock)
    rerunner = start_reruns(database, store, stop=stop, clock=clock, idle=lambda: not sweep.waiting)
    try:
        while not stop.wait(SWEEP_S):
            sweep.once()
    finally:
        stop.set()
        worker.stop(timeout=STOP_MS)
        broker.close()
        for teller in tellers:
            teller.join(STOP_TELLING_S)
        for thread in (keeper, eraser, rerunner, analyst, sealer):
            if thread is not None:
                thread.join(2.0)  # an event that is being computed again is left: its lease runs out
        database.dispose()


def _said_of(message: dramatiq.Message[Any]) -> dict[str, object]:
    """What a message says to the one that follows from it: all but its own count of retries."""
    options = message.options
    return {**known(options), **{name: options[name] for name in ("max_retries",) if name in options}}


class Sweep:
    """Sends again what is due while nothing waits in the queue: lost messages, and reviews."""

    def __init__(self, database: Database, broker: RabbitmqBroker, queue: str, clock: Clock) -> None:
        self._database = database
        self._broker = broker
        self._queue = queue
        self._clock = clock
        self._sent: dict[str, dt.datetime] = {}
        self.waiting = 0
        """Messages in the queue at the last look."""

    def once(self) -> int:
        """Look once; how many were sent."""
        try:
            self.waiting, _, _ = self._broker.get_queue_message_counts(self._queue)
            return 0 if self.waiting else self._send()
        except Exception:
            log.exception("sweep failed")
            return 0

    def _send(self) -> int:
        now = self._clock()
        self._sent = {k: at for k, at in self._sent.items() if (now - at).total_seconds() < RESEND_S}
        with self._database.reading() as session:
            # Those that failed lately wait for their pause: else each look would start a further chain of retries.
            held, given_up = left_alone(session, now), dead(session)
            due = due_devices(session, SWEEP_DEVICES, now=now)
        devices = [device_id for device_id in due if device_id not in self._sent and device_id not in held]
        for device_id in devices:
            options: dict[str, object] = {"max_retries": 0} if device_id in given_up else {}
            self._broker.enqueue(message_for(device_id, self._queue, options=options))
            self._sent[device_id] = now
        return len(devices)


class Queues:
    """The broker's queues as an operator sees them; each look is a connection of its own, short and bounded in time."""

    def __init__(self, settings: Settings, names: tuple[str, ...] = (QUEUE, BURSTS)) -> None:
        assert settings.broker_url is not None
        self._parameters = pika.URLParameters(settings.broker_url.get_secret_value())
        self._parameters.connection_attempts = 1
        self._parameters.socket_timeout = self._parameters.stack_timeout = LOOK_TIMEOUT_S
        self._parameters.blocked_connection_timeout = LOOK_TIMEOUT_S
        self._names = names

    @contextmanager
    def _connection(self) -> Generator[Any]:  # pika is untyped
        try:
            connection = pika.BlockingConnection(self._parameters)
            try:
                yield connection
            finally:
                if connection.is_open:
                    connection.close()
        except (pika.exceptions.AMQPError, OSError) as error:
            raise BrokerUnreachableError(type(error).__name__) from error

    def check(self) -> None:
        """Raise BrokerUnreachableError unless the broker lets us in."""
        with self._connection():
            pass

    def depths(self) -> dict[str, int]:
        """Messages by queue, with those that wait for a retry and the dead letters; none of queues not made yet."""
        with self._connection() as connection:
            names = [each for queue in self._names for each in (queue, dq_name(queue), xq_name(queue))]
            counts = {name: _count(connection.channel(), name) for name in names}
        return {name: count for name, count in counts.items() if count is not None}

    def drop_letters(self, device_ids: set[str]) -> int:
        """Take the dead letters of some boxes out of the broker, for they are sent anew; how many."""
        dropped = 0
        with self._connection() as connection:
            for queue in map(xq_name, self._names):
                count = _count(connection.channel(), queue)
                channel = connection.channel()
                # What is not acknowledged goes back to its place when the channel closes.
                for _ in range(count or 0):
                    method, _, body = channel.basic_get(queue)
                    if method is not None and _device_of(body) in device_ids:
                        channel.basic_ack(method.delivery_tag)
                        dropped += 1
                channel.close()
        return dropped


class BrokerUnreachableError(Exception):
    """The broker does not answer, or does not let us in."""


def _count(channel: Any, queue: str) -> int | None:
    try:
        return int(channel.queue_declare(queue, passive=True).method.message_count)
    except pika.exceptions.ChannelClosedByBroker:
        return None  # nobody has made it yet


def _device_of(body: bytes) -> str | None:
    try:
        return str(json.loads(body)["args"][0])
    except (ValueError, KeyError, IndexError, TypeError):
        return None
