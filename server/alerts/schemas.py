from __future__ import annotations

import datetime as dt
import re
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from server.alerts.geometry import Circle, Fence, FenceError, Polygon

Kind = Literal["crash", "moved", "silent", "calibration", "harsh", "geofence", "theft", "emergency"]
Severity = Literal["info", "attention", "alarm"]
_MAIL = re.compile(r"[A-Za-z0-9.!#$%&'*+/=?^_`{|}~-]{1,64}@[A-Za-z0-9](?:[A-Za-z0-9.-]{0,250}[A-Za-z0-9])?")


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", str_strip_whitespace=True)


class CrashCondition(_Strict):
    """A crash, rollover or parked impact."""

    kind: Literal["crash"]
    min_delta_v_kmh: float = Field(default=0.0, ge=0.0, le=300.0, description="one whose delta-V is not known counts")


class MovedCondition(_Strict):
    """The box was turned in its vehicle."""

    kind: Literal["moved"]
    min_angle_deg: float = Field(default=0.0, ge=0.0, le=180.0)


class SilentCondition(_Strict):
    """No upload for so long."""

    kind: Literal["silent"]
    hours: float = Field(default=24.0, gt=0.0, le=8760.0)


class CalibrationCondition(_Strict):
    """The mounting is not ready so long after the box was installed or moved, although it reports."""

    kind: Literal["calibration"]
    hours: float = Field(default=72.0, gt=0.0, le=8760.0)


class HarshCondition(_Strict):
    """Harsh braking, acceleration and cornering of one UTC day."""

    kind: Literal["harsh"]
    count: float = Field(default=5.0, gt=0.0, le=1000.0)
    per: Literal["day", "100km"] = Field(default="day", description="per 100 km needs 20 km driven on that day")


class CircleIn(_Strict):
    shape: Literal["circle"]
    lat_deg: float
    lon_deg: float = Field(ge=-180.0, le=180.0)
    radius_m: float

    def made(self) -> Fence:
        return Circle(self.lat_deg, self.lon_deg, self.radius_m)


class PolygonIn(_Strict):
    shape: Literal["polygon"]
    corners: list[tuple[float, Annotated[float, Field(ge=-180.0, le=180.0)]]] = Field(
        max_length=501, description="latitude and longitude, degrees, in order; the last may repeat the first"
    )

    def made(self) -> Fence:
        return Polygon(self.corners)


def _is_a_fence(shape: CircleIn | PolygonIn) -> CircleIn | PolygonIn:
    try:
        shape.made()
    except FenceError as error:
        raise ValueError(str(error)) from None
    return shape


class GeofenceCondition(_Strict):
    """The vehicle enters or leaves an area."""

    kind: Literal["geofence"]
    fence: Annotated[CircleIn | PolygonIn, Field(discriminator="shape"), AfterValidator(_is_a_fence)]
    on: Literal["enter", "leave", "both"] = "both"
    margin_m: float = Field(
        default=25.0,
        ge=0.0,
        le=1000.0,
        description="so far past the edge counts; an eighth of the fence's size at most",
    )


class TheftCondition(_Strict):
    """The vehicle moves while its ignition is off."""

    kind: Literal["theft"]


Condition = (
    CrashCondition
    | MovedCondition
    | SilentCondition
    | CalibrationCondition
    | HarshCondition
    | GeofenceCondition
    | TheftCondition
)
COOLDOWN_S: dict[str, float] = {"geofence": 300.0, "theft": 3600.0, "silent": 3600.0, "calibration": 86400.0}
"""Where nothing else is wished; what is not named has none, for each occurrence is told once anyway."""


class RuleIn(_Strict):
    name: str = Field(min_length=1, max_length=200)
    enabled: bool = True
    vehicle_id: str | None = Field(default=None, max_length=32, description="null: the whole fleet")
    condition: Annotated[Condition, Field(discriminator="kind")]
    channels: list[Annotated[str, Field(max_length=32)]] = Field(default_factory=list[str], max_length=20)
    cooldown_s: float | None = Field(
        default=None, ge=0.0, le=30 * 86400.0, description="what happens again within it is counted, not told"
    )


