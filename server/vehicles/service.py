"""Vehicles, and which box is in which."""

from __future__ import annotations

import datetime as dt

from sqlalchemy import exists, select
from sqlalchemy.orm import Session

from server.errors import ConflictError, InvalidError
from server.live.changes import announce
from server.models import AccidentClaim, Assignment, Device, Installation, Trip, Vehicle
from server.vehicles.queries import vehicle_of
from server.vehicles.schemas import VehicleChange, VehicleIn


def _announce(session: Session, vehicle: Vehicle, now: dt.datetime) -> None:
    announce(session, "vehicle", at=now, organisation_id=vehicle.organisation_id, vehicle_id=vehicle.id)


def create(session: Session, organisation_id: str, wanted: VehicleIn, *, now: dt.datetime) -> Vehicle:
    """A new vehicle."""
    vehicle = Vehicle(organisation_id=organisation_id, created_at=now, **wanted.model_dump())
    session.add(vehicle)
    session.flush()
    _announce(session, vehicle, now)
    return vehicle


def change(
    session: Session, organisation_id: str, vehicle_id: str, wanted: VehicleChange, *, now: dt.datetime
) -> Vehicle:
    """Change what is named."""
    vehicle = vehicle_of(session, organisation_id, vehicle_id)
    fields = wanted.model_dump(exclude_unset=True)
    for name in ("name", "vehicle_class"):
        if name in fields and fields[name] is None:
            raise InvalidError(f"{name} cannot be cleared")
    for name, value in fields.items():
        setattr(vehicle, name, value)
    _announce(session, vehicle, now)
    return vehicle


def remove(session: Session, organisation_id: str, vehicle_id: str, *, now: dt.datetime) -> None:
    """Delete a vehicle that never had a box; what happened in a vehicle stays on record."""
    vehicle = vehicle_of(session, organisation_id, vehicle_id)
    tables = (AccidentClaim, Assignment, Device, Installation, Trip)
    has_history = (exists().where(table.vehicle_id == vehicle.id) for table in tables)
    if any(session.scalar(select(found)) for found in has_history):
        raise ConflictError("The vehicle has had a box; its record is kept", code="vehicle_in_use")
    _announce(session, vehicle, now)
    session.delete(vehicle)


def assign(session: Session, device: Device, vehicle_id: str | None, *, at: dt.datetime) -> bool:
    """Put a box into a vehicle, or take it out; whether that changed anything.

    Ends the box's time in its present vehicle and begins the new one at `at`.
    """
    if vehicle_id == device.vehicle_id:
        return False
    present = session.scalar(
        select(Assignment).where(Assignment.device_id == device.id, Assignment.ended_at.is_(None)).limit(1)
    )
    if present is not None:
        if at < present.began_at:
            raise InvalidError("`at` is before the box was put into its present vehicle")
        present.ended_at = at
    if vehicle_id is not None:
        session.add(Assignment(device_id=device.id, vehicle_id=vehicle_id, began_at=at))
    device.vehicle_id = vehicle_id
    return True
