"""Mountings that another version estimated, estimated anew: asked for, done by whoever works, compared.

Nothing is kept of a run but what the rows say anyway.  An installation of another version that is asked for counts as
one whose data wait, so that any number of workers share them out and a stopped run goes on; and its result of before
stays among its revisions.  Only digests are read: what retention or an erasure took is left as it was.
"""

from __future__ import annotations

import datetime as dt
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from sqlalchemy import ColumnElement, func, select, update
from sqlalchemy.orm import Session

from server.database import Database
from server.installations.service import ALGORITHM, MANUAL_ALGORITHM
from server.models import Device, DeviceState, Installation, MountingRevision

WAITS_S = 300.0
"""As much data waiting as is estimated at once, also while the box goes on sending."""
_PAGE = 500


def outdated(device_id: str | None = None) -> tuple[ColumnElement[bool], ...]:
    """Conditions of installations that another version estimated, and that this one can."""
    here = Installation.algorithm.not_in((ALGORITHM, MANUAL_ALGORITHM)), Installation.input_sha256 != ""
    whole = Installation.raw_erased_at.is_(None)
    return (*here, whole) if device_id is None else (*here, whole, Installation.device_id == device_id)


def ask(
    database: Database, *, now: dt.datetime, organisation_id: str | None = None, device_id: str | None = None
) -> list[str]:
    """Have every such installation estimated anew; the boxes that are due for it, a short transaction each."""
    query = select(Installation.device_id).join(Device, Device.id == Installation.device_id).where(*outdated(device_id))
    if organisation_id is not None:
        query = query.where(Device.organisation_id == organisation_id)
    with database.reading() as session:
        boxes = list(session.scalars(query.distinct().order_by(Installation.device_id)))
    for box in boxes:
        with database.transaction() as session:
            _wake(session, box, now)
    return boxes


def _wake(session: Session, device_id: str, now: dt.datetime) -> None:
    # The box's own row first, as every round does; one that is under way starts over.
    session.execute(select(Device.id).where(Device.id == device_id).with_for_update())
    state = session.get(DeviceState, device_id, with_for_update=True)
    if state is None:
        return
    state.version += 1
    state.review_at = now
    rows = update(Installation).where(*outdated(device_id), Installation.unestimated_s < WAITS_S)
    session.execute(rows.values(unestimated_s=WAITS_S))


# --- the comparison


@dataclass(frozen=True, slots=True)
class Turn:
    """How far mountings were turned by the other version, degrees."""

    mountings: int
    median: float
    p95: float
    worst: float
    worst_installation_id: str


@dataclass(frozen=True, slots=True)
class MountingReport:
    """How the mountings of a fleet stand, and what this version changed."""

    algorithm: str
    waiting: int
    """Of another version, asked for and not estimated yet."""
    outdated: int
    """Of another version, not asked for, or without data that tell anything."""
    done: int
    """Of this version now, of another before."""
    before_algorithms: dict[str, int]
    statuses: dict[str, int]
    """Of those that are done: ``before -> after``, and how many."""
    turned: Turn | None
    sigma_ratio: float | None
    """Median of the largest sigma after over that before."""


def report(session: Session, *, organisation_id: str | None = None, device_id: str | None = None) -> MountingReport:
    """What is left, and what this version changed so far."""
    of_fleet: list[ColumnElement[bool]] = []
    if organisation_id is not None:
        boxes = select(Device.id).where(Device.organisation_id == organisation_id)
        of_fleet.append(Installation.device_id.in_(boxes))
    if device_id is not None:
        of_fleet.append(Installation.device_id == device_id)
    waits = Installation.unestimated_s >= WAITS_S
    old = select(func.count(Installation.id)).where(*outdated(), *of_fleet)
    before: Counter[str] = Counter()
    statuses: Counter[str] = Counter()
    angles: list[tuple[float, str]] = []
    ratios: list[float] = []
    for row, last in _done(session, of_fleet):
        before[last.algorithm] += 1
        statuses[f"{last.status} -> {row.status}"] += 1
        angle, ratio = _angle_deg(last.result, row.result), _sigma_ratio(last.result, row.result)
        angles += [] if angle is None else [(angle, row.id)]
        ratios += [] if ratio is None else [ratio]
    return MountingReport(
        algorithm=ALGORITHM,
        waiting=session.scalar(old.where(waits)) or 0,
        outdated=session.scalar(old.where(~waits)) or 0,
        done=before.total(),
        before_algorithms=dict(before),
        statuses=dict(statuses),
        turned=_turn(angles),
        sigma_ratio=float(np.median(ratios)) if ratios else None,
    )


def _done(session: Session, of_fleet: Sequence[ColumnElement[bool]]) -> list[tuple[Installation, MountingRevision]]:
    """Installations of this version with the newest revision of another, which is what they were before."""
    newest = (
        select(MountingRevision.installation_id, func.max(MountingRevision.created_at).label("at"))
        .where(MountingRevision.algorithm.not_in((ALGORITHM, MANUAL_ALGORITHM)))
        .group_by(MountingRevision.installation_id)
        .subquery()
    )
    query = (
        select(Installation, MountingRevision)
        .join(newest, newest.c.installation_id == Installation.id)
        .join(
            MountingRevision,
            (MountingRevision.installation_id == Installation.id) & (MountingRevision.created_at == newest.c.at),
        )
        .where(Installation.algorithm == ALGORITHM, MountingRevision.algorithm.not_in((ALGORITHM, MANUAL_ALGORITHM)))
        .where(*of_fleet)
        .order_by(Installation.id, MountingRevision.data_at)
    )
    # Several of one moment: the last by its data counts.
    found = {row.id: (row, last) for row, last in session.execute(query.execution_options(yield_per=_PAGE))}
    return list(found.values())


def _angle_deg(before: dict[str, Any], after: dict[str, Any]) -> float | None:
    if before.get("R_va") is None or after.get("R_va") is None:
        return None
    turn = np.array(before["R_va"]) @ np.array(after["R_va"]).T
    return float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0))))


def _sigma_ratio(before: dict[str, Any], after: dict[str, Any]) -> float | None:
    if not before.get("sigma_deg") or not after.get("sigma_deg"):
        return None
    largest = max(before["sigma_deg"].values())
    return None if largest <= 0.0 else float(max(after["sigma_deg"].values()) / largest)


def _turn(angles: Sequence[tuple[float, str]]) -> Turn | None:
    if not angles:
        return None
    sizes = np.array([angle for angle, _ in angles])
    worst = int(np.argmax(sizes))
    return Turn(
        len(angles), float(np.median(sizes)), float(np.percentile(sizes, 95)), float(sizes[worst]), angles[worst][1]
    )
