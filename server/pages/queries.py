"""What the pages show, read once: a fixed number of statements whatever the size of the fleet."""

from __future__ import annotations

import datetime as dt
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sqlalchemy import and_, case, func, select
from sqlalchemy.orm import Session

from server.errors import NotFoundError
from server.installations.blank import blank_result
from server.models import Change, Device, DeviceState, Installation, Trip, Vehicle
from server.pages.events import Line, lines, unreviewed
from server.pages.words import (
    LIVE_WITHIN,
    MOVED_IS_NEWS_FOR,
    SILENT_AFTER,
    Standing,
    angle_to_reference,
    standing,
)
from server.trips.queries import trips

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
    distance_m: float
    """Over all trips of the vehicle, or of the box where it sits in none."""
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
    def reasons(self) -> Sequence[str]:
        """What is still missing, as sentences for the driver."""
        return (self.installation.result if self.installation else blank_result())["reasons"]


@dataclass(frozen=True)
class Fleet:
    boxes: list[Box]
    empty_vehicles: list[Vehicle]
    """Vehicles without a box."""
    crashes: list[Line]
    """Severe events that nobody has looked at."""

    @property
    def reporting(self) -> int:
        return sum(box.reporting for box in self.boxes)

    @property
    def attention(self) -> Sequence[tuple[str, str, str, Sequence[Box | Line]]]:
        """Tiles: state for colour and shape, heading, what it means, whom it concerns."""
        loose = [box for box in self.boxes if box.standing.state == "alarm"]
        moved = [box for box in self.boxes if box.moved_lately]
        silent = [box for box in self.boxes if box.silent]
        waiting = [box for box in self.boxes if not box.standing.calibrated and box.standing.state != "alarm"]
        return [
            ("alarm", "Crash", "not yet looked at", self.crashes),
            ("alarm", "Not fixed", "the box swings or lies loose", loose),
            ("attention", "Moved", "the box was turned in its vehicle", moved),
            ("unknown", "Silent", "no word for a day, or never", silent),
            ("attention", "Not calibrated", "still learning how the box sits", waiting),
        ]


@dataclass(frozen=True)
class History:
    """What a box, and the vehicle around it, went through."""

    installations: list[Installation]
    """Newest first, like the trips."""
    trips: list[Trip]
    events: list[Line]
    """Newest first; manoeuvres too."""
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


def last_change(session: Session, organisation_id: str) -> int:
    """Id of the newest change; what is read after this is at least as new."""
    return session.scalar(select(func.max(Change.id)).where(Change.organisation_id == organisation_id)) or 0


def fleet(session: Session, organisation_id: str, *, now: dt.datetime) -> Fleet:
    """All boxes and vehicles of an organisation, by name."""
    boxes = _boxes(session, organisation_id, now=now)
    carried = {box.vehicle.id for box in boxes if box.vehicle}
    vehicles = session.scalars(select(Vehicle).where(Vehicle.organisation_id == organisation_id).order_by(Vehicle.name))
    crashes = unreviewed(session, organisation_id, now=now)
    return Fleet(boxes, [vehicle for vehicle in vehicles if vehicle.id not in carried], crashes)


def vehicle_page(session: Session, organisation_id: str, vehicle_id: str, *, now: dt.datetime) -> VehiclePage:
    """A vehicle and the box in it that was heard last."""
    vehicle = session.get(Vehicle, vehicle_id)
    if vehicle is None or vehicle.organisation_id != organisation_id:
        raise NotFoundError(f"There is no vehicle {vehicle_id}")
    boxes = _boxes(session, organisation_id, now=now, vehicle_id=vehicle_id)
    box = max(boxes, key=lambda box: box.device.last_seen_at or box.device.created_at, default=None)
    return VehiclePage(vehicle, box, _history(session, organisation_id, vehicle, box), len(boxes))


def device_page(session: Session, organisation_id: str, device_id: str, *, now: dt.datetime) -> VehiclePage:
    """A box, whatever it sits in."""
    boxes = _boxes(session, organisation_id, now=now, device_id=device_id)
    if not boxes:
        raise NotFoundError(f"There is no box {device_id}")
    return VehiclePage(boxes[0].vehicle, boxes[0], _history(session, organisation_id, None, boxes[0]), 1)


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
    return History(list(installations), list(driven), happened, angle)


def _boxes(
    session: Session,
    organisation_id: str,
    *,
    now: dt.datetime,
    vehicle_id: str | None = None,
    device_id: str | None = None,
) -> list[Box]:
    """Boxes in use, with vehicle, state and open installation; revoked ones only when asked for by id."""
    distances = _distances(session, organisation_id)
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
        device.id: _box(device, vehicle, state, installation, distances.of(device), now=now)
        for device, vehicle, state, installation in session.execute(statement)
    }
    return list(boxes.values())


@dataclass(frozen=True)
class _Distances:
    """Metres driven, so that they can be told for a vehicle whichever boxes it carried."""

    boxes: Mapping[str, float]
    """Of a box, wherever it sat."""
    together: Mapping[tuple[str, str], float]
    """Of a box in the vehicle that it still sits in."""
    former: Mapping[str, float]
    """Of a vehicle with boxes that left it."""

    def of(self, device: Device) -> float:
        """What its row shows.  Another box in the same vehicle measured the same way: it counts in its own row."""
        if device.vehicle_id is None or device.revoked_at is not None:
            return self.boxes.get(device.id, 0.0)
        return self.together.get((device.id, device.vehicle_id), 0.0) + self.former.get(device.vehicle_id, 0.0)


def _distances(session: Session, organisation_id: str) -> _Distances:
    sits_there = and_(Device.vehicle_id == Trip.vehicle_id, Device.revoked_at.is_(None))
    driven = session.execute(
        select(Trip.device_id, Trip.vehicle_id, func.sum(Trip.distance_m), func.max(case((sits_there, 1), else_=0)))
        .join(Device, Device.id == Trip.device_id)
        .where(Trip.organisation_id == organisation_id)
        .group_by(Trip.device_id, Trip.vehicle_id)
    )
    boxes: defaultdict[str, float] = defaultdict(float)
    former: defaultdict[str, float] = defaultdict(float)
    together: dict[tuple[str, str], float] = {}
    for device_id, vehicle_id, metres, still_there in driven:
        boxes[device_id] += metres
        if vehicle_id is not None and still_there:
            together[device_id, vehicle_id] = metres
        elif vehicle_id is not None:
            former[vehicle_id] += metres
    return _Distances(boxes, together, former)


def _box(
    device: Device,
    vehicle: Vehicle | None,
    state: DeviceState | None,
    installation: Installation | None,
    distance_m: float,
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
        distance_m=distance_m,
        speed_mps=state.speed_mps if state is not None and is_live else None,
        reporting=reporting,
        silent=quiet_for is None or quiet_for > SILENT_AFTER,
        moved_lately=installation is not None
        and moved
        and (not how.calibrated or now - installation.updated_at < MOVED_IS_NEWS_FOR),
    )
