"""Diagnosis values over HTTP."""

from __future__ import annotations

import datetime as dt
from typing import Annotated, cast

from fastapi import APIRouter, Depends, Query, Request

from server.accounts.access import Caller, DeviceCaller, Reader
from server.devices.queries import device_of
from server.diagnosis import queries, service
from server.diagnosis.schemas import DiagnosisOut, Kept, LatestOut, Name, ReadingOut, ValuesIn
from server.edge import DatabaseOf, Moment, Now
from server.errors import TooManyRequestsError, UnauthenticatedError
from server.ingest.service import bytes_sha256
from server.limits import TokenBuckets
from server.problems import described

UNITS = {"battery_v": "V", "temperature_c": "degC"}
SHOWN = dt.timedelta(days=7)

router = APIRouter(tags=["diagnosis"])


async def _as_signed(request: Request, caller: DeviceCaller) -> Caller:
    """The box, whose body is the one that was signed where it signs."""
    if caller.signed_body_sha256 not in (None, bytes_sha256(await request.body())):
        raise UnauthenticatedError("The body is not the one that was signed", code="signature")
    return caller


@router.post("/api/v1/device/diagnosis", status_code=202, responses=described(429))
def take(
    request: Request, wanted: ValuesIn, caller: Annotated[Caller, Depends(_as_signed)], database: DatabaseOf, now: Now
) -> Kept:
    """Named values that the box read on the vehicle; once a minute and only where they changed is enough."""
    uploads = cast("TokenBuckets", request.app.state.uploads)
    wait_s = uploads.take(cast("str", caller.device_id), now.timestamp())
    if wait_s > 0.0:
        seconds = int(wait_s) + 1
        raise TooManyRequestsError(f"Too many uploads; try again in {seconds} s", retry_after_s=seconds)
    readings = [
        service.Reading(
            each.name, each.at or now - dt.timedelta(seconds=0.0 if each.age_s is None else each.age_s), each.value
        )
        for each in wanted.values
    ]
    with database.transaction() as session:
        return Kept(kept=service.keep(session, cast("str", caller.device_id), readings, now=now))


@router.get("/api/v1/devices/{device_id}/diagnosis")
def read(
    device_id: str,
    caller: Reader,
    database: DatabaseOf,
    now: Now,
    name: Annotated[list[Name] | None, Query(max_length=20, description="may be repeated")] = None,
    since: Annotated[Moment | None, Query(alias="from", description="default: a week before `to`")] = None,
    until: Annotated[Moment | None, Query(alias="to", description="default: now")] = None,
) -> DiagnosisOut:
    """The newest of every value, and the course of those that are named."""
    end = until or now
    begin = since or max(end, dt.datetime.min.replace(tzinfo=dt.UTC) + SHOWN) - SHOWN
    with database.reading() as session:
        device_of(session, caller.organisation_id, device_id)
        latest = queries.newest(session, device_id)
        series = {
            each: [
                ReadingOut(at=row.at, value=row.value) for row in queries.readings(session, device_id, each, begin, end)
            ]
            for each in name or ()
        }
    return DiagnosisOut(
        device_id=device_id,
        latest=[LatestOut(name=row.name, value=row.value, unit=UNITS.get(row.name), at=row.at) for row in latest],
        series=series,
    )
