from __future__ import annotations

import datetime as dt
import math
from typing import Annotated, Any

import numpy as np
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, model_validator

from nav_core.by_hand import largest_tilt
from nav_core.rotation import thesis_to_matrix
from server.devices.schemas import Rotation
from server.installations.blank import blank_result
from server.installations.level import FRESH_FOR, Feel, level_of
from server.models import Installation, MountingRevision


class EulerDeg(BaseModel):
    """The thesis' angles: ``R_va = Ry(theta) Rz(phi) Rx(psi)``."""

    theta: float
    phi: float
    psi: float


class SigmaDeg(BaseModel):
    """1-sigma of the small rotation between estimate and truth, about the vehicle's axes."""

    x: float
    y: float
    z: float


class SelfTestOut(BaseModel):
    passed: bool
    drift_mps: float
    duration_s: float


class LagOut(BaseModel):
    speed: float | None
    course: float | None


class ChangeOut(BaseModel):
    t_s: float
    angle_deg: float


class MountOut(BaseModel):
    """What `scatola mount --json` prints."""

    status: str = Field(description="ready, settling, insufficient or not_fixed")
    method: str = Field(description="whole-drive, online, mekf, two-phase, or manual")
    R_va: list[list[float]] | None
    euler_deg: EulerDeg | None
    sigma_deg: SigmaDeg | None
    observability: float | None
    stable: bool
    reliable: bool
    self_test: SelfTestOut | None
    converged_after_s: float | None
    gps_lag_s: LagOut
    changes: list[ChangeOut]
    reasons: list[str]
    reason_codes: list[str]
    percent: int


class RevisionOut(MountOut):
    """An estimate as it stood at a moment of the data."""

    data_at: dt.datetime
    created_at: dt.datetime
    algorithm: str
    input_sha256: str


class InstallationOut(MountOut):
    """One box in one vehicle in one orientation."""

    id: str | None
    device_id: str
    vehicle_id: str | None
    began_at: dt.datetime | None
    ended_at: dt.datetime | None
    beginning: str | None = Field(description="first, moved, swapped or manual")
    moved_angle_rad: float | None
    manual_reason: str | None
    updated_at: dt.datetime | None
    algorithm: str | None
    input_sha256: str | None
    raw_erased_at: dt.datetime | None = Field(default=None, description="since when data that it rests on are erased")
    revisions: list[RevisionOut] | None = None


class History(BaseModel):
    items: list[InstallationOut]


class LevelOut(BaseModel):
    """The newest second of a box's specific force, and whether the box stands on one of its axes (001 §3.2)."""

    received_at: dt.datetime | None = Field(description="null before any data, like all the rest")
    at: dt.datetime | None = Field(description="of the last sample, where the box's clock is known")
    fresh: bool = Field(description="received so lately that it tells of now")
    still: bool
    f_a_mps2: list[float] | None = Field(description="mean specific force in the box's axes")
    f_v_mps2: list[float] | None = Field(description="the same in the vehicle's axes, where the mounting is known")
    axis: str | None = Field(description="of the box, nearest to the vertical: x, y or z")
    sign: int | None = Field(description="1 where this axis points up, -1 where it points down")
    reading_g: float | None = Field(description="specific force along this axis, in parts of gravity")
    tilt_deg: float | None = Field(description="between this axis and the vertical")
    tolerance_deg: float
    ok: bool = Field(description="upright within the tolerance, and still")


class ManualMounting(BaseModel):
    """A measured mounting: the matrix or the angles, and why."""

    model_config = ConfigDict(extra="forbid", str_strip_whitespace=True)

    R_va: Rotation | None = Field(default=None, description="rows of the matrix that maps box axes to vehicle axes")
    euler_deg: EulerDeg | None = None
    sigma_deg: SigmaDeg | None = Field(default=None, description="how well it was measured")
    reason: Annotated[str, Field(min_length=1, max_length=500)]
    since: AwareDatetime | None = Field(default=None, alias="from", description="now unless told")

    @model_validator(mode="after")
    def _one_of_both(self) -> ManualMounting:
        if (self.R_va is None) == (self.euler_deg is None):
            raise ValueError("give either R_va or euler_deg")
        return self

    def matrix(self) -> list[list[float]]:
        """R_va, whichever way it was given."""
        if self.R_va is not None:
            return self.R_va
        assert self.euler_deg is not None
        radians = (math.radians(angle) for angle in self.euler_deg.model_dump().values())
        return thesis_to_matrix(*radians).tolist()


def installation_out(
    device_id: str, row: Installation | None, revisions: list[MountingRevision] | None = None
) -> InstallationOut:
    """An installation as JSON; before any data, one of which nothing is known."""
    fields: dict[str, Any] = {"device_id": device_id}
    for name in (
        "id",
        "vehicle_id",
        "began_at",
        "ended_at",
        "beginning",
        "moved_angle_rad",
        "manual_reason",
        "updated_at",
        "algorithm",
        "input_sha256",
        "raw_erased_at",
    ):
        fields[name] = None if row is None else getattr(row, name)
    if revisions is not None:
        fields["revisions"] = [_revision_out(revision) for revision in revisions]
    return InstallationOut(**(blank_result() if row is None else row.result), **fields)


def level_out(felt: Feel | None, R_va: list[list[float]] | None, *, now: dt.datetime) -> LevelOut:
    """What a box feels as JSON; nulls where it has sent nothing yet."""
    level = None if felt is None else level_of(felt)
    check = None if level is None else level.check
    return LevelOut(
        received_at=None if felt is None else felt.received_at,
        at=None if felt is None else felt.at,
        fresh=felt is not None and now - felt.received_at <= FRESH_FOR,
        still=felt is not None and felt.still,
        f_a_mps2=None if felt is None else felt.f_a.tolist(),
        f_v_mps2=None if felt is None or R_va is None else (np.asarray(R_va) @ felt.f_a).tolist(),
        axis=None if check is None else "xyz"[check.axis],
        sign=None if check is None else check.sign,
        reading_g=None if check is None else check.reading,
        tilt_deg=None if check is None else math.degrees(check.angle),
        tolerance_deg=math.degrees(largest_tilt()),
        ok=level is not None and level.ok,
    )


def _revision_out(revision: MountingRevision) -> RevisionOut:
    return RevisionOut(
        **revision.result,
        data_at=revision.data_at,
        created_at=revision.created_at,
        algorithm=revision.algorithm,
        input_sha256=revision.input_sha256,
    )
