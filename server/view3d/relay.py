"""Passing a browser's WebSocket on to another server, message by message in both directions."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from urllib.parse import urlsplit

from starlette.responses import PlainTextResponse
from starlette.websockets import WebSocket, WebSocketDisconnect
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus
from websockets.typing import Subprotocol

_DEFAULT_PORTS = {"http": 80, "https": 443}
# Scenes are small; this only keeps a broken peer from filling the memory.
_MAX_MESSAGE_BYTES = 16 * 1024 * 1024
_MAY_BE_SENT = frozenset({1000, 1001, 1002, 1003, 1007, 1008, 1009, 1010, 1011, 1012, 1013})
_SERVICE_RESTART = 1012


def same_origin(headers: Mapping[str, str], trusted: Iterable[str]) -> bool:
    """Whether the page that opens a WebSocket comes from this host, or from an origin that is trusted.

    Browsers do not apply the same-origin policy to WebSockets; the server must.  A page cannot set
    ``X-Forwarded-Host``, only a proxy before us can, so it may be believed here.
    """
    origin = headers.get("origin", "")
    if origin in trusted:
        return True
    parts = urlsplit(origin)
    if parts.scheme not in _DEFAULT_PORTS or not parts.hostname:
        return False
    host = headers.get("x-forwarded-host", headers.get("host", "")).split(",")[0].strip()
    addressed = urlsplit(f"{parts.scheme}://{host}")
    try:
        ports = (parts.port or _DEFAULT_PORTS[parts.scheme], addressed.port or _DEFAULT_PORTS[parts.scheme])
    except ValueError:
        return False
    return parts.hostname == addressed.hostname and ports[0] == ports[1]


async def refuse(websocket: WebSocket, status: int, sentence: str) -> None:
    """Answer the opening handshake with an ordinary HTTP refusal."""
    await websocket.send_denial_response(PlainTextResponse(sentence, status))


async def relay(websocket: WebSocket, url: str, *, headers: Mapping[str, str] | None = None) -> None:
    """Connect to `url` with the sub-protocols that the browser offers, then pass messages until either side ends."""
    offered = [Subprotocol(name) for name in websocket.scope["subprotocols"]]
    try:
        upstream = await connect(
            url,
            subprotocols=offered or None,
            additional_headers=dict(headers or {}),
            user_agent_header=None,
            compression=None,
            max_size=_MAX_MESSAGE_BYTES,
            open_timeout=10,
            close_timeout=1,
            proxy=None,
        )
    except InvalidStatus as refusal:
        await refuse(websocket, refusal.response.status_code, "The 3D view refused the connection.")
        return
    except (OSError, TimeoutError, InvalidHandshake):
        await refuse(websocket, 503, "The 3D view is not running now.")
        return
    async with upstream:
        await websocket.accept(subprotocol=upstream.subprotocol)
        ways = {asyncio.create_task(_down(upstream, websocket)), asyncio.create_task(_up(websocket, upstream))}
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)


async def _down(upstream: ClientConnection, websocket: WebSocket) -> None:
    try:
        async for message in upstream:
            if isinstance(message, str):
                await websocket.send_text(message)
            else:
                await websocket.send_bytes(message)
    except ConnectionClosed:
        pass  # the code below says how
    except WebSocketDisconnect:
        return
    code = upstream.close_code if upstream.close_code in _MAY_BE_SENT else _SERVICE_RESTART
    await websocket.close(code or _SERVICE_RESTART, upstream.close_reason or "")


async def _up(websocket: WebSocket, upstream: ClientConnection) -> None:
    while True:
        message = await websocket.receive()
        if message["type"] == "websocket.disconnect":
            return
        payload = message.get("bytes")
        try:
            await upstream.send(message["text"] if payload is None else payload)
        except ConnectionClosed:
            return
