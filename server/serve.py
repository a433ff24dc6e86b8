"""`scatola serve`: the API in this process, worker and viewer as supervised children when embedded."""

from __future__ import annotations

import asyncio
import contextlib
import datetime as dt
import signal
import socket
import time
from collections.abc import Callable
from types import FrameType

import structlog
import uvicorn
from fastapi import FastAPI

from server.accounts.service import first_sign_in
from server.app import create_app
from server.database import Database
from server.formats import decode
from server.jobs.supervise import Child, Supervisor, scatola
from server.live.hub import LiveHub
from server.logs import configure_logging
from server.memory import set_aside, share_heaps
from server.migrations import serves, upgrade
from server.patience import PatientProtocol
from server.settings import Settings
from server.tracing import configure_tracing

log = structlog.stdlib.get_logger("scatola.serve")

_FINISH_REQUESTS_S, _FINISH_CHILDREN_S = 2, 7.0
_FINISH_AFTER_DRAIN_S = 9.0
"""Together under the ten seconds in which everything is promised to have stopped."""


def serve(
    settings: Settings,
    *,
    say: Callable[[str], None],
    more_children: Callable[[str], list[Child]] = lambda url: [],  # noqa: ARG005  none needs the address
    sign_in: Callable[[Database], str | None] | None = None,
) -> None:
    """Serve until SIGTERM or SIGINT; `say` gets the lines that a person at the terminal should read.

    `more_children` are started beside worker and viewer once the address is known.
    """
    configure_logging(as_json=settings.log_json, level=settings.log_level)
    flush = configure_tracing(settings, "api")
    if settings.embedded:
        upgrade(settings)
    app = create_app(settings)
    if not serves(app.state.database.engine):
        raise ValueError("the database is not at this version's schema: run `scatola migrate` first")
    settle()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, _leave)
    with contextlib.ExitStack() as stack:
        stack.callback(flush)
        sock = socket.create_server((settings.host, settings.port), reuse_port=False, backlog=1024)
        stack.callback(sock.close)
        url = _address(settings.host, sock.getsockname()[1])
        if settings.embedded:
            children = [*_children(app), *more_children(url)]
            supervisor = Supervisor(children)
            app.state.wake = app.state.wake_burst = supervisor.wake
            stack.callback(supervisor.stop, max(1.0, _FINISH_CHILDREN_S - settings.drain_s))
            supervisor.start()
            app.state.readiness.helpers["worker"] = lambda: None if supervisor.alive()["worker"] else "does not run"
        else:
            _use_broker(app, stack)

        def greet() -> None:
            say(f"Scatola serves {url}")
            code = (sign_in or _first_sign_in(settings))(app.state.database)
            if code is not None:
                say(f"Sign in, once:  {url}/login?code={code}")

        config = uvicorn.Config(
            app,
            http=PatientProtocol,
            log_config=None,
            access_log=False,  # our own log names routes, not paths: those may carry tickets and codes
            ws="websockets-sansio",
            ws_max_size=1024 * 1024,
            timeout_graceful_shutdown=(
                _FINISH_REQUESTS_S if settings.embedded else int(_FINISH_AFTER_DRAIN_S - settings.drain_s)
            ),
        )
        _Server(config, greet, app).run(sockets=[sock])


def settle() -> None:
    """Once an application is made, before threads work: few heaps, what uploads need, nothing that lasts collected."""
    share_heaps()
    decode.load()
    set_aside()


class _Server(uvicorn.Server):
    """Tells when it listens; at the end drains, and ends the live streams, which end by themselves never."""

    def __init__(self, config: uvicorn.Config, started: Callable[[], None], app: FastAPI) -> None:
        super().__init__(config)
        self._tell = started
        self._app = app

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self._tell()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        state = self._app.state
        # First /readyz says so, while everything is served as before: who balances must notice before we are gone.
        state.readiness.draining = True
        deadline = time.monotonic() + state.settings.drain_s
        while time.monotonic() < deadline and not self.force_exit:  # noqa: ASYNC110  set by a signal handler
            await asyncio.sleep(0.05)
        live: LiveHub | None = getattr(state, "live", None)
        if live is not None:
            live.close()
        await super().shutdown(sockets)


def _use_broker(app: FastAPI, stack: contextlib.ExitStack) -> None:
    """Send what is due to the broker, and show how it does."""
    from server.jobs.broker import BURST_ACTOR, BURSTS, BrokerUnreachableError, Queues, Sender

    state, settings = app.state, app.state.settings
    state.wake = Sender(settings)
    state.wake_burst = Sender(settings, queue=BURSTS, actor=BURST_ACTOR)
    stack.callback(state.wake.close)
    stack.callback(state.wake_burst.close)
    queues = Queues(settings)

    def failure() -> str | None:
        try:
            queues.check()
        except BrokerUnreachableError as error:
            return f"does not answer ({error})"
        return None

    def depths() -> dict[str, float] | None:
        try:
            return {name: float(count) for name, count in queues.depths().items()}
        except BrokerUnreachableError:
            return None

    def drop_letters(device_ids: set[str]) -> None:
        try:
            queues.drop_letters(device_ids)
        except BrokerUnreachableError:
            log.warning("dead letters stay in the broker")  # they expire there, and say nothing new

    state.readiness.helpers["broker"] = failure
    state.queue_depths = depths
    state.drop_letters = drop_letters


def _children(app: FastAPI) -> list[Child]:
    children = [Child("worker", scatola("worker"))]
    settings: Settings = app.state.settings
    if settings.viewer_url is None:
        port = _free_port()
        app.state.viewer_url = f"http://127.0.0.1:{port}"
        children.append(Child("viewer", scatola("viewer", "--port", str(port))))
    return children


def _first_sign_in(settings: Settings) -> Callable[[Database], str | None]:
    def code(database: Database) -> str | None:
        if settings.admin_token is not None:
            return None
        with database.transaction() as session:
            return first_sign_in(session, now=dt.datetime.now(dt.UTC))

    return code


def _address(host: str, port: int) -> str:
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


def _leave(number: int, frame: FrameType | None) -> None:
    # uvicorn handles the signal while it serves and raises it again when it is done: everything is
    # stopped on the way out.
    del number, frame
    raise SystemExit(0)
