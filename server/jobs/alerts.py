"""What a round's results mean for an organisation's rules; the alerts are written with the results.

Only what is recent alerts: boxes that come back send weeks of driving, and whoever gets a mail for each geofence of a
month ago reads none any more.
"""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, cast

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session

from nav_core.typing import Floats
from server.alerts import queries
from server.alerts.emergency import FRESH, emergency_message
from server.alerts.geometry import margin_m, passages
from server.alerts.raising import Finding, Raised, raise_all, recover
from server.alerts.schemas import GeofenceCondition
from server.database import Database
from server.events.queries import document
from server.formats.columns import Columns
from server.jobs.results import Results
from server.jobs.situation import Situation
from server.jobs.stretch import Piece
from server.models import (
    AlertRule,
    DeviceState,
    Event,
    EventRevision,
    GeofencePresence,
    Installation,
    TheftWatch,
    Trip,
    Vehicle,
)
from server.models.event import CRASHES, HARSH
from server.trips.track import MOVING_MPS, Point, seconds, speed_at

NEWS = dt.timedelta(days=7)
"""A crash or a move that becomes known later is in the lists, and alerts nobody."""
LIVE = dt.timedelta(hours=24)
"""The same for what is over when it is over: a fence passed, a harsh day, movement without ignition."""
THEFT_S = 3.0
"""Movement must last so long; a fix alone may jump."""
CARRIED_S = 3600.0
"""How long the last word about the ignition holds where later data say nothing of it."""
MIN_HARSH_KM = 20.0


