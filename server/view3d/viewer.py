"""The viewer process: serves the 3D view's page and its sockets to whoever holds a ticket.

It is a process of its own because viser keeps a thread and an event loop per scene, and because
the API imports neither viser nor scipy.
"""

from __future__ import annotations

import asyncio
import contextlib
import datetime as dt
import gzip
import threading
from collections.abc import AsyncGenerator
from importlib.metadata import distribution
from pathlib import Path
from typing import Annotated, Literal

import rich
import uvicorn
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from server.database import Database
from server.edge import Clock
from server.errors import ProblemError
from server.settings import Settings
from server.store import open_store
from server.view3d import permission
from server.view3d.pool import ScenePool
from server.view3d.recording import Replays
from server.view3d.relay import refuse, relay, same_origin
from server.view3d.view import Choice

_EXPIRED = "This 3D view's ticket has expired. Reload the page that shows it."
_PANEL, _NOTICES = ".mantine-Paper-root", ".mantine-Notifications-root"

Force = Annotated[float, Field(ge=-1e4, le=1e4)] | None


class Wanted(BaseModel):
    """What the page around a scene asks it to show."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    step: str | None = Field(default=None, max_length=32)
    before: bool = False
    proposal: int | None = Field(default=None, ge=0, le=3)
    at: float | None = Field(default=None, ge=0.0, le=2.5e11)
    """Unix s."""
    f: tuple[Force, Force, Force] | None = None
    """What the page shows at that instant, m/s²; the viewer reads no recording for it."""
    frame: Literal["a", "v"] = "a"
    """Axes of `f`."""

    def choice(self) -> Choice:
        """The same for the pool."""
        at = None if self.at is None else dt.datetime.fromtimestamp(self.at, dt.UTC)
        x, y, z = self.f or (None, None, None)
        f = None if x is None or y is None or z is None else (x, y, z)
        return Choice(self.step, self.before, self.proposal, at, f, self.frame == "v")


class _Client:
    """viser's page, as it is and compressed."""

    def __init__(self, page: bytes) -> None:
        self.page, self.compressed = page, gzip.compress(page, 6)


class Viewer:
    """The ASGI application's routes and what they share."""

    def __init__(self, settings: Settings, *, clock: Clock, pool: ScenePool | None = None) -> None:
        self._settings = settings
        self._clock = clock
        self._database = Database(settings)
        self.pool = pool or ScenePool(self._database, clock=clock, store=open_store(settings))
        self.replays = Replays(self._database)
        page = client_page()
        self._shared = _Client(page)
        # The panel shows the socket's address, and so the ticket; a replay is led from its page.
        self._bare = _Client(without(page, _NOTICES, _PANEL))
        self._headers = {
            "Content-Security-Policy": content_security_policy(settings),
            "X-Content-Type-Options": "nosniff",
            # The path is a credential for ten minutes.
            "Referrer-Policy": "no-referrer",
            "Cache-Control": "no-store",
            "Vary": "Accept-Encoding",
        }

    async def page(self, request: Request) -> Response:
        """The client that viser ships, for the holder of a ticket; a replay's as a mere picture."""
        return await self._client(request, self._bare if "playbackPath" in request.query_params else self._shared)

    async def own_page(self, request: Request) -> Response:
        """The same as a mere picture, for a page that has words and controls of its own."""
        return await self._client(request, self._bare)

    async def _client(self, request: Request, client: _Client) -> Response:
        secret, device_id = request.path_params["ticket"], request.path_params["device_id"]
        if not await run_in_threadpool(self._opens, secret, device_id):
            return PlainTextResponse(_EXPIRED, 403, self._headers)
        if "gzip" in request.headers.get("accept-encoding", ""):
            headers = {**self._headers, "Content-Encoding": "gzip"}
            return Response(client.compressed, headers=headers, media_type="text/html")
        return Response(client.page, headers=self._headers, media_type="text/html")

    async def socket(self, websocket: WebSocket) -> None:
        """The scene's socket: ticket and origin are checked, then bytes pass both ways."""
        await self._pass_on(websocket, None)

    async def own_socket(self, websocket: WebSocket) -> None:
        """The same, to a scene that is the ticket holder's own."""
        await self._pass_on(websocket, websocket.path_params["ticket"])

    async def _pass_on(self, websocket: WebSocket, owner: str | None) -> None:
        secret, device_id = websocket.path_params["ticket"], websocket.path_params["device_id"]
        if not same_origin(websocket.headers, self._settings.trusted_origins):
            await refuse(websocket, 403, "The 3D view does not open from another site.")
            return
        if not await run_in_threadpool(self._opens, secret, device_id):
            await refuse(websocket, 403, _EXPIRED)
            return
        try:
            port = await run_in_threadpool(self.pool.enter, device_id, owner)
        except ProblemError as problem:
            await refuse(websocket, problem.status, problem.detail)
            return
        renewing = asyncio.create_task(self._keep(secret))
        try:
            await relay(websocket, f"ws://127.0.0.1:{port}/")
        finally:
            renewing.cancel()
            await run_in_threadpool(self.pool.leave, device_id, owner)

    async def state(self, request: Request) -> Response:
        """What the ticket holder's own scene shows; PUT shows something else."""
        secret, device_id = request.path_params["ticket"], request.path_params["device_id"]
        if not await run_in_threadpool(self._opens, secret, device_id):
            return PlainTextResponse(_EXPIRED, 403, self._headers)
        try:
            if request.method == "PUT":
                wanted = Wanted.model_validate_json(await request.body())
                await run_in_threadpool(self.pool.choose, device_id, secret, wanted.choice())
            told = await run_in_threadpool(self.pool.state, device_id, secret)
        except ValidationError:
            return PlainTextResponse("Not a choice of step, before, proposal, at", 422, self._headers)
        except ProblemError as problem:
            return PlainTextResponse(problem.detail, problem.status, self._headers)
        return JSONResponse(told, headers=self._headers)

    async def recording(self, request: Request) -> Response:
        """A recorded replay of one of the box's events, for the holder of a ticket for it."""
        secret, device_id, event_id = (request.path_params[name] for name in ("ticket", "device_id", "event_id"))
        if not await run_in_threadpool(self._opens, secret, device_id, event_id):
            return PlainTextResponse(_EXPIRED, 403, self._headers)
        try:
            content = await run_in_threadpool(self.replays.of, device_id, event_id)
        except ProblemError as problem:
            return PlainTextResponse(problem.detail, problem.status, self._headers)
        return Response(content, headers=self._headers, media_type="application/octet-stream")

    async def health(self, request: Request) -> Response:
        """Answers while the process lives."""
        del request
        return PlainTextResponse("ok")

    def close(self) -> None:
        self.pool.close()
        self._database.dispose()

    def _opens(self, secret: str, device_id: str, event_id: str | None = None) -> bool:
        with self._database.reading() as session:
            return permission.opens(session, secret, device_id, now=self._clock(), event_id=event_id)

    async def _keep(self, secret: str) -> None:
        while True:
            await asyncio.sleep(permission.LIFETIME.total_seconds() / 3)
            await run_in_threadpool(self._renew, secret)

    def _renew(self, secret: str) -> None:
        with self._database.transaction() as session:
            permission.renew(session, secret, now=self._clock())


