"""What the pages show, read once: a fixed number of statements whatever the size of the fleet."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from server.errors import NotFoundError
from server.installations.blank import blank_result
from server.installations.queries import revisions
from server.models import Change, Device, DeviceState, Installation, Trip, Vehicle
from server.pages.events import Line, lines
from server.pages.health import Course, Figure, course_of, figures, remark_sentences
from server.pages.words import (
    LIVE_WITHIN,
    MOVED_IS_NEWS_FOR,
    SILENT_AFTER,
    Standing,
    angle_to_reference,
    reasons,
    standing,
)
from server.trips.queries import trip_of, trips

TRIPS_SHOWN = 50
EVENTS_SHOWN = 50
INSTALLATIONS_SHOWN = 50


@dataclass(frozen=True)
class Box:
    """A box, the vehicle that carries it, and the newest of everything known about it."""

    device: Device
    vehicle: Vehicle | None
    state: DeviceState | None
    installation: Installation | None
    standing: Standing
    speed_mps: float | None
    """At a fix so young that it tells of now."""
    reporting: bool
    silent: bool
    moved_lately: bool

    @property
    def name(self) -> str:
        return self.vehicle.name if self.vehicle else self.device.name

    @property
    def url(self) -> str:
        return f"/vehicles/{self.vehicle.id}" if self.vehicle else f"/devices/{self.device.id}"

    @property
    def mark(self) -> str:
        """State for the map; a box that is silent is unknown, whatever it was before."""
        return "unknown" if self.silent else self.standing.state

    @property
    def reasons(self) -> list[tuple[str, str]]:
        """What is still missing, as sentences for the driver, each with its name in the catalogues."""
        return reasons(self.installation.result if self.installation else blank_result())


@dataclass(frozen=True)
class History:
    """What a box, and the vehicle around it, went through."""

    installations: list[Installation]
    """Newest first, like the trips."""
    trips: list[Trip]
    events: list[Line]
    """Newest first; manoeuvres too."""
    distance_m: float
    moving_s: float
    """Over the trips that are listed."""
    reference_angle_deg: float | None
    """Between the estimate and the latest mounting known from elsewhere."""


@dataclass(frozen=True)
class VehiclePage:
    """A vehicle and the box in it; either may be missing."""

    vehicle: Vehicle | None
    box: Box | None
    history: History
    box_count: int
    """Boxes in the vehicle; the page shows the one heard last."""
    trip: Trip | None
    """The one that map and charts show: the last, or the one that the address names."""
    health: Sequence[Figure]
    remarks: Sequence[str]
    course: Course | None


def last_change(session: Session, organisation_id: str) -> int:
    """Id of the newest change; what is read after this is at least as new."""
    return session.scalar(select(func.max(Change.id)).where(Change.organisation_id == organisation_id)) or 0


def vehicle_page(
    session: Session, organisation_id: str, vehicle_id: str, *, now: dt.datetime, trip_id: str | None = None
) -> VehiclePage:
    """A vehicle and the box in it that was heard last."""
    vehicle = session.get(Vehicle, vehicle_id)
    if vehicle is None or vehicle.organisation_id != organisation_id:
        raise NotFoundError(f"There is no vehicle {vehicle_id}")
    boxes = _boxes(session, organisation_id, now=now, vehicle_id=vehicle_id)
    box = max(boxes, key=lambda box: box.device.last_seen_at or box.device.created_at, default=None)
    return _page(session, organisation_id, vehicle, box, len(boxes), trip_id, subject=vehicle)


def device_page(
    session: Session, organisation_id: str, device_id: str, *, now: dt.datetime, trip_id: str | None = None
) -> VehiclePage:
    """A box, whatever it sits in."""
    boxes = _boxes(session, organisation_id, now=now, device_id=device_id)
    if not boxes:
        raise NotFoundError(f"There is no box {device_id}")
    return _page(session, organisation_id, boxes[0].vehicle, boxes[0], 1, trip_id, subject=None)


def _page(
    session: Session,
    organisation_id: str,
    vehicle: Vehicle | None,
    box: Box | None,
    box_count: int,
    trip_id: str | None,
    *,
    subject: Vehicle | None,
) -> VehiclePage:
    history = _history(session, organisation_id, subject, box)
    trip = trip_of(session, organisation_id, trip_id) if trip_id else next(iter(history.trips), None)
    state = box.state if box is not None else None
    course = None
    if box is not None and box.installation is not None:
        course = course_of(revisions(session, [box.installation.id])[box.installation.id])
    health = {} if state is None else state.health
    return VehiclePage(vehicle, box, history, box_count, trip, figures(health), remark_sentences(health), course)


def _history(session: Session, organisation_id: str, vehicle: Vehicle | None, box: Box | None) -> History:
    """Of the vehicle, whichever box it carried; of the box, wherever it was, when no vehicle is given."""
    device_id = None if box is None or vehicle is not None else box.device.id
    installed = Installation.device_id == device_id if vehicle is None else Installation.vehicle_id == vehicle.id
    installations = session.scalars(
        select(Installation).where(installed).order_by(Installation.began_at.desc()).limit(INSTALLATIONS_SHOWN)
    ).all()
    driven = trips(
        session,
        organisation_id,
        device_id=device_id,
        vehicle_id=None if vehicle is None else vehicle.id,
        limit=TRIPS_SHOWN,
    )
    angle = None
    if box is not None and box.installation is not None:
        angle = angle_to_reference(box.installation.result, box.device.reference_mountings)
    happened = lines(
        session,
        organisation_id,
        device_id=device_id,
        vehicle_id=None if vehicle is None else vehicle.id,
        limit=EVENTS_SHOWN,
    )
    metres, seconds = sum(trip.distance_m for trip in driven), sum(trip.moving_s for trip in driven)
    return History(list(installations), list(driven), happened, metres, seconds, angle)


def _boxes(
    session: Session,
    organisation_id: str,
    *,
    now: dt.datetime,
    vehicle_id: str | None = None,
    device_id: str | None = None,
) -> list[Box]:
    """Boxes in use, with vehicle, state and open installation; revoked ones only when asked for by id."""
    statement = (
        select(Device, Vehicle, DeviceState, Installation)
        .outerjoin(Vehicle, Vehicle.id == Device.vehicle_id)
        .outerjoin(DeviceState, DeviceState.device_id == Device.id)
        .outerjoin(Installation, (Installation.device_id == Device.id) & Installation.ended_at.is_(None))
        .where(Device.organisation_id == organisation_id)
        .order_by(func.coalesce(Vehicle.name, Device.name), Device.name, Installation.began_at)
    )
    if vehicle_id is not None:
        statement = statement.where(Device.vehicle_id == vehicle_id)
    statement = statement.where(Device.id == device_id) if device_id else statement.where(Device.revoked_at.is_(None))
    boxes = {
        device.id: _box(device, vehicle, state, installation, now=now)
        for device, vehicle, state, installation in session.execute(statement)
    }
    return list(boxes.values())


def _box(
    device: Device,
    vehicle: Vehicle | None,
    state: DeviceState | None,
    installation: Installation | None,
    *,
    now: dt.datetime,
) -> Box:
    moved = installation is not None and installation.beginning == "moved"
    how = (
        standing(None, {}, progress=0.0, moved=False)
        if installation is None
        else standing(installation.status, installation.result, progress=installation.progress, moved=moved)
    )
    quiet_for = None if device.last_seen_at is None else now - device.last_seen_at
    reporting = quiet_for is not None and quiet_for < LIVE_WITHIN
    # Both count: what a box sends late is old although the box is heard now.
    is_live = (
        reporting and state is not None and state.position_at is not None and now - state.position_at < LIVE_WITHIN
    )
    return Box(
        device=device,
        vehicle=vehicle,
        state=state,
        installation=installation,
        standing=how,
        speed_mps=state.speed_mps if state is not None and is_live else None,
        reporting=reporting,
        silent=quiet_for is None or quiet_for > SILENT_AFTER,
        moved_lately=installation is not None
        and moved
        and (not how.calibrated or now - installation.updated_at < MOVED_IS_NEWS_FOR),
    )
