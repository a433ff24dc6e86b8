"""Trips and track of the boots that got new data."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from server.jobs.mountings import vehicle_at
from server.jobs.results import Results, TrackRow
from server.jobs.situation import Situation
from server.jobs.stretch import Piece
from server.models import Boot, Trip, new_id
from server.trips.track import ALGORITHM, REST_S, Point, Track, TrackState, TripPiece, TripTotals

REMAP_S = 0.5
"""When a boot's clock moves by more than this and its own sigma, its trips are laid out anew."""


@dataclass(frozen=True, slots=True)
class StoredTrips:
    """Where stored trips and digests of a boot come from."""

    trip: Callable[[str], Trip | None]
    """One by its id."""
    trips: Callable[[str], Sequence[Trip]]
    """All of a boot, in the order of time."""
    pieces: Callable[[str, float], list[Piece]]
    """Digests of a boot that end after a box time."""


class Trips:
    """The trips of one device during one round."""

    def __init__(self, situation: Situation, stored: StoredTrips, results: Results) -> None:
        self._situation = situation
        self._stored = stored
        self._results = results

    def continue_boot(self, boot: Boot, new: Sequence[Piece]) -> None:
        """Fold the new batches of a boot in; from an earlier point again when they are not the last ones."""
        state = TrackState.from_json(boot.trip_state)
        pieces = sorted(new, key=lambda piece: piece.sequence)
        remapped = _is_remapped(boot, state)
        if remapped or pieces[0].sequence < state.sequence:
            self._again(boot, pieces, everything=remapped)
            return
        if state.utc_offset_s is None:
            state.utc_offset_s, state.utc_drift = boot.utc_offset_s, boot.utc_drift
        track = Track(state)
        for piece in pieces:
            track.add(piece.sequence, piece.column_sha256, piece.digest.gnss)
        for trip in track.pieces:
            self._store(boot, trip, self._stored.trip(trip.totals.id) if trip.continued else None)
        boot.trip_state = track.state.to_json()

    def _again(self, boot: Boot, new: Sequence[Piece], *, everything: bool) -> None:
        """Reckon anew from the last trip that the new batches cannot touch."""
        rows = self._stored.trips(boot.boot)
        earliest = min(piece.t_first_s for piece in new)
        kept = [] if everything else [trip for trip in rows if trip.t_last_s + REST_S < earliest]
        # What rests on data that are erased cannot be reckoned again: it stays, and so does what lies before it.
        erased = max((k for k, trip in enumerate(rows, 1) if trip.raw_erased_at is not None), default=0)
        kept = kept if len(kept) >= erased else list(rows[:erased])
        begin = kept[-1].t_last_s if kept else float("-inf")
        state = TrackState(
            second=int(begin // 1.0) if kept else None, utc_offset_s=boot.utc_offset_s, utc_drift=boot.utc_drift
        )
        track = Track(state)
        for piece in sorted([*self._stored.pieces(boot.boot, begin), *new], key=lambda piece: piece.sequence):
            track.add(piece.sequence, piece.column_sha256, piece.digest.gnss)
        replaced = list(rows[len(kept) :])
        self._results.replaced_trips += [trip.id for trip in replaced]
        for trip in track.pieces:
            same = next((old for old in replaced if _overlap(old, trip.totals)), None)
            if same is not None:
                replaced.remove(same)
                trip.totals.id = same.id
            self._store(boot, trip, None)
        boot.trip_state = track.state.to_json()

    def give_up(self, boot: Boot) -> None:
        """End what is under way in a boot: nothing tells that the vehicle still moves."""
        state = TrackState.from_json(boot.trip_state)
        if state.trip is None or state.given_up:
            return
        written = (row for row in self._results.rows if isinstance(row, Trip) and row.id == state.trip.id)
        row = next(written, None) or self._stored.trip(state.trip.id)
        if row is not None:
            row.under_way = False
            self._results.put(row)
            if not any(told.kind == "trip" and told.data["trip_id"] == row.id for told in self._results.announcements):
                self._announce(row)
        state.given_up = True
        boot.trip_state = state.to_json()
        self._results.put(boot)

    def _store(self, boot: Boot, piece: TripPiece, row: Trip | None) -> None:
        totals = piece.totals
        if row is None:
            totals.id = totals.id or new_id()
            began_at = boot.utc(totals.t_first)
            row = Trip(
                id=totals.id,
                organisation_id=self._situation.device.organisation_id,
                device_id=self._situation.device.id,
                vehicle_id=vehicle_at(self._situation.assignments, began_at),
                boot=boot.boot,
                t_first_s=totals.t_first,
            )
        row.began_at, row.ended_at = boot.utc(totals.t_first), boot.utc(totals.t_last)
        row.t_last_s = totals.t_last
        row.under_way = not piece.over
        row.distance_m, row.position_distance_m = totals.distance_m, totals.position_distance_m
        row.moving_s, row.max_speed_mps = totals.moving_s, totals.max_speed
        row.algorithm, row.input_sha256 = ALGORITHM, totals.input_sha256
        self._results.put(row)
        self._results.points += [_track_point(row.id, boot, point) for point in piece.points]
        self._announce(row)

    def _announce(self, row: Trip) -> None:
        self._results.announce("trip", row.vehicle_id, trip_id=row.id)


def has_rested(boot: Boot) -> bool:
    """Whether a boot's data go on for a rest's length after the last movement, with fixes or without."""
    trip = TrackState.from_json(boot.trip_state).trip
    return trip is not None and boot.t_last_s - trip.moved_at > REST_S


def _is_remapped(boot: Boot, state: TrackState) -> bool:
    if state.utc_offset_s is None:
        return False
    moved = boot.utc_offset_s - state.utc_offset_s + (boot.utc_drift - state.utc_drift) * boot.t_last_s
    return abs(moved) > max(REMAP_S, boot.utc_sigma_s)


def _overlap(old: Trip, totals: TripTotals) -> bool:
    return old.t_first_s <= totals.t_last and totals.t_first <= old.t_last_s


def _track_point(trip_id: str, boot: Boot, point: Point) -> TrackRow:
    return (
        trip_id,
        point.t,
        boot.utc(point.t),
        math.degrees(point.lat),
        math.degrees(point.lon),
        point.alt,
        point.speed,
        point.course,
    )
