from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from server.accounts.places import Sight, seen
from server.models import Event, EventAction, EventRevision

Verdict = Literal["confirmed", "false_alarm"]
Kind = Literal[
    "crash",
    "harsh_braking",
    "harsh_acceleration",
    "harsh_cornering",
    "road_shock",
    "handling",
    "rollover",
    "parked_impact",
]


class DeltaVOut(BaseModel):
    longitudinal: float | None
    lateral: float | None
    resultant: float | None


class DeltaVIntervalsOut(BaseModel):
    longitudinal: list[float] | None
    lateral: list[float] | None
    resultant: list[float] | None


class CrashOut(BaseModel):
    """What `scatola crash --json` says of an event, and more of ours beside it."""

    model_config = ConfigDict(extra="allow")

    kind: Kind
    t0_s: float = Field(description="box clock")
    t_end_s: float
    delta_v_kmh: DeltaVOut
    delta_v_interval95_kmh: DeltaVIntervalsOut
    time_of_max_ms: float | None
    pdof_deg: float | None = Field(description="where the force came from, clockwise from straight ahead")
    pdof_interval95_deg: list[float] | None
    pdof_clock: int | None
    impact_speed_kmh: float | None
    impact_speed_interval95_kmh: list[float] | None
    peak_g: float
    clipped: bool
    clipped_samples: int
    asi: float | None
    olc_g: float | None
    thiv_kmh: float | None
    phd_g: float | None
    injury: dict[str, Any] | None
    quality: list[str]


class ReviewOut(BaseModel):
    verdict: Verdict | None = Field(description="null as long as nobody said")
    note: str | None
    reviewed_at: dt.datetime | None


class HoldOut(BaseModel):
    held: bool
    since: dt.datetime | None
    reason: str | None


class EventOut(CrashOut):
    """An event as its newest revision tells it, and what people say of it."""

    id: str
    device_id: str
    vehicle_id: str | None
    boot: str
    at: dt.datetime = Field(description="UTC of time zero by the boot's clock")
    severe: bool
    created_at: dt.datetime
    updated_at: dt.datetime
    revision: int
    withdrawn_at: dt.datetime | None
    raw_erased_at: dt.datetime | None = Field(
        description="since when raw data that it rests on are erased: it cannot be computed again"
    )
    review: ReviewOut
    hold: HoldOut


class EventDetail(EventOut):
    algorithm: str
    input_sha256: str
    event_sha256: str = Field(description="SHA-256 of the canonical JSON, which is /event.json")


class EventPage(BaseModel):
    items: list[EventOut]
    next: str | None = Field(description="value of `before` for the next page")


class RevisionOut(BaseModel):
    number: int
    created_at: dt.datetime
    algorithm: str
    input_sha256: str
    event_sha256: str
    installation_id: str | None


class ActionOut(BaseModel):
    at: dt.datetime
    actor: str
    action: str
    note: str | None


class History(BaseModel):
    """Everything that was computed and said of an event."""

    revisions: list[RevisionOut]
    actions: list[ActionOut] = Field(description="newest first")


class DifferenceOut(BaseModel):
    path: str = Field(description="member of the canonical JSON, parts joined by dots")
    before: Any
    after: Any


class DiffOut(BaseModel):
    before: RevisionOut
    after: RevisionOut
    same_input: bool
    same_algorithm: bool
    differences: list[DifferenceOut]


class ReviewIn(BaseModel):
    model_config = ConfigDict(extra="forbid", str_strip_whitespace=True)

    verdict: Verdict | None = Field(description="null opens the event again")
    note: Annotated[str | None, Field(max_length=2000)] = None


class HoldIn(BaseModel):
    model_config = ConfigDict(extra="forbid", str_strip_whitespace=True)

    held: bool
    reason: Annotated[str, Field(min_length=1, max_length=500)]


def event_out(event: Event, *, sight: Sight) -> EventOut:
    """An event as JSON; where it ended as the caller may see it."""
    return EventOut(**_fields(event, sight=sight))


def event_detail(event: Event, revision: EventRevision, *, sight: Sight) -> EventDetail:
    """An event with the hashes of its newest revision."""
    return EventDetail(
        **_fields(event, sight=sight),
        algorithm=revision.algorithm,
        input_sha256=revision.input_sha256,
        event_sha256=revision.event_sha256,
    )


def _fields(event: Event, *, sight: Sight) -> dict[str, Any]:
    own = ("id", "device_id", "vehicle_id", "boot", "at", "severe", "created_at", "updated_at", "revision")
    return {
        **with_place(event.result, sight),
        **{name: getattr(event, name) for name in (*own, "withdrawn_at", "raw_erased_at")},
        "review": ReviewOut.model_validate(event, from_attributes=True),
        "hold": HoldOut(held=event.held_at is not None, since=event.held_at, reason=event.hold_reason),
    }


def with_place(told: dict[str, Any], sight: Sight) -> dict[str, Any]:
    """The crash JSON with the end of the way as it may be told; the way's length stays."""
    rest = told.get("rest")
    if rest is None or sight == "exact":
        return told
    place = seen(rest.get("lat"), rest.get("lon"), sight)
    end = {"lat": None, "lon": None} if place is None else {"lat": place.lat_deg, "lon": place.lon_deg}
    return {**told, "rest": {**rest, **end}}


def revision_out(revision: EventRevision) -> RevisionOut:
    return RevisionOut.model_validate(revision, from_attributes=True)


def history(revisions: Sequence[EventRevision], actions: Sequence[EventAction]) -> History:
    return History(
        revisions=[revision_out(revision) for revision in revisions],
        actions=[ActionOut.model_validate(action, from_attributes=True) for action in actions],
    )
