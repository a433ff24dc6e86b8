"""Vehicles over HTTP."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query
from starlette.responses import Response

from server.accounts import audit
from server.accounts.access import Administrator, Reader
from server.edge import DatabaseOf, Now
from server.problems import described
from server.vehicles import queries, service
from server.vehicles.schemas import VehicleChange, VehicleIn, VehicleOut, VehiclePage

router = APIRouter(prefix="/api/v1/vehicles", tags=["vehicles"])


@router.post("", status_code=201)
def create(wanted: VehicleIn, caller: Administrator, database: DatabaseOf, now: Now) -> VehicleOut:
    """Add a vehicle."""
    with database.transaction() as session:
        vehicle = service.create(session, caller.organisation_id, wanted, now=now)
        detail = wanted.model_dump(mode="json")
        audit.record(session, caller, "vehicle.added", f"vehicle={vehicle.id}", now=now, detail=detail)
        return queries.vehicle(session, caller.organisation_id, vehicle.id)


@router.get("")
def list_vehicles(
    caller: Reader,
    database: DatabaseOf,
    after: Annotated[str, Query(max_length=32)] = "",
    limit: Annotated[int, Query(ge=1, le=500)] = 200,
) -> VehiclePage:
    """List vehicles, a page at a time."""
    with database.reading() as session:
        return queries.vehicles(session, caller.organisation_id, after=after, limit=limit)


@router.get("/{vehicle_id}")
def read(vehicle_id: str, caller: Reader, database: DatabaseOf) -> VehicleOut:
    """One vehicle, with the boxes it has and had."""
    with database.reading() as session:
        return queries.vehicle(session, caller.organisation_id, vehicle_id)


@router.patch("/{vehicle_id}")
def change(vehicle_id: str, wanted: VehicleChange, caller: Administrator, database: DatabaseOf, now: Now) -> VehicleOut:
    """Change what is named."""
    with database.transaction() as session:
        service.change(session, caller.organisation_id, vehicle_id, wanted, now=now)
        detail = wanted.model_dump(mode="json", exclude_unset=True)
        audit.record(session, caller, "vehicle.changed", f"vehicle={vehicle_id}", now=now, detail=detail)
        return queries.vehicle(session, caller.organisation_id, vehicle_id)


@router.delete("/{vehicle_id}", status_code=204, responses=described(409))
def remove(vehicle_id: str, caller: Administrator, database: DatabaseOf, now: Now) -> Response:
    """Delete a vehicle that never had a box."""
    with database.transaction() as session:
        service.remove(session, caller.organisation_id, vehicle_id, now=now)
        audit.record(session, caller, "vehicle.removed", f"vehicle={vehicle_id}", now=now)
    return Response(status_code=204)
