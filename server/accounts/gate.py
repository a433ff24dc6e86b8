"""The one gate: whoever has no credentials is refused here, before anything else is looked at.

Also refused here: a device token anywhere but at its own door, and a browser's unsafe request
without its CSRF token or from another origin.
"""

from __future__ import annotations

import dataclasses
import datetime as dt
import re
from collections.abc import Callable
from typing import cast
from urllib.parse import parse_qs, quote, urlsplit

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.accounts import service, signature
from server.accounts.access import address_of
from server.accounts.caller import Caller
from server.accounts.cookie import COOKIE, cookie_header
from server.accounts.permissions import ALL
from server.accounts.secrets import KEY_PREFIX, hash_of, same
from server.database import Database
from server.errors import ForbiddenError, ProblemError, UnauthenticatedError
from server.problems import is_api, problem_response
from server.settings import Settings
from server.view3d import permission

_OPEN = frozenset({"/healthz", "/readyz", "/metrics", "/openapi.json", "/docs"})
_SIGN_IN = ("/login", "/api/v1/auth")
DEVICE_PATHS = frozenset({"/api/v1/batches", "/api/v1/device", "/api/v1/device/token", "/api/v1/device/diagnosis"})
_CLAIM = ("/api/v1/claim",)
_VIEW = re.compile(r"/view3d/(?P<ticket>[A-Za-z0-9_-]{16,})/(?P<device>[0-9a-f]{32})(?:/.*)?")
_SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
_MAX_FORM_BYTES = 64 * 1024
_CSRF_PART = re.compile(rb'name="csrf_token"\r\n\r\n([^\r\n]*)\r\n')


def _is_below(path: str, roots: tuple[str, ...]) -> bool:
    return any(path == root or path.startswith(root + "/") for root in roots)


def _is_open(path: str) -> bool:
    return path in _OPEN or path.startswith("/static/") or _is_below(path, _CLAIM)


class AccessGate:
    """Identifies callers and lets them through, or not."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket") or _is_open(scope["path"]):
            await self._app(scope, receive, send)
            return
        connection = HTTPConnection(scope)
        try:
            caller, renewed = await run_in_threadpool(_identify, connection)
            if _is_below(scope["path"], _SIGN_IN):
                receive = await _admit_sign_in(connection, caller, receive)
            else:
                receive = await _admit(connection, caller, receive)
        except ProblemError as error:
            await _refuse(error, connection, receive, send)
            return
        if caller is not None:
            caller = dataclasses.replace(caller, address=address_of(connection))
        scope.setdefault("state", {})["caller"] = caller
        await self._app(scope, receive, _renewing(send, connection) if renewed else send)


def _identify(connection: HTTPConnection) -> tuple[Caller | None, bool]:
    """The caller, and whether its session was renewed."""
    settings = cast("Settings", connection.app.state.settings)
    database = cast("Database", connection.app.state.database)
    now = cast("dt.datetime", connection.app.state.clock())
    scheme, _, token = connection.headers.get("authorization", "").partition(" ")
    if scheme.lower() == signature.SCHEME:
        return _signed(database, connection, signature.parse(token), now), False
    if scheme:
        if scheme.lower() != "bearer":
            return None, False
        return _bearer(settings, database, token.strip(), now), False
    cookie = connection.cookies.get(COOKIE)
    if cookie:
        with database.reading() as session:
            found = service.session_of(session, cookie, now=now)
        if found is not None:
            row, caller = found
            renew = service.due_to_slide(row, now=now)
            if renew:
                with database.transaction() as session:
                    service.slide(session, row.id, now=now)
            return caller, renew
    view = _VIEW.fullmatch(connection.url.path)
    if view is not None:
        with database.reading() as session:
            opens = permission.opens(session, view["ticket"], view["device"], now=now)
        return (Caller("", "ticket", device_id=view["device"]) if opens else None), False
    return None, False


def _bearer(settings: Settings, database: Database, token: str, now: dt.datetime) -> Caller | None:
    if settings.admin_token is not None and same(token, settings.admin_token.get_secret_value()):
        with database.reading() as session:
            organisation = service.default_organisation(session)
        if organisation is None:
            return None
        return Caller(organisation.id, "admin", name="administrator's token", permissions=ALL)
    if token.startswith(KEY_PREFIX):
        with database.reading() as session:
            return service.key_of(session, token, now=now)
    with database.glance() as connection:
        found = service.device_of(connection, token)
    if found is None:
        return None
    caller, is_next = found
    if is_next:
        with database.transaction() as session:
            service.begin_next_token(session, hash_of(token))
    return caller


def _signed(database: Database, connection: HTTPConnection, claim: signature.Claim, now: dt.datetime) -> Caller:
    with database.reading() as session:
        found = service.signing_device(session, claim.device_id)
    # An unknown box fails like a wrong signature: which boxes exist is nobody's business.
    caller, keys = found or (None, [hash_of("")])
    method, path = connection.scope["method"], connection.url.path
    key = signature.check(claim, keys, method=method, path=path, headers=connection.headers, now=now)
    if caller is None:
        raise UnauthenticatedError("The signature is not this box's for this request", code="signature")
    if key != keys[0]:
        with database.transaction() as session:
            service.begin_next_token(session, key)
    return dataclasses.replace(caller, signed_body_sha256=claim.body_sha256)


async def _admit(connection: HTTPConnection, caller: Caller | None, receive: Receive) -> Receive:
    path = connection.url.path
    if caller is None:
        raise UnauthenticatedError("Send a bearer token, or sign in")
    if caller.kind == "ticket" and _VIEW.fullmatch(path) is None:
        raise ForbiddenError("A view's ticket opens that view only")
    if (caller.kind == "device") != (path in DEVICE_PATHS):
        raise ForbiddenError("Only a device token may upload, and it may do nothing else")
    if caller.kind == "session":
        return await _check_browser(connection, caller, receive)
    return receive


async def _admit_sign_in(connection: HTTPConnection, caller: Caller | None, receive: Receive) -> Receive:
    """Signing in needs no credentials, but a foreign page must not sign a browser in or out."""
    method = str(connection.scope.get("method", "GET"))
    if method == "DELETE" and caller is not None and caller.kind == "session":
        return await _check_browser(connection, caller, receive)
    if method not in _SAFE_METHODS:
        _check_origin(connection)
    return receive


async def _check_browser(connection: HTTPConnection, caller: Caller, receive: Receive) -> Receive:
    if connection.scope["type"] == "websocket":
        _check_origin(connection)
        return receive
    if connection.scope["method"] in _SAFE_METHODS:
        return receive
    _check_origin(connection)
    given = connection.headers.get("x-csrf-token")
    if given is None and connection.headers.get("content-type", "").startswith("application/x-www-form-urlencoded"):
        given, receive = await _csrf_of_form(receive)
    elif given is None and connection.headers.get("content-type", "").startswith("multipart/form-data"):
        given, receive = await _csrf_of_upload(receive)
    if given is None or caller.csrf_token is None or not same(given, caller.csrf_token):
        raise ForbiddenError("The CSRF token is missing or not this session's", code="csrf")
    return receive


def _check_origin(connection: HTTPConnection) -> None:
    """Refuse another origin's request; what sends no Origin at all is not a page."""
    origin = connection.headers.get("origin")
    if origin is None:
        if connection.headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none"):
            raise ForbiddenError("From another origin", code="origin")
        return
    settings = cast("Settings", connection.app.state.settings)
    # Behind a proxy that ends TLS the scheme seen here may be the inner one, so only the host must agree;
    # a page of the same host over plain http could not have set our cookie's Secure twin.
    own = urlsplit(origin).netloc == connection.headers.get("host", "")
    if not own and origin.rstrip("/") not in {trusted.rstrip("/") for trusted in settings.trusted_origins}:
        raise ForbiddenError("From another origin", code="origin")


