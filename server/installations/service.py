"""Beginning and ending installations by hand: a swap between vehicles, a mounting that somebody measured.

Both change what the worker reads, so both raise the device's state version: a round that is
computing meanwhile starts over.
"""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Sequence
from hashlib import sha256
from typing import Any

import numpy as np
from sqlalchemy import select, update
from sqlalchemy.orm import Session

from nav_core.rotation import matrix_to_thesis
from server.devices.queries import device_of
from server.errors import InvalidError
from server.installations.blank import blank_result
from server.live.changes import announce
from server.models import Device, DeviceState, Installation, Trip, new_id
from server.wording import marked

ALGORITHM = "whole-drive/7"
"""Of the worker's estimates; here, where whoever shows and compares versions needs none of the numerics."""
MANUAL_ALGORITHM = "manual/1"


def end_for_swap(session: Session, device: Device, at: dt.datetime) -> None:
    """A box went to another vehicle at `at`, or to none: `device` says where it is now."""
    rows = _installations(session, device)
    ended = _end_at(rows, at)
    later = [row for row in rows if row.began_at >= at]
    for row in later:
        row.vehicle_id = device.vehicle_id
    if ended is not None and device.vehicle_id is not None:
        begun = _begin(session, device, "swapped", at, blank_result("swapped"))
        begun.ended_at = later[0].began_at if later else None
        # Data from after the swap may be here already, counted to the vehicle before.
        overlap = max(0.0, ((device.last_seen_at or at) - at).total_seconds())
        begun.unestimated_s = overlap
        if begun.vehicle_id != ended.vehicle_id:
            ended.unestimated_s += overlap
    moved = update(Trip).where(Trip.device_id == device.id, Trip.began_at >= at)
    session.execute(moved.values(vehicle_id=device.vehicle_id))
    _raise_version(session, device, at)
    _announce(session, device, ended, at)


def set_manual(
    session: Session,
    organisation_id: str,
    device_id: str,
    R_va: Sequence[Sequence[float]],
    *,
    reason: str,
    sigma_deg: dict[str, float] | None,
    since: dt.datetime,
    now: dt.datetime,
) -> Installation:
    """A mounting that somebody measured holds from `since` on, until the box is seen to move."""
    device = device_of(session, organisation_id, device_id, lock=True)
    if since > now:
        raise InvalidError(marked("`from` is in the future"), code="future")
    rows = _installations(session, device)
    if any(row.began_at >= since for row in rows):
        raise InvalidError(marked("The box moved or was swapped after `from`"), code="superseded")
    _end_at(rows, since)
    theta, phi, psi = np.degrees(matrix_to_thesis(np.asarray(R_va, dtype=np.float64))).tolist()
    result = {
        **blank_result(),
        "status": "ready",
        "method": "manual",
        "R_va": [list(row) for row in R_va],
        "euler_deg": {"theta": theta, "phi": phi, "psi": psi},
        "sigma_deg": sigma_deg,
        "stable": True,
        "reliable": True,
        "reasons": [f"Set by hand: {reason}"],
        "reason_codes": ["manual"],
        "percent": 100,
    }
    row = _begin(session, device, "manual", since, result)
    row.algorithm, row.manual_reason, row.updated_at = MANUAL_ALGORITHM, reason, now
    row.input_sha256 = sha256(json.dumps(result, sort_keys=True).encode()).hexdigest()
    _raise_version(session, device, now)
    _announce(session, device, row, now)
    session.flush()
    return row


def _installations(session: Session, device: Device) -> list[Installation]:
    query = select(Installation).where(Installation.device_id == device.id).order_by(Installation.began_at)
    return list(session.scalars(query))


def _end_at(rows: list[Installation], at: dt.datetime) -> Installation | None:
    """End the installation that was at `at`."""
    for row in rows:
        if row.began_at < at and (row.ended_at is None or row.ended_at > at):
            row.ended_at = at
            return row
    return None


def _begin(session: Session, device: Device, beginning: str, at: dt.datetime, result: dict[str, Any]) -> Installation:
    row = Installation(
        id=new_id(),
        device_id=device.id,
        vehicle_id=device.vehicle_id,
        began_at=at,
        beginning=beginning,
        updated_at=at,
        status=str(result["status"]),
        progress=1.0 if result["status"] == "ready" else 0.0,
        result=result,
        algorithm="none",
        input_sha256="",
        unestimated_s=0.0,
        unestimated_moving_s=0.0,
    )
    session.add(row)
    return row


def _raise_version(session: Session, device: Device, at: dt.datetime) -> None:
    state = session.get(DeviceState, device.id, with_for_update=True)
    if state is None:
        session.add(DeviceState(device_id=device.id, version=1, updated_at=at, review_at=at, health={}))
        return
    state.version += 1
    state.review_at = at


def _announce(session: Session, device: Device, row: Installation | None, at: dt.datetime) -> None:
    announce(
        session,
        "installation",
        at=at,
        organisation_id=device.organisation_id,
        device_id=device.id,
        vehicle_id=device.vehicle_id,
        data={"installation_id": row.id, "status": row.status, "percent": row.result["percent"]} if row else {},
    )
