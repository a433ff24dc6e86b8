"""Signals as binary columns for charts."""

from __future__ import annotations

import datetime as dt
from typing import Annotated, cast

import numpy as np
import orjson
from fastapi import APIRouter, Depends, Query, Request
from starlette.responses import Response

from server.accounts.access import RawReader
from server.edge import DatabaseOf, Now, StoreOf
from server.errors import ForbiddenError, InvalidError
from server.signals import queries, service
from server.signals.service import UNITS, Frame, Signals, Window
from server.signals.thin import Memory

router = APIRouter(tags=["signals"])


async def _memory(request: Request) -> Memory:
    return cast("Memory", request.app.state.thinned)


MemoryOf = Annotated[Memory, Depends(_memory)]
MEDIA_TYPE = "application/octet-stream"


@router.get(
    "/api/v1/devices/{device_id}/signals",
    response_class=Response,
    responses={200: {"content": {MEDIA_TYPE: {}}, "description": "header length, header, columns"}},
)
def get_signals(
    device_id: str,
    caller: RawReader,
    database: DatabaseOf,
    store: StoreOf,
    memory: MemoryOf,
    now: Now,
    begin: Annotated[dt.datetime | None, Query(alias="from", description="default: `seconds` before the end")] = None,
    end: Annotated[dt.datetime | None, Query(alias="to", description="default: the newest sample")] = None,
    seconds: Annotated[float, Query(gt=0.0, le=86400.0, description="length of the window without `from`")] = 60.0,
    columns: Annotated[
        str, Query(max_length=200, description="names of the drive file, comma separated")
    ] = "fx,fy,fz,speed",
    frame: Annotated[
        Frame, Query(description="`a` the box's axes, `v` the vehicle's where the mounting is known")
    ] = "a",
    points: Annotated[int, Query(ge=10, le=20000, description="at most about so many per column")] = 1200,
) -> Response:
    """Signals of a window, thinned to what a chart can show; the smallest and largest values survive.

    The answer, little-endian throughout:

    - `uint32`: length n of the header in bytes;
    - n bytes: the header, a JSON object with `t0` (UTC, to which times are relative), `from` and
      `to` (the window), `frame` (`v` only if a mounting is known; else `a`), `units`, `groups`
      (`[{"columns": [...], "count": n}, ...]`) and `gaps` (`[[a, b], ...]`, seconds since `t0`);
    - for each group: `count` times as float64, seconds since `t0`, then `count` float32 values for
      each of its columns.  NaN interrupts the line.
    """
    if {"lat", "lon"} & set(columns.split(",")) and not caller.may("location.read"):
        raise ForbiddenError("lat and lon need the permission location.read")
    with database.reading() as session:
        queries.require_device(session, caller.organisation_id, device_id)
        window = _window(begin, end or queries.newest(session, device_id) or now, seconds)
        coarse = service.is_coarse(window, points)
        pieces = queries.pieces(session, device_id, window.begin, window.end, coarse=coarse)
        mountings = queries.mountings(session, device_id, window.begin, window.end) if frame == "v" else []
    names = columns.split(",")
    found = service.signals(store, memory, pieces, mountings, window, names=names, frame=frame, points=points)
    return Response(_encode(found, window), media_type=MEDIA_TYPE)


def _window(begin: dt.datetime | None, end: dt.datetime, seconds: float) -> Window:
    if end.tzinfo is None or (begin is not None and begin.tzinfo is None):
        raise InvalidError("from and to need a time zone, such as Z", code="naive_time")
    first = begin if begin is not None else end - dt.timedelta(seconds=seconds)
    if first >= end:
        raise InvalidError("from must lie before to", code="empty_window")
    return Window(first, end)


def _encode(found: Signals, window: Window) -> bytes:
    names = [name for curve in found.curves for name in curve.columns]
    header = orjson.dumps(
        {
            "t0": found.t0,
            "from": window.begin,
            "to": window.end,
            "frame": found.frame,
            "units": {name: UNITS[name] for name in names},
            "groups": [{"columns": list(curve.columns), "count": curve.t.size} for curve in found.curves],
            "gaps": found.gaps,
        }
    )
    blocks = [np.uint32(len(header)).astype("<u4").tobytes(), header]
    for curve in found.curves:
        blocks.append(curve.t.astype("<f8").tobytes())
        blocks.extend(values.astype("<f4").tobytes() for values in curve.columns.values())
    return b"".join(blocks)
