"""Who is calling, and what that allows.

The gate (`server.accounts.gate`) has identified the caller and refused what must be refused before
a route runs; the dependencies here hand the caller to the route and state what the route needs.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Awaitable, Callable
from typing import Annotated, cast

from fastapi import Depends
from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection

from server.accounts import audit
from server.accounts.caller import Caller
from server.accounts.permissions import Permission
from server.database import Database
from server.errors import ForbiddenError, UnauthenticatedError

_PEOPLE = ("admin", "session", "key")


async def caller_of(connection: HTTPConnection) -> Caller:
    """The caller that the gate identified."""
    caller = cast("Caller | None", getattr(connection.state, "caller", None))
    if caller is None:
        raise UnauthenticatedError("Send a bearer token, or sign in")
    return caller


def needs(permission: Permission) -> Callable[[HTTPConnection], Awaitable[Caller]]:
    """A dependency: a caller with this permission."""

    async def with_permission(connection: HTTPConnection) -> Caller:
        caller = await caller_of(connection)
        if caller.kind not in _PEOPLE or not caller.may(permission):
            raise ForbiddenError(f"Needs the permission {permission}")
        return caller

    return with_permission


def looks_at(permission: Permission) -> Callable[[HTTPConnection], Awaitable[Caller]]:
    """A dependency: a caller with this permission, whose look is written to the audit log before it gets anything."""
    allowed = needs(permission)

    async def with_entry(connection: HTTPConnection) -> Caller:
        caller = await allowed(connection)
        await run_in_threadpool(look, connection, caller, permission)
        return caller

    return with_entry


def look(connection: HTTPConnection, caller: Caller, permission: Permission, *, aside: str | None = None) -> None:
    """Write to the audit log that a caller sees locations or samples: the route, the ids in it, the query.

    `aside` is a parameter of the query that says nothing of what is seen, but differs each time.
    """
    state = connection.app.state
    now = cast("dt.datetime", state.clock())
    route = getattr(connection.scope.get("route"), "path", connection.url.path)
    subject = " ".join([route, *(f"{name}={value}" for name, value in connection.path_params.items())])
    actor = caller.user_id or caller.key_id or caller.session_id
    given = connection.url.query
    query = "&".join(part for part in given.split("&") if aside is None or part.partition("=")[0] != aside)[:500]
    key = (caller.organisation_id, caller.kind, actor, permission, subject, query)
    if not cast("audit.RecentLooks", state.recent_looks).is_new(key, now):
        return
    with cast("Database", state.database).transaction() as session:
        detail = {"query": query} if query else {}
        audit.record(session, caller, permission, subject, now=now, detail=detail)


def look_at_places(connection: HTTPConnection, caller: Caller) -> None:
    """Write to the audit log that a caller sees locations, if it may: where it may not, what it gets holds none."""
    if caller.may("location.read"):
        look(connection, caller, "location.read")


def sees_places(at_least: Permission) -> Callable[[HTTPConnection], Awaitable[Caller]]:
    """A dependency: a caller that may see places, if only coarsely; an exact look is written to the audit log."""

    async def with_sight(connection: HTTPConnection) -> Caller:
        caller = await caller_of(connection)
        if caller.kind not in _PEOPLE or not (caller.may(at_least) or caller.may("location.read")):
            raise ForbiddenError(f"Needs the permission {at_least}, or location.read")
        await run_in_threadpool(look_at_places, connection, caller)
        return caller

    return with_sight


def address_of(connection: HTTPConnection) -> str:
    """Where a request came from, as far as the proxies in front are believed."""
    return connection.client.host if connection.client else ""


async def device_caller(connection: HTTPConnection) -> Caller:
    """A box, with its own token."""
    caller = await caller_of(connection)
    if caller.kind != "device":
        raise ForbiddenError("Only a device token may upload")
    return caller


async def operator(connection: HTTPConnection) -> Caller:
    """Who runs the installation, with the administrator's token."""
    caller = await caller_of(connection)
    if caller.kind != "admin":
        raise ForbiddenError("Only the installation's administrator may do this")
    return caller


AnyCaller = Annotated[Caller, Depends(caller_of)]
Reader = Annotated[Caller, Depends(needs("fleet.read"))]
Administrator = Annotated[Caller, Depends(needs("fleet.write"))]
Installer = Annotated[Caller, Depends(needs("install"))]
LocationReader = Annotated[Caller, Depends(looks_at("location.read"))]
PlaceReader = Annotated[Caller, Depends(sees_places("location.coarse"))]
RawReader = Annotated[Caller, Depends(looks_at("raw.read"))]
Reviewer = Annotated[Caller, Depends(needs("events.review"))]
UserManager = Annotated[Caller, Depends(needs("users.manage"))]
PrivacyManager = Annotated[Caller, Depends(needs("privacy.manage"))]
PrivacyExporter = Annotated[Caller, Depends(needs("privacy.export"))]
AuditReader = Annotated[Caller, Depends(needs("audit.read"))]
Exporter = Annotated[Caller, Depends(needs("export"))]
JobManager = Annotated[Caller, Depends(needs("jobs.manage"))]
Operator = Annotated[Caller, Depends(operator)]
DeviceCaller = Annotated[Caller, Depends(device_caller)]

__all__ = [
    "Administrator",
    "AnyCaller",
    "AuditReader",
    "Caller",
    "DeviceCaller",
    "Exporter",
    "Installer",
    "JobManager",
    "LocationReader",
    "Operator",
    "PlaceReader",
    "PrivacyExporter",
    "PrivacyManager",
    "RawReader",
    "Reader",
    "Reviewer",
    "UserManager",
    "address_of",
    "caller_of",
    "look",
    "look_at_places",
    "needs",
]
