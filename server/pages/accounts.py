"""Pages about people: one's own account, users and API keys, the audit log.

Forms post here; what they show once (a code, a key) is in the answer itself, everything else leads back to the page.
"""

from __future__ import annotations

import datetime as dt
from typing import Annotated, Any, Literal, cast

from fastapi import APIRouter, Form, Query, Request
from starlette.responses import HTMLResponse, Response

from server.accounts import audit, passwords, users
from server.accounts.access import AnyCaller, AuditReader, Caller, UserManager
from server.accounts.permissions import Permission
from server.accounts.preferences import LANGUAGES, Preferences, Units
from server.accounts.schemas import ApiKeyIn, UserChange, UserIn
from server.accounts.service import keep_preferences
from server.database import Database
from server.edge import DatabaseOf, Now
from server.errors import ForbiddenError, ProblemError
from server.models import User
from server.pages import queries
from server.pages.audit_words import DEEDS
from server.pages.forms import Text, back, checked
from server.pages.routes import answer
from server.wording import marked

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)

ENTRIES = 100
LOGS = {"all": marked("All"), "done": marked("What was done"), "looks": marked("What was looked at")}
ROLE_WORDS = {
    "admin": marked("Administrator"),
    "manager": marked("Fleet manager"),
    "installer": marked("Installer"),
    "claims": marked("Claims handler"),
    "reader": marked("Read only"),
}
PERMISSION_WORDS: dict[Permission, str] = {
    "fleet.read": marked("see vehicles, boxes and mountings"),
    "fleet.write": marked("add, change and configure vehicles and boxes"),
    "install": marked("install boxes and set mountings by hand"),
    "location.read": marked("see where vehicles are and were"),
    "location.coarse": marked("see where vehicles are and were to about a kilometre"),
    "raw.read": marked("see the samples themselves"),
    "events.review": marked("review events and hold them for a claim"),
    "users.manage": marked("add people and API keys"),
    "audit.read": marked("read the audit log"),
    "privacy.manage": marked("set how long data are kept, and erase"),
    "privacy.export": marked("export all that is held about a vehicle or a person"),
    "export": marked("take out tracks, events and samples in bulk"),
    "jobs.manage": marked("see and replay work that fails, run events again"),
}


def _page(request: Request, template: str, caller: Caller, database: Database, context: dict[str, Any]) -> HTMLResponse:
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
    section = template.removesuffix(".html")
    return answer(request, template, caller, section if section == "account" else "admin", change, context)


# --- one's own account


@router.get("/account")
def account_page(request: Request, caller: AnyCaller, database: DatabaseOf, said: str = "") -> HTMLResponse:
    """Password and authenticator."""
    words = {
        "saved": marked("Saved."),
        "password": marked("The password is saved."),
        "totp": marked("The authenticator is set up."),
        "totp-off": marked("It is taken off."),
    }
    return _account(request, caller, database, done=words.get(said))


def _account(request: Request, caller: Caller, database: Database, **shown: Any) -> HTMLResponse:
    if caller.kind not in ("session", "admin"):
        raise ForbiddenError("Only for whoever is signed in")
    user: User | None = None
    if caller.user_id is not None:
        with database.reading() as session:
            user = users.own(session, caller)
    context: dict[str, Any] = {"user": user, "who": caller.name, "permission_words": PERMISSION_WORDS}
    context |= {"languages": LANGUAGES, "preferences": caller.preferences}
    context |= {"error": None, "done": None, "totp_secret": None, "totp_uri": None} | shown
    error = cast("ProblemError | None", shown.get("problem"))
    page = _page(request, "account.html", caller, database, context | {"error": error and error.detail})
    page.status_code = 200 if error is None else error.status
    return page


@router.post("/account/preferences")
def change_preferences(
    caller: AnyCaller,
    database: DatabaseOf,
    language: Annotated[Literal["", "en", "it"], Form()] = "",
    units: Annotated[Units, Form()] = "metric",
) -> Response:
    """Language and units; the language of the browser where none is chosen."""
    kept = Preferences(language or None, units, caller.preferences.views)
    with database.transaction() as session:
        keep_preferences(session, caller, kept)
    return back("/account?said=saved")


@router.post("/account/password")
def change_password(
    request: Request, caller: AnyCaller, database: DatabaseOf, now: Now, new: Text = "", current: Text = ""
) -> Response:
    """Save a password."""
    try:
        with database.reading() as session:
            users.check_current(session, caller, current)
            passwords.check_new(new, users.own(session, caller).email)
        stored = passwords.hashed(new)
        with database.transaction() as session:
            users.set_password(session, caller, stored, now=now)
    except ProblemError as error:
        return _account(request, caller, database, problem=error)
    return back("/account?said=password")


@router.post("/account/totp")
def begin_totp(request: Request, caller: AnyCaller, database: DatabaseOf) -> Response:
    """Show a secret for an authenticator."""
    try:
        with database.transaction() as session:
            secret, uri = users.begin_totp(session, caller)
    except ProblemError as error:
        return _account(request, caller, database, problem=error)
    return _account(request, caller, database, totp_secret=secret, totp_uri=uri)


@router.post("/account/totp/confirm")
def confirm_totp(request: Request, caller: AnyCaller, database: DatabaseOf, now: Now, code: Text = "") -> Response:
    """Set the authenticator up."""
    try:
        with database.transaction() as session:
            users.confirm_totp(session, caller, code, now=now)
    except ProblemError as error:
        return _account(request, caller, database, problem=error)
    return back("/account?said=totp")


