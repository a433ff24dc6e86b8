"""Boxes: registering, tokens, and the vehicle they sit in."""

from __future__ import annotations

import datetime as dt

from sqlalchemy import select
from sqlalchemy.orm import Session

from server.accounts.secrets import hash_of, new_token
from server.devices.provisioning import TOKEN_PREFIX, announce_device
from server.devices.queries import device_of
from server.devices.schemas import DeviceIn, DeviceToken, ReferenceMountings
from server.errors import ConflictError, InvalidError
from server.installations.service import end_for_swap
from server.models import Device, Organisation, Vehicle, new_id
from server.vehicles.service import assign


def _check_vehicle(session: Session, organisation_id: str, vehicle_id: str | None) -> None:
    if vehicle_id is None:
        return
    vehicle = session.get(Vehicle, vehicle_id)
    if vehicle is None or vehicle.organisation_id != organisation_id:
        raise InvalidError(f"There is no vehicle {vehicle_id!r}", code="unknown_vehicle")


def register(
    session: Session, organisation_id: str, wanted: DeviceIn, *, idempotency_key: str | None, now: dt.datetime
) -> tuple[DeviceToken, bool]:
    """A new box and its token, and whether it is new; an idempotency key seen before gives the box it made."""
    # Two requests with one key must not both find nothing: they take turns.
    session.get_one(Organisation, organisation_id, with_for_update=True)
    if idempotency_key is not None:
        same = Device.organisation_id == organisation_id, Device.idempotency_key == idempotency_key
        known = session.execute(select(Device.id, Device.name).where(*same)).first()
        if known is not None:
            # Its vehicle is not compared: it may have been put into another one since.
            if known.name != wanted.name:
                raise ConflictError(
                    "Another box was registered under this key; a key is used once",
                    code="idempotency_key_reused",
                    device_id=known.id,
                )
            return DeviceToken(id=known.id, token=None), False
    _check_vehicle(session, organisation_id, wanted.vehicle_id)
    token = new_token(TOKEN_PREFIX)
    device = Device(
        id=new_id(),
        organisation_id=organisation_id,
        name=wanted.name,
        token_hash=hash_of(token),
        idempotency_key=idempotency_key,
        created_at=now,
    )
    session.add(device)
    session.flush()
    assign(session, device, wanted.vehicle_id, at=now)
    announce_device(session, device, now)
    return DeviceToken(id=device.id, token=token), True


def rotate_token(session: Session, organisation_id: str, device_id: str, *, now: dt.datetime) -> DeviceToken:
    """A new token; the old one ends at once."""
    device = device_of(session, organisation_id, device_id, lock=True)
    if device.revoked_at is not None:
        raise ConflictError("The device is revoked", code="device_revoked")
    token = new_token(TOKEN_PREFIX)
    device.token_hash, device.next_token_hash = hash_of(token), None
    announce_device(session, device, now)
    return DeviceToken(id=device.id, token=token)


def revoke(session: Session, organisation_id: str, device_id: str, *, now: dt.datetime) -> None:
    """Refuse this box from now on; its data stay."""
    device = device_of(session, organisation_id, device_id, lock=True)
    if device.revoked_at is None:
        device.revoked_at = now
        announce_device(session, device, now)


def set_references(
    session: Session, organisation_id: str, device_id: str, wanted: ReferenceMountings, *, now: dt.datetime
) -> None:
    """Keep the mountings known from elsewhere, in the order of time."""
    device = device_of(session, organisation_id, device_id, lock=True)
    ordered = sorted(wanted.mountings, key=lambda mounting: mounting.since)
    device.reference_mountings = [
        {"from": mounting.since.astimezone(dt.UTC).isoformat(), "R_va": mounting.R_va} for mounting in ordered
    ]
    announce_device(session, device, now)


def put_into_vehicle(
    session: Session,
    organisation_id: str,
    device_id: str,
    vehicle_id: str | None,
    *,
    at: dt.datetime | None,
    now: dt.datetime,
) -> None:
    """Swap a box to another vehicle, or take it out: its installation ends there."""
    device = device_of(session, organisation_id, device_id, lock=True)
    _check_vehicle(session, organisation_id, vehicle_id)
    moment = now if at is None else at
    if moment > now:
        raise InvalidError("`at` is in the future")
    if assign(session, device, vehicle_id, at=moment):
        end_for_swap(session, device, moment)
        announce_device(session, device, now)
