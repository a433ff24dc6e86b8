"""Dramatiq on RabbitMQ: carries device ids to any number of workers.

A message only says *when*; what is due stands in the database.  So a message is acknowledged after the
commit, may come twice, and may be lost: the sweep of each worker sends again what stays due.  Devices with a
burst have a queue of their own, which each worker looks at first.
"""

from __future__ import annotations

import datetime as dt
import threading
from collections.abc import Callable

import dramatiq
import structlog
from dramatiq.brokers.rabbitmq import RabbitmqBroker
from dramatiq.middleware import Retries, ShutdownNotifications

from server.database import Database
from server.jobs.due import due_devices
from server.settings import Settings
from server.store import open_store

Clock = Callable[[], dt.datetime]

QUEUE = "devices"
BURSTS = "bursts"
ACTOR = "bring_up_to_date"
BURST_ACTOR = "bring_up_to_date_first"
MAX_RETRIES = 8
BACKOFF_MS = (1_000, 300_000)
SWEEP_S = 5.0
SWEEP_DEVICES = 1000
RESEND_S = 60.0
"""The sweep sends one device again at most this often."""
RECONNECT_S = (0.5, 30.0)
STOP_MS = 7_000

log = structlog.stdlib.get_logger("scatola.broker")


def make_broker(url: str) -> RabbitmqBroker:
    """A broker with what is needed: retries with backoff, then the dead-letter queue."""
    retries = Retries(max_retries=MAX_RETRIES, min_backoff=BACKOFF_MS[0], max_backoff=BACKOFF_MS[1])
    return RabbitmqBroker(url=url, confirm_delivery=True, middleware=[ShutdownNotifications(), retries])


def message_for(device_id: str, queue: str, actor: str = ACTOR) -> dramatiq.Message[None]:
    """The message that a device is due."""
    return dramatiq.Message(queue_name=queue, actor_name=actor, args=(device_id,), kwargs={}, options={})


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
        self._waiting: dict[str, None] = {}
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="sender", daemon=True)
        self._thread.start()

    def __call__(self, device_id: str) -> None:
        """Send a device's id soon."""
        with self._changed:
            self._waiting[device_id] = None
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
                del self._waiting[device_id]
            try:
                broker.enqueue(message_for(device_id, self._queue, self._actor))
                pause = RECONNECT_S[0]
            except Exception:
                # Whatever the broker does, an upload must not feel it.
                log.warning("broker cannot be reached", again_in_s=pause, exc_info=True)
                with self._changed:
                    self._waiting[device_id] = None
                    self._changed.wait_for(lambda: self._closed, timeout=pause)
                pause = min(2.0 * pause, RECONNECT_S[1])
        broker.close()


def run_consumer(
    settings: Settings, *, stop: threading.Event, clock: Clock, queue: str = QUEUE, bursts: str = BURSTS
) -> None:
    """Work off what the queue brings, and send again what stays due, until told to stop."""
    from server.jobs.analyses import start_analyses
    from server.jobs.work import bring_up_to_date
    from server.jobs.worker import start_housekeeping, start_sealing

    assert settings.broker_url is not None
    database, store = Database(settings), open_store(settings)
    broker = make_broker(settings.broker_url.get_secret_value())

    def work(device_id: str) -> None:
        while bring_up_to_date(database, store, device_id, clock=clock).more and not stop.is_set():
            pass

    # The lower number goes first among the messages that this worker has fetched.
    dramatiq.Actor(work, broker=broker, actor_name=BURST_ACTOR, queue_name=bursts, priority=0, options={})
    dramatiq.Actor(work, broker=broker, actor_name=ACTOR, queue_name=queue, priority=1, options={})
    # One thread: the work is computation, a host's further cores take further processes.
    worker = dramatiq.Worker(broker, queues={queue, bursts}, worker_threads=1)
    worker.start()
    keeper = start_housekeeping(database, store, stop=stop, clock=clock)
    sealer = start_sealing(database, settings, stop=stop, clock=clock)
    analyst = start_analyses(settings, database, stop=stop, clock=clock)
    sweep = Sweep(database, broker, queue, clock)
    try:
        while not stop.wait(SWEEP_S):
            sweep.once()
    finally:
        stop.set()
        worker.stop(timeout=STOP_MS)
        broker.close()
        keeper.join()
        analyst.join()
        if sealer is not None:
            sealer.join()
        database.dispose()


class Sweep:
    """Sends again what is due while nothing waits in the queue: lost messages, and reviews."""

    def __init__(self, database: Database, broker: RabbitmqBroker, queue: str, clock: Clock) -> None:
        self._database = database
        self._broker = broker
        self._queue = queue
        self._clock = clock
        self._sent: dict[str, dt.datetime] = {}

    def once(self) -> int:
        """Look once; how many were sent."""
        try:
            waiting, _, _ = self._broker.get_queue_message_counts(self._queue)
            if waiting:
                return 0
            return self._send(self._due())
        except Exception:
            log.exception("sweep failed")
            return 0

    def _due(self) -> list[str]:
        now = self._clock()
        self._sent = {k: at for k, at in self._sent.items() if (now - at).total_seconds() < RESEND_S}
        with self._database.reading() as session:
            devices = due_devices(session, SWEEP_DEVICES, now=now)
        return [device_id for device_id in devices if device_id not in self._sent]

    def _send(self, devices: list[str]) -> int:
        for device_id in devices:
            self._broker.enqueue(message_for(device_id, self._queue))
            self._sent[device_id] = self._clock()
        return len(devices)
