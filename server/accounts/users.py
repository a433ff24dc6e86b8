"""People, their passwords and second factors, and API keys."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from typing import Any

from sqlalchemy import ColumnElement, delete, func, or_, select, update
from sqlalchemy.orm import InstrumentedAttribute, Session

from server.accounts import audit, passwords, service
from server.accounts.caller import Caller
from server.accounts.permissions import known
from server.accounts.schemas import ApiKeyIn, UserChange, UserIn
from server.accounts.secrets import KEY_PREFIX, hash_of, new_token
from server.errors import ConflictError, InvalidError, NotFoundError, UnauthenticatedError
from server.isolation import EVERYWHERE
from server.models import (
    ApiKey,
    AuditEntry,
    Event,
    EventAction,
    Organisation,
    SignInCode,
    User,
    WebSession,
    new_id,
)
from server.wording import marked

ERASED_DOMAIN = "@erased.invalid"
FREE_FAILURES = 5
_FIRST_LOCK, _LONGEST_LOCK = dt.timedelta(minutes=1), dt.timedelta(hours=1)


@dataclass(frozen=True, slots=True)
class Candidate:
    """Whom an e-mail belongs to, before anything is believed."""

    user_id: str
    password_hash: str | None


def candidate(session: Session, email: str) -> Candidate | None:
    """The user with this e-mail."""
    row = session.execute(select(User.id, User.password_hash).where(User.email == email.strip().lower())).first()
    return None if row is None else Candidate(row.id, row.password_hash)


def sign_in(
    session: Session, found: Candidate, code: str, *, right: bool, now: dt.datetime, address: str
) -> service.OpenedSession | None:
    """Open a session, or count the failure; None says nothing about which part was wrong.

    `right` tells whether the password was; it was compared outside the transaction, for that takes long.
    """
    user = session.get_one(User, found.user_id, with_for_update=True)
    locked = user.locked_until is not None and user.locked_until > now
    step = None
    if user.totp_confirmed and user.totp_secret is not None:
        step = passwords.totp_step(user.totp_secret, code, after=user.totp_step, now=now)
    # The password may have been changed since it was compared.
    right = right and user.password_hash == found.password_hash and (step is not None or not user.totp_confirmed)
    caller = Caller(user.organisation_id, "session", name=user.email, user_id=user.id, address=address)
    if locked or not right or user.disabled_at is not None:
        if not locked:
            user.failures += 1
            if user.failures >= FREE_FAILURES:
                doublings = min(user.failures - FREE_FAILURES, 10)
                user.locked_until = now + min(_FIRST_LOCK * 2**doublings, _LONGEST_LOCK)
        audit.record(session, caller, "sign_in.failed", user.email, now=now)
        return None
    user.failures, user.locked_until, user.signed_in_at = 0, None, now
    user.totp_step = step if step is not None else user.totp_step
    audit.record(session, caller, "sign_in", user.email, now=now)
    return service.open_session(session, user.organisation_id, now=now, user_id=user.id)


def user_of(session: Session, caller: Caller, user_id: str, *, lock: bool = False) -> User:
    """A user of the caller's organisation."""
    user = session.get(User, user_id, with_for_update=lock)
    if user is None or user.organisation_id != caller.organisation_id:
        raise NotFoundError(f"There is no user {user_id!r}")
    return user


def users(session: Session, organisation_id: str) -> list[User]:
    """The organisation's users by e-mail."""
    return list(session.scalars(select(User).where(User.organisation_id == organisation_id).order_by(User.email)))


def add_user(
    session: Session, organisation_id: str, caller: Caller, wanted: UserIn, *, now: dt.datetime
) -> tuple[User, str]:
    """A new user, and the one-time code with which they sign in first and choose a password."""
    email = wanted.email.strip().lower()
    # Two requests with one e-mail take turns.
    session.get_one(Organisation, organisation_id, with_for_update=True)
    if session.scalar(select(User.id).where(User.email == email).execution_options(**{EVERYWHERE: True})) is not None:
        raise ConflictError("That e-mail is in use", code="email_in_use")
    user = User(
        id=new_id(), organisation_id=organisation_id, email=email, name=wanted.name, role=wanted.role, created_at=now
    )
    session.add(user)
    session.flush()
    audit.record(session, caller, "user.added", email, now=now, detail={"role": wanted.role})
    return user, service.new_sign_in_code(session, organisation_id, now=now, user_id=user.id)


