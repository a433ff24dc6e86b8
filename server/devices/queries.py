"""Boxes as they are shown."""

from __future__ import annotations

from sqlalchemy import select
from sqlalchemy.orm import Session

from server.devices.schemas import ChainOut, DeviceOut, DevicePage, ReferenceMounting, WindowOut
from server.errors import NotFoundError
from server.models import Device, DeviceRequest


def device_of(session: Session, organisation_id: str, device_id: str, *, lock: bool = False) -> Device:
    """A box of the organisation, its row locked when it is going to change."""
    device = session.get(Device, device_id, with_for_update=lock)
    if device is None or device.organisation_id != organisation_id:
        raise NotFoundError(f"There is no device {device_id!r}")
    return device


def device(session: Session, organisation_id: str, device_id: str) -> DeviceOut:
    """One box."""
    return _shown(device_of(session, organisation_id, device_id))


def devices(session: Session, organisation_id: str, *, after: str, limit: int) -> DevicePage:
    """A page of boxes in the order of their ids."""
    wanted = select(Device).where(Device.organisation_id == organisation_id, Device.id > after)
    found = session.scalars(wanted.order_by(Device.id).limit(limit + 1)).all()
    more = len(found) > limit
    return DevicePage(items=[_shown(row) for row in found[:limit]], next=found[limit - 1].id if more else None)


def _shown(row: Device) -> DeviceOut:
    return DeviceOut(
        id=row.id,
        name=row.name,
        vehicle_id=row.vehicle_id,
        created_at=row.created_at,
        revoked_at=row.revoked_at,
        last_seen_at=row.last_seen_at,
        signed_only=row.signed_only,
        bytes_per_day=row.bytes_per_day,
        configuration=row.configuration,
        configuration_version=row.configuration_version,
        configuration_seen=row.configuration_seen,
        chain=ChainOut(length=row.chain_length, head=row.chain_head),
        reference_mountings=[ReferenceMounting.model_validate(mounting) for mounting in row.reference_mountings],
    )


def requests(session: Session, organisation_id: str, device_id: str) -> list[WindowOut]:
    """What a box was asked for, the newest first."""
    device_of(session, organisation_id, device_id)
    wanted = select(DeviceRequest).where(DeviceRequest.device_id == device_id)
    rows = session.scalars(wanted.order_by(DeviceRequest.created_at.desc(), DeviceRequest.id).limit(100))
    return [WindowOut.model_validate(row, from_attributes=True) for row in rows]
