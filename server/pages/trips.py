"""The page of the whole fleet's trips."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated
from urllib.parse import urlencode

from fastapi import APIRouter, Query, Request
from sqlalchemy import or_, select, tuple_
from starlette.responses import HTMLResponse

from server.accounts.access import Reader
from server.edge import DatabaseOf, place_of
from server.errors import ProblemError
from server.models import Device, Trip, Vehicle
from server.pages import queries
from server.pages.forms import day
from server.pages.routes import answer

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)

SHOWN = 100
Day = Annotated[str, Query(max_length=20)]


@dataclass(frozen=True)
class Line:
    """A trip in the list."""

    trip: Trip
    device: Device
    vehicle: Vehicle | None

    @property
    def name(self) -> str:
        return self.vehicle.name if self.vehicle else self.device.name

    @property
    def url(self) -> str:
        """The page of its vehicle, while that is where its box still sits; else of the box."""
        here = self.vehicle is not None and self.device.vehicle_id == self.vehicle.id
        subject = f"/vehicles/{self.trip.vehicle_id}" if here else f"/devices/{self.device.id}"
        return f"{subject}?trip={self.trip.id}"


@router.get("/trips")
def trips(
    request: Request,
    caller: Reader,
    database: DatabaseOf,
    q: Annotated[str, Query(max_length=100)] = "",
    since: Day = "",
    until: Day = "",
    shortest_km: Annotated[float, Query(ge=0.0, le=1e5)] = 0.0,
    before: Annotated[str, Query(max_length=100)] = "",
) -> HTMLResponse:
    """Trips, the newest first, by vehicle, days and distance; days are UTC's, the last one included."""
    problem: ProblemError | None = None
    query = (
        select(Trip, Device, Vehicle)
        .join(Device, Device.id == Trip.device_id)
        .outerjoin(Vehicle, Vehicle.id == Trip.vehicle_id)
        .where(Trip.organisation_id == caller.organisation_id, Trip.distance_m >= 1000.0 * shortest_km)
    )
    for word in q.split():
        named = (Device.name, Vehicle.name, Vehicle.plate)
        query = query.where(or_(*(column.icontains(word, autoescape=True) for column in named)))
    try:
        first, last = day(since), day(until, following=1)
        if first is not None:
            query = query.where(Trip.began_at >= first)
        if last is not None:
            query = query.where(Trip.began_at < last)
        if before:
            query = query.where(tuple_(Trip.began_at, Trip.id) < place_of(before))
    except ProblemError as error:
        problem = error
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        rows = session.execute(query.order_by(Trip.began_at.desc(), Trip.id.desc()).limit(SHOWN + 1)).all()
    lines = [Line(trip, device, vehicle) for trip, device, vehicle in rows]
    shown = lines[:SHOWN]
    wanted = {"q": q.strip(), "since": since, "until": until, "shortest_km": f"{shortest_km:g}"}
    following = None
    if len(lines) > SHOWN:
        trip = shown[-1].trip
        following = urlencode({**wanted, "before": f"{trip.began_at.isoformat()}~{trip.id}"})
    context = {"lines": shown, "wanted": wanted, "next": following, "error": problem and problem.detail}
    page = answer(request, "trips.html", caller, "trips", change, context)
    page.status_code = 200 if problem is None else problem.status
    return page
