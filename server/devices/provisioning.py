"""How a box comes to its token and keeps it: claim codes, rotation by the box, quotas, what it is told."""

from __future__ import annotations

import datetime as dt
import secrets
from collections.abc import Sequence
from typing import Any, NamedTuple

from sqlalchemy import Row, Select, and_, bindparam, delete, select, update
from sqlalchemy.orm import Session

from server.accounts.secrets import hash_of, new_token
from server.devices.queries import device_of
from server.devices.schemas import (
    ClaimCodeOut,
    ConfigurationTold,
    DeviceSettings,
    DeviceToken,
    LiveTold,
    Told,
    WindowIn,
    WindowTold,
)
from server.errors import ConflictError, InvalidError, NotFoundError, TooManyRequestsError, UnauthenticatedError
from server.live.changes import announce
from server.models import ClaimCode, Device, DeviceRequest, TheftWatch, new_id

TOKEN_PREFIX = "scd_"  # noqa: S105  lets scanners find a token that leaked
CODE_LIFE = dt.timedelta(days=90)
REQUEST_LIFE = dt.timedelta(days=7)
LIVE_PERIOD_S = 5.0
LIVE_FOR = dt.timedelta(hours=24)
"""A stolen vehicle's box reports often for so long, then saves its battery."""
MAX_OPEN_REQUESTS = 20
# Crockford's: no letter that reads like a digit or like another letter.
_ALPHABET = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"
_LOOK_ALIKE = str.maketrans({"O": "0", "I": "1", "L": "1"})


def new_claim_code(session: Session, organisation_id: str, device_id: str, *, now: dt.datetime) -> ClaimCodeOut:
    """A code to print on a box or to type into it; it voids the box's earlier ones."""
    device = device_of(session, organisation_id, device_id, lock=True)
    if device.revoked_at is not None:
        raise ConflictError("The device is revoked", code="device_revoked")
    session.execute(delete(ClaimCode).where(ClaimCode.device_id == device_id))
    letters = "".join(secrets.choice(_ALPHABET) for _ in range(16))  # 80 bits
    session.add(ClaimCode(code_hash=hash_of(letters), device_id=device_id, created_at=now, expires_at=now + CODE_LIFE))
    code = "-".join(letters[at : at + 4] for at in range(0, 16, 4))
    return ClaimCodeOut(code=code, expires_at=now + CODE_LIFE)


def claim(session: Session, code: str, *, now: dt.datetime) -> DeviceToken:
    """Trade a code for a token.

    An answer may be lost on its way: until the token was used, the code may be traded again, and each time
    ends the token before.
    """
    row = session.get(ClaimCode, hash_of(_letters(code)), with_for_update=True)
    device = None if row is None else session.get(Device, row.device_id, with_for_update=True)
    used = row is not None and device is not None and row.claimed_at is not None and _seen_since(device, row.claimed_at)
    if row is None or device is None or device.revoked_at is not None or row.expires_at <= now or used:
        raise UnauthenticatedError("The code is not valid, ran out, or was used", code="claim_failed")
    row.claimed_at = now
    token = new_token(TOKEN_PREFIX)
    device.token_hash, device.next_token_hash = hash_of(token), None
    announce_device(session, device, now)
    return DeviceToken(id=device.id, token=token)


def device_by_code(session: Session, code: str) -> Device | None:
    """The box that a code is printed on, whether it was traded or not: for the installer who holds the box."""
    row = session.get(ClaimCode, hash_of(_letters(code)))
    return None if row is None else session.get(Device, row.device_id)


def _letters(code: str) -> str:
    return "".join(letter for letter in code.upper() if letter.isalnum()).translate(_LOOK_ALIKE)


def _seen_since(device: Device, moment: dt.datetime) -> bool:
    return device.last_seen_at is not None and device.last_seen_at >= moment


def announce_device(session: Session, device: Device, now: dt.datetime) -> None:
    """Tell whoever looks at the device that it changed."""
    announce(
        session,
        "device",
        at=now,
        organisation_id=device.organisation_id,
        device_id=device.id,
        vehicle_id=device.vehicle_id,
    )


def ask_for_token(session: Session, device_id: str, *, now: dt.datetime) -> DeviceToken:
    """A new token for the box that asks; the old one lasts until the new one is used, for an answer may be lost."""
    device = session.get_one(Device, device_id, with_for_update=True)
    device.last_seen_at = now
    token = new_token(TOKEN_PREFIX)
    device.next_token_hash = hash_of(token)
    return DeviceToken(id=device.id, token=token)


def set_settings(
    session: Session, organisation_id: str, device_id: str, wanted: DeviceSettings, *, now: dt.datetime
) -> None:
    """What the box is told, how it must show who it is, and how much it may send."""
    device = device_of(session, organisation_id, device_id, lock=True)
    if device.configuration != wanted.configuration:
        device.configuration = wanted.configuration
        device.configuration_version += 1
    device.signed_only = wanted.signed_only
    device.bytes_per_day = wanted.bytes_per_day
    announce_device(session, device, now)


