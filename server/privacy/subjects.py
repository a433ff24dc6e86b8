"""Which rows are about a vehicle: those of the boxes in it, while they were in it, in the time that is asked for."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator
from dataclasses import dataclass

from sqlalchemy import ColumnElement, and_, or_, select
from sqlalchemy.orm import Session

from server.errors import InvalidError, NotFoundError
from server.models import (
    AccidentClaim,
    Alert,
    Assignment,
    Batch,
    Boot,
    Change,
    Device,
    Diagnosis,
    Event,
    Installation,
    Trip,
    Vehicle,
)

_FIRST, _LAST = dt.datetime(1970, 1, 1, tzinfo=dt.UTC), dt.datetime(9999, 1, 1, tzinfo=dt.UTC)


@dataclass(frozen=True)
class Subject:
    """A vehicle, and from when to when; no bounds: everything."""

    organisation_id: str
    vehicle_id: str
    since: dt.datetime | None = None
    until: dt.datetime | None = None

    @property
    def whole(self) -> bool:
        return self.since is None and self.until is None

    def trips(self) -> tuple[ColumnElement[bool], ...]:
        """Conditions of its trips: those that touch the time."""
        return (
            Trip.vehicle_id == self.vehicle_id,
            *(() if self.since is None else (Trip.ended_at >= self.since,)),
            *(() if self.until is None else (Trip.began_at < self.until,)),
        )

    def events(self) -> tuple[ColumnElement[bool], ...]:
        return (
            Event.vehicle_id == self.vehicle_id,
            *(() if self.since is None else (Event.at >= self.since,)),
            *(() if self.until is None else (Event.at < self.until,)),
        )

    def changes(self) -> tuple[ColumnElement[bool], ...]:
        """All of it whatever the time: it is only what a browser replays."""
        return (Change.organisation_id == self.organisation_id, Change.vehicle_id == self.vehicle_id)

    def alerts(self) -> tuple[ColumnElement[bool], ...]:
        return (
            Alert.organisation_id == self.organisation_id,
            Alert.vehicle_id == self.vehicle_id,
            *(() if self.since is None else (Alert.at >= self.since,)),
            *(() if self.until is None else (Alert.at < self.until,)),
        )

    def claims(self) -> tuple[ColumnElement[bool], ...]:
        """Accidents that somebody said it had: those that touch the time."""
        return (
            AccidentClaim.vehicle_id == self.vehicle_id,
            *(() if self.since is None else (AccidentClaim.ended_at >= self.since,)),
            *(() if self.until is None else (AccidentClaim.began_at < self.until,)),
        )

    def installations(self) -> tuple[ColumnElement[bool], ...]:
        return (Installation.vehicle_id == self.vehicle_id,)


def vehicle_subject(
    session: Session,
    organisation_id: str,
    vehicle_id: str,
    since: dt.datetime | None = None,
    until: dt.datetime | None = None,
) -> Subject:
    """The subject; raises unless the organisation has that vehicle and the time is one."""
    row = session.get(Vehicle, vehicle_id)
    if row is None or row.organisation_id != organisation_id:
        raise NotFoundError(f"There is no vehicle {vehicle_id!r}")
    if since is not None and until is not None and since >= until:
        raise InvalidError("`since` must lie before `until`", code="period")
    return Subject(organisation_id, vehicle_id, since, until)


@dataclass(frozen=True)
class Stay:
    """A box in the vehicle, from when to when."""

    device_id: str
    began_at: dt.datetime
    ended_at: dt.datetime


def stays(session: Session, subject: Subject) -> list[Stay]:
    """The boxes that were in the vehicle, as `server.jobs.mountings.vehicle_at` tells it, within the subject's time."""
    in_it = select(Assignment.device_id).where(Assignment.vehicle_id == subject.vehicle_id)
    boxes = session.scalars(
        select(Device)
        .where(Device.organisation_id == subject.organisation_id)
        .where(or_(Device.id.in_(in_it), Device.vehicle_id == subject.vehicle_id))
        .order_by(Device.id)
    ).all()
    found: list[Stay] = []
    for box in boxes:
        query = select(Assignment).where(Assignment.device_id == box.id).order_by(Assignment.began_at)
        rows = session.scalars(query).all()
        if not rows:
            found.append(Stay(box.id, _FIRST, _LAST))
        for k, row in enumerate(rows):
            if row.vehicle_id == subject.vehicle_id:
                # Recordings may be older than the first assignment: they are its vehicle's.
                began = row.began_at if k else _FIRST
                following = rows[k + 1].began_at if k + 1 < len(rows) else _LAST
                found.append(Stay(box.id, began, min(row.ended_at or _LAST, following)))
    clipped = [
        Stay(s.device_id, max(s.began_at, subject.since or _FIRST), min(s.ended_at, subject.until or _LAST))
        for s in found
    ]
    return [stay for stay in clipped if stay.began_at < stay.ended_at]


def diagnosis(stay: Stay) -> tuple[ColumnElement[bool], ...]:
    """Conditions of the named values of a stay."""
    return Diagnosis.device_id == stay.device_id, Diagnosis.at >= stay.began_at, Diagnosis.at < stay.ended_at


def boots_of(session: Session, stay: Stay) -> list[Boot]:
    """Runs of the box's clock that touch a stay."""
    rows = session.scalars(select(Boot).where(Boot.device_id == stay.device_id).order_by(Boot.ordinal))
    begin, end = stay.began_at.timestamp(), stay.ended_at.timestamp()
    return [row for row in rows if row.unix_s(row.t_last_s) >= begin and row.unix_s(row.t_first_s) < end]


def batches(session: Session, subject: Subject) -> Iterator[tuple[str, tuple[ColumnElement[bool], ...]]]:
    """Box and conditions of the vehicle's batches, in parts: a batch goes by the middle of its time.

    One whose clock is not known, as it was never worked off, goes by its arrival.
    """
    for stay in stays(session, subject):
        known = select(Boot.boot).where(Boot.device_id == stay.device_id)
        arrival = and_(Batch.received_at >= stay.began_at, Batch.received_at < stay.ended_at)
        of_box = Batch.device_id == stay.device_id
        yield stay.device_id, (of_box, Batch.boot.not_in(known), arrival)
        for boot in boots_of(session, stay):
            begin, end = boot.box_s(stay.began_at.timestamp()), boot.box_s(stay.ended_at.timestamp())
            middle = 0.5 * (Batch.t_first_s + Batch.t_last_s)
            yield stay.device_id, (of_box, Batch.boot == boot.boot, middle >= begin, middle < end)
