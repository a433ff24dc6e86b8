from __future__ import annotations

import datetime as dt
import json
from typing import Annotated, Any, Literal

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
    signed_only: bool
    bytes_per_day: int | None
    configuration: dict[str, Any] | None
    configuration_version: int
    configuration_seen: int | None = Field(description="the version that the box last said it has")
    chain: ChainOut
    reference_mountings: list[ReferenceMounting]


class DevicePage(BaseModel):
    items: list[DeviceOut]
    next: str | None = Field(description="value of `after` for the next page")


class ClaimCodeOut(BaseModel):
    code: str = Field(description="shown once; to be traded by the box at /api/v1/claim")
    expires_at: dt.datetime


class ClaimIn(BaseModel):
    model_config = ConfigDict(extra="forbid")

    code: str = Field(min_length=16, max_length=40, description="letter case and dashes do not matter")


class ClaimedOut(DeviceToken):
    server_time: dt.datetime


def _small(values: dict[str, Any]) -> dict[str, Any]:
    if len(json.dumps(values)) > 4096:
        raise ValueError("more than 4096 bytes as JSON")
    return values


class DeviceSettings(BaseModel):
    """What an administrator decides for one box."""

    model_config = ConfigDict(extra="forbid")

    configuration: Annotated[dict[str, Any], AfterValidator(_small)] | None = Field(
        default=None, description="told to the box until it says that it has this version; the box gives it its meaning"
    )
    signed_only: bool = Field(default=False, description="refuse the bare token, take signed requests only")
    bytes_per_day: int | None = Field(default=None, ge=0, le=2**50, description="null: the installation's")


class WindowIn(BaseModel):
    model_config = ConfigDict(extra="forbid")

    boot: str = Field(pattern=r"^[A-Za-z0-9._-]{1,64}$")
    t_first_s: float = Field(ge=-1e10, le=1e10)
    t_last_s: float = Field(ge=-1e10, le=1e10)
    reason: str = Field(default="", max_length=200)


class WindowOut(WindowIn):
    id: str
    created_at: dt.datetime
    expires_at: dt.datetime
    closed_at: dt.datetime | None
    outcome: str | None
    batch_id: str | None


class WindowTold(BaseModel):
    """A stretch of its clock that the box is asked to send as a burst."""

    kind: Literal["window"] = "window"
    id: str = Field(description="to be named in Scatola-Answers with the batch that answers")
    boot: str
    t_first_s: float
    t_last_s: float


class ConfigurationTold(BaseModel):
    """Values that the box should use from now on."""

    kind: Literal["configuration"] = "configuration"
    version: int = Field(description="to be named in Scatola-Configuration from then on")
    values: dict[str, Any]


class LiveTold(BaseModel):
    """The vehicle moves as it should not: send a batch with fixes often, until then or until this is no longer told."""

    kind: Literal["live"] = "live"
    period_s: float
    until: dt.datetime


Told = WindowTold | ConfigurationTold | LiveTold


class BoxOut(BaseModel):
    id: str
    server_time: dt.datetime
    requests: list[Told]
