from __future__ import annotations

import datetime as dt
import math
from collections.abc import Sequence
from typing import Literal

from pydantic import BaseModel, Field

from server.accounts.places import Place, Sight, seen
from server.models import TrackPoint, Trip


class TripOut(BaseModel):
    """From the first movement to a rest that lasts."""

    id: str
    device_id: str
    vehicle_id: str | None
    began_at: dt.datetime
    ended_at: dt.datetime
    under_way: bool
    distance_m: float = Field(description="speed integrated over time")
    position_distance_m: float = Field(description="the same way between positions 50 m apart: the check")
    moving_s: float
    max_speed_kmh: float
    algorithm: str
    input_sha256: str
    raw_erased_at: dt.datetime | None = Field(description="since when data that it was reckoned from are erased")
    track_erased_at: dt.datetime | None


class TripPage(BaseModel):
    items: list[TripOut]
    next: str | None = Field(description="value of `before` for the next page")


class LineString(BaseModel):
    type: Literal["LineString"] = "LineString"
    coordinates: list[list[float]] = Field(description="longitude, latitude, degrees")


class TrackProperties(BaseModel):
    """One value per coordinate."""

    trip_id: str
    at: list[dt.datetime]
    speed_mps: list[float | None]
    course_deg: list[float | None] = Field(description="clockwise from true north")
    alt_m: list[float | None]


class TrackOut(BaseModel):
    """GeoJSON."""

    type: Literal["Feature"] = "Feature"
    geometry: LineString | None
    properties: TrackProperties


def trip_out(trip: Trip) -> TripOut:
    """A trip as JSON."""
    return TripOut(
        id=trip.id,
        device_id=trip.device_id,
        vehicle_id=trip.vehicle_id,
        began_at=trip.began_at,
        ended_at=trip.ended_at,
        under_way=trip.under_way,
        distance_m=trip.distance_m,
        position_distance_m=trip.position_distance_m,
        moving_s=trip.moving_s,
        max_speed_kmh=3.6 * trip.max_speed_mps,
        algorithm=trip.algorithm,
        input_sha256=trip.input_sha256,
        raw_erased_at=trip.raw_erased_at,
        track_erased_at=trip.track_erased_at,
    )


def track_out(trip_id: str, points: Sequence[TrackPoint], sight: Sight) -> TrackOut:
    """A track as GeoJSON; a line needs two points.

    Seen coarsely, a stay in a cell is one point with the minute of its beginning, and no speed, course or height: speed
    and course of every second would draw the way again.
    """
    if sight != "exact":
        return _coarse(trip_id, points, sight)
    coordinates = [[round(point.lon_deg, 7), round(point.lat_deg, 7)] for point in points]
    return TrackOut(
        geometry=LineString(coordinates=coordinates) if len(coordinates) >= 2 else None,
        properties=TrackProperties(
            trip_id=trip_id,
            at=[point.at for point in points],
            speed_mps=[point.speed_mps for point in points],
            course_deg=[None if p.course_rad is None else math.degrees(p.course_rad) % 360.0 for p in points],
            alt_m=[point.alt_m for point in points],
        ),
    )


def _coarse(trip_id: str, points: Sequence[TrackPoint], sight: Sight) -> TrackOut:
    cells: list[tuple[Place, dt.datetime]] = []
    for point in points:
        place = seen(point.lat_deg, point.lon_deg, sight)
        if place is not None and (not cells or cells[-1][0] != place):
            cells.append((place, point.at.replace(second=0, microsecond=0)))
    line = LineString(coordinates=[[place.lon_deg, place.lat_deg] for place, _ in cells])
    nothing: list[float | None] = [None] * len(cells)
    at = [at for _, at in cells]
    told = TrackProperties(trip_id=trip_id, at=at, speed_mps=nothing, course_deg=nothing, alt_m=nothing)
    return TrackOut(geometry=line if len(cells) >= 2 else None, properties=told)
