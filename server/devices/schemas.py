from __future__ import annotations

import datetime as dt
from typing import Annotated

from pydantic import AfterValidator, AwareDatetime, BaseModel, ConfigDict, Field

from server.devices.rotations import nearest_rotation

Row = Annotated[list[float], Field(min_length=3, max_length=3)]
Rotation = Annotated[list[Row], Field(min_length=3, max_length=3), AfterValidator(nearest_rotation)]


class DeviceIn(BaseModel):
    model_config = ConfigDict(extra="forbid", str_strip_whitespace=True)

    name: str = Field(min_length=1, max_length=200)
    vehicle_id: str | None = Field(default=None, max_length=32)


class DeviceToken(BaseModel):
    id: str
    token: str | None = Field(description="shown once; null where it was shown before: rotate a lost token")


class ReferenceMounting(BaseModel):
    """A mounting known from elsewhere."""

    model_config = ConfigDict(extra="forbid")

    since: AwareDatetime = Field(alias="from")
    R_va: Rotation = Field(description="rows of the matrix that maps box axes to vehicle axes")


class ReferenceMountings(BaseModel):
    model_config = ConfigDict(extra="forbid")

    mountings: list[ReferenceMounting] = Field(max_length=100)


class VehicleChoice(BaseModel):
    model_config = ConfigDict(extra="forbid")

    vehicle_id: str | None = Field(max_length=32, description="null takes the box out")
    at: AwareDatetime | None = Field(default=None, description="when it was done; now unless told")


class ChainOut(BaseModel):
    """Head of the box's evidence chain."""

    length: int
    head: str


class DeviceOut(BaseModel):
    id: str
    name: str
    vehicle_id: str | None
    created_at: dt.datetime
    revoked_at: dt.datetime | None
    last_seen_at: dt.datetime | None
    chain: ChainOut
    reference_mountings: list[ReferenceMounting]


class DevicePage(BaseModel):
    items: list[DeviceOut]
    next: str | None = Field(description="value of `after` for the next page")
