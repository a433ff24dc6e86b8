"""What the installation assistant shows: boxes to choose from, vehicles, and how far a box has come."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import func, or_, select
from sqlalchemy.orm import Session

from server.devices.provisioning import device_by_code
from server.errors import NotFoundError
from server.installations.level import Level
from server.models import Device, DeviceState, Installation, Vehicle
from server.pages.words import LIVE_WITHIN, Standing, reasons, standing
from server.view3d.axonometry import Drawing, drawing

SHOWN = 20
MINUS = "\N{MINUS SIGN}"
_ID_LETTERS = 6


@dataclass(frozen=True)
class Candidate:
    """A box in somebody's hands."""

    device: Device
    vehicle: Vehicle | None
    installation: Installation | None
    state: DeviceState | None
    standing: Standing
    heard: bool
    """Whether it sent something just now."""
    located: bool
    """Whether it has a fix of just now."""

    @property
    def reasons(self) -> Sequence[tuple[str, str]]:
        """What is still missing, for the driver."""
        return [] if self.installation is None else reasons(self.installation.result)

    @property
    def sigma_deg(self) -> dict[str, float] | None:
        """1-sigma about the vehicle's axes."""
        return None if self.installation is None else self.installation.result.get("sigma_deg")


@dataclass(frozen=True)
class Choice:
    """One of the four orientations of a box that stands upright."""

    number: int
    drawing: Drawing
    forward: str
    """Which way of the box looks ahead: +x, -x, and so on."""


def find_box(session: Session, organisation_id: str, typed: str) -> Device | None:
    """The box of a claim code, a name or an id (its first letters will do); also out of the address in a QR code."""
    words = typed.strip().rstrip("/").rsplit("/", 1)[-1].rsplit("=", 1)[-1].strip()
    if not words:
        return None
    by_code = device_by_code(session, words)
    if by_code is not None and by_code.organisation_id == organisation_id:
        return by_code
    query = select(Device).where(Device.organisation_id == organisation_id, Device.revoked_at.is_(None))
    named = session.scalars(query.where(func.lower(Device.name) == words.lower()).limit(2)).all()
    if len(named) == 1:
        return named[0]
    if len(words) < _ID_LETTERS or not words.isalnum():
        return None
    same = session.scalars(query.where(Device.id.startswith(words.lower(), autoescape=True)).limit(2)).all()
    return same[0] if len(same) == 1 else None


def candidate(session: Session, organisation_id: str, device_id: str, *, now: dt.datetime) -> Candidate:
    """One box."""
    found = _candidates(session, organisation_id, now=now, device_id=device_id)
    if not found:
        raise NotFoundError(f"There is no box {device_id}")
    return found[0]


def waiting(session: Session, organisation_id: str, *, now: dt.datetime) -> list[Candidate]:
    """Boxes that are not calibrated, the newest first."""
    return _candidates(session, organisation_id, now=now)


def _candidates(
    session: Session, organisation_id: str, *, now: dt.datetime, device_id: str | None = None
) -> list[Candidate]:
    query = (
        select(Device, Vehicle, Installation, DeviceState)
        .outerjoin(Vehicle, Vehicle.id == Device.vehicle_id)
        .outerjoin(Installation, (Installation.device_id == Device.id) & Installation.ended_at.is_(None))
        .outerjoin(DeviceState, DeviceState.device_id == Device.id)
        .where(Device.organisation_id == organisation_id)
        .order_by(Device.created_at.desc(), Device.name, Installation.began_at.desc())
    )
    if device_id is None:
        unfinished = or_(Device.vehicle_id.is_(None), Installation.id.is_(None), Installation.status != "ready")
        query = query.where(Device.revoked_at.is_(None), unfinished)
    else:
        query = query.where(Device.id == device_id)
    return [_candidate(*row, now=now) for row in session.execute(query.limit(SHOWN))]


def _candidate(
    device: Device,
    vehicle: Vehicle | None,
    installation: Installation | None,
    state: DeviceState | None,
    *,
    now: dt.datetime,
) -> Candidate:
    how = (
        standing(None, {}, progress=0.0, moved=False)
        if installation is None
        else standing(
            installation.status,
            installation.result,
            progress=installation.progress,
            moved=installation.beginning == "moved",
        )
    )
    return Candidate(
        device,
        vehicle,
        installation,
        state,
        how,
        heard=device.last_seen_at is not None and now - device.last_seen_at < LIVE_WITHIN,
        located=state is not None and state.position_at is not None and now - state.position_at < LIVE_WITHIN,
    )


def vehicles(session: Session, organisation_id: str, q: str) -> list[Vehicle]:
    """Vehicles by name or plate."""
    query = select(Vehicle).where(Vehicle.organisation_id == organisation_id).order_by(Vehicle.name)
    if q:
        query = query.where(
            or_(Vehicle.name.icontains(q, autoescape=True), Vehicle.plate.icontains(q, autoescape=True))
        )
    return list(session.scalars(query.limit(SHOWN)))


def choices(level: Level, vehicle_class: str) -> list[Choice]:
    """The four orientations as pictures."""
    found: list[Choice] = []
    for number, R_va in enumerate(level.choices):
        axis = int(abs(R_va[0]).argmax())
        found.append(
            Choice(number, drawing(vehicle_class, R_va), f"{'+' if R_va[0, axis] > 0 else MINUS}{'xyz'[axis]}")
        )
    return found


def bubble(level: Level) -> tuple[float, float, str, str]:
    """Where the bubble stands, in parts of the tolerance, and the letters of the two level axes.

    It goes to the higher side, like a spirit level's: the specific force points up.
    """
    first, second = (level.check.axis + 1) % 3, (level.check.axis + 2) % 3
    size = float(sum(part * part for part in level.feel.f_a)) ** 0.5
    u, v = float(level.feel.f_a[first]) / size, float(level.feel.f_a[second]) / size
    return u, v, "xyz"[first], "xyz"[second]