def change_user(session: Session, caller: Caller, user_id: str, wanted: UserChange, *, now: dt.datetime) -> User:
    """Another name or role, or an end to it; what is open is closed where less is allowed."""
    session.get_one(Organisation, caller.organisation_id, with_for_update=True)
    user = user_of(session, caller, user_id, lock=True)
    fields = wanted.model_dump(exclude_unset=True)
    loses_admin = user.role == "admin" and (fields.get("role", "admin") != "admin" or fields.get("disabled") is True)
    if loses_admin and user.disabled_at is None and _administrators(session, caller.organisation_id) == 1:
        raise ConflictError("The last administrator stays", code="last_administrator")
    if wanted.name is not None:
        user.name = wanted.name
    if wanted.role is not None:
        user.role = wanted.role
    if wanted.disabled is not None:
        user.disabled_at = (user.disabled_at or now) if wanted.disabled else None
        if wanted.disabled:
            session.execute(delete(WebSession).where(WebSession.user_id == user.id))
    audit.record(session, caller, "user.changed", user.email, now=now, detail=fields)
    return user


def _administrators(session: Session, organisation_id: str) -> int:
    there = User.organisation_id == organisation_id, User.role == "admin", User.disabled_at.is_(None)
    return session.scalar(select(func.count(User.id)).where(*there)) or 0


def sign_in_code(session: Session, caller: Caller, user_id: str, *, now: dt.datetime) -> str:
    """A one-time code for somebody who forgot; whoever lost the authenticator with it starts anew there too."""
    user = user_of(session, caller, user_id, lock=True)
    if user.disabled_at is not None:
        raise ConflictError("The user is disabled", code="user_disabled")
    user.failures, user.locked_until = 0, None
    user.totp_secret, user.totp_confirmed = None, False
    audit.record(session, caller, "user.code", user.email, now=now)
    return service.new_sign_in_code(session, caller.organisation_id, now=now, user_id=user.id)


def own(session: Session, caller: Caller, *, lock: bool = False) -> User:
    """The caller's account."""
    if caller.user_id is None:
        raise NotFoundError("Signed in without an account: with a token, or with the code of the first start")
    return user_of(session, caller, caller.user_id, lock=lock)


def check_current(session: Session, caller: Caller, current: str) -> None:
    """Raise unless this is the caller's password; not asked of whoever came with a one-time code."""
    user = own(session, caller)
    row = session.get_one(WebSession, caller.session_id)
    if not row.by_code and not passwords.matches(user.password_hash, current):
        raise UnauthenticatedError(marked("The current password is not right"), code="password_wrong")


def set_password(session: Session, caller: Caller, password_hash: str, *, now: dt.datetime) -> None:
    """A new password; every other session of the account ends."""
    user = own(session, caller, lock=True)
    user.password_hash = password_hash
    session.execute(delete(WebSession).where(WebSession.user_id == user.id, WebSession.id != caller.session_id))
    session.execute(update(WebSession).where(WebSession.id == caller.session_id).values(by_code=False))
    audit.record(session, caller, "password.changed", user.email, now=now)


def begin_totp(session: Session, caller: Caller) -> tuple[str, str]:
    """A secret for the caller's authenticator and its address; it counts once a code of it was given."""
    user = own(session, caller, lock=True)
    if user.totp_confirmed:
        raise ConflictError(marked("An authenticator is set up; take it off first"), code="totp_on")
    secret = user.totp_secret = passwords.new_totp_secret()
    return secret, passwords.totp_uri(secret, user.email)


def confirm_totp(session: Session, caller: Caller, code: str, *, now: dt.datetime) -> None:
    """From now on signing in needs a code."""
    user = own(session, caller, lock=True)
    if user.totp_secret is None or user.totp_confirmed:
        raise ConflictError(marked("No authenticator is being set up"), code="totp_not_begun")
    step = passwords.totp_step(user.totp_secret, code, after=user.totp_step, now=now)
    if step is None:
        raise InvalidError(marked("The code is not right"), code="totp_code")
    user.totp_confirmed, user.totp_step = True, step
    audit.record(session, caller, "totp.on", user.email, now=now)


def end_totp(session: Session, caller: Caller, code: str, *, now: dt.datetime) -> None:
    """Take the authenticator off; that takes one of its codes."""
    user = own(session, caller, lock=True)
    if not user.totp_confirmed or user.totp_secret is None:
        raise ConflictError(marked("No authenticator is set up"), code="totp_off")
    if passwords.totp_step(user.totp_secret, code, after=user.totp_step, now=now) is None:
        raise InvalidError(marked("The code is not right"), code="totp_code")
    user.totp_secret, user.totp_confirmed = None, False
    audit.record(session, caller, "totp.off", user.email, now=now)


