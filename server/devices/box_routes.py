"""A box's own doors besides uploading: trading its claim code, asking what it is told, a new token."""

from __future__ import annotations

from typing import cast

from fastapi import APIRouter, Request

from server.accounts.access import DeviceCaller
from server.devices import provisioning
from server.devices.schemas import BoxOut, ClaimedOut, ClaimIn, DeviceToken
from server.edge import DatabaseOf, Now
from server.errors import ForbiddenError, TooManyRequestsError
from server.limits import TokenBuckets
from server.problems import described

router = APIRouter(tags=["boxes"])

# Many boxes may stand behind one address of a mobile network.
CLAIMS_PER_MINUTE = 60


@router.post("/api/v1/claim", responses=described(429))
def claim(wanted: ClaimIn, request: Request, database: DatabaseOf, now: Now) -> ClaimedOut:
    """Trade a claim code for the box's token; may be repeated until the token was used."""
    attempts = cast("TokenBuckets", request.app.state.claim_attempts)
    wait_s = attempts.take(request.client.host if request.client else "", now.timestamp())
    if wait_s > 0.0:
        seconds = int(wait_s) + 1
        raise TooManyRequestsError(f"Too many attempts; try again in {seconds} s", retry_after_s=seconds)
    with database.transaction() as session:
        claimed = provisioning.claim(session, wanted.code, now=now)
    return ClaimedOut(id=claimed.id, token=claimed.token, server_time=now)


@router.get("/api/v1/device")
def read_box(caller: DeviceCaller, database: DatabaseOf, now: Now) -> BoxOut:
    """Who the box is, the time, its configuration and what it is asked for."""
    device_id = cast("str", caller.device_id)
    with database.reading() as session:
        return BoxOut(id=device_id, server_time=now, requests=provisioning.told(session, device_id, None, now=now))


@router.post("/api/v1/device/token")
def rotate_own_token(caller: DeviceCaller, database: DatabaseOf, now: Now) -> DeviceToken:
    """A new token for the box; the old one ends when the new one is used first."""
    if caller.signed_body_sha256 is not None:
        raise ForbiddenError("A signed request may travel in the open: a token is not given in its answer")
    with database.transaction() as session:
        return provisioning.ask_for_token(session, cast("str", caller.device_id), now=now)
