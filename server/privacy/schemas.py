from __future__ import annotations

import datetime as dt
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from server.edge import Moment
from server.models import Erasure, Event, RetentionRule

DataClass = Literal["raw", "tracks", "trips", "manoeuvres", "events", "diagnosis", "alerts", "changes", "audit"]
Days = Annotated[int, Field(ge=1, le=36500)]


class RuleOut(BaseModel):
    data_class: DataClass
    days: int | None = Field(description="null: kept without end")
    applies_at: dt.datetime = Field(description="nothing is removed by this rule before")
    updated_at: dt.datetime
    updated_by: str = Field(description='"default" where nobody chose')


class RulesIn(BaseModel):
    """Days by class; a class that is left out stays as it is."""

    model_config = ConfigDict(extra="forbid")

    days: dict[DataClass, Days | None] = Field(description="null: kept without end")


class ErasureIn(BaseModel):
    model_config = ConfigDict(extra="forbid", str_strip_whitespace=True)

    reason: Annotated[str, Field(min_length=1, max_length=500)]
    since: Moment | None = Field(default=None, description="of a vehicle: from when on; null: from the beginning")
    until: Moment | None = Field(default=None, description="of a vehicle: until when; null: to the end")
    dry_run: bool = Field(default=False, description="only say what would be erased and what would be kept")


class UserErasureIn(BaseModel):
    model_config = ConfigDict(extra="forbid", str_strip_whitespace=True)

    reason: Annotated[str, Field(min_length=1, max_length=500)]
    dry_run: bool = False


class KeptOut(BaseModel):
    what: str
    id: str | None
    count: int
    why: str


class PlanOut(BaseModel):
    """What an erasure would do."""

    would_erase: dict[str, int]
    would_keep: list[KeptOut]


class ErasureOut(BaseModel):
    id: str
    subject_kind: Literal["vehicle", "user"]
    subject_id: str
    since: dt.datetime | None
    until: dt.datetime | None
    reason: str
    requested_at: dt.datetime
    requested_by: str
    finished_at: dt.datetime | None = Field(description="when the last blob was gone; null: under way")
    erased: dict[str, int]
    kept: list[KeptOut]


class HoldOut(BaseModel):
    event_id: str
    kind: str
    at: dt.datetime
    device_id: str
    vehicle_id: str | None
    held_at: dt.datetime
    reason: str | None


def rule_out(rule: RetentionRule) -> RuleOut:
    return RuleOut.model_validate(rule, from_attributes=True)


def erasure_out(row: Erasure) -> ErasureOut:
    return ErasureOut.model_validate(row, from_attributes=True)


def hold_out(event: Event) -> HoldOut:
    shown: dict[str, Any] = {
        name: getattr(event, name) for name in ("kind", "at", "device_id", "vehicle_id", "held_at")
    }
    return HoldOut(event_id=event.id, reason=event.hold_reason, **shown)