async def _csrf_of_form(receive: Receive) -> tuple[str | None, Receive]:
    """The token in a form, and a `receive` that gives the form again."""
    body, again = await _beginning(receive, _MAX_FORM_BYTES, lambda _: False)
    if len(body) > _MAX_FORM_BYTES:
        raise ForbiddenError("The form is too large to look for its CSRF token", code="csrf")
    return parse_qs(body.decode("latin-1")).get("csrf_token", [None])[0], again


async def _csrf_of_upload(receive: Receive) -> tuple[str | None, Receive]:
    """The token of a form with a file, in which it must stand first; the file itself is not waited for."""
    body, again = await _beginning(receive, _MAX_FORM_BYTES, lambda body: _CSRF_PART.search(body) is not None)
    found = _CSRF_PART.search(body, 0, _MAX_FORM_BYTES)
    return None if found is None else found[1].decode("latin-1"), again


async def _beginning(receive: Receive, most: int, enough: Callable[[bytes], bool]) -> tuple[bytes, Receive]:
    """A body until it is enough, ends or is more than `most` bytes, and a `receive` that gives all of it."""
    messages: list[Message] = []
    body = b""
    while True:
        message = await receive()
        messages.append(message)
        body += message.get("body", b"")
        ended = message["type"] != "http.request" or not message.get("more_body", False)
        if ended or len(body) > most or enough(body):
            break
    pending = iter(messages)

    async def again() -> Message:
        message = next(pending, None)
        return message if message is not None else await receive()

    return body, again


async def _refuse(error: ProblemError, connection: HTTPConnection, receive: Receive, send: Send) -> None:
    scope = connection.scope
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": error.title})
        return
    if error.status == 401 and not is_api(connection.url.path):
        query = f"?{connection.url.query}" if connection.url.query else ""
        back = connection.url.path + query if scope["method"] == "GET" else "/"
        await RedirectResponse(f"/login?next={quote(back, safe='/')}", 303)(scope, receive, send)
        return
    await problem_response(error, connection)(scope, receive, send)


def _renewing(send: Send, connection: HTTPConnection) -> Send:
    """Send the cookie again with the session's new end, unless the route set or deleted it."""

    async def renew(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            if not any(value.startswith(f"{COOKIE}=") for value in headers.getlist("set-cookie")):
                headers.append("set-cookie", cookie_header(connection.cookies[COOKIE], connection))
        await send(message)

    return renew
