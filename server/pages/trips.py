"""The page of the whole fleet's trips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from fastapi import APIRouter, Depends, Query, Request
from sqlalchemy import ColumnElement, SQLColumnExpression, func, select
from sqlalchemy.orm import Session
from starlette.responses import HTMLResponse

from server.accounts.access import Reader
from server.edge import DatabaseOf
from server.errors import ProblemError
from server.models import Device, Trip, Vehicle
from server.pages import frame, lists, queries
from server.pages.routes import answer

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)

Sort = Literal["began", "vehicle", "distance", "moving", "top"]
_SORTED: dict[Sort, SQLColumnExpression[Any]] = {
    "began": Trip.began_at,
    "vehicle": func.lower(func.coalesce(Vehicle.name, Device.name)),
    "distance": Trip.distance_m,
    "moving": Trip.moving_s,
    "top": Trip.max_speed_mps,
}


@dataclass(frozen=True)
class Wanted(lists.Wanted):
    """What a reader asked of the list."""

    sort: Sort = "began"
    down: bool = True
    since: str = ""
    until: str = ""
    shortest: float = 0.0
    """In the reader's unit of distance."""

    FALLING: ClassVar[frozenset[str]] = frozenset({"began", "distance", "moving", "top"})

    def conditions(self, per_m: float) -> list[ColumnElement[bool]]:
        """Of the filters, `per_m` from metres to the reader's unit; raises `InvalidError` when a day is none."""
        days = lists.between(Trip.began_at, self.since, self.until)
        return [*lists.named(self.q), Trip.distance_m >= self.shortest / per_m, *days]


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


def _wanted(
    q: Annotated[str, Query(max_length=100)] = "",
    since: Annotated[str, Query(max_length=20)] = "",
    until: Annotated[str, Query(max_length=20)] = "",
    shortest: Annotated[float, Query(ge=0.0, le=1e5)] = 0.0,
    sort: Sort = "began",
    down: bool = True,
    page: Annotated[int, Query(ge=1, le=100_000)] = 1,
) -> Wanted:
    return Wanted(
        q=q.strip(), sort=sort, down=down, page=page, since=since.strip(), until=until.strip(), shortest=shortest
    )


def listed(session: Session, organisation_id: str, wanted: Wanted, per_m: float) -> tuple[Sequence[Line], int]:
    """Trips of one page of the list, and how many the filters leave."""
    query = (
        select(Trip, Device, Vehicle)
        .join(Device, Device.id == Trip.device_id)
        .outerjoin(Vehicle, Vehicle.id == Trip.vehicle_id)
        .where(Trip.organisation_id == organisation_id, *wanted.conditions(per_m))
    )
    column = _SORTED[wanted.sort]
    order = column.desc() if wanted.down else column.asc()
    rows, found = lists.rows_of(session, query, wanted, order, Trip.began_at.desc(), Trip.id)
    return [Line(trip, device, vehicle) for trip, device, vehicle in rows], found


@router.get("/trips")
def trips(
    request: Request, caller: Reader, database: DatabaseOf, wanted: Annotated[Wanted, Depends(_wanted)]
) -> HTMLResponse:
    """Trips by vehicle, days and distance; days are UTC's, the last one included."""
    problem: ProblemError | None = None
    lines: Sequence[Line] = []
    found = 0
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        try:
            lines, found = listed(session, caller.organisation_id, wanted, frame.measures_of(request).per_m)
        except ProblemError as error:
            problem = error
    views = caller.preferences.views_of("trips")
    context = {"lines": lines, "found": found, "wanted": wanted, "views": views, "error": problem and problem.detail}
    page = answer(request, "trips.html", caller, "trips", change, context)
    page.status_code = 200 if problem is None else problem.status
    return page
