"""What the page about a box's mounting shows: each step of its history, and what the box feels now."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from sqlalchemy.orm import Session

from nav_core.rotation import angle_between
from server.errors import NotFoundError
from server.installations.level import Feel, Source, sources
from server.installations.steps import Step, steps
from server.models import Device, DeviceState, Vehicle
from server.pages.words import Standing, reasons, standing
from server.view3d.uncertainty import widest_deg


@dataclass(frozen=True)
class Moment:
    """A step of the history with the words and figures beside its picture."""

    step: Step
    standing: Standing

    @property
    def result(self) -> Mapping[str, Any]:
        """The mount JSON."""
        return self.step.result

    @property
    def known(self) -> bool:
        """Whether there is an orientation to draw."""
        return self.step.status in ("ready", "settling") and self.step.result.get("R_va") is not None

    @property
    def reasons(self) -> Sequence[tuple[str, str]]:
        """What is missing or worth knowing."""
        return reasons(self.step.result)

    @property
    def cones_deg(self) -> list[float] | None:
        """Half the opening of each box axis' 95 % cone where it is widest."""
        sigma = self.step.result.get("sigma_deg")
        return widest_deg(self.step.result["R_va"], sigma) if self.known and sigma else None

    @property
    def turned_deg(self) -> float | None:
        """Between the box before the move and at this step."""
        before = None if self.step.before is None else self.step.before.get("R_va")
        if before is None or not self.known:
            return None
        return math.degrees(angle_between(np.array(before), np.array(self.step.result["R_va"])))


@dataclass(frozen=True)
class MountingPage:
    """A box, the vehicle around it, and its history."""

    device: Device
    vehicle: Vehicle | None
    moments: list[Moment]
    shown: int
    """Which of the moments."""
    sources: list[Source]
    course_rad: float | None

    @property
    def moment(self) -> Moment | None:
        """The one that is shown."""
        return self.moments[self.shown] if self.moments else None

    @property
    def is_newest(self) -> bool:
        """Whether it is how the box stands now."""
        return self.shown == len(self.moments) - 1


@dataclass(frozen=True)
class Arrow:
    """A vector that the scene draws, in figures."""

    letter: str
    xyz: tuple[float, float, float]

    @property
    def size(self) -> float:
        """m/s²."""
        return math.sqrt(sum(part * part for part in self.xyz))


def mounting_page(session: Session, organisation_id: str, device_id: str, step_id: str | None) -> MountingPage:
    """The page of a box at a step, the newest unless told."""
    device = session.get(Device, device_id)
    if device is None or device.organisation_id != organisation_id:
        raise NotFoundError(f"There is no box {device_id}")
    moments = [
        Moment(step, standing(step.status, step.result, progress=step.progress, moved=step.moved))
        for step in steps(session, device_id)
    ]
    shown = next((k for k, moment in enumerate(moments) if moment.step.id == step_id), len(moments) - 1)
    inside = moments[shown].step.installation.vehicle_id if moments else device.vehicle_id
    state = session.get(DeviceState, device_id)
    return MountingPage(
        device,
        session.get(Vehicle, inside) if inside else None,
        moments,
        max(shown, 0),
        sources(session, device_id),
        None if state is None else state.course_rad,
    )


def force(page: MountingPage, felt: Feel | None) -> Arrow | None:
    """The measured specific force in the vehicle's axes; None where it cannot be told."""
    if felt is None or page.moment is None or not page.moment.known:
        return None
    x, y, z = (np.array(page.moment.result["R_va"]) @ felt.f_a).tolist()
    return Arrow("f", (x, y, z))
