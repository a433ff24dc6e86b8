from __future__ import annotations

import datetime as dt

from pydantic import BaseModel, Field


class PeriodOut(BaseModel):
    """What a vehicle drove in a day or week."""

    begins: dt.date = Field(description="local day, or Monday of the week, on which the trips began")
    vehicle_id: str | None
    device_id: str | None = Field(description="of a box that sat in no vehicle")
    trips: int
    distance_m: float
    moving_s: float
    idle_s: float = Field(description="standing within trips: at lights, in queues, engine running or not")
    night_share: float | None = Field(description="of the moving time, 22:00 to 05:00 local, 0..1")
    max_speed_kmh: float


class StatisticsOut(BaseModel):
    zone: str
    items: list[PeriodOut] = Field(description="newest first")


class ScoreOut(BaseModel):
    """Driving style, and how sure it is."""

    vehicle_id: str
    since: dt.datetime
    until: dt.datetime
    status: str = Field(description="ok, or not_enough_distance")
    score: float | None = Field(description="0..100, 100 best")
    score_interval95: tuple[float, float] | None
    events: int
    by_kind: dict[str, int]
    kilometres: float
    min_kilometres: float
    per_100_km: float | None
    per_100_km_interval95: tuple[float, float] | None
    formula: str
