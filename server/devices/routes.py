"""Boxes over HTTP."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Header, Query
from starlette.responses import Response

from server.accounts import audit
from server.accounts.access import Administrator, Installer, Reader
from server.devices import provisioning, queries, service
from server.devices.schemas import (
    ClaimCodeOut,
    DeviceIn,
    DeviceOut,
    DevicePage,
    DeviceSettings,
    DeviceToken,
    ReferenceMountings,
    VehicleChoice,
    WindowIn,
    WindowOut,
)
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
        if new:
            audit.record(session, caller, "box.added", f"device={device.id}", now=now, detail={"name": wanted.name})
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


@router.post("/{device_id}/token", responses=described(409))
def rotate_token(device_id: str, caller: Administrator, database: DatabaseOf, now: Now) -> DeviceToken:
    """Give a box a new token; the old one ends at once."""
    with database.transaction() as session:
        audit.record(session, caller, "box.token", f"device={device_id}", now=now)
        return service.rotate_token(session, caller.organisation_id, device_id, now=now)


@router.post("/{device_id}/revoke")
def revoke(device_id: str, caller: Administrator, database: DatabaseOf, now: Now) -> DeviceOut:
    """Refuse a box from now on; its data stay."""
    with database.transaction() as session:
        audit.record(session, caller, "box.revoked", f"device={device_id}", now=now)
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
    device_id: str, wanted: VehicleChoice, caller: Installer, database: DatabaseOf, now: Now
) -> DeviceOut:
    """Swap a box to another vehicle, or take it out; its installation ends there."""
    with database.transaction() as session:
        service.put_into_vehicle(session, caller.organisation_id, device_id, wanted.vehicle_id, at=wanted.at, now=now)
        detail = {"vehicle": wanted.vehicle_id}
        audit.record(session, caller, "box.vehicle", f"device={device_id}", now=now, detail=detail)
        return queries.device(session, caller.organisation_id, device_id)


@router.post("/{device_id}/claim-code", status_code=201, responses=described(409))
def new_claim_code(device_id: str, caller: Installer, database: DatabaseOf, now: Now) -> ClaimCodeOut:
    """A code that the box trades for its token at /api/v1/claim; it voids the box's earlier codes."""
    with database.transaction() as session:
        audit.record(session, caller, "box.claim-code", f"device={device_id}", now=now)
        return provisioning.new_claim_code(session, caller.organisation_id, device_id, now=now)


@router.put("/{device_id}/settings")
def set_settings(
    device_id: str, wanted: DeviceSettings, caller: Administrator, database: DatabaseOf, now: Now
) -> DeviceOut:
    """Set what the box is told, how it must show who it is, and how much it may send in a day."""
    with database.transaction() as session:
        provisioning.set_settings(session, caller.organisation_id, device_id, wanted, now=now)
        told = wanted.model_dump(exclude={"configuration"})
        audit.record(session, caller, "box.settings", f"device={device_id}", now=now, detail=told)
        return queries.device(session, caller.organisation_id, device_id)


@router.get("/{device_id}/requests")
def list_requests(device_id: str, caller: Reader, database: DatabaseOf) -> list[WindowOut]:
    """What the box was asked for, the newest first."""
    with database.reading() as session:
        return queries.requests(session, caller.organisation_id, device_id)


@router.post("/{device_id}/requests", status_code=201, responses=described(409))
def ask_for_window(
    device_id: str, wanted: WindowIn, caller: Administrator, database: DatabaseOf, now: Now
) -> WindowOut:
    """Ask the box for a stretch of its clock; told with every answer until a batch answers it, for a week."""
    with database.transaction() as session:
        made = provisioning.ask_for_window(session, caller.organisation_id, device_id, wanted, now=now)
        session.flush()
        detail = wanted.model_dump(mode="json")
        audit.record(session, caller, "box.asked", f"device={device_id}", now=now, detail=detail)
        found = queries.requests(session, caller.organisation_id, device_id)
    return next(each for each in found if each.id == made)


@router.delete("/{device_id}/requests/{request_id}", status_code=204)
def cancel_request(device_id: str, request_id: str, caller: Administrator, database: DatabaseOf, now: Now) -> Response:
    """Ask no longer."""
    with database.transaction() as session:
        provisioning.cancel_request(session, caller.organisation_id, device_id, request_id, now=now)
        subject = f"device={device_id} request={request_id}"
        audit.record(session, caller, "box.not-asked", subject, now=now)
    return Response(status_code=204)
