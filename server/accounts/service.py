"""Organisations, signing in, sessions, and who a credential belongs to."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass

from sqlalchemy import Connection, bindparam, delete, or_, select
from sqlalchemy.orm import Session

from server.accounts import audit
from server.accounts.caller import Caller
from server.accounts.permissions import ALL, ROLE_PERMISSIONS, known
from server.accounts.preferences import Preferences
from server.accounts.secrets import hash_of, new_code, new_token
from server.errors import UnauthenticatedError
from server.models import ApiKey, Device, Organisation, SignInCode, User, WebSession
from server.wording import marked

SESSION_LIFE = dt.timedelta(hours=12)
CODE_LIFE = dt.timedelta(hours=24)
# A session slides in steps, so that not every request writes.
_SLIDE_STEP = dt.timedelta(minutes=10)


@dataclass(frozen=True, slots=True)
class OpenedSession:
    """A session that was just opened; `token` goes into the cookie and is kept nowhere."""

    token: str
    csrf_token: str
    expires_at: dt.datetime


def default_organisation(session: Session) -> Organisation | None:
    """The organisation of the administrator's token: the first one."""
    return session.scalar(select(Organisation).order_by(Organisation.created_at, Organisation.id).limit(1))


def ensure_organisation(session: Session, *, now: dt.datetime) -> Organisation:
    """The default organisation, made when there is none."""
    organisation = default_organisation(session)
    if organisation is None:
        organisation = Organisation(name="Fleet", created_at=now)
        session.add(organisation)
        session.flush()
    return organisation


def first_sign_in(session: Session, *, now: dt.datetime) -> str | None:
    """A one-time code to print at start, unless somebody is signed in; it voids earlier unused ones."""
    if session.scalar(select(WebSession.id).where(WebSession.expires_at > now).limit(1)) is not None:
        return None
    session.execute(delete(SignInCode).where(SignInCode.used_at.is_(None)))
    return new_sign_in_code(session, ensure_organisation(session, now=now).id, now=now)


def new_sign_in_code(session: Session, organisation_id: str, *, now: dt.datetime, user_id: str | None = None) -> str:
    """A one-time code that opens a session within a day, for a user or for an administrator without an account."""
    code = new_code()
    session.add(
        SignInCode(
            code_hash=hash_of(code),
            organisation_id=organisation_id,
            created_at=now,
            expires_at=now + CODE_LIFE,
            user_id=user_id,
        )
    )
    return code


def redeem(session: Session, code: str, *, now: dt.datetime, address: str) -> OpenedSession:
    """Open a session with a one-time code, on record in the audit log."""
    # The row is locked, so that a code that is sent twice at once opens one session.
    row = session.get(SignInCode, hash_of(code), with_for_update=True)
    if row is None or row.used_at is not None or row.expires_at <= now:
        raise UnauthenticatedError(marked("The code is not valid, or was used already"), code="sign_in_failed")
    user = None if row.user_id is None else session.get_one(User, row.user_id)
    if user is not None and user.disabled_at is not None:
        raise UnauthenticatedError(marked("The code is not valid, or was used already"), code="sign_in_failed")
    row.used_at = now
    name, user_id = ("administrator", None) if user is None else (user.email, user.id)
    caller = Caller(row.organisation_id, "session", name=name, user_id=user_id, address=address)
    audit.record(session, caller, "sign_in", name, now=now, detail={"by": "code"})
    return open_session(session, row.organisation_id, now=now, user_id=row.user_id, by_code=True)


def open_session(
    session: Session, organisation_id: str, *, now: dt.datetime, user_id: str | None = None, by_code: bool = False
) -> OpenedSession:
    """A session for a browser; sessions that ran out are forgotten on the way."""
    session.execute(delete(WebSession).where(WebSession.expires_at <= now))
    opened = OpenedSession(token=new_token(), csrf_token=new_token(), expires_at=now + SESSION_LIFE)
    session.add(
        WebSession(
            token_hash=hash_of(opened.token),
            csrf_token=opened.csrf_token,
            organisation_id=organisation_id,
            created_at=now,
            expires_at=opened.expires_at,
            user_id=user_id,
            by_code=by_code,
        )
    )
    return opened


