"""Kilometres, trip statistics and driving style over HTTP."""

from __future__ import annotations

import datetime as dt
from typing import Annotated
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from fastapi import APIRouter, Query

from server.accounts.access import Reader
from server.edge import DatabaseOf, Moment, Now
from server.errors import InvalidError
from server.statistics import queries
from server.statistics.schemas import ScoreOut, StatisticsOut
from server.vehicles.queries import vehicle_of

SHOWN = {"day": dt.timedelta(days=30), "week": dt.timedelta(days=182)}
SCORED = dt.timedelta(days=30)

router = APIRouter(prefix="/api/v1", tags=["statistics"])


@router.get("/statistics")
def read_statistics(
    caller: Reader,
    database: DatabaseOf,
    now: Now,
    group: Annotated[queries.Group, Query()] = "day",
    zone: Annotated[str, Query(max_length=64, description="IANA name, for days, weeks and nights")] = "UTC",
    vehicle: Annotated[str | None, Query(max_length=32)] = None,
    device: Annotated[str | None, Query(max_length=32)] = None,
    since: Annotated[Moment | None, Query(alias="from", description="default: 30 days or 26 weeks ago")] = None,
    until: Annotated[Moment | None, Query(alias="to", description="default: now")] = None,
) -> StatisticsOut:
    """Kilometres, driving time, standing time, share of night and top speed per vehicle and day or week."""
    try:
        local = ZoneInfo(zone)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise InvalidError("`zone` is no time zone that is known here", code="zone") from None
    with database.reading() as session:
        items = queries.periods(
            session,
            caller.organisation_id,
            group=group,
            zone=local,
            since=since or now - SHOWN[group],
            until=until or now,
            vehicle_id=vehicle,
            device_id=device,
        )
    return StatisticsOut(zone=zone, items=items)


@router.get("/vehicles/{vehicle_id}/score")
def read_score(
    vehicle_id: str,
    caller: Reader,
    database: DatabaseOf,
    now: Now,
    since: Annotated[Moment | None, Query(alias="from", description="default: 30 days ago")] = None,
    until: Annotated[Moment | None, Query(alias="to", description="default: now")] = None,
) -> ScoreOut:
    """Driving style from harsh events per distance, with its formula and its uncertainty."""
    with database.reading() as session:
        vehicle_of(session, caller.organisation_id, vehicle_id)
        return queries.score(session, caller.organisation_id, vehicle_id, since or now - SCORED, until or now)
