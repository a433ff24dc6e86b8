"""What a satellite receiver does wrong, told from its own fixes: slow, frozen, late, in a wrong unit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.mounting.reasons import reason
from nav_core.records import Gnss, Reason
from nav_core.rotation import wrap
from nav_core.timebase import STANDING, stale
from nav_core.typing import Flags, Floats

SLOW_FIXES = 1.3
"""Hz; up to here named as slow."""

FROZEN = 3.0
"""Repeated fixes that last this long are named, s."""

LATE = 0.8
"""A receiver later than this is named, s."""


def slow_fixes(gnss: Gnss) -> Reason | None:
    """Whether the receiver is slow.

    Parameters
    ----------
    gnss : Gnss
        Of a recording.

    Returns
    -------
    Reason or None
        None of a rate that is high enough, or of too few fixes.
    """
    t = gnss.t[gnss.fix & ~stale(gnss)]
    if t.size < 10:
        return None
    rate = 1.0 / float(np.median(np.diff(t)))
    return reason("slow_gps", f"{rate:.2g}") if rate < SLOW_FIXES else None


class Repeats(NamedTuple):
    """How long a receiver has repeated old fixes."""

    since: float = -np.inf
    """Box time of the latest fix that carried news, s."""
    until: float = -np.inf
    """Of the latest fix, s."""
    lost: float = 0.0
    """By repeats of at least `FROZEN` before `since`, s."""
    dated: bool = False
    """Whether the receiver's time has been seen to go on: one that never did accuses no parked vehicle."""


def repeats_on(before: Repeats, gnss: Gnss, repeated: Flags | None = None) -> Repeats:
    """The same after more of the stream.

    Parameters
    ----------
    before : Repeats
        Of the fixes so far.
    gnss : Gnss
        Fixes that begin before the end of those, or later, and go on.
    repeated : ndarray of bool, shape (n,), optional
        Which of them are `stale`, where that is known already.

    Returns
    -------
    Repeats
    """
    new = gnss.t > before.until
    t = gnss.t[new]
    again = (stale(gnss) if repeated is None else repeated)[new]
    dated = before.dated or (gnss.utc is not None and bool((np.diff(gnss.utc) > 0.0).any()))
    news = np.flatnonzero(~again if dated else ~again | (gnss.speed[new] <= STANDING))
    if not news.size:
        return before._replace(until=float(t[-1]), dated=dated) if t.size else before
    lost = before.lost + _lost(before.since, float(t[news[0] - 1]) if news[0] else before.until)
    runs = t[news[1:] - 1] - t[news[:-1]]
    return Repeats(float(t[news[-1]]), float(t[-1]), lost + float(runs[runs >= FROZEN].sum()), dated)


def frozen(told: Repeats) -> Reason | None:
    """Whether the receiver repeated old fixes for long.

    Parameters
    ----------
    told : Repeats
        Of a recording or a stream.

    Returns
    -------
    Reason or None
        With the time that was lost, s; None where there was none.
    """
    lost = told.lost + _lost(told.since, told.until)
    return reason("gps_frozen", f"{lost:.0f}") if lost > 0.0 else None


def _lost(since: float, until: float) -> float:
    return until - since if until - since >= FROZEN else 0.0


def late(speed_lag: float | None, course_lag: float | None) -> tuple[Reason, ...]:
    """Whether the receiver is late, from lags that are known, s.

    Parameters
    ----------
    speed_lag, course_lag : float or None
        s; None where unknown.

    Returns
    -------
    tuple of Reason
        One or none.
    """
    worst = max(speed_lag or 0.0, course_lag or 0.0)
    return (reason("gps_late", f"{worst:.1f}"),) if worst > LATE else ()


EARTH_RADIUS = 6.371e6
"""m."""

CHORD = 5.0
"""Positions are compared over pieces of box time of this length, s."""

UNDER_WAY = 3.0
"""Chords travelled faster than this, m/s, stand out of the positions' errors."""

REMEMBERED = 60
"""So many chords are kept of a stream."""

LEAST_CHORDS = 6
"""Fewer do not tell a unit."""

SPEED_UNITS = {
    "km/h": 3.6,
    "knots": 3600.0 / 1852.0,
    "miles an hour": 3600.0 / 1609.344,
    "feet a second": 1.0 / 0.3048,
    "cm/s": 100.0,
    "mm/s": 1000.0,
}
"""How many make 1 m/s."""

SPEED_SHARE = 0.06
"""By how much of it a unit may be missed: the nearest two are 9 % apart."""

ALIKE = 1.25
"""Most by which the upper quartile of the ratios exceeds the lower where it is a matter of unit."""

LEAST_COURSES = 10
"""Fewer chords with a course do not tell what it means."""

ASTRAY = 0.25
LATE_IN_BENDS = 0.8
"""A course is asked for its meaning where half of it is off the chords by more than the first, rad; the right meaning
leaves half as much or less, and less than the second: a receiver 2 s late in a roundabout."""

BEYOND = 2.0 * np.pi + 0.1
"""No course in rad is larger, unless it counts turns on."""

WINDING = 0.1
"""A road whose directions scatter by less (1 less the length of their mean) does not tell which way its course is
counted."""