class Alerts:
    """The alerts of one device during one round."""

    def __init__(
        self, database: Database, situation: Situation, results: Results, state: DeviceState, *, now: dt.datetime
    ) -> None:
        self._database = database
        self._situation = situation
        self._results = results
        self._state = state
        self._now = now
        self._device = situation.device

    def look(self, pieces: Sequence[Piece], columns: Mapping[tuple[str, int], Columns]) -> None:
        """Find what is to be told; `columns` by boot and sequence of the continuous batches in `pieces`."""
        # Rows are changed while more is read: what is flushed here would be lost with the view, and clean in the write.
        with self._database.reading() as session, session.no_autoflush:
            rules = queries.rules_on(session, self._device.organisation_id, self._device.vehicle_id)
            watch = queries.watch_of(session, self._device.vehicle_id)
            by_kind = {kind: [rule for rule in rules if rule.kind == kind] for kind in {rule.kind for rule in rules}}
            findings = [
                *self._crashes(session, by_kind.get("crash", [])),
                *self._moved(by_kind.get("moved", [])),
                *self._harsh(session, by_kind.get("harsh", [])),
                *self._fences(session, by_kind.get("geofence", []), pieces),
                *self._theft(by_kind.get("theft", []), watch, pieces, columns),
            ]
            device = self._device
            told = raise_all(session, device.organisation_id, device.id, device.vehicle_id, findings, now=self._now)
            self._take(told)
            self._take(self._withdrawn(session))

    def _take(self, raised: Raised) -> None:
        for alert in raised.alerts:
            self._results.put(alert)
            self._results.announce(
                "alert", alert.vehicle_id, alert_id=alert.id, alert_kind=alert.kind, severity=alert.severity
            )
        self._results.deliveries += raised.deliveries

    def _events(self) -> Iterable[Event]:
        return (row for row in self._results.rows if isinstance(row, Event))

    def _crashes(self, session: Session, rules: Sequence[AlertRule]) -> Iterable[Finding]:
        for row in self._events():
            recent = self._now - row.at < NEWS
            if row.kind not in CRASHES or not row.severe or row.withdrawn_at is not None or not recent:
                continue
            delta_v = row.result["delta_v_kmh"]["resultant"]
            facts = {"event_kind": row.kind, "delta_v_kmh": delta_v, "pdof_clock": row.result["pdof_clock"]}
            for rule in rules:
                if delta_v is None or delta_v >= rule.parameters["min_delta_v_kmh"]:
                    yield Finding(rule, "crash", "alarm", f"crash/{rule.id}/{row.id}", row.at, facts, row.id)
            if row.kind != "parked_impact" and self._now - row.at < FRESH:
                message = self._emergency(session, row)
                yield Finding(None, "emergency", "alarm", f"emergency/{row.id}", row.at, message, row.id)

    def _emergency(self, session: Session, row: Event) -> dict[str, Any]:
        revision = next(
            each for each in self._results.rows if isinstance(each, EventRevision) and each.event_id == row.id
        )
        vehicle = session.get(Vehicle, row.vehicle_id) if row.vehicle_id else None
        return emergency_message(
            row.result,
            document(revision)["curves"]["trajectory"],
            at=row.at,
            now=self._now,
            vehicle_class=None if vehicle is None else vehicle.vehicle_class,
            fallback=self._last_fix(),
        )

    def _last_fix(self) -> dict[str, Any] | None:
        state = self._state
        if state.position_at is None or state.lat_deg is None or state.lon_deg is None:
            return None
        course = None if state.course_rad is None else round(math.degrees(state.course_rad) % 360.0, 1)
        return {"at": state.position_at, "lat_deg": state.lat_deg, "lon_deg": state.lon_deg, "course_deg": course}

    def _withdrawn(self, session: Session) -> Raised:
        gone = [row.id for row in self._events() if row.withdrawn_at is not None]
        if not gone:
            return Raised()
        alerts = queries.of_events(session, self._device.organisation_id, gone)
        return recover(session, alerts, now=self._now)

    def _moved(self, rules: Sequence[AlertRule]) -> Iterable[Finding]:
        rows = [row for row in self._results.rows if isinstance(row, Installation) and row.beginning == "moved"]
        for row in rows:
            angle = None if row.moved_angle_rad is None else round(math.degrees(row.moved_angle_rad), 1)
            for rule in rules:
                large = angle is None or angle >= rule.parameters["min_angle_deg"]
                if large and self._now - row.began_at < NEWS:
                    facts = {"angle_deg": angle}
                    yield Finding(rule, "moved", "attention", f"moved/{rule.id}/{row.id}", row.began_at, facts)

    def _harsh(self, session: Session, rules: Sequence[AlertRule]) -> Iterable[Finding]:
        new = [row for row in self._events() if row.kind in HARSH and row.withdrawn_at is None]
        if not rules:
            return
        for day in sorted({row.at.date() for row in new}):
            begin = dt.datetime.combine(day, dt.time(), dt.UTC)
            end = begin + dt.timedelta(days=1)
            if self._now - end >= LIVE:
                continue
            count = self._harsh_of(session, begin, end)
            kilometres = self._kilometres_of(session, begin, end)
            for rule in rules:
                limit = rule.parameters["count"]
                value = float(count) if rule.parameters["per"] == "day" else _per_100_km(count, kilometres)
                if value is None or value < limit:
                    continue
                facts = {"count": count, "kilometres": round(kilometres, 1), "day": day.isoformat()}
                facts |= {"limit": limit, "per": rule.parameters["per"]}
                last = max(row.at for row in new if row.at.date() == day)
                yield Finding(
                    rule, "harsh", "attention", f"harsh/{rule.id}/{self._device.id}/{day.isoformat()}", last, facts
                )

    def _harsh_of(self, session: Session, begin: dt.datetime, end: dt.datetime) -> int:
        """Harsh events of a day, those of this round as it leaves them."""
        mine = {row.id: row for row in self._events()}
        stored = select(Event.id).where(
            Event.device_id == self._device.id,
            Event.kind.in_(HARSH),
            Event.withdrawn_at.is_(None),
            Event.at >= begin,
            Event.at < end,
        )
        others = sum(event_id not in mine for event_id in session.scalars(stored))
        own = (row for row in mine.values() if row.kind in HARSH and row.withdrawn_at is None)
        return others + sum(begin <= row.at < end for row in own)

    def _kilometres_of(self, session: Session, begin: dt.datetime, end: dt.datetime) -> float:
        mine = {row.id: row for row in self._results.rows if isinstance(row, Trip)}
        stored = select(Trip.id, Trip.distance_m).where(
            Trip.device_id == self._device.id, Trip.began_at >= begin, Trip.began_at < end
        )
        replaced = {*mine, *self._results.replaced_trips}
        metres = sum(distance for trip_id, distance in session.execute(stored) if trip_id not in replaced)
        return (metres + sum(row.distance_m for row in mine.values() if begin <= row.began_at < end)) / 1000.0

    def _points(self, pieces: Sequence[Piece]) -> list[tuple[dt.datetime, Point, Piece]]:
        """Recent fixes, one a second, in the order of time."""
        boots, found = self._situation.boots, list[tuple[dt.datetime, Point, Piece]]()
        for piece in pieces:
            boot = boots[piece.boot]
            if self._now - boot.utc(piece.t_last_s) < LIVE:
                found += [(boot.utc(point.t), point, piece) for point in seconds(piece.digest.gnss, None)]
        return sorted(found, key=lambda each: each[0])

    def _fences(self, session: Session, rules: Sequence[AlertRule], pieces: Sequence[Piece]) -> Iterable[Finding]:
        points = self._points(pieces) if rules else []
        if not points:
            return
        presences = queries.presences(session, self._device.id)
        lat, lon = (np.degrees([getattr(point, name) for _, point, _ in points]) for name in ("lat", "lon"))
        for rule in rules:
            presence = presences.get(rule.id)
            # Data that come late tell where the box was, not that it passed the fence now.
            new = [k for k, (at, _, _) in enumerate(points) if presence is None or at > presence.at]
            if not new:
                continue
            condition = GeofenceCondition.model_validate({"kind": "geofence", **rule.parameters})
            fence = condition.fence.made()
            passed, inside = passages(
                fence.outside_m(cast("Floats", lat)[new], cast("Floats", lon)[new]),
                margin_m(fence, condition.margin_m),
                None if presence is None else presence.inside,
            )
            if inside is None:
                continue
            if presence is None:
                presence = GeofencePresence(rule_id=rule.id, device_id=self._device.id)
            presence.inside, presence.at = inside, points[new[-1]][0]
            self._results.put(presence)
            for row, entered in passed:
                if condition.on == "both" or (condition.on == "enter") == entered:
                    at, k = points[new[row]][0], new[row]
                    yield self._passage(rule, at, float(lat[k]), float(lon[k]), entered=entered)

    def _passage(self, rule: AlertRule, at: dt.datetime, lat_deg: float, lon_deg: float, *, entered: bool) -> Finding:
        facts = {"passage": "entered" if entered else "left", "fence": rule.name}
        facts |= {"position": {"lat_deg": round(lat_deg, 6), "lon_deg": round(lon_deg, 6)}}
        occurrence = f"geofence/{rule.id}/{self._device.id}/{at.isoformat()}"
        return Finding(rule, "geofence", "info", occurrence, at, facts)

    def _theft(
        self,
        rules: Sequence[AlertRule],
        watch: TheftWatch | None,
        pieces: Sequence[Piece],
        columns: Mapping[tuple[str, int], Columns],
    ) -> Iterable[Finding]:
        ignition = self._ignition(pieces, columns)
        armed_at = None if watch is None else watch.armed_at
        if (not rules and armed_at is None) or (watch is not None and watch.alarm_at is not None):
            return
        began: dict[str, tuple[dt.datetime, Point] | None] = {"ignition": None, "armed": None}
        last: Point | None = None
        last_piece: Piece | None = None
        for at, point, piece in self._points(pieces):
            if last_piece is not None and piece.boot != last_piece.boot:
                last = None  # another clock: no way and no speed between the two
            if last is not None and point.t <= last.t:
                continue  # the same second at the end of one batch and the beginning of the next
            moving = speed_at(point, last) > MOVING_MPS
            last, last_piece = point, piece
            tests = {
                "ignition": bool(rules) and ignition.at(at) == 0.0,
                "armed": armed_at is not None and at >= armed_at,
            }
            for why, applies in tests.items():
                if not (moving and applies):
                    began[why] = None
                elif (first := began[why]) is None:
                    began[why] = at, point
                elif (at - first[0]).total_seconds() >= THEFT_S:
                    yield from self._stolen(rules, watch, first[0], point, why)
                    return

    def _stolen(
        self, rules: Sequence[AlertRule], watch: TheftWatch | None, since: dt.datetime, point: Point, why: str
    ) -> Iterable[Finding]:
        device = self._device
        if device.vehicle_id is not None:
            watch = watch or TheftWatch(vehicle_id=device.vehicle_id, organisation_id=device.organisation_id)
            watch.alarm_at = since
            self._results.put(watch)
            self._results.announce("vehicle", device.vehicle_id)
        facts: dict[str, Any] = {
            "why": "moves without ignition" if why == "ignition" else "moves although armed",
            "position": {"lat_deg": round(math.degrees(point.lat), 6), "lon_deg": round(math.degrees(point.lon), 6)},
            "speed_kmh": None if point.speed is None else round(3.6 * point.speed, 1),
            "course_deg": None if point.course is None else round(math.degrees(point.course) % 360.0, 1),
        }
        for rule in rules or [None]:
            name = "armed" if rule is None else rule.id
            yield Finding(rule, "theft", "alarm", f"theft/{name}/{device.id}/{since.isoformat()}", since, facts)

    def _ignition(self, pieces: Sequence[Piece], columns: Mapping[tuple[str, int], Columns]) -> _Ignition:
        """What the box says of the ignition, and what it said last; remembered for the next round."""
        health = self._state.health
        said: list[tuple[float, float]] = [tuple(health["ignition"])] if health.get("ignition") else []
        for piece in pieces:
            values = columns[piece.boot, piece.sequence].values
            if "ignition" not in values:
                continue
            boot = self._situation.boots[piece.boot]
            known = np.flatnonzero(np.isfinite(values["ignition"]))
            changes = known[np.flatnonzero(np.diff(values["ignition"][known], prepend=np.nan) != 0.0)]
            rows = sorted({*changes.tolist(), *known[-1:].tolist()})
            said += [(boot.unix_s(float(values["t"][k])), float(values["ignition"][k])) for k in rows]
        said.sort()
        if said:
            self._state.health = {**health, "ignition": list(said[-1])}
        return _Ignition(said)


class _Ignition:
    """The ignition over time."""

    def __init__(self, said: Sequence[tuple[float, float]]) -> None:
        self._t = [t for t, _ in said]
        self._on = [on for _, on in said]

    def at(self, moment: dt.datetime) -> float | None:
        """1, 0, or None where nobody said for long."""
        t = moment.timestamp()
        k = int(np.searchsorted(self._t, t, side="right")) - 1
        if k < 0 or (k == len(self._t) - 1 and t - self._t[k] > CARRIED_S):
            return None
        return self._on[k]


def _per_100_km(count: int, kilometres: float) -> float | None:
    return None if kilometres < MIN_HARSH_KM else 100.0 * count / kilometres
