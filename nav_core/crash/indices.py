"""Severity indices by their standards, each only where the data allow.

ASI, THIV and PHD: EN 1317-1.  OLC: Euro NCAP TB 027.  Coefficients as in docs/crash.md; none of this is a claim of
conformity, which would need the standard's instruments and mounting as well.
"""

from __future__ import annotations

import numpy as np

from nav_core.crash.filters import ASI_CUTOFF, LEAST_RATE, cfc, low_pass, moving_mean
from nav_core.earth import STANDARD_GRAVITY
from nav_core.typing import Floats

ASI_LIMITS = np.array([12.0, 9.0, 10.0]) * STANDARD_GRAVITY

OLC_FREE, OLC_HELD = 0.065, 0.235
"""Way of the occupant before the restraint holds, and while it does, m."""

FLAIL = (0.6, 0.3)
"""Way of the theoretical head to the front and to the side, m."""

PHD_MEAN = 0.010
PHD_SAMPLES = 4


def asi_2010(a: Floats, rate: float) -> float:
    """Acceleration severity index by the 13 Hz filter (EN 1317-1:2010).

    Parameters
    ----------
    a : ndarray, shape (n, 3)
        Vehicle axes, gravity removed, m/s², evenly sampled.
    rate : float
        Hz.

    Returns
    -------
    float
        Without unit.

    Raises
    ------
    RateError
        Below 78 Hz.

    Notes
    -----
    The standard's CFC 180 before it is applied where the rate allows; at 13 Hz it changes nothing that can be seen.
    """
    if rate >= LEAST_RATE[180]:
        a = cfc(a, rate, 180)
    return _asi(low_pass(a, rate, ASI_CUTOFF))


def asi_1998(a: Floats, rate: float) -> float:
    """Acceleration severity index by the 50 ms mean (EN 1317-1:1998); arguments as `asi_2010`.

    Parameters
    ----------
    a : ndarray, shape (n, 3)
        Acceleration, vehicle axes, m/s²; evenly sampled.
    rate : float
        Hz.

    Returns
    -------
    float
        Without unit.
    """
    return _asi(moving_mean(a, rate, 0.050))


def _asi(a: Floats) -> float:
    return float(np.sqrt(((a / ASI_LIMITS) ** 2).sum(axis=1)).max())


def olc(t: Floats, lost: Floats) -> float | None:
    """Occupant load criterion (Euro NCAP TB 027).

    Parameters
    ----------
    t : ndarray, shape (n,)
        From time zero, s.
    lost : ndarray, shape (n,)
        Speed lost along the vehicle since time zero, ``V0 - v``, m/s.

    Returns
    -------
    float or None
        m/s².  None when the pulse is too weak, or recorded too short, for the occupant to use up the way.

    Notes
    -----
    ``int_0^t1 lost dt = 0.065 m``; between t1 and t2 the occupant slows evenly from V0 to ``v(t2)`` and gains
    0.235 m on the vehicle; ``OLC = lost(t2) / (t2 - t1)``.
    """
    way = np.concatenate([[0.0], np.cumsum(0.5 * (lost[1:] + lost[:-1]) * np.diff(t))])
    if way.max(initial=0.0) <= OLC_FREE:
        return None
    k = int(np.argmax(way > OLC_FREE))
    t1 = float(np.interp(OLC_FREE, way[k - 1 : k + 1], t[k - 1 : k + 1]))
    later = t > t1 + 1e-3
    held = way - OLC_FREE - 0.5 * lost * (t - t1)
    reached = np.flatnonzero(later & (held >= OLC_HELD))
    if reached.size == 0:
        return None
    j = int(reached[0])
    t2 = float(np.interp(OLC_HELD, held[j - 1 : j + 1], t[j - 1 : j + 1]))
    return float(np.interp(t2, t, lost)) / (t2 - t1)


def head(t: Floats, a: Floats, C: Floats, w: Floats) -> tuple[float | None, float | None]:
    """THIV and PHD: a free head in a vehicle that moves and turns (EN 1317-1).

    Parameters
    ----------
    t : ndarray, shape (n,)
        From time zero, s, evenly spaced.
    a : ndarray, shape (n, 3)
        V axes at time zero, gravity removed, m/s².
    C : ndarray, shape (n, 3, 3)
        V axes at time zero from V axes now.
    w : ndarray, shape (n, 3)
        Angular rate, V axes now, rad/s.

    Returns
    -------
    thiv : float or None
        m/s; None when the head reaches nothing within the record.
    phd : float or None
        m/s²; None also with fewer than four samples in its 10 ms mean.

    Notes
    -----
    The head starts at the box, which is taken to be where the vehicle turns about.
    """
    step = np.diff(t, prepend=t[:1])[:, None]
    v = np.cumsum(np.concatenate([a[:1] * 0.0, 0.5 * (a[1:] + a[:-1])]) * step, axis=0)
    x = np.cumsum(np.concatenate([v[:1] * 0.0, 0.5 * (v[1:] + v[:-1])]) * step, axis=0)
    seen = np.einsum("nji,nj->ni", C, -x)
    speed = np.einsum("nji,nj->ni", C, -v) - np.cross(w, seen)
    contact = (seen[:, 0] >= FLAIL[0]) | (seen[:, 0] <= -FLAIL[0]) | (np.abs(seen[:, 1]) >= FLAIL[1])
    if not contact.any():
        return None, None
    k = int(np.argmax(contact))
    thiv = float(np.hypot(speed[k, 0], speed[k, 1]))
    rate = 1.0 / float(np.median(np.diff(t)))
    if rate * PHD_MEAN < PHD_SAMPLES or t[-1] - t[k] < PHD_MEAN:
        return thiv, None
    force = moving_mean(np.hypot(a[k:, 0], a[k:, 1]), rate, PHD_MEAN)
    return thiv, float(force.max())