def client_page() -> bytes:
    """The client of the installed viser: one file that asks no other host for anything."""
    return Path(str(distribution("viser").locate_file("viser/client/build/index.html"))).read_bytes()


def without(page: bytes, *classes: str) -> bytes:
    """The client with elements of those classes hidden."""
    style = f"<style>{','.join(classes)}{{display:none!important}}</style>"
    return page.replace(b"</head>", style.encode() + b"</head>", 1)


def content_security_policy(settings: Settings) -> str:
    """What viser's client needs and no more; it compiles WebAssembly and starts a worker from a blob."""
    framers = " ".join(("'self'", *settings.trusted_origins))
    return (
        "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; worker-src blob:; "
        "connect-src 'self' blob: data:; img-src 'self' data: blob:; font-src data:; "
        f"style-src 'self' 'unsafe-inline'; object-src 'none'; base-uri 'none'; frame-ancestors {framers}"
    )


def create_viewer(
    settings: Settings, *, clock: Clock = lambda: dt.datetime.now(dt.UTC), pool: ScenePool | None = None
) -> Starlette:
    """The viewer's ASGI application."""
    viewer = Viewer(settings, clock=clock, pool=pool)

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncGenerator[None]:
        del app
        yield
        await run_in_threadpool(viewer.close)

    path = "/view3d/{ticket}/{device_id}"
    return Starlette(
        routes=[
            Route("/healthz", viewer.health),
            Route(path + "/", viewer.page),
            Route(path + "/events/{event_id}.viser", viewer.recording),
            Route(path + "/mounting/", viewer.own_page),
            Route(path + "/mounting/state", viewer.state, methods=["GET", "PUT"]),
            WebSocketRoute(path + "/mounting", viewer.own_socket),
            # viser's client drops the slash at the end of the page's address to get the socket's.
            WebSocketRoute(path, viewer.socket),
            WebSocketRoute(path + "/", viewer.socket),
        ],
        lifespan=lifespan,
    )


def run_viewer(settings: Settings, *, host: str, port: int, stop: threading.Event | None = None) -> None:
    """Serve until SIGTERM, SIGINT or `stop`."""
    # viser prints a box for each server, on a console of rich's that it has to itself in this process.
    rich.reconfigure(quiet=True)
    config = uvicorn.Config(
        create_viewer(settings),
        host=host,
        port=port,
        log_level="warning",
        access_log=False,  # paths carry tickets
        ws="websockets-sansio",
        ws_max_size=1024 * 1024,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=3,
    )
    server = uvicorn.Server(config)
    if stop is not None:

        def follow(event: threading.Event = stop) -> None:
            event.wait()
            server.should_exit = True

        threading.Thread(target=follow, name="view3d-stop", daemon=True).start()
    server.run()
