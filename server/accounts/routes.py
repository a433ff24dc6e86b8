"""Signing in and out, for browsers and for programs that want a session."""

from __future__ import annotations

import datetime as dt
from typing import Annotated, cast

from fastapi import APIRouter, Form, Request
from starlette.responses import RedirectResponse, Response

from server.accounts import audit, passwords, service, users
from server.accounts.access import AnyCaller, Caller, address_of
from server.accounts.cookie import cookie_header
from server.accounts.schemas import OpenedSessionOut, SessionOut, SignIn
from server.accounts.secrets import same
from server.database import Database
from server.edge import DatabaseOf, Now, SettingsOf
from server.errors import TooManyRequestsError, UnauthenticatedError
from server.limits import TokenBuckets
from server.problems import described
from server.settings import Settings
from server.wording import marked

router = APIRouter(tags=["signing in"])

LOGIN_ATTEMPTS_PER_MINUTE = 10


def _local(target: str) -> str:
    """Where to go after signing in: a path of ours, never another host."""
    ok = target.startswith("/") and not target.startswith(("//", "/\\")) and target.isprintable()
    return target if ok else "/"


def _check_attempts(request: Request, now: dt.datetime) -> None:
    attempts = cast("TokenBuckets", request.app.state.login_attempts)
    wait_s = attempts.take(request.client.host if request.client else "", now.timestamp())
    if wait_s > 0.0:
        seconds = int(wait_s) + 1
        raise TooManyRequestsError(f"Too many attempts; try again in {seconds} s", retry_after_s=seconds)


def _open_by_password(
    request: Request, database: Database, email: str, password: str, totp: str, now: dt.datetime
) -> service.OpenedSession:
    with database.reading() as session:
        found = users.candidate(session, email)
    right = passwords.matches(None if found is None else found.password_hash, password)
    opened = None
    if found is not None:
        with database.transaction() as session:
            opened = users.sign_in(session, found, totp, right=right, now=now, address=address_of(request))
    if opened is None:
        raise UnauthenticatedError(
            marked(
                "E-mail, password or authenticator code is not right, or there were too many attempts; wait a little"
            ),
            code="sign_in_failed",
        )
    return opened


def _open(
    request: Request, settings: Settings, database: Database, code: str, now: dt.datetime
) -> service.OpenedSession:
    address = address_of(request)
    with database.transaction() as session:
        if settings.admin_token is not None and same(code, settings.admin_token.get_secret_value()):
            organisation_id = service.ensure_organisation(session, now=now).id
            caller = Caller(organisation_id, "session", name="administrator", address=address)
            audit.record(session, caller, "sign_in", caller.name, now=now, detail={"by": "administrator's token"})
            return service.open_session(session, organisation_id, now=now)
        return service.redeem(session, code, now=now, address=address)


@router.get("/login", include_in_schema=False)
def login_page(request: Request, code: str = "", next: str = "/") -> Response:  # noqa: A002  the query's name
    """The form; opening the link does not use up its code, or a mail program's preview would."""
    if getattr(request.state, "caller", None) is not None:
        return RedirectResponse(_local(next), 303)
    return _form(request, code, next, None)


def _form(request: Request, code: str, target: str, error: str | None, status: int = 200) -> Response:
    context = {"request": request, "code": code, "next": _local(target), "error": error}
    return cast("Response", request.app.state.render("login.html", context, connection=request, status_code=status))


@router.post("/login", include_in_schema=False)
def login(
    request: Request,
    settings: SettingsOf,
    database: DatabaseOf,
    now: Now,
    code: Annotated[str, Form(max_length=500)] = "",
    email: Annotated[str, Form(max_length=254)] = "",
    password: Annotated[str, Form(max_length=200)] = "",
    totp: Annotated[str, Form(max_length=20)] = "",
    next: Annotated[str, Form(max_length=2000)] = "/",  # noqa: A002  the form's name
) -> Response:
    """Open a session and go on to the page that was asked for."""
    try:
        _check_attempts(request, now)
        if email and not code:
            opened = _open_by_password(request, database, email, password, totp, now)
        else:
            opened = _open(request, settings, database, code.strip(), now)
    except (UnauthenticatedError, TooManyRequestsError) as error:
        return _form(request, "", next, error.detail, error.status)
    response = RedirectResponse(_local(next), 303)
    response.headers["set-cookie"] = cookie_header(opened.token, request)
    return response


@router.post("/logout", include_in_schema=False)
def logout_page(request: Request, caller: AnyCaller, database: DatabaseOf) -> Response:
    """Close the session and show the form."""
    _close(caller, database)
    response = RedirectResponse("/login", 303)
    response.headers["set-cookie"] = cookie_header("", request)
    return response


def _close(caller: Caller, database: Database) -> None:
    if caller.session_id is not None:
        with database.transaction() as session:
            service.close_session(session, caller.session_id)


@router.post("/api/v1/auth/session", status_code=201, responses=described(429))
def open_session(
    body: SignIn, request: Request, response: Response, settings: SettingsOf, database: DatabaseOf, now: Now
) -> OpenedSessionOut:
    """Sign in: sets the session's cookie and tells its CSRF token."""
    _check_attempts(request, now)
    if body.code is not None:
        opened = _open(request, settings, database, body.code.strip(), now)
    else:
        opened = _open_by_password(request, database, body.email or "", body.password or "", body.totp, now)
    response.headers["set-cookie"] = cookie_header(opened.token, request)
    return OpenedSessionOut(csrf_token=opened.csrf_token, expires_at=opened.expires_at)


@router.get("/api/v1/auth/session")
def current_session(caller: AnyCaller) -> SessionOut:
    """The CSRF token of the session that is signed in."""
    if caller.csrf_token is None:
        raise UnauthenticatedError("No session; a bearer token needs none")
    return SessionOut(csrf_token=caller.csrf_token)


@router.delete("/api/v1/auth/session", status_code=204)
def close_session(request: Request, caller: AnyCaller, database: DatabaseOf) -> Response:
    """Sign out."""
    _close(caller, database)
    response = Response(status_code=204)
    response.headers["set-cookie"] = cookie_header("", request)
    return response
