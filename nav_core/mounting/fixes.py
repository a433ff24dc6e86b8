"""What the satellite receiver said of a drive: its usable fixes, and rates of change from them."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from nav_core.records import Gnss
from nav_core.signal import first_not_before
from nav_core.timebase import stale
from nav_core.typing import Flags, Floats

FOLLOW_SPEED = 2.0
"""Course is used above this speed, m/s."""


COARSE = 60.0
"""Half width of the means that divide a road's slope between force and height, s."""


class _Columns(NamedTuple):
    t: Floats
    """Box time of arrival, s, shape (n,)."""
    speed: Floats
    course: Floats
    """rad, NaN where the receiver cannot know it."""
    alt: Floats
    """m, NaN where unknown."""


class Fixes(_Columns):
    """Usable fixes of a drive: repeats and crowding removed.

    What follows from them alone is worked out once, however often a record is evaluated.
    """

    @cached_property
    def acceleration(self) -> Floats:
        """Rate of change of the speed, m/s², shape (n,)."""
        return gps_rate(self.t, self.speed)

    @cached_property
    def turn_rate(self) -> Floats:
        """Rate of change of the course, rad/s, shape (n,)."""
        return gps_rate(self.t, unrolled(self.course))

    @cached_property
    def rise(self) -> Floats:
        """Slope of the road by height over a minute or two, rad, uphill positive, shape (n,)."""
        way = np.cumsum(self.speed * np.diff(self.t, prepend=self.t[0]))
        pace = gps_rate(self.t, way, COARSE)
        return np.where(pace > 2.0, gps_rate(self.t, self.alt, COARSE) / np.maximum(pace, 2.0), 0.0)


SPACING = 0.18
LONG = 800.0
LONG_SPACING = 0.45
"""Least time between fixes, s, up to a duration of `LONG` seconds and beyond: a long drive has fixes to spare.  At a
quarter of an hour the yaw's error is within a tenth of what all fixes give, in two thirds of the time."""


def usable_fixes(gnss: Gnss, *, thinned: bool = True) -> Fixes:
    """Fixes that carry news, without crowding: half of the error of velocity is common to neighbours.

    Parameters
    ----------
    gnss : Gnss
    thinned : bool
        Leave out what crowds; all fixes know a little more and cost more.

    Returns
    -------
    Fixes
    """
    good = gnss.fix & np.isfinite(gnss.speed) & ~stale(gnss)
    # Columns that condemn most of a drive say more about themselves: some receivers fill them with a constant.
    placed = good & ~gnss.poorly_placed()
    if 2 * np.count_nonzero(placed) >= np.count_nonzero(good):
        good = placed
    t, speed, course, alt = gnss.t[good], gnss.speed[good], gnss.course[good], gnss.alt[good]
    if thinned and t.size > 1:
        spacing = SPACING if t[-1] - t[0] < LONG else LONG_SPACING
        if np.median(np.diff(t)) < spacing:
            cell = np.floor(t / spacing).astype(np.int64)
            keep = np.concatenate([[True], np.diff(cell) > 0])
            t, speed, course, alt = t[keep], speed[keep], course[keep], alt[keep]
    course = np.where(speed > FOLLOW_SPEED, course, np.nan)
    return Fixes(t, speed, course, alt)


def gps_rate(t: Floats, values: Floats, reach: float = 1.0) -> Floats:
    """Rate of change of what the receiver says, over `reach` seconds either side, shape (n,).

    Parameters
    ----------
    t : ndarray, shape (n,)
        Box clock, s.
    values : ndarray, shape (n,)
        In any unit; NaN where unknown.
    reach : float
        s.

    Returns
    -------
    ndarray, shape (n,)
        That unit per s.
    """
    known = np.isfinite(values)
    if known.sum() < 2:
        return np.zeros(t.size)
    reach = max(reach, 1.01 * float(np.median(np.diff(t))))
    ahead = np.interp(t + reach, t[known], values[known])
    behind = np.interp(t - reach, t[known], values[known])
    return (ahead - behind) / (2.0 * reach)


def followed(fixes: Fixes, when: Floats, longest: float) -> Flags:
    """Whether the receiver gave a course shortly before or after, shape (m,).

    Parameters
    ----------
    fixes : Fixes
        n of them.
    when : ndarray, shape (m,)
        Box clock of the fixes, not decreasing, s.
    longest : float
        How long before or after, s.

    Returns
    -------
    ndarray of bool, shape (m,)
    """
    known = np.concatenate([[-np.inf], fixes.t[np.isfinite(fixes.course)], [np.inf]])
    after = first_not_before(known, when)
    near: Flags = np.minimum(when - known[after - 1], known[after] - when) <= longest
    return near


def clear_part(rate: Floats, noise: Floats | float) -> Floats:
    """A rate of change (`gps_rate`) where it stands out of the receiver's `noise` (1 sigma), else nothing, shape (n,).

    The derivatives to lags and suspension gains are taken from this.  The accelerometer would not
    do: it feels slope and bank as well, and a highway has more of those than of acceleration.  Nor
    would the bare rate: its noise would pass for knowledge of the lag.

    Parameters
    ----------
    rate : ndarray, shape (n,)
        In any unit per s.
    noise : ndarray or float, shape (n,)
        Of what changes, in that unit; one number for all fixes will do.

    Returns
    -------
    ndarray, shape (n,)
        That unit per s.
    """
    doubt = 2.0 * noise / np.sqrt(2.0)
    return rate * np.clip(1.0 - (doubt / np.maximum(np.abs(rate), 1e-9)) ** 2, 0.0, 1.0)


def unrolled(course: Floats) -> Floats:
    """Course without jumps at north; NaN stay.

    Parameters
    ----------
    course : ndarray, shape (n,)
        rad.

    Returns
    -------
    ndarray, shape (n,)
        rad, no longer within one turn.
    """
    known = np.isfinite(course)
    out = course.copy()
    out[known] = np.unwrap(course[known])
    return out
