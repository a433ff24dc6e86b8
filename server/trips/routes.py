"""Trips over HTTP."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from server.accounts.access import PlaceReader, Reader
from server.accounts.places import sight_of
from server.edge import DatabaseOf, Moment, place_of
from server.trips import queries
from server.trips.schemas import TrackOut, TripOut, TripPage, track_out, trip_out

router = APIRouter(prefix="/api/v1/trips", tags=["trips"])


@router.get("")
def list_trips(
    caller: Reader,
    database: DatabaseOf,
    device: Annotated[str | None, Query(max_length=32)] = None,
    vehicle: Annotated[str | None, Query(max_length=32)] = None,
    since: Annotated[Moment | None, Query(alias="from")] = None,
    until: Annotated[Moment | None, Query(alias="to")] = None,
    before: Annotated[str | None, Query(max_length=100)] = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
) -> TripPage:
    """Trips, the newest first, a page at a time."""
    with database.reading() as session:
        rows = queries.trips(
            session,
            caller.organisation_id,
            device_id=device,
            vehicle_id=vehicle,
            since=since,
            until=until,
            before=None if before is None else place_of(before),
            limit=limit + 1,
        )
        last = rows[limit - 1] if len(rows) > limit else None
        return TripPage(
            items=[trip_out(row) for row in rows[:limit]],
            next=None if last is None else f"{last.began_at.isoformat()}~{last.id}",
        )


@router.get("/{trip_id}")
def read(trip_id: str, caller: Reader, database: DatabaseOf) -> TripOut:
    """One trip."""
    with database.reading() as session:
        return trip_out(queries.trip_of(session, caller.organisation_id, trip_id))


@router.get("/{trip_id}/track")
def read_track(trip_id: str, caller: PlaceReader, database: DatabaseOf) -> TrackOut:
    """The 1 Hz track as GeoJSON, of standing time the first point only; cells of a kilometre without location.read."""
    with database.reading() as session:
        trip = queries.trip_of(session, caller.organisation_id, trip_id)
        return track_out(trip.id, queries.track(session, trip.id), sight_of(caller))