def close_session(session: Session, session_id: str) -> None:
    """Sign out."""
    session.execute(delete(WebSession).where(WebSession.id == session_id))


def session_of(session: Session, token: str, *, now: dt.datetime) -> tuple[WebSession, Caller] | None:
    """The live session of a cookie and whom it lets in; a user's role counts as it is now."""
    found = session.execute(
        select(WebSession, User)
        .outerjoin(User, User.id == WebSession.user_id)
        .where(WebSession.token_hash == hash_of(token), WebSession.expires_at > now)
    ).first()
    if found is None:
        return None
    row, user = found[0], _maybe(found[1])
    if user is not None and user.disabled_at is not None:
        return None
    caller = Caller(
        row.organisation_id,
        "session",
        name="administrator" if user is None else user.email,
        permissions=ALL if user is None else ROLE_PERMISSIONS[user.role],
        user_id=None if user is None else user.id,
        session_id=row.id,
        csrf_token=row.csrf_token,
        preferences=Preferences.from_json(row.preferences if user is None else user.preferences),
    )
    return row, caller


def keep_preferences(session: Session, caller: Caller, preferences: Preferences) -> None:
    """Remember what the caller wants to read pages in."""
    row = session.get(User, caller.user_id) if caller.user_id else session.get(WebSession, caller.session_id)
    if row is not None:
        row.preferences = preferences.to_json()


def _maybe(user: User | None) -> User | None:
    """What an outer join gives, typed as it is."""
    return user


def key_of(session: Session, token: str, *, now: dt.datetime) -> Caller | None:
    """The program that an API key belongs to; a key is never worth more than its maker is now."""
    found = session.execute(
        select(ApiKey, User)
        .outerjoin(User, User.id == ApiKey.user_id)
        .where(ApiKey.key_hash == hash_of(token), ApiKey.revoked_at.is_(None))
    ).first()
    if found is None:
        return None
    key, maker = found[0], _maybe(found[1])
    if (key.expires_at is not None and key.expires_at <= now) or (maker is not None and maker.disabled_at is not None):
        return None
    most = ALL if maker is None else ROLE_PERMISSIONS[maker.role]
    return Caller(key.organisation_id, "key", name=key.name, permissions=known(key.scopes) & most, key_id=key.id)


def due_to_slide(row: WebSession, *, now: dt.datetime) -> bool:
    """Whether a session's end should move."""
    return row.expires_at < now + SESSION_LIFE - _SLIDE_STEP


def slide(session: Session, session_id: str, *, now: dt.datetime) -> None:
    """Let a session live on from now."""
    row = session.get(WebSession, session_id)
    if row is not None:
        row.expires_at = now + SESSION_LIFE


# Built once: every upload asks.
_BOX = select(Device.id, Device.organisation_id, Device.signed_only, Device.token_hash).where(
    or_(Device.token_hash == bindparam("digest"), Device.next_token_hash == bindparam("digest")),
    Device.revoked_at.is_(None),
)


def device_of(connection: Connection, token: str) -> tuple[Caller, bool] | None:
    """The box that a bearer token belongs to, and whether the token is its next one; none once it is revoked."""
    digest = hash_of(token)
    row = connection.execute(_BOX, {"digest": digest}).first()
    if row is None:
        return None
    if row.signed_only:
        raise UnauthenticatedError("This box signs its requests; the token is not sent", code="signature_required")
    return Caller(row.organisation_id, "device", device_id=row.id), row.token_hash != digest


def begin_next_token(session: Session, token_hash: str) -> None:
    """The first use of a token that the box asked for ends the one before."""
    device = session.scalar(select(Device).where(Device.next_token_hash == token_hash).with_for_update())
    if device is not None:
        device.token_hash, device.next_token_hash = token_hash, None


def signing_device(session: Session, device_id: str) -> tuple[Caller, list[str]] | None:
    """A box that signs its requests, and its keys: that of its token, and of the next one if it asked for one."""
    row = session.execute(
        select(Device.organisation_id, Device.token_hash, Device.next_token_hash).where(
            Device.id == device_id, Device.revoked_at.is_(None)
        )
    ).first()
    if row is None:
        return None
    keys = [key for key in (row.token_hash, row.next_token_hash) if key is not None]
    return Caller(row.organisation_id, "device", device_id=device_id), keys
