"""Trips and the 1 Hz track out of fixes: a fold, so that each batch continues where the last one ended.

Folding batch by batch gives bit for bit what folding the whole boot at once gives; a batch that
comes late is handled by folding again from the last trip that it cannot touch.

Rules.  A trip begins with the first of `CONFIRM_S` seconds of movement above `MOVING_MPS` and ends
after `REST_S` without such movement, or at a gap in the fixes as long.  It ends where the vehicle came to
rest.  Standing time gives no track points but the first.  Distance is speed integrated over time, and the way
between positions where speed is missing for longer than `BRIDGE_S`; the second distance, between
positions at least `CHORD_M` apart, is the check.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from hashlib import sha256
from typing import Any

import numpy as np

from nav_core.records import Gnss

ALGORITHM = "trips/1"
MOVING_MPS = 1.5
STANDING_MPS = 0.5
CONFIRM_S = 3.0
REST_S = 240.0
BRIDGE_S = 3.0
CHORD_M = 50.0
LOSE_S = 30.0
"""A beginning movement is forgotten when the fixes pause as long."""
EARTH_M = 6371008.8


@dataclass(frozen=True, slots=True)
class Point:
    """A fix of the 1 Hz track; box time in s, angles in rad, None where not known."""

    t: float
    lat: float
    lon: float
    alt: float | None
    speed: float | None
    course: float | None


@dataclass(slots=True)
class TripTotals:
    """A trip as far as it is known."""

    t_first: float
    t_last: float
    id: str = ""
    """Of its row, given by whoever stores it."""
    distance_m: float = 0.0
    position_distance_m: float = 0.0
    moving_s: float = 0.0
    max_speed: float = 0.0
    moved_at: float = 0.0
    """Box time of the last movement above `MOVING_MPS`."""
    anchor_lat: float = 0.0
    """Position from which the next chord is measured."""
    anchor_lon: float = 0.0
    standing: bool = False
    input_sha256: str = ""
    """Hash over the column hashes of its batches, chained in order."""

    def add_input(self, column_sha256: str) -> None:
        """Chain a further batch onto the hash of the input."""
        self.input_sha256 = sha256((self.input_sha256 + column_sha256).encode()).hexdigest()


@dataclass(slots=True)
class TrackState:
    """Where the fold stands between two batches."""

    sequence: int = -1
    """Of the last batch folded."""
    second: int | None = None
    """Whole second of the last point used."""
    last: Point | None = None
    candidates: list[Point] = field(default_factory=list[Point])
    """Points of a movement that is not confirmed yet."""
    trip: TripTotals | None = None
    utc_offset_s: float | None = None
    """The boot's clock when its trips were laid out."""
    utc_drift: float = 0.0
    given_up: bool = False
    """Whether the open trip was ended from outside: a later boot has data, or nothing tells of movement."""

    def to_json(self) -> dict[str, Any]:
        """Plain document for the database."""
        return asdict(self)

    @classmethod
    def from_json(cls, document: dict[str, Any]) -> TrackState:
        """State from what `to_json` gave; an empty document is the start."""
        if not document:
            return cls()
        parts: dict[str, Any] = {**document, "candidates": [Point(**point) for point in document["candidates"]]}
        if document["last"]:
            parts["last"] = Point(**document["last"])
        if document["trip"]:
            parts["trip"] = TripTotals(**document["trip"])
        return cls(**parts)


@dataclass(slots=True)
class TripPiece:
    """What a fold adds to one trip: its totals now, whether it is over, and the new points."""

    totals: TripTotals
    continued: bool
    """Whether the trip was open before this fold began."""
    over: bool = False
    points: list[Point] = field(default_factory=list[Point])


