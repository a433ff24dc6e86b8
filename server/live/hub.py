"""One reader of the change table per process, and many listeners.

While somebody listens, the reader asks for the highest id every `POLL_S`, fetches what is new and hands it to
the listeners of the same organisation.  A listener that cannot keep up is cut off: its browser comes back
with `Last-Event-ID` and reads from the table what it missed.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from dataclasses import dataclass, field

import structlog
from sqlalchemy import func, select
from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool

from server.database import Database
from server.models import Change

POLL_S = 0.2
QUEUE = 256
PAGE = 128
"""Handed out at once; half a queue, so that a burst of changes alone cuts nobody off."""

log = structlog.stdlib.get_logger("scatola.live")


@dataclass(eq=False, slots=True)
class Listener:
    """A connection: what waits for it, and whether it was cut off."""

    organisation_id: str
    queue: asyncio.Queue[Change | None] = field(default_factory=lambda: asyncio.Queue(QUEUE))
    """None ends the stream."""


class LiveHub:
    """The changes of one process' listeners; made in the event loop that serves them."""

    def __init__(self, database: Database, *, poll_s: float = POLL_S) -> None:
        self._database = database
        self._poll_s = poll_s
        self._listeners: set[Listener] = set()
        self._reader: asyncio.Task[None] | None = None
        self._cursor = 0
        self._loop = asyncio.get_running_loop()
        self._lock = asyncio.Lock()
        self._closed = False

    async def changes(self, organisation_id: str, after: int | None) -> AsyncGenerator[Change]:
        """Changes of an organisation from after an id on, or from now on; ends when the hub is closed."""
        listener = Listener(organisation_id)
        async with self._lock:
            if not self._listeners:
                self._cursor = await run_in_threadpool(self._highest)
            now = self._cursor
            self._listeners.add(listener)
            if self._reader is None and not self._closed:
                self._reader = self._loop.create_task(self._read())
        try:
            if after is not None and after > now and after > await run_in_threadpool(self._highest):
                after = None  # of a database that is no more: who waited for that id would hear nothing until then
            if after is not None:
                while page := await run_in_threadpool(self._page, organisation_id, after, now):
                    for change in page:
                        yield change
                    after = page[-1].id
            while not self._closed and (change := await listener.queue.get()) is not None:
                # Another process may have told the listener already what this one only learns now.
                if after is None or change.id > after:
                    yield change
        finally:
            self._listeners.discard(listener)
            if not self._listeners and self._reader is not None:
                self._reader.cancel()
                self._reader = None

    def close(self) -> None:
        """End all streams; from any thread."""
        self._closed = True
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._end_all)

    def _end_all(self) -> None:
        for listener in list(self._listeners):
            _cut_off(listener)

    async def _read(self) -> None:
        while not self._closed:
            try:
                found = await run_in_threadpool(self._news, self._cursor)
            except SQLAlchemyError:
                log.warning("changes cannot be read", exc_info=True)
                found = []
            for change in found:
                self._cursor = change.id
                self._hand_out(change)
            if len(found) < PAGE:
                await asyncio.sleep(self._poll_s)

    def _hand_out(self, change: Change) -> None:
        for listener in list(self._listeners):
            if listener.organisation_id != change.organisation_id:
                continue
            try:
                listener.queue.put_nowait(change)
            except asyncio.QueueFull:
                _cut_off(listener)
                self._listeners.discard(listener)

    def _highest(self) -> int:
        with self._database.reading() as session:
            return session.scalar(select(func.max(Change.id))) or 0

    def _news(self, after: int) -> list[Change]:
        with self._database.reading() as session:
            if (session.scalar(select(func.max(Change.id))) or 0) <= after:
                return []
            return list(session.scalars(select(Change).where(Change.id > after).order_by(Change.id).limit(PAGE)))

    def _page(self, organisation_id: str, after: int, until: int) -> list[Change]:
        query = select(Change).where(Change.organisation_id == organisation_id, Change.id > after, Change.id <= until)
        with self._database.reading() as session:
            return list(session.scalars(query.order_by(Change.id).limit(PAGE)))


def _cut_off(listener: Listener) -> None:
    while not listener.queue.empty():
        listener.queue.get_nowait()
    listener.queue.put_nowait(None)
