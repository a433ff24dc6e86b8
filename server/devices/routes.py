"""Boxes over HTTP."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Header, Query
from starlette.responses import Response

from server.accounts.access import Administrator, Reader
from server.devices import queries, service
from server.devices.schemas import DeviceIn, DeviceOut, DevicePage, DeviceToken, ReferenceMountings, VehicleChoice
from server.edge import DatabaseOf, Now
from server.problems import described

router = APIRouter(prefix="/api/v1/devices", tags=["devices"])

IdempotencyKey = Annotated[str | None, Header(min_length=1, max_length=200)]


@router.post("", status_code=201, responses={200: {"model": DeviceToken}, **described(409)})
def register(
    wanted: DeviceIn,
    response: Response,
    caller: Administrator,
    database: DatabaseOf,
    now: Now,
    idempotency_key: IdempotencyKey = None,
) -> DeviceToken:
    """Register a box; its token is shown once.  The same Idempotency-Key again gives the same box without it."""
    with database.transaction() as session:
        device, new = service.register(
            session, caller.organisation_id, wanted, idempotency_key=idempotency_key, now=now
        )
    response.status_code = 201 if new else 200
    return device


@router.get("")
def list_devices(
    caller: Reader,
    database: DatabaseOf,
    after: Annotated[str, Query(max_length=32)] = "",
    limit: Annotated[int, Query(ge=1, le=500)] = 200,
) -> DevicePage:
    """List boxes, a page at a time."""
    with database.reading() as session:
        return queries.devices(session, caller.organisation_id, after=after, limit=limit)


@router.get("/{device_id}")
def read(device_id: str, caller: Reader, database: DatabaseOf) -> DeviceOut:
    """One box."""
    with database.reading() as session:
        return queries.device(session, caller.organisation_id, device_id)


@router.post("/{device_id}/token")
def rotate_token(device_id: str, caller: Administrator, database: DatabaseOf, now: Now) -> DeviceToken:
    """Give a box a new token; the old one ends at once."""
    with database.transaction() as session:
        return service.rotate_token(session, caller.organisation_id, device_id, now=now)


@router.post("/{device_id}/revoke")
def revoke(device_id: str, caller: Administrator, database: DatabaseOf, now: Now) -> DeviceOut:
    """Refuse a box from now on; its data stay."""
    with database.transaction() as session:
        service.revoke(session, caller.organisation_id, device_id, now=now)
        return queries.device(session, caller.organisation_id, device_id)


@router.put("/{device_id}/reference")
def set_references(
    device_id: str, wanted: ReferenceMountings, caller: Administrator, database: DatabaseOf, now: Now
) -> DeviceOut:
    """Set the mountings known from elsewhere, shown beside the estimates."""
    with database.transaction() as session:
        service.set_references(session, caller.organisation_id, device_id, wanted, now=now)
        return queries.device(session, caller.organisation_id, device_id)


@router.put("/{device_id}/vehicle")
def put_into_vehicle(
    device_id: str, wanted: VehicleChoice, caller: Administrator, database: DatabaseOf, now: Now
) -> DeviceOut:
    """Swap a box to another vehicle, or take it out; its installation ends there."""
    with database.transaction() as session:
        service.put_into_vehicle(session, caller.organisation_id, device_id, wanted.vehicle_id, at=wanted.at, now=now)
        return queries.device(session, caller.organisation_id, device_id)