@router.post("/account/totp/end")
def end_totp(request: Request, caller: AnyCaller, database: DatabaseOf, now: Now, code: Text = "") -> Response:
    """Take the authenticator off."""
    try:
        with database.transaction() as session:
            users.end_totp(session, caller, code, now=now)
    except ProblemError as error:
        return _account(request, caller, database, problem=error)
    return back("/account?said=totp-off")


# --- people and keys


@router.get("/users")
def users_page(request: Request, caller: UserManager, database: DatabaseOf) -> HTMLResponse:
    """Everybody who may sign in, and every key."""
    return _users(request, caller, database)


def _users(
    request: Request,
    caller: Caller,
    database: Database,
    *,
    secret: dict[str, str] | None = None,
    problem: ProblemError | None = None,
) -> HTMLResponse:
    with database.reading() as session:
        context = {
            "users": users.users(session, caller.organisation_id),
            "keys": users.keys(session, caller.organisation_id),
        }
    words = {"roles": ROLE_WORDS, "permission_words": PERMISSION_WORDS}
    shown = {"secret": secret, "error": None if problem is None else problem.detail}
    page = _page(request, "users.html", caller, database, {**context, **words, **shown})
    page.status_code = 200 if problem is None else problem.status
    return page


def _code_shown(request: Request, code: str, email: str) -> dict[str, str]:
    return {
        "title": marked("Sign-in link for %(name)s"),
        "name": email,
        "value": str(request.url_for("login_page").include_query_params(code=code, next="/account")),
        "hint": marked("Good once, within a day. It leads to the page where a password is chosen."),
    }


@router.post("/users")
def add_user(
    request: Request,
    caller: UserManager,
    database: DatabaseOf,
    now: Now,
    email: Text = "",
    name: Text = "",
    role: Text = "",
) -> Response:
    """Add somebody and show the link with which they sign in first."""
    try:
        wanted = checked(UserIn, email=email, name=name, role=role)
        with database.transaction() as session:
            user, code = users.add_user(session, caller.organisation_id, caller, wanted, now=now)
    except ProblemError as error:
        return _users(request, caller, database, problem=error)
    return _users(request, caller, database, secret=_code_shown(request, code, user.email))


@router.post("/users/{user_id}/code")
def new_code(request: Request, user_id: str, caller: UserManager, database: DatabaseOf, now: Now) -> Response:
    """Show a new link for somebody who forgot."""
    try:
        with database.transaction() as session:
            code = users.sign_in_code(session, caller, user_id, now=now)
            email = users.user_of(session, caller, user_id).email
    except ProblemError as error:
        return _users(request, caller, database, problem=error)
    return _users(request, caller, database, secret=_code_shown(request, code, email))


def _change(
    request: Request, caller: Caller, database: Database, user_id: str, now: dt.datetime, **fields: object
) -> Response:
    try:
        wanted = checked(UserChange, **fields)
        with database.transaction() as session:
            users.change_user(session, caller, user_id, wanted, now=now)
    except ProblemError as error:
        return _users(request, caller, database, problem=error)
    return back("/users")


@router.post("/users/{user_id}/role")
def set_role(
    request: Request, user_id: str, caller: UserManager, database: DatabaseOf, now: Now, role: Text = ""
) -> Response:
    """Give somebody another role."""
    return _change(request, caller, database, user_id, now, role=role)


@router.post("/users/{user_id}/disable")
def disable(request: Request, user_id: str, caller: UserManager, database: DatabaseOf, now: Now) -> Response:
    """Let somebody in no more."""
    return _change(request, caller, database, user_id, now, disabled=True)


@router.post("/users/{user_id}/enable")
def enable(request: Request, user_id: str, caller: UserManager, database: DatabaseOf, now: Now) -> Response:
    """Let somebody in again."""
    return _change(request, caller, database, user_id, now, disabled=False)


@router.post("/api-keys")
def add_key(
    request: Request,
    caller: UserManager,
    database: DatabaseOf,
    now: Now,
    name: Text = "",
    scopes: Annotated[list[str] | None, Form()] = None,
) -> Response:
    """Make a key and show it once."""
    try:
        wanted = checked(ApiKeyIn, name=name, scopes=scopes or [])
        with database.transaction() as session:
            key, token = users.add_key(session, caller, wanted, now=now)
    except ProblemError as error:
        return _users(request, caller, database, problem=error)
    secret = {"title": marked("API key for %(name)s"), "name": key.name, "value": token}
    secret["hint"] = marked("Send it as a bearer token.")
    return _users(request, caller, database, secret=secret)


@router.post("/api-keys/{key_id}/revoke")
def revoke_key(key_id: str, caller: UserManager, database: DatabaseOf, now: Now) -> Response:
    """End a key."""
    with database.transaction() as session:
        users.revoke_key(session, caller, key_id, now=now)
    return back("/users")


# --- the log


@router.get("/audit")
def audit_page(
    request: Request,
    caller: AuditReader,
    database: DatabaseOf,
    before: Annotated[int | None, Query(ge=0, le=2**63 - 1)] = None,
    show: Literal["all", "done", "looks"] = "all",
) -> HTMLResponse:
    """Who did and saw what."""
    looks = None if show == "all" else show == "looks"
    with database.reading() as session:
        rows = audit.entries(
            session, caller.organisation_id, before=before, action=None, looks=looks, limit=ENTRIES + 1
        )
    shown = rows[:ENTRIES]
    context = {"entries": shown, "next": shown[-1].id if len(rows) > ENTRIES else None}
    context |= {"deeds": DEEDS, "show": show, "shows": LOGS}
    return _page(request, "audit.html", caller, database, context)