class RuleOut(BaseModel):
    id: str
    name: str
    enabled: bool
    vehicle_id: str | None
    condition: Condition
    channels: list[str]
    cooldown_s: float
    created_at: dt.datetime


def _is_mail(address: str) -> str:
    if len(address) > 254 or not _MAIL.fullmatch(address) or ".." in address:
        raise ValueError("not an e-mail address")
    return address


class EmailIn(_Strict):
    kind: Literal["email"]
    name: str = Field(min_length=1, max_length=200)
    recipients: list[Annotated[str, AfterValidator(_is_mail)]] = Field(min_length=1, max_length=20)
    emergency: bool = Field(default=False, description="gets emergencies and theft, whatever the rules say")
    enabled: bool = True


class WebhookIn(_Strict):
    kind: Literal["webhook"]
    name: str = Field(min_length=1, max_length=200)
    url: str = Field(min_length=1, max_length=2000)
    emergency: bool = Field(default=False, description="gets emergencies and theft, whatever the rules say")
    enabled: bool = True


ChannelIn = Annotated[EmailIn | WebhookIn, Field(discriminator="kind")]


class ChannelOut(BaseModel):
    id: str
    kind: Literal["email", "webhook"]
    name: str
    recipients: list[str] = Field(description="e-mail addresses, or the webhook's address")
    emergency: bool
    enabled: bool
    created_at: dt.datetime


class ChannelMade(ChannelOut):
    secret: str | None = Field(description="of a webhook, shown once; signs every post")


class AlertOut(BaseModel):
    id: str
    rule_id: str | None
    kind: Kind
    severity: Severity
    device_id: str
    vehicle_id: str | None
    event_id: str | None
    at: dt.datetime
    created_at: dt.datetime
    facts: dict[str, Any] = Field(description="without location.read, places are coarse or null")
    repeats: int
    repeated_at: dt.datetime | None
    recovered_at: dt.datetime | None
    acknowledged_at: dt.datetime | None
    acknowledged_by: str | None


class AlertPage(BaseModel):
    items: list[AlertOut]
    next: str | None = Field(description="value of `before` for the next page")


class AttemptOut(BaseModel):
    number: int
    began_at: dt.datetime
    ended_at: dt.datetime | None = Field(description="null when whoever tried was lost on the way")
    outcome: str | None
    status: int | None
    detail: str | None


class DeliveryOut(BaseModel):
    id: str = Field(description="the Idempotency-Key that the receiver sees")
    alert_id: str
    channel_id: str
    reason: str
    priority: int
    state: Literal["waiting", "delivered", "dead"]
    created_at: dt.datetime
    due_at: dt.datetime
    finished_at: dt.datetime | None
    attempts: int
    error: str | None


class DeliveryDetail(DeliveryOut):
    tries: list[AttemptOut]


class DeliveryPage(BaseModel):
    items: list[DeliveryOut]
    next: str | None = Field(description="value of `before` for the next page")


class TestOut(BaseModel):
    """What came of a test message."""

    __test__ = False  # no test of ours, whatever its name

    delivered: bool
    status: int | None = Field(description="of the receiver, HTTP or SMTP")
    detail: str


class Replayed(BaseModel):
    replayed: int


class TheftIn(_Strict):
    """Arm a vehicle by hand, or end that and the alarm."""

    armed: bool


class TheftOut(BaseModel):
    vehicle_id: str
    armed_at: dt.datetime | None = Field(description="armed by hand: any movement is an alarm")
    armed_by: str | None
    armed_by_ignition: bool = Field(description="a theft rule is on: movement without ignition is an alarm")
    alarm_at: dt.datetime | None
