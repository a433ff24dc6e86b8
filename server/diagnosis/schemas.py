from __future__ import annotations

import datetime as dt
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from server.moments import Moment

Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9._-]{0,63}$", description="such as battery_v or obd.rpm")]


class ValueIn(BaseModel):
    model_config = ConfigDict(extra="forbid")

    name: Name
    value: float = Field(ge=-1e15, le=1e15)
    at: Moment | None = Field(default=None, description="when it was read; now unless told")
    age_s: float | None = Field(default=None, ge=0.0, le=1e8, description="the same, for a box that does not know UTC")


class ValuesIn(BaseModel):
    model_config = ConfigDict(extra="forbid")

    values: list[ValueIn] = Field(min_length=1, max_length=1000)


class Kept(BaseModel):
    kept: int = Field(description="values that were new: at most one a minute, and only where it changed")


class LatestOut(BaseModel):
    name: str
    value: float
    unit: str | None
    at: dt.datetime


class ReadingOut(BaseModel):
    at: dt.datetime
    value: float


class DiagnosisOut(BaseModel):
    device_id: str
    latest: list[LatestOut] = Field(description="the newest of every name")
    series: dict[str, list[ReadingOut]] = Field(description="of the names that were asked for, oldest first")
