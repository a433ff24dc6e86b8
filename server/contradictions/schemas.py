from __future__ import annotations

import datetime as dt
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from server.moments import Moment

Weight = Literal["note", "doubt", "grave"]


class ContradictionOut(BaseModel):
    """Something around an event that whoever decides on liability or fraud should know."""

    code: str = Field(description="stable")
    weight: Weight = Field(description="note: has harmless reasons as a rule; doubt: needs an explanation; grave")
    detail: str
    evidence: dict[str, Any] = Field(description="the figures behind it")


class ContradictionsOut(BaseModel):
    event_id: str
    checked: list[str] = Field(description="codes that were looked for")
    items: list[ContradictionOut]


class ClaimIn(BaseModel):
    model_config = ConfigDict(extra="forbid", str_strip_whitespace=True)

    vehicle_id: str = Field(max_length=32)
    reference: str = Field(min_length=1, max_length=200, description="number of the claim")
    since: Moment = Field(alias="from")
    until: Moment = Field(alias="to")
    direction_deg: Annotated[float, Field(gt=-180.0, le=180.0)] | None = Field(
        default=None, description="where the force is said to have come from, clockwise from straight ahead"
    )
    note: str | None = Field(default=None, max_length=2000)

    @model_validator(mode="after")
    def _is_a_window(self) -> ClaimIn:
        if not dt.timedelta(0) < self.until - self.since <= dt.timedelta(hours=6):
            raise ValueError("`to` is after `from`, by six hours at most")
        if not 1970 <= self.since.year < self.until.year + 1 < 9999:
            raise ValueError("there were no boxes then")
        return self


class PulseOut(BaseModel):
    event_id: str
    kind: str
    at: dt.datetime
    delta_v_kmh: float | None
    delta_v_interval95_kmh: list[float] | None
    pdof_deg: float | None
    pdof_interval95_deg: list[float] | None
    direction: Literal["agrees", "disagrees", "not_known"] = Field(
        description="agrees: the claimed direction is within 30° of the interval"
    )


class BoundOut(BaseModel):
    """The most that the velocity can have changed within any 0.3 s, where there are samples."""

    max_delta_v_kmh: float = Field(description="driving and braking included; of |delta-V|, upper")
    at: dt.datetime
    window_s: float
    peak_g: float = Field(description="largest deviation from the mean of the seconds around it")
    sample_rate_hz: float
    reliable: bool = Field(description="false below 50 samples/s: a short pulse can fall between samples")


class AnswerOut(BaseModel):
    verdict: Literal["pulse_found", "no_pulse", "not_covered", "no_data"] = Field(
        description="no_pulse: data cover the whole window and hold none; not_covered: they hold none but have gaps"
    )
    says: str
    pulses: list[PulseOut]
    bound: BoundOut | None
    covered_share: float = Field(description="of the window, 0..1")
    gaps: list[tuple[dt.datetime, dt.datetime]] = Field(description="longer than 2 s, the first hundred")
    boxes: list[str]
    contradictions: list[ContradictionOut]


class ClaimOut(BaseModel):
    id: str
    vehicle_id: str
    reference: str
    since: dt.datetime = Field(alias="from")
    until: dt.datetime = Field(alias="to")
    direction_deg: float | None
    note: str | None
    created_at: dt.datetime
    created_by: str
    answer: AnswerOut

    model_config = ConfigDict(populate_by_name=True)