class Chords(NamedTuple):
    """What the receiver says of pieces of `CHORD` seconds: its positions, and beside them speed and course."""

    t: Floats
    """Box time of the end, s, shape (k,)."""
    way: Floats
    """By the positions, m."""
    bearing: Floats
    """By the positions, rad clockwise from north."""
    told: Floats
    """By the speed: its integral, m if it is in m/s."""
    course: Floats
    """At the middle, as sent; NaN where unknown."""


NO_CHORDS = Chords(*np.empty((5, 0)))


def chords(gnss: Gnss, after: float = -np.inf, repeated: Flags | None = None) -> Chords:
    """What the fixes say of each piece of box time that they cover.

    Parameters
    ----------
    gnss : Gnss
    after : float
        Box time; only pieces that end later, s.
    repeated : ndarray of bool, shape (n,), optional
        Which fixes are `stale`, where that is known already.

    Returns
    -------
    Chords
        In order of time.  The way is that of an arc through three positions.
    """
    good = gnss.fix & np.isfinite(gnss.lat) & np.isfinite(gnss.lon) & np.isfinite(gnss.speed)
    good &= ~(stale(gnss) if repeated is None else repeated)
    t, speed = gnss.t[good], gnss.speed[good]
    starts = np.flatnonzero(np.diff(np.floor(t / CHORD), prepend=-np.inf) > 0.0)
    first, last = starts[:-1], starts[1:]
    middle = np.searchsorted(t, 0.5 * (t[first] + t[last]))
    kept = (t[last] > after) & (np.abs(t[last] - t[first] - CHORD) < 0.3 * CHORD) & (middle > first) & (middle < last)
    first, middle, last = first[kept], middle[kept], last[kept]
    lat, lon = gnss.lat[good], gnss.lon[good]
    north = EARTH_RADIUS * np.stack([lat[middle] - lat[first], lat[last] - lat[first]])
    east = np.stack([wrap(lon[middle] - lon[first]), wrap(lon[last] - lon[first])]) * np.cos(lat[first]) * EARTH_RADIUS
    whole = np.hypot(east[1], north[1])
    halves = np.hypot(east[0], north[0]) + np.hypot(east[1] - east[0], north[1] - north[0])
    run = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(t))])[: t.size]
    return Chords(
        t[last],
        # Two halves of an arc miss a quarter of what the whole chord misses.
        (4.0 * halves - whole) / 3.0,
        np.arctan2(east[1], north[1]),
        run[last] - run[first],
        gnss.course[good][middle],
    )


def followed_on(before: Chords, gnss: Gnss, repeated: Flags | None = None) -> Chords:
    """The latest `REMEMBERED` chords after more of the stream.

    Parameters
    ----------
    before : Chords
        Of the fixes so far.
    gnss : Gnss
        Fixes that begin before the end of the last of them, or later, and go on.
    repeated : ndarray of bool, shape (n,), optional
        Which of them are `stale`, where that is known already.

    Returns
    -------
    Chords
        `before` itself where there is no new one.
    """
    new = chords(gnss, float(before.t[-1]) if before.t.size else -np.inf, repeated)
    if not new.t.size:
        return before
    return Chords(*(np.concatenate(pair)[-REMEMBERED:] for pair in zip(before, new, strict=True)))


def wrong_gps_unit(told: Chords) -> Reason | None:
    """In what unit the receiver sends speed or course instead of m/s and rad, by its own positions.

    Parameters
    ----------
    told : Chords
        Of the drive so far.

    Returns
    -------
    Reason or None
        ``gps_speed_unit`` or ``gps_course_unit``; None of a receiver that fits its positions, or neither them nor any
        unit.
    """
    moving = (told.way > UNDER_WAY * CHORD) & (told.told > 0.0)
    if np.count_nonzero(moving) < LEAST_CHORDS:
        return None
    low, middle, high = np.percentile(told.told[moving] / told.way[moving], [25.0, 50.0, 75.0])
    if high < ALIKE * low:
        for name, many in SPEED_UNITS.items():
            if abs(middle / many - 1.0) < SPEED_SHARE:
                return reason("gps_speed_unit", name)
    known = moving & np.isfinite(told.course)
    return _wrong_course(told.course[known], told.bearing[known])


def _wrong_course(course: Floats, bearing: Floats) -> Reason | None:
    """What is sent as course, beside the bearings that it should be."""
    if course.size < LEAST_COURSES:
        return None
    as_it_is = _misfit(course, bearing)
    beyond = bool(np.abs(course).max() > BEYOND)
    winding = 1.0 - abs(np.exp(1j * bearing).mean()) > WINDING
    meanings = [("in degrees", np.radians(course))] if beyond else []
    if winding:
        meanings += [
            ("counter-clockwise from east", 0.5 * np.pi - course),
            ("counter-clockwise from north", -course),
        ]
    if as_it_is < ASTRAY or not meanings:
        return None
    misfit, name = min((_misfit(meant, bearing), name) for name, meant in meanings)
    return reason("gps_course_unit", name) if misfit < min(LATE_IN_BENDS, 0.5 * as_it_is) else None


def _misfit(course: Floats, bearing: Floats) -> float:
    """Median angle between two directions, rad."""
    return float(np.median(np.abs(wrap(course - bearing))))
