from __future__ import annotations

import datetime as dt
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

VehicleClass = Literal["car", "van", "truck", "bus", "motorcycle"]
TrafficSide = Literal["right", "left"]


class VehicleIn(BaseModel):
    model_config = ConfigDict(extra="forbid", str_strip_whitespace=True)

    name: str = Field(min_length=1, max_length=200)
    plate: str | None = Field(default=None, min_length=1, max_length=20)
    vehicle_class: VehicleClass = "car"
    traffic_side: TrafficSide | None = Field(default=None, description="side of the road it drives on, where known")


class VehicleChange(BaseModel):
    """What is not named stays as it is; null clears."""

    model_config = ConfigDict(extra="forbid", str_strip_whitespace=True)

    name: str | None = Field(default=None, min_length=1, max_length=200)
    plate: str | None = Field(default=None, min_length=1, max_length=20)
    vehicle_class: VehicleClass | None = None
    traffic_side: TrafficSide | None = None


class BoxPeriod(BaseModel):
    """When a box was in the vehicle."""

    device_id: str
    began_at: dt.datetime
    ended_at: dt.datetime | None


class VehicleOut(VehicleIn):
    id: str
    created_at: dt.datetime
    boxes: list[BoxPeriod] = Field(description="newest first; the one without an end is in it now")


class VehiclePage(BaseModel):
    items: list[VehicleOut]
    next: str | None = Field(description="value of `after` for the next page")
