"""People, their own accounts, API keys, the audit log, tenants, over HTTP."""

from __future__ import annotations

from typing import Annotated, cast

from fastapi import APIRouter, Query, Request
from sqlalchemy import select
from starlette.responses import Response

from server.accounts import audit, passwords, users
from server.accounts.access import AnyCaller, AuditReader, Caller, Operator, UserManager
from server.accounts.schemas import (
    AccountOut,
    ApiKeyIn,
    ApiKeyOut,
    AuditOut,
    AuditPage,
    NewApiKeyOut,
    NewOrganisationOut,
    NewPassword,
    NewUserOut,
    OrganisationIn,
    OrganisationOut,
    SignInCodeOut,
    TotpBegun,
    TotpCode,
    UserChange,
    UserIn,
    UserOut,
)
from server.database import Database
from server.edge import DatabaseOf, Now
from server.errors import ForbiddenError
from server.models import Organisation, User
from server.problems import described

router = APIRouter(prefix="/api/v1", tags=["accounts"])


def new_user_out(user: User, code: str) -> NewUserOut:
    """A user with the one-time code."""
    return NewUserOut(**UserOut.model_validate(user).model_dump(), code=code)


def _signed_in(caller: Caller) -> None:
    """Passwords and second factors are changed by the person, not by a key that was left somewhere."""
    if caller.kind != "session":
        raise ForbiddenError("Only for whoever is signed in")


@router.get("/account")
def read_account(caller: AnyCaller) -> AccountOut:
    """Who is calling, and what that allows."""
    return AccountOut(
        name=caller.name,
        user_id=caller.user_id,
        organisation_id=caller.organisation_id,
        permissions=sorted(caller.permissions),
    )


@router.put("/account/password", status_code=204)
def set_password(wanted: NewPassword, caller: AnyCaller, database: DatabaseOf, now: Now) -> Response:
    """Choose a password; every other session of the account ends."""
    _signed_in(caller)
    with database.reading() as session:
        users.check_current(session, caller, wanted.current)
        passwords.check_new(wanted.new, users.own(session, caller).email)
    new = passwords.hashed(wanted.new)
    with database.transaction() as session:
        users.set_password(session, caller, new, now=now)
    return Response(status_code=204)


@router.post("/account/totp", responses=described(409))
def begin_totp(caller: AnyCaller, database: DatabaseOf) -> TotpBegun:
    """A secret for an authenticator."""
    _signed_in(caller)
    with database.transaction() as session:
        secret, uri = users.begin_totp(session, caller)
    return TotpBegun(secret=secret, uri=uri)


@router.post("/account/totp/confirm", status_code=204, responses=described(409))
def confirm_totp(wanted: TotpCode, caller: AnyCaller, database: DatabaseOf, now: Now) -> Response:
    """Show that the authenticator works; from now on signing in needs it."""
    _signed_in(caller)
    with database.transaction() as session:
        users.confirm_totp(session, caller, wanted.code, now=now)
    return Response(status_code=204)


@router.post("/account/totp/end", status_code=204, responses=described(409))
def end_totp(wanted: TotpCode, caller: AnyCaller, database: DatabaseOf, now: Now) -> Response:
    """Take the authenticator off."""
    _signed_in(caller)
    with database.transaction() as session:
        users.end_totp(session, caller, wanted.code, now=now)
    return Response(status_code=204)


@router.get("/users")
def list_users(caller: UserManager, database: DatabaseOf) -> list[UserOut]:
    """Who may sign in."""
    with database.reading() as session:
        return [UserOut.model_validate(user) for user in users.users(session, caller.organisation_id)]


@router.post("/users", status_code=201, responses=described(409))
def add_user(wanted: UserIn, caller: UserManager, database: DatabaseOf, now: Now) -> NewUserOut:
    """Add somebody; the code lets them in once, to choose a password."""
    with database.transaction() as session:
        user, code = users.add_user(session, caller.organisation_id, caller, wanted, now=now)
        return new_user_out(user, code)


@router.patch("/users/{user_id}", responses=described(409))
def change_user(user_id: str, wanted: UserChange, caller: UserManager, database: DatabaseOf, now: Now) -> UserOut:
    """Another name or role, or an end to it."""
    with database.transaction() as session:
        return UserOut.model_validate(users.change_user(session, caller, user_id, wanted, now=now))


@router.post("/users/{user_id}/sign-in-code", status_code=201, responses=described(409))
def sign_in_code(user_id: str, caller: UserManager, database: DatabaseOf, now: Now) -> SignInCodeOut:
    """A one-time code for somebody who lost password or authenticator; takes the authenticator off."""
    with database.transaction() as session:
        return SignInCodeOut(code=users.sign_in_code(session, caller, user_id, now=now))


@router.get("/api-keys")
def list_keys(caller: UserManager, database: DatabaseOf) -> list[ApiKeyOut]:
    """The organisation's API keys."""
    with database.reading() as session:
        return [ApiKeyOut.model_validate(key) for key in users.keys(session, caller.organisation_id)]


@router.post("/api-keys", status_code=201)
def add_key(wanted: ApiKeyIn, caller: UserManager, database: DatabaseOf, now: Now) -> NewApiKeyOut:
    """A key for a program, with a part of the caller's permissions; shown once."""
    with database.transaction() as session:
        key, token = users.add_key(session, caller, wanted, now=now)
        return NewApiKeyOut(**ApiKeyOut.model_validate(key).model_dump(), key=token)


@router.delete("/api-keys/{key_id}", status_code=204)
def revoke_key(key_id: str, caller: UserManager, database: DatabaseOf, now: Now) -> Response:
    """End a key."""
    with database.transaction() as session:
        users.revoke_key(session, caller, key_id, now=now)
    return Response(status_code=204)


@router.get("/audit")
def read_audit(
    caller: AuditReader,
    database: DatabaseOf,
    before: Annotated[int | None, Query(ge=0, le=2**63 - 1)] = None,
    action: Annotated[str | None, Query(max_length=40)] = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
) -> AuditPage:
    """Who did and saw what, the newest first."""
    with database.reading() as session:
        rows = audit.entries(session, caller.organisation_id, before=before, action=action, limit=limit + 1)
    items = [AuditOut.model_validate(row) for row in rows[:limit]]
    return AuditPage(items=items, next=items[-1].id if len(rows) > limit else None)


@router.get("/organisations")
def list_organisations(caller: Operator, request: Request) -> list[OrganisationOut]:
    """The tenants of this installation."""
    del caller
    with _everything(request).reading() as session:
        rows = session.scalars(select(Organisation).order_by(Organisation.created_at, Organisation.id))
        return [OrganisationOut.model_validate(row) for row in rows]


@router.post("/organisations", status_code=201, responses=described(409))
def add_organisation(wanted: OrganisationIn, caller: Operator, request: Request, now: Now) -> NewOrganisationOut:
    """A new tenant and its first administrator."""
    with _everything(request).transaction() as session:
        organisation, user, code = users.add_organisation(session, caller, wanted.name, wanted.administrator, now=now)
        shown = OrganisationOut.model_validate(organisation).model_dump()
        return NewOrganisationOut(**shown, administrator=new_user_out(user, code))


def _everything(request: Request) -> Database:
    """The database past the walls between tenants, for the installation's administrator."""
    return cast("Database", request.app.state.database)
