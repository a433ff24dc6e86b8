"""The 3D view under the API's own address: page and sockets are passed on to the viewer process.

Only forwards; the viewer checks ticket and origin itself.  A reverse proxy that sends
``/view3d/`` to the viewer does the same.
"""

from __future__ import annotations

import contextlib
from typing import cast
from urllib.parse import quote

import httpx
from fastapi import APIRouter, Request
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, Response
from starlette.websockets import WebSocket

from server.settings import Settings
from server.view3d.relay import refuse, relay

router = APIRouter(include_in_schema=False)

_DOWN = "The 3D view is not running now. Reload in a moment."
_PASSED_ON = ("content-type", "content-encoding", "content-security-policy", "referrer-policy", "cache-control", "vary")


def viewer_url(connection: HTTPConnection) -> str | None:
    """Where the viewer listens: the supervisor's word, else the operator's; None when there is no viewer."""
    supervised = cast("str | None", getattr(connection.app.state, "viewer_url", None))
    configured = cast("Settings", connection.app.state.settings).viewer_url
    url = supervised or configured
    return url.rstrip("/") if url else None


def forwarded(connection: HTTPConnection) -> dict[str, str]:
    """Headers that tell the viewer how the browser addressed us."""
    headers = connection.headers
    names = {
        "origin": headers.get("origin"),
        "x-forwarded-host": headers.get("x-forwarded-host", headers.get("host")),
    }
    return {name: value for name, value in names.items() if value is not None}


def _path(ticket: str, device_id: str) -> str:
    return f"/view3d/{quote(ticket, safe='')}/{quote(device_id, safe='')}"


@router.get("/view3d/{ticket}/{device_id}/")
async def page(request: Request, ticket: str, device_id: str) -> Response:
    """The view's page, from the viewer; the query says whether it is a replay's."""
    return await forward(request, f"{_path(ticket, device_id)}/?{request.url.query}")


@router.get("/view3d/{ticket}/{device_id}/events/{event_id}.viser")
async def recording(request: Request, ticket: str, device_id: str, event_id: str) -> Response:
    """A recorded replay, from the viewer."""
    return await forward(request, f"{_path(ticket, device_id)}/events/{quote(event_id, safe='')}.viser")


@router.get("/view3d/{ticket}/{device_id}/mounting/")
async def own_page(request: Request, ticket: str, device_id: str) -> Response:
    """The page of a view of one's own, that walks through a box's history."""
    return await forward(request, f"{_path(ticket, device_id)}/mounting/")


@router.get("/view3d/{ticket}/{device_id}/mounting/state")
@router.put("/view3d/{ticket}/{device_id}/mounting/state")
async def own_state(request: Request, ticket: str, device_id: str) -> Response:
    """What such a view shows; PUT shows something else."""
    return await forward(request, f"{_path(ticket, device_id)}/mounting/state")


async def forward(request: Request, path: str) -> Response:
    """The viewer's answer; 503 where there is no viewer."""
    base = viewer_url(request)
    if base is not None:
        # The proxy settings of the environment are for other hosts.
        async with httpx.AsyncClient(trust_env=False, timeout=30.0) as client:
            with contextlib.suppress(httpx.TransportError):
                headers = {"accept-encoding": request.headers.get("accept-encoding", "identity"), **forwarded(request)}
                body = None if request.method == "GET" else await request.body()
                async with client.stream(request.method, f"{base}{path}", headers=headers, content=body) as answer:
                    content = b"".join([part async for part in answer.aiter_raw()])
                kept = {name: answer.headers[name] for name in _PASSED_ON if name in answer.headers}
                return Response(content, answer.status_code, kept)
    return PlainTextResponse(_DOWN, 503, {"Retry-After": "2"})


@router.websocket("/view3d/{ticket}/{device_id}")
@router.websocket("/view3d/{ticket}/{device_id}/")
async def socket(websocket: WebSocket, ticket: str, device_id: str) -> None:
    """The view's socket, piped to the viewer."""
    await _pipe(websocket, _path(ticket, device_id))


@router.websocket("/view3d/{ticket}/{device_id}/mounting")
async def own_socket(websocket: WebSocket, ticket: str, device_id: str) -> None:
    """The socket of a view of one's own."""
    await _pipe(websocket, f"{_path(ticket, device_id)}/mounting")


async def _pipe(websocket: WebSocket, path: str) -> None:
    base = viewer_url(websocket)
    if base is None:
        await refuse(websocket, 503, _DOWN)
        return
    await relay(websocket, f"ws{base.removeprefix('http')}{path}", headers=forwarded(websocket))
