"""From ticks and fixes to the rows of the online estimator: what is known at each fix, free of any mounting.

A fix is worked off once the receiver has been heard for `HORIZON` seconds more: only then are its
acceleration and turn rate known from both sides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.mounting.fixes import Fixes, clear_part, gps_rate, unrolled, usable_fixes
from nav_core.mounting.online_model import (
    ACCELERATION,
    BROKEN,
    COVERED,
    ELAPSED,
    FORCE,
    FORCE_PER_SPEED,
    GPS_CHANGE,
    GPS_COURSE,
    GPS_HEIGHT,
    GPS_SPEED,
    GRAVITY,
    GYRO,
    GYRO_PER_SPEED,
    N_COLUMNS,
    PER_SPEED,
    SIDE,
    SQUARE_ALONG,
    SQUARE_TURN,
    STANDING,
    TRACK_LOST,
    TURN_RATE,
    TURNED,
    WAY,
    Tuning,
)
from nav_core.mounting.stretch import Record, at, gained_between, prepare
from nav_core.records import Gnss
from nav_core.signal import Ticks
from nav_core.typing import Flags, Floats, Integers

HORIZON = 1.0
"""How long after a fix it is worked off, s: the reach of its rates."""

KEEP = 6.0
"""How much of the raw stream before the last fix a state carries, s."""

SLOWEST = 1.0
"""Least divisor, m/s."""

REST = 0.3
"""Standing: no fix within `HORIZON` is faster, m/s."""

CREEP = 3.0
"""A vehicle that has stood and has not been faster than this since may be going backwards, m/s: what the receiver
says of speed and course is the same both ways."""

STOOD = 0.8
"""So slow, a receiver of one fix a second may have missed a stand, m/s."""

LONGEST_STEP = 3.0
"""Between courses further apart the track is not followed, s."""


class Place(NamedTuple):
    """How far the stream has been worked off.

    Attributes
    ----------
    fix : float
        Box time of the last fix worked off, s.
    speed_at, course_at : float
        Moments at which speed and track of the filter stand, s.
    speed, course : float
        What that fix said.
    creeping : bool
        Whether the vehicle may be going backwards, see `CREEP`.
    """

    fix: float
    speed_at: float
    course_at: float
    speed: float
    course: float
    creeping: bool = True


def ready_fixes(fixes: Fixes, after: float, heard: float) -> Flags:
    """Fixes after a box time that can be worked off when the stream has been heard until `heard`, shape (n,).

    Parameters
    ----------
    fixes : Fixes
        n of them.
    after, heard : float
        Box clock, s.

    Returns
    -------
    ndarray of bool, shape (n,)
        In order.
    """
    return (fixes.t > after) & (fixes.t + HORIZON <= heard + 1e-9)


def rows_of(
    record: Record, spin: Record | None, place: Place | None, ready: Flags, lags: tuple[float, float], tuning: Tuning
) -> tuple[Floats, Place]:
    """Rows of the fixes that are ready.

    Parameters
    ----------
    record : Record
        Ticks and fixes from some seconds before the first ready fix to `HORIZON` after the last.
    spin : Record, optional
        The gyro's ticks in place of the specific force.
    place : Place, optional
        None at the begin of the stream: the first row then only starts the filter.
    ready : ndarray of bool, shape (n,)
        At least one.
    lags : tuple of float
        Of GPS speed and course, s, at which the fixes are taken.
    tuning : Tuning

    Returns
    -------
    rows : ndarray, shape (k, 30)
    Place
        After the last row.
    """
    fixes = record.fixes
    take: Integers = np.flatnonzero(ready)
    t, speed, course = fixes.t[take], fixes.speed[take], fixes.course[take]
    a = gps_rate(fixes.t, fixes.speed, HORIZON)
    w = gps_rate(fixes.t, unrolled(fixes.course), HORIZON)
    across = tuning.across_white / np.maximum(fixes.speed, SLOWEST)
    if place is None:
        place = Place(t[0], t[0] - lags[0], t[0] - lags[1], float(speed[0]), float(course[0]))
    when, when_course = t - lags[0], t - lags[1]
    rows = np.full((take.size, N_COLUMNS), np.nan)
    elapsed = np.diff(when, prepend=place.speed_at)
    before = np.append(place.speed, speed[:-1])
    rows[:, ELAPSED], rows[:, GPS_CHANGE] = elapsed, speed - before
    rows[:, WAY] = np.maximum(0.5 * (speed + before) * elapsed, 0.0)
    rows[:, GPS_SPEED], rows[:, GPS_HEIGHT], rows[:, GPS_COURSE] = speed, fixes.alt[take], course

    edges = np.append(place.speed_at, when)
    gains = gained_between(record, edges, [np.ones(record.t.size), *record.f.T])
    rows[:, COVERED], rows[:, FORCE : FORCE + 3] = gains[:, 0], gains[:, 1:]
    creeping = _creeping(speed, creeping=place.creeping)
    standing = _standing(fixes, take)
    backwards = np.append(place.creeping, creeping[:-1]) & ~standing
    rows[:, BROKEN] = (np.abs(elapsed - rows[:, COVERED]) > 0.15) | backwards
    known = np.isfinite(w) & (fixes.speed > SLOWEST)
    side = np.where(known, w, 0.0)
    squares = np.column_stack([a**2 / GRAVITY, (fixes.speed * side) ** 2 / GRAVITY, side**2])
    middle = np.clip(take - 1, 0, None)
    rows[:, SQUARE_ALONG : SQUARE_TURN + 1] = 0.5 * (squares[take] + squares[middle]) * elapsed[:, None]
    rows[:, ACCELERATION] = clear_part(fixes.acceleration, tuning.speed_white)[take]
    rows[:, TURN_RATE] = clear_part(fixes.turn_rate, across)[take]

    edges = np.append(place.course_at, when_course)
    apart = np.diff(edges)
    inverse = 1.0 / np.maximum(np.interp(record.t + lags[0], fixes.t, fixes.speed), SLOWEST)
    rows[:, FORCE_PER_SPEED : PER_SPEED + 1] = gained_between(record, edges, [*(record.f.T * inverse), inverse])
    rows[:, TURNED] = rows[:, TURN_RATE] * apart
    rows[:, SIDE] = (a * side / np.maximum(fixes.speed, SLOWEST) ** 2)[take] * apart
    last_course = np.append(place.course, course[:-1])
    rows[:, TRACK_LOST] = (apart > LONGEST_STEP) | np.isnan(course) | np.isnan(last_course) | (rows[:, BROKEN] > 0.0)
    rows[:, STANDING] = standing
    if spin is not None and spin.t.size > 1:
        _add_gyro(rows, spin, edges, lags[0], fixes)
    last = float(speed[-1]), float(course[-1]), bool(creeping[-1])
    return rows, Place(float(t[-1]), float(when[-1]), float(when_course[-1]), *last)


def _creeping(speed: Floats, *, creeping: bool) -> Flags:
    """Whether the vehicle has stood and has not been faster than `CREEP` since, at each fix; `creeping` before them."""
    index = np.arange(speed.size)
    stood = np.maximum.accumulate(np.where(speed < STOOD, index, -1))
    fast = np.maximum.accumulate(np.where(speed > CREEP, index, -1))
    return np.where((stood < 0) & (fast < 0), creeping, stood > fast)


def _standing(fixes: Fixes, take: Integers) -> Flags:
    """Whether no fix near enough is faster than `REST`."""
    fast = np.concatenate([[0], np.cumsum(fixes.speed > REST)])
    first = np.searchsorted(fixes.t, fixes.t[take] - HORIZON)
    last = np.searchsorted(fixes.t, fixes.t[take] + HORIZON, side="right")
    return fast[last] == fast[first]


def _add_gyro(rows: Floats, spin: Record, edges: Floats, lag: float, fixes: Fixes) -> None:
    """Integrated rates, where the gyro covers the step."""
    gains = gained_between(spin, edges, [np.ones(spin.t.size), *spin.f.T])
    whole = np.abs(gains[:, 0] - np.diff(edges)) < 0.15
    inverse = 1.0 / np.maximum(np.interp(edges + lag, fixes.t, fixes.speed), SLOWEST)
    change = np.diff(at(spin, edges, spin.f) * inverse[:, None], axis=0)
    rows[whole, GYRO : GYRO + 3] = gains[whole, 1:]
    rows[whole, GYRO_PER_SPEED : GYRO_PER_SPEED + 3] = change[whole]


def records_of(ticks: Ticks, spin: Ticks | None, gnss: Gnss) -> tuple[Record, Record | None]:
    """Ticks and usable fixes of a stretch of the stream, prepared; the gyro's in a record of their own.

    Parameters
    ----------
    ticks : Ticks
        Of the specific force, A-frame, m/s².
    spin : Ticks or None
        Of the angular rate, A-frame, rad/s; None without gyro.
    gnss : Gnss
        The fixes of the stretch.

    Returns
    -------
    force : Record
        m/s².
    spin : Record or None
        rad/s.
    """
    fixes = usable_fixes(gnss)
    return prepare(ticks, fixes), None if spin is None else prepare(spin, fixes)


def window(record: Record, begin: float, end: float) -> Record:
    """A stretch of a record, with the steps of its ticks as they were; ticks from `KEEP` earlier on.

    Parameters
    ----------
    record : Record
    begin, end : float
        Box time, s.

    Returns
    -------
    Record
        Views.
    """
    fixes = slice(*np.searchsorted(record.fixes.t, [begin, end]).tolist())
    ticks = slice(*np.searchsorted(record.t, [begin - KEEP, end]).tolist())
    return Record(
        record.t[ticks],
        record.f[ticks],
        record.step[ticks],
        Fixes(*(column[fixes] for column in record.fixes)),
        record.density[ticks],
    )