class Track:
    """Folds the batches of one boot in their order; afterwards `pieces` and `state` are the result."""

    def __init__(self, state: TrackState) -> None:
        self.state = state
        self.pieces: list[TripPiece] = []
        if state.trip is not None:
            self.pieces.append(TripPiece(state.trip, continued=True))

    def add(self, sequence: int, column_sha256: str, gnss: Gnss) -> None:
        """Continue with the next batch."""
        state = self.state
        hashed = state.trip
        if hashed is not None:
            hashed.add_input(column_sha256)
        for point in seconds(gnss, state.second):
            state.second = math.floor(point.t)
            self._step(point)
            if state.trip is not None and state.trip is not hashed:
                hashed = state.trip
                hashed.add_input(column_sha256)
            state.last = point
        state.sequence = sequence
        state.given_up = False

    def _step(self, point: Point) -> None:
        state = self.state
        trip = state.trip
        if trip is not None and point.t - trip.moved_at > REST_S:
            self.pieces[-1].over = True
            state.trip = trip = None
        speed = speed_at(point, state.last)
        if trip is not None:
            self._extend(trip, point, speed)
        elif speed <= MOVING_MPS or (state.last is not None and point.t - state.last.t > LOSE_S):
            state.candidates = [point] if speed > MOVING_MPS else []
        else:
            state.candidates.append(point)
            if point.t - state.candidates[0].t >= CONFIRM_S:
                self._begin()

    def _begin(self) -> None:
        first, *further = self.state.candidates
        self.state.candidates = []
        trip = TripTotals(first.t, first.t, moved_at=first.t, anchor_lat=first.lat, anchor_lon=first.lon)
        trip.max_speed = first.speed or 0.0
        self.state.trip = trip
        self.pieces.append(TripPiece(trip, continued=False, points=[first]))
        self.state.last = first
        for point in further:
            self._extend(trip, point, speed_at(point, self.state.last))
            self.state.last = point

    def _extend(self, trip: TripTotals, point: Point, speed: float) -> None:
        last = self.state.last
        assert last is not None
        step = point.t - last.t
        stands = speed < STANDING_MPS
        if stands and trip.standing:
            pass  # summed up, the noise of a standing receiver would grow into metres
        elif step <= BRIDGE_S and last.speed is not None and point.speed is not None:
            trip.distance_m += 0.5 * (last.speed + point.speed) * step
        else:
            trip.distance_m += distance(last.lat, last.lon, point.lat, point.lon)
        chord = distance(trip.anchor_lat, trip.anchor_lon, point.lat, point.lon)
        if chord >= CHORD_M:
            trip.position_distance_m += chord
            trip.anchor_lat, trip.anchor_lon = point.lat, point.lon
        if speed > MOVING_MPS:
            trip.moving_s += min(step, BRIDGE_S)
            trip.moved_at = point.t
            trip.max_speed = max(trip.max_speed, speed)
        if not (stands and trip.standing):
            self.pieces[-1].points.append(point)
            trip.t_last = point.t
        trip.standing = stands


def seconds(gnss: Gnss, after: int | None) -> Iterator[Point]:
    """The first usable fix of each whole second later than `after`."""
    usable = gnss.fix & np.isfinite(gnss.lat) & np.isfinite(gnss.lon)
    second = np.floor(gnss.t).astype(np.int64)
    if after is not None:
        usable &= second > after
    at = np.flatnonzero(usable)
    at = at[np.diff(second[at], prepend=np.iinfo(np.int64).min // 2) > 0]
    for row in zip(
        *(getattr(gnss, name)[at].tolist() for name in ("t", "lat", "lon", "alt", "speed", "course")), strict=True
    ):
        t, lat, lon, *rest = row
        alt, speed, course = (value if math.isfinite(value) else None for value in rest)
        yield Point(t, lat, lon, alt, speed, course)


def speed_at(point: Point, last: Point | None) -> float:
    """Speed of a point, from the way since the last one where the fix has none, m/s."""
    if point.speed is not None:
        return point.speed
    if last is None:
        return 0.0
    return distance(last.lat, last.lon, point.lat, point.lon) / (point.t - last.t)


def distance(lat1: float, lon1: float, lat2: float, lon2: float) -> float:
    """Great-circle distance on the mean sphere, m; 0.5 % is far below what the check looks for."""
    a = math.sin(0.5 * (lat2 - lat1)) ** 2 + math.cos(lat1) * math.cos(lat2) * math.sin(0.5 * (lon2 - lon1)) ** 2
    return 2.0 * EARTH_M * math.asin(math.sqrt(min(1.0, a)))