def add_key(session: Session, caller: Caller, wanted: ApiKeyIn, *, now: dt.datetime) -> tuple[ApiKey, str]:
    """A new API key with a part of the caller's permissions; shown once."""
    scopes = known(list(wanted.scopes))
    if not scopes <= caller.permissions:
        beyond = ", ".join(sorted(scopes - caller.permissions))
        raise InvalidError(f"A key cannot have what its maker does not: {beyond}", code="scopes")
    token = new_token(KEY_PREFIX)
    key = ApiKey(
        id=new_id(),
        organisation_id=caller.organisation_id,
        user_id=caller.user_id,
        name=wanted.name,
        key_hash=hash_of(token),
        scopes=sorted(scopes),
        created_at=now,
        expires_at=wanted.expires_at,
    )
    session.add(key)
    audit.record(session, caller, "key.added", wanted.name, now=now, detail={"scopes": sorted(scopes)})
    return key, token


def keys(session: Session, organisation_id: str) -> list[ApiKey]:
    """The organisation's API keys, the newest first."""
    wanted = select(ApiKey).where(ApiKey.organisation_id == organisation_id)
    return list(session.scalars(wanted.order_by(ApiKey.created_at.desc(), ApiKey.id)))


def revoke_key(session: Session, caller: Caller, key_id: str, *, now: dt.datetime) -> None:
    """End a key."""
    key = session.get(ApiKey, key_id, with_for_update=True)
    if key is None or key.organisation_id != caller.organisation_id:
        raise NotFoundError(f"There is no key {key_id!r}")
    if key.revoked_at is None:
        key.revoked_at = now
        audit.record(session, caller, "key.revoked", key.name, now=now)


def add_organisation(
    session: Session, caller: Caller, name: str, administrator: UserIn, *, now: dt.datetime
) -> tuple[Organisation, User, str]:
    """A new tenant and its first administrator, who signs in with the code."""
    organisation = Organisation(id=new_id(), name=name, created_at=now)
    session.add(organisation)
    session.flush()
    user, code = add_user(session, organisation.id, caller, administrator, now=now)
    audit.record(session, caller, "organisation.added", name, now=now, detail={"id": organisation.id})
    return organisation, user, code


# --- a person's right to be forgotten


def user_holdings(session: Session, user: User) -> tuple[dict[str, int], dict[str, int]]:
    """What erasing a user takes, and what stays: entries of the audit log, and what they said of events."""

    def count(column: InstrumentedAttribute[Any], *wanted: ColumnElement[bool]) -> int:
        return session.scalar(select(func.count(column)).where(*wanted)) or 0

    takes = {
        "account": int(not user.email.endswith(ERASED_DOMAIN)),
        "sessions": count(WebSession.id, WebSession.user_id == user.id),
        "sign-in codes": count(SignInCode.code_hash, SignInCode.user_id == user.id),
        "API keys": count(ApiKey.id, ApiKey.user_id == user.id, ApiKey.revoked_at.is_(None)),
    }
    theirs = or_(AuditEntry.actor_id == user.id, AuditEntry.actor_name == user.email, AuditEntry.subject == user.email)
    of_events = EventAction.actor == user.email, Event.organisation_id == user.organisation_id
    query = select(func.count(EventAction.id)).join(Event, Event.id == EventAction.event_id).where(*of_events)
    stays = {
        "audit entries": count(AuditEntry.id, AuditEntry.organisation_id == user.organisation_id, theirs),
        "event actions": session.scalar(query) or 0,
    }
    return takes, stays


def erase_user(session: Session, user: User, *, now: dt.datetime) -> None:
    """Leave a row without a person: rows that name it by its id stay true."""
    session.get_one(Organisation, user.organisation_id, with_for_update=True)
    if user.role == "admin" and user.disabled_at is None and _administrators(session, user.organisation_id) == 1:
        raise ConflictError("The last administrator stays", code="last_administrator")
    session.execute(delete(WebSession).where(WebSession.user_id == user.id))
    session.execute(delete(SignInCode).where(SignInCode.user_id == user.id))
    ends = ApiKey.user_id == user.id, ApiKey.revoked_at.is_(None)
    session.execute(update(ApiKey).where(*ends).values(revoked_at=now))
    user.email, user.name = f"erased-{user.id}{ERASED_DOMAIN}", "Erased user"
    user.password_hash = user.totp_secret = user.locked_until = user.signed_in_at = None
    user.totp_confirmed, user.failures, user.disabled_at = False, 0, user.disabled_at or now
