"""HTTP/1.1 as uvicorn serves it, but a connection on which no request arrives is closed.

uvicorn bounds the pause between two requests, not the time until a head is whole: without this, a thousand sockets that
send a byte now and then would keep everybody else out.  Bodies have bounds of their own (`server.ingest.body`).
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

HEAD_S = 30.0
"""From the opening of a connection, or the first byte of a further request, to the end of its head."""


class PatientProtocol(H11Protocol):
    """Closes what keeps it waiting for a head."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:  # uvicorn's own
        super().__init__(*args, **kwargs)
        self._waiting: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]  as in uvicorn
        super().connection_made(transport)
        self._wait()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self._lacks_head():
            self._wait()
        else:
            self._stop()

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop()
        super().connection_lost(exc)

    def _lacks_head(self) -> bool:
        if self.transport.get_protocol() is not self:  # a socket's upgrade handed the connection on
            return False
        return self.cycle is None or self.cycle.response_complete  # pyright: ignore[reportUnnecessaryComparison]  before the first request

    def _wait(self) -> None:
        if self._waiting is None:
            self._waiting = self.loop.call_later(HEAD_S, self._give_up)

    def _stop(self) -> None:
        if self._waiting is not None:
            self._waiting.cancel()
            self._waiting = None

    def _give_up(self) -> None:
        self._waiting = None
        if self._lacks_head() and not self.transport.is_closing():
            self.transport.close()
