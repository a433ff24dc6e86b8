"""Vehicles as they are shown."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import select
from sqlalchemy.orm import Session

from server.errors import NotFoundError
from server.models import Assignment, Vehicle
from server.vehicles.schemas import BoxPeriod, VehicleOut, VehiclePage


def vehicle_of(session: Session, organisation_id: str, vehicle_id: str) -> Vehicle:
    """A vehicle of the organisation."""
    vehicle = session.get(Vehicle, vehicle_id)
    if vehicle is None or vehicle.organisation_id != organisation_id:
        raise NotFoundError(f"There is no vehicle {vehicle_id!r}")
    return vehicle


def vehicle(session: Session, organisation_id: str, vehicle_id: str) -> VehicleOut:
    """One vehicle."""
    return _shown(session, [vehicle_of(session, organisation_id, vehicle_id)])[0]


def vehicles(session: Session, organisation_id: str, *, after: str, limit: int) -> VehiclePage:
    """A page of vehicles in the order of their ids."""
    wanted = select(Vehicle).where(Vehicle.organisation_id == organisation_id, Vehicle.id > after)
    found = session.scalars(wanted.order_by(Vehicle.id).limit(limit + 1)).all()
    more = len(found) > limit
    return VehiclePage(items=_shown(session, found[:limit]), next=found[limit - 1].id if more else None)


def _shown(session: Session, rows: Sequence[Vehicle]) -> list[VehicleOut]:
    boxes: dict[str, list[BoxPeriod]] = {row.id: [] for row in rows}
    periods = select(Assignment).where(Assignment.vehicle_id.in_(boxes)).order_by(Assignment.began_at.desc())
    for period in session.scalars(periods):
        boxes[period.vehicle_id].append(
            BoxPeriod(device_id=period.device_id, began_at=period.began_at, ended_at=period.ended_at)
        )
    return [
        VehicleOut.model_validate(
            {
                "id": row.id,
                "name": row.name,
                "plate": row.plate,
                "vehicle_class": row.vehicle_class,
                "traffic_side": row.traffic_side,
                "created_at": row.created_at,
                "boxes": boxes[row.id],
            }
        )
        for row in rows
    ]
