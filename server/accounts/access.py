"""Who is calling, and what that allows.

The gate (`server.accounts.gate`) has identified the caller and refused what must be refused before
a route runs; the dependencies here hand the caller to the route and state what the route needs.
"""

from __future__ import annotations

from typing import Annotated, cast

from fastapi import Depends
from starlette.requests import HTTPConnection

from server.accounts.caller import Caller
from server.errors import ForbiddenError, UnauthenticatedError


async def caller_of(connection: HTTPConnection) -> Caller:
    """The caller that the gate identified."""
    caller = cast("Caller | None", getattr(connection.state, "caller", None))
    if caller is None:
        raise UnauthenticatedError("Send a bearer token, or sign in")
    return caller


async def reader(connection: HTTPConnection) -> Caller:
    """A caller that may read the fleet."""
    caller = await caller_of(connection)
    if caller.kind not in ("admin", "session"):
        raise ForbiddenError("Not for this token")
    return caller


async def administrator(connection: HTTPConnection) -> Caller:
    """A caller that may change the fleet; whoever is signed in may, as long as there are no roles."""
    return await reader(connection)


async def device_caller(connection: HTTPConnection) -> Caller:
    """A box, with its own token."""
    caller = await caller_of(connection)
    if caller.kind != "device":
        raise ForbiddenError("Only a device token may upload")
    return caller


AnyCaller = Annotated[Caller, Depends(caller_of)]
Reader = Annotated[Caller, Depends(reader)]
Administrator = Annotated[Caller, Depends(administrator)]
DeviceCaller = Annotated[Caller, Depends(device_caller)]

__all__ = [
    "Administrator",
    "AnyCaller",
    "Caller",
    "DeviceCaller",
    "Reader",
    "administrator",
    "caller_of",
    "device_caller",
    "reader",
]
