"""Kilometres and trip statistics, and the driving-style score."""

from __future__ import annotations

import datetime as dt
from collections import Counter
from dataclasses import dataclass
from typing import Literal
from zoneinfo import ZoneInfo

from sqlalchemy import func, or_, select
from sqlalchemy.orm import Session

from server.errors import InvalidError
from server.models import Event, Trip
from server.models.event import HARSH
from server.statistics.schemas import PeriodOut, ScoreOut
from server.statistics.score import FORMULA, MIN_KM, score_of

NIGHT = dt.time(22), dt.time(5)
MAX_TRIPS = 50_000

Group = Literal["day", "week"]


@dataclass
class _Sum:
    trips: int = 0
    distance_m: float = 0.0
    moving_s: float = 0.0
    idle_s: float = 0.0
    night_s: float = 0.0
    max_speed_mps: float = 0.0


def periods(
    session: Session,
    organisation_id: str,
    *,
    group: Group,
    zone: ZoneInfo,
    since: dt.datetime,
    until: dt.datetime,
    vehicle_id: str | None = None,
    device_id: str | None = None,
) -> list[PeriodOut]:
    """Sums per vehicle over local days or weeks; a trip counts where it began."""
    query = select(Trip).where(Trip.organisation_id == organisation_id, Trip.began_at >= since, Trip.began_at < until)
    if vehicle_id is not None:
        query = query.where(Trip.vehicle_id == vehicle_id)
    if device_id is not None:
        query = query.where(Trip.device_id == device_id)
    trips = session.scalars(query.limit(MAX_TRIPS + 1)).all()
    if len(trips) > MAX_TRIPS:
        raise InvalidError(f"More than {MAX_TRIPS} trips; ask for a shorter time", code="too_many_trips")
    sums: dict[tuple[dt.date, str | None, str | None], _Sum] = {}
    for trip in trips:
        day = trip.began_at.astimezone(zone).date()
        begins = day if group == "day" else day - dt.timedelta(days=day.weekday())
        key = begins, trip.vehicle_id, None if trip.vehicle_id is not None else trip.device_id
        _add(sums.setdefault(key, _Sum()), trip, zone)
    ordered = sorted(sums.items(), key=lambda item: (-item[0][0].toordinal(), item[0][1] or "", item[0][2] or ""))
    return [
        PeriodOut(
            begins=begins,
            vehicle_id=vehicle,
            device_id=device,
            trips=each.trips,
            distance_m=each.distance_m,
            moving_s=each.moving_s,
            idle_s=each.idle_s,
            night_share=each.night_s / each.moving_s if each.moving_s > 0.0 else None,
            max_speed_kmh=3.6 * each.max_speed_mps,
        )
        for (begins, vehicle, device), each in ordered
    ]


def _add(total: _Sum, trip: Trip, zone: ZoneInfo) -> None:
    lasted_s = (trip.ended_at - trip.began_at).total_seconds()
    total.trips += 1
    total.distance_m += trip.distance_m
    total.moving_s += trip.moving_s
    total.idle_s += max(0.0, lasted_s - trip.moving_s)
    # A trip's movement is taken as spread evenly over it: the track would say it better, at a thousand times the rows.
    total.night_s += trip.moving_s * night_s(trip.began_at, trip.ended_at, zone) / lasted_s if lasted_s > 0.0 else 0.0
    total.max_speed_mps = max(total.max_speed_mps, trip.max_speed_mps)


def night_s(began_at: dt.datetime, ended_at: dt.datetime, zone: ZoneInfo) -> float:
    """How much of a span lies between 22:00 and 05:00 local, s."""
    day = began_at.astimezone(zone).date() - dt.timedelta(days=1)
    total = 0.0
    while day <= ended_at.astimezone(zone).date():
        # Compared in UTC: across a change of the clock the night is an hour longer or shorter.
        begin = dt.datetime.combine(day, NIGHT[0], zone).astimezone(dt.UTC)
        end = dt.datetime.combine(day + dt.timedelta(days=1), NIGHT[1], zone).astimezone(dt.UTC)
        total += max(0.0, (min(end, ended_at) - max(begin, began_at)).total_seconds())
        day += dt.timedelta(days=1)
    return total


def score(session: Session, organisation_id: str, vehicle_id: str, since: dt.datetime, until: dt.datetime) -> ScoreOut:
    """Driving style of a vehicle; what a person called a false alarm does not count."""
    metres = session.scalar(
        select(func.sum(Trip.distance_m)).where(
            Trip.organisation_id == organisation_id,
            Trip.vehicle_id == vehicle_id,
            Trip.began_at >= since,
            Trip.began_at < until,
        )
    )
    kinds = Counter(
        session.scalars(
            select(Event.kind).where(
                Event.organisation_id == organisation_id,
                Event.vehicle_id == vehicle_id,
                Event.kind.in_(HARSH),
                Event.withdrawn_at.is_(None),
                or_(Event.verdict.is_(None), Event.verdict != "false_alarm"),
                Event.at >= since,
                Event.at < until,
            )
        )
    )
    found = score_of(sum(kinds.values()), (metres or 0.0) / 1000.0)
    return ScoreOut(
        vehicle_id=vehicle_id,
        since=since,
        until=until,
        status="not_enough_distance" if found.score is None else "ok",
        score=found.score,
        score_interval95=found.score_interval95,
        events=found.events,
        by_kind={kind: kinds.get(kind, 0) for kind in HARSH},
        kilometres=found.kilometres,
        min_kilometres=MIN_KM,
        per_100_km=found.per_100_km,
        per_100_km_interval95=found.per_100_km_interval95,
        formula=FORMULA,
    )
