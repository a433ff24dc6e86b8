"""What the 3D view shows of a box: read once from the result rows, plain and comparable."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from server.installations.steps import Step, steps
from server.models import Device, Installation, MountingRevision, Vehicle
from server.pages.words import State, standing

LATER = dt.datetime.max.replace(tzinfo=dt.UTC)
Triad = tuple[float, float, float]
Matrix = tuple[Triad, Triad, Triad]


@dataclass(frozen=True, slots=True)
class MountingView:
    """One box in one vehicle as it is to be drawn; two equal views look the same."""

    title: str
    vehicle_class: str
    state: State
    headline: str
    percent: int
    reasons: tuple[str, ...]
    R_va: Matrix | None
    """Only when the estimate is known."""
    sigma: Triad | None
    """1-sigma about V x, y, z, rad."""
    reference: Matrix | None
    """The mounting known from elsewhere, when there is one."""
    before: Matrix | None = None
    """How the box sat before it was moved, where that is to be drawn too."""


@dataclass(frozen=True, slots=True)
class Choice:
    """What somebody wants to see of a box's history, instead of how it is now."""

    step: str | None = None
    """Id of a `Step`; None for the newest."""
    before: bool = False
    """Whether the box as it sat before the move is drawn beside it."""
    proposal: int | None = None
    """One of the four orientations of a box that is levelled by hand, instead of the estimate."""
    at: dt.datetime | None = None
    """The instant under the cursor of the page's charts, instead of now."""
    f: Triad | None = None
    """Specific force that the charts show at that instant, m/s²."""
    f_in_vehicle: bool = False
    """Whether that is in the V-frame, else in the A-frame."""


def load_step(session: Session, device_id: str, choice: Choice, *, now: dt.datetime) -> MountingView | None:
    """The view of a box at a step of its history; as it is now where the step is gone."""
    device = session.get(Device, device_id)
    if device is None:
        return None
    found = steps(session, device_id)
    step = _chosen(found, choice)
    if step is None:
        return load(session, device_id, now=now)
    vehicle_id = step.installation.vehicle_id
    vehicle = session.get(Vehicle, vehicle_id) if vehicle_id else None
    view = view_of(
        *_names(device, vehicle),
        step.status,
        step.result,
        progress=step.progress,
        moved=step.moved,
        references=device.reference_mountings,
        at=step.at,
    )
    before = step.before.get("R_va") if choice.before and step.before is not None else None
    return view if before is None else replace(view, before=_matrix(before))


def _chosen(found: Sequence[Step], choice: Choice) -> Step | None:
    """The step of that id; of an instant, what is known now of how the box sat then; else the newest."""
    at = choice.at
    if at is not None:
        found = [s for s in found if s.installation.began_at <= at < (s.installation.ended_at or LATER)] or found
    newest = found[-1] if found else None
    return next((step for step in found if step.id == choice.step), newest)


def proposal_view(view: MountingView, R_va: Sequence[Sequence[float]]) -> MountingView:
    """The view with an orientation that is only proposed."""
    return replace(view, R_va=_matrix(R_va), sigma=None, reference=None, before=None)


def _names(device: Device, vehicle: Vehicle | None) -> tuple[str, str]:
    if vehicle is None:
        return device.name, "car"
    return f"{vehicle.name} · {device.name}", vehicle.vehicle_class


def load(session: Session, device_id: str, *, now: dt.datetime) -> MountingView | None:
    """The view of a box, None when there is no such box."""
    device = session.get(Device, device_id)
    if device is None:
        return None
    vehicle = session.get(Vehicle, device.vehicle_id) if device.vehicle_id else None
    installation = session.scalars(
        select(Installation)
        .where(Installation.device_id == device_id)
        # The open one, else the last that was.
        .order_by(Installation.ended_at.is_not(None), Installation.began_at.desc(), Installation.id.desc())
        .limit(1)
    ).first()
    title, vehicle_class = _names(device, vehicle)
    if installation is None:
        return view_of(title, vehicle_class, None, {}, references=device.reference_mountings, at=now)
    data_at = session.scalars(
        select(MountingRevision.data_at)
        .where(MountingRevision.installation_id == installation.id)
        .order_by(MountingRevision.data_at.desc())
        .limit(1)
    ).first()
    return view_of(
        title,
        vehicle_class,
        installation.status,
        installation.result,
        progress=installation.progress,
        moved=installation.beginning == "moved",
        references=device.reference_mountings,
        at=data_at or now,
    )


def view_of(
    title: str,
    vehicle_class: str,
    status: str | None,
    result: Mapping[str, Any],
    *,
    progress: float = 0.0,
    moved: bool = False,
    references: Sequence[Mapping[str, Any]] = (),
    at: dt.datetime,
) -> MountingView:
    """The view from the mount JSON (empty before any data) and the reference mounting in force at `at`."""
    words = standing(status, result, progress=progress, moved=moved)
    known = status in ("ready", "settling")
    matrix, sigma = result.get("R_va"), result.get("sigma_deg")
    return MountingView(
        title=title,
        vehicle_class=vehicle_class,
        state=words.state,
        headline=words.headline,
        percent=words.percent,
        reasons=tuple(str(reason) for reason in result.get("reasons", ())),
        R_va=_matrix(matrix) if known and matrix is not None else None,
        sigma=_sigma(sigma) if known and sigma is not None else None,
        reference=_reference(references, at),
    )


def _matrix(rows: Sequence[Sequence[float]]) -> Matrix:
    a, b, c = ((float(x), float(y), float(z)) for x, y, z in rows)
    return a, b, c


def _sigma(sigma_deg: Mapping[str, float | None]) -> Triad | None:
    values = [sigma_deg.get(axis) for axis in "xyz"]
    if any(value is None for value in values):
        return None
    x, y, z = (math.radians(float(value)) for value in values if value is not None)
    return x, y, z


def _reference(references: Sequence[Mapping[str, Any]], at: dt.datetime) -> Matrix | None:
    in_force = None
    for reference in references:
        if dt.datetime.fromisoformat(reference["from"]) <= at:
            in_force = reference["R_va"]
    return None if in_force is None else _matrix(in_force)
