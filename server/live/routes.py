"""The live stream: server-sent events out of the change table."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import aclosing
from typing import Annotated, cast

import orjson
from fastapi import APIRouter, Header, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import StreamingResponse

from server.accounts.access import Reader, look
from server.accounts.places import Sight, seen, sight_of
from server.live.hub import LiveHub
from server.models import Change

router = APIRouter(prefix="/api/v1", tags=["live"])

HEARTBEAT_S = 15.0
LIFE_S = 3600.0
"""A stream ends after this long; the browser comes back and is checked again."""

_WHERE = ("lat_deg", "lon_deg")

Place = Annotated[int | None, Header(alias="Last-Event-ID", ge=0, le=2**63 - 1)]
After = Annotated[int | None, Query(ge=0, le=2**63 - 1, description="as Last-Event-ID, for a page's first connection")]


@router.get(
    "/live",
    response_class=StreamingResponse,
    responses={200: {"content": {"text/event-stream": {"schema": {"type": "string"}}}}},
)
async def live(request: Request, caller: Reader, last_event_id: Place = None, after: After = None) -> StreamingResponse:
    """What changes in the fleet, as it happens: id, event = kind, data = JSON with the moment and the ids.

    A client that lost the connection comes back with Last-Event-ID and misses nothing.
    """
    sight = sight_of(caller)
    if sight == "exact":
        # Each page goes on from another change; that is the same look.
        await run_in_threadpool(look, request, caller, "location.read", aside="after")
    place = last_event_id if last_event_id is not None else after
    stream = _events(hub_of(request), caller.organisation_id, place, sight)
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(stream, media_type="text/event-stream", headers=headers)


def hub_of(request: Request) -> LiveHub:
    """The process' hub, made with the first listener."""
    state = request.app.state
    if getattr(state, "live", None) is None:
        state.live = LiveHub(state.database)
    return cast("LiveHub", state.live)


async def _events(hub: LiveHub, organisation_id: str, after: int | None, sight: Sight) -> AsyncGenerator[bytes]:
    yield b"retry: 2000\n\n"
    deadline = asyncio.get_running_loop().time() + LIFE_S
    async with aclosing(hub.changes(organisation_id, after)) as changes:
        coming: asyncio.Task[Change] | None = None
        try:
            while asyncio.get_running_loop().time() < deadline:
                coming = coming or asyncio.ensure_future(anext(changes))
                # Not wait_for: it would cancel the generator, and with it the place in the queue.
                done, _ = await asyncio.wait([coming], timeout=HEARTBEAT_S)
                if not done:
                    yield b": still here\n\n"
                    continue
                try:
                    change = coming.result()
                except StopAsyncIteration:
                    return
                coming = None
                yield _event(change, sight)
        finally:
            if coming is not None:
                coming.cancel()
                await asyncio.wait([coming])


def _event(change: Change, sight: Sight) -> bytes:
    told = {name: value for name, value in change.data.items() if name not in _WHERE}
    place = seen(change.data.get("lat_deg"), change.data.get("lon_deg"), sight)
    if place is not None:
        told |= {"lat_deg": place.lat_deg, "lon_deg": place.lon_deg}
    data = {"at": change.at, "device_id": change.device_id, "vehicle_id": change.vehicle_id, **told}
    return b"id: %d\nevent: %b\ndata: %b\n\n" % (change.id, change.kind.encode(), orjson.dumps(data))
