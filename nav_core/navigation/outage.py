"""Stretches without GPS: where they are, how far astray the filter may be there, and how far it was."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from nav_core import earth
from nav_core.errors import RangeError, ShapeError
from nav_core.kalman import normalised
from nav_core.navigation.fixes import Receiver, believable
from nav_core.navigation.solution import Solution
from nav_core.records import Gnss
from nav_core.timebase import Gap, gaps
from nav_core.typing import Flags, Floats

SHORTEST = 3.0
"""Shorter stretches without a fix are no outage, s."""


def outages(gnss: Gnss, receiver: Receiver | None = None, *, shortest: float = SHORTEST) -> tuple[Gap, ...]:
    """Stretches between two believable fixes that are further apart than `shortest`, s.

    Parameters
    ----------
    gnss : Gnss
        Of a recording.
    receiver : Receiver, optional
        Its gates; the default's where not given.
    shortest : float
        s.

    Returns
    -------
    tuple of Gap
        Box clock, s.
    """
    return gaps(gnss.t[believable(gnss, receiver or Receiver())], shortest)


def hidden(gnss: Gnss, begin: float, end: float) -> Gnss:
    """The same fixes with none from `begin` to `end`, s: an outage to rehearse where the truth is known after all.

    Parameters
    ----------
    gnss : Gnss
        Of a recording.
    begin, end : float
        Box clock, s; `end` is not included.

    Returns
    -------
    Gnss
        `fix` false in between.
    """
    return replace(gnss, fix=gnss.fix & ~((gnss.t >= begin) & (gnss.t < end)))


class Miss(NamedTuple):
    """How far a solution lies from known positions.

    Attributes
    ----------
    error : ndarray, shape (k, 2)
        Known minus estimated, north and east, m.
    P : ndarray, shape (k, 2, 2)
        What the solution says of its covariance, m².
    """

    error: Floats
    P: Floats

    @property
    def distance(self) -> Floats:
        """m, shape (k,)."""
        return np.hypot(self.error[:, 0], self.error[:, 1])


def miss(solution: Solution, t: Floats, lat: Floats, lon: Floats) -> Miss:
    """Compare a solution with known positions at moments within it.

    Parameters
    ----------
    solution : Solution
    t, lat, lon : ndarray, shape (k,)
        s, rad, rad.

    Returns
    -------
    Miss
        The solution interpolated between its moments, the covariance of the moment before.

    Raises
    ------
    ShapeError
    RangeError
        A moment before the solution's begin or after its end.
    """
    if not t.shape == lat.shape == lon.shape:
        raise ShapeError("lat, lon", lat.shape, str(t.shape))
    for moment in (t.min(initial=solution.t[0]), t.max(initial=solution.t[-1])):
        if not solution.t[0] <= moment <= solution.t[-1]:
            raise RangeError("t", float(moment), f"{solution.t[0]:g}..{solution.t[-1]:g} s")
    meridian, normal = earth.radii(lat)
    height = np.interp(t, solution.t, solution.height)
    north = (lat - np.interp(t, solution.t, solution.lat)) * (meridian + height)
    east = lon - np.interp(t, solution.t, np.unwrap(solution.lon))
    east = (np.pi - np.mod(np.pi - east, 2.0 * np.pi)) * (normal + height) * np.cos(lat)
    before = np.searchsorted(solution.t, t, side="right") - 1
    return Miss(np.stack((north, east), axis=1), solution.P[before, :2, :2])


def inside(found: Miss, probability: float = 0.95) -> Flags:
    """Which errors lie within the solution's own horizontal ellipse of this probability, shape (k,).

    Parameters
    ----------
    found : Miss
        k errors with their covariances.
    probability : float
        Between 0 and 1.

    Returns
    -------
    ndarray of bool, shape (k,)
        In order.
    """
    return normalised(found.error, found.P) <= _bound(probability)


def radius(solution: Solution, probability: float = 0.95) -> Floats:
    """Long half axis of the horizontal ellipse of this probability at each moment, m, shape (n,).

    Parameters
    ----------
    solution : Solution
        n epochs.
    probability : float
        Between 0 and 1.

    Returns
    -------
    ndarray, shape (n,)
        m.
    """
    return np.sqrt(_bound(probability) * np.linalg.eigvalsh(solution.P[:, :2, :2])[:, 1])


def _bound(probability: float) -> float:
    from scipy.special import chdtri

    if not 0.0 < probability < 1.0:
        raise RangeError("probability", probability, "between 0 and 1")
    return float(chdtri(2, 1.0 - probability))