def ask_for_window(
    session: Session, organisation_id: str, device_id: str, wanted: WindowIn, *, now: dt.datetime
) -> str:
    """Ask a box for a stretch of its clock; id of the request."""
    device = device_of(session, organisation_id, device_id, lock=True)
    if len(open_requests(session, device.id, now=now)) >= MAX_OPEN_REQUESTS:
        raise ConflictError(f"{MAX_OPEN_REQUESTS} requests are open; cancel some", code="requests_full")
    if wanted.t_last_s <= wanted.t_first_s:
        raise InvalidError("The window ends before it begins")
    request = DeviceRequest(
        id=new_id(),
        device_id=device.id,
        boot=wanted.boot,
        t_first_s=wanted.t_first_s,
        t_last_s=wanted.t_last_s,
        reason=wanted.reason,
        created_at=now,
        expires_at=now + REQUEST_LIFE,
    )
    session.add(request)
    return request.id


def cancel_request(
    session: Session, organisation_id: str, device_id: str, request_id: str, *, now: dt.datetime
) -> None:
    """Ask no longer."""
    device_of(session, organisation_id, device_id, lock=True)
    request = session.get(DeviceRequest, request_id)
    if request is None or request.device_id != device_id:
        raise NotFoundError(f"There is no request {request_id!r}")
    if request.closed_at is None:
        request.closed_at, request.outcome = now, "cancelled"


def answered(
    session: Session, device_id: str, request_ids: tuple[str, ...], batch_id: str, *, now: dt.datetime
) -> None:
    """Close the requests that a batch says it answers; others' and unknown ones are passed over."""
    if request_ids:
        session.execute(
            update(DeviceRequest)
            .where(
                DeviceRequest.device_id == device_id,
                DeviceRequest.id.in_(request_ids),
                DeviceRequest.closed_at.is_(None),
            )
            .values(closed_at=now, outcome="answered", batch_id=batch_id)
        )


def open_requests(session: Session, device_id: str, *, now: dt.datetime) -> list[DeviceRequest]:
    """What a box is still asked for, the oldest first."""
    wanted = select(DeviceRequest).where(DeviceRequest.device_id == device_id, DeviceRequest.closed_at.is_(None))
    return list(session.scalars(wanted.where(DeviceRequest.expires_at > now).order_by(DeviceRequest.created_at)))


TOLD = (
    Device.configuration_version,
    Device.configuration,
    TheftWatch.alarm_at,
    DeviceRequest.id,
    DeviceRequest.boot,
    DeviceRequest.t_first_s,
    DeviceRequest.t_last_s,
)
"""The columns that `told_by` wants first in its rows."""


def with_told(statement: Select[*tuple[Any, ...]]) -> Select[*tuple[Any, ...]]:
    """A statement on a box, whose parameters are `device_id` and `now`, with what `TOLD` is taken from."""
    still_open = and_(
        DeviceRequest.device_id == Device.id,
        DeviceRequest.closed_at.is_(None),
        DeviceRequest.expires_at > bindparam("now"),
    )
    return (
        statement.outerjoin(TheftWatch, TheftWatch.vehicle_id == Device.vehicle_id)
        .outerjoin(DeviceRequest, still_open)
        .where(Device.id == bindparam("device_id"))
        .order_by(DeviceRequest.created_at)
    )


# Built once: building a statement and its key in the compiler's cache costs more than running it.
_TOLD = with_told(select(*TOLD).select_from(Device))


def told(session: Session, device_id: str, configuration_seen: int | None, *, now: dt.datetime) -> list[Told]:
    """What goes into an answer to a box: another configuration, open requests, whether to report often."""
    rows = session.connection().execute(_TOLD, {"device_id": device_id, "now": now}).all()
    return told_by(rows, configuration_seen, now=now)


def told_by(rows: Sequence[Row[*tuple[Any, ...]]], configuration_seen: int | None, *, now: dt.datetime) -> list[Told]:
    """The same from the rows of a statement of `with_told`; a row each for the requests, one where there is none."""
    version, configuration, alarm_at = rows[0][:3]
    items: list[Told] = []
    if version > 0 and configuration_seen != version:
        items.append(ConfigurationTold(version=version, values=configuration or {}))
    if alarm_at is not None and now < alarm_at + LIVE_FOR:
        items.append(LiveTold(period_s=LIVE_PERIOD_S, until=alarm_at + LIVE_FOR))
    items += [
        WindowTold(id=row[3], boot=row[4], t_first_s=row[5], t_last_s=row[6]) for row in rows if row[3] is not None
    ]
    return items


class Quota(NamedTuple):
    """What a box sent on a day, and how much it may send, where it has a limit of its own."""

    day: dt.date | None
    used: int
    own: int | None


def check_quota(quota: Quota, size: int, *, limit: int, burst: bool, now: dt.datetime) -> None:
    """Raise when a box has sent too much today; bursts are evidence, so they have as much again."""
    allowed = (limit if quota.own is None else quota.own) * (2 if burst else 1)
    today = now.astimezone(dt.UTC).date()
    if (quota.used if quota.day == today else 0) + size > allowed:
        midnight = dt.datetime.combine(today + dt.timedelta(days=1), dt.time(), dt.UTC)
        raise TooManyRequestsError(
            f"More than {allowed} bytes today; go on at midnight UTC",
            code="quota",
            retry_after_s=int((midnight - now).total_seconds()) + 1,
        )


def counted(quota: Quota, size: int, *, now: dt.datetime) -> Quota:
    """With so much more that was stored."""
    today = now.astimezone(dt.UTC).date()
    return quota._replace(day=today, used=(quota.used if quota.day == today else 0) + size)
