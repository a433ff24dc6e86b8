"""Trips and tracks as they are shown; JSON and pages read the same."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence

from sqlalchemy import select, tuple_
from sqlalchemy.orm import Session

from server.errors import NotFoundError
from server.models import TrackPoint, Trip


def trips(
    session: Session,
    organisation_id: str,
    *,
    device_id: str | None = None,
    vehicle_id: str | None = None,
    since: dt.datetime | None = None,
    until: dt.datetime | None = None,
    before: tuple[dt.datetime, str] | None = None,
    limit: int,
) -> Sequence[Trip]:
    """Trips that touch the time from `since` to `until`, the newest first, from after `before` in that order."""
    query = select(Trip).where(Trip.organisation_id == organisation_id)
    if device_id is not None:
        query = query.where(Trip.device_id == device_id)
    if vehicle_id is not None:
        query = query.where(Trip.vehicle_id == vehicle_id)
    if since is not None:
        query = query.where(Trip.ended_at >= since)
    if until is not None:
        query = query.where(Trip.began_at < until)
    if before is not None:
        query = query.where(tuple_(Trip.began_at, Trip.id) < before)
    return session.scalars(query.order_by(Trip.began_at.desc(), Trip.id.desc()).limit(limit)).all()


def trip_of(session: Session, organisation_id: str, trip_id: str) -> Trip:
    """A trip of the organisation."""
    trip = session.get(Trip, trip_id)
    if trip is None or trip.organisation_id != organisation_id:
        raise NotFoundError(f"There is no trip {trip_id!r}")
    return trip


def track(session: Session, trip_id: str) -> Sequence[TrackPoint]:
    """The 1 Hz track of a trip in the order of time."""
    return session.scalars(select(TrackPoint).where(TrackPoint.trip_id == trip_id).order_by(TrackPoint.t_s)).all()
