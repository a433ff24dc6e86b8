"""The blow in the V axes held at time zero: attitude before it, axes through it, its integral.

With a gyro the axes are carried by the turn since `t0`; without one they are the box's own, turning with the vehicle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.crash.gps_change import LEVEL, LOOK_BACK, Level
from nav_core.earth import STANDARD_GRAVITY
from nav_core.events.level import Gravity, gravity_before
from nav_core.events.trigger import Stream, Window, integrate
from nav_core.rotation import product, quaternion_to_matrix, rotvec_to_quaternion
from nav_core.typing import Floats

MARGIN = 0.005
"""Gravity and bias are taken until this long before `t0`, s."""


def steady_before(stream: Stream, t0: float, level: Level | None, tilt: float | None) -> Gravity:
    """Gravity and bias from the seconds before the blow.

    Parameters
    ----------
    stream : Stream
    t0 : float
        Box clock, s.
    level : Level, optional
        What the fixes tell of it.
    tilt : float, optional
        1 sigma of how upright the V axes are, rad; None where they are not known to be.

    Returns
    -------
    Gravity
        Without fixes, by `gravity_before`.
    """
    first, last = np.searchsorted(stream.t, [t0 - LOOK_BACK, t0 - MARGIN])
    if level is not None and last > first:
        span = float(stream.t[last - 1] - stream.t[first])
        return Gravity(np.array([*level.f, stream.f[first:last, 2].mean()]), max(level.sigma, LEVEL), span)
    gravity = gravity_before(stream, t0 - MARGIN, tilt)
    if gravity is not None:
        return gravity
    near = int(np.searchsorted(stream.t, t0))
    upright = np.array([0.0, 0.0, -STANDARD_GRAVITY])
    return Gravity(stream.rest[min(near, stream.t.size - 1)] if stream.t.size else upright, 0.6, 0.0)


def turn_since(t: Floats, w: Floats) -> Floats:
    """Attitude relative to the first sample, shape (n, 3, 3), from angular rates (n, 3), rad/s, in body axes.

    The quaternions of the steps are multiplied up by doubling: n log n products in array code.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Increasing, s.
    w : ndarray, shape (n, 3)
        Angular rate, rad/s, body axes.

    Returns
    -------
    ndarray, shape (n, 3, 3)
        From the body's axes at each sample to those at the first.
    """
    step = np.diff(t, prepend=t[:1])[:, None]
    middle = np.concatenate([w[:1], 0.5 * (w[1:] + w[:-1])])
    q = rotvec_to_quaternion(middle * step)
    shift = 1
    while shift < q.shape[0]:
        q = np.concatenate([q[:shift], product(q[:-shift], q[shift:])])
        shift *= 2
    return quaternion_to_matrix(q)


GYRO_GAP = 0.02
"""A gyro that misses more than this of a blow does not tell how its axes turned, s."""


class Blow(NamedTuple):
    """Samples around a blow in the V axes at time zero.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Box clock, s.
    zero, end, last : int
        Of `t`: time zero, end of event, end of integration.
    C : ndarray, shape (n, 3, 3)
        V axes at time zero from V axes now; identity without a gyro.
    a : ndarray, shape (n, 3)
        Acceleration as recorded, V axes at time zero, m/s².
    v : ndarray, shape (n, 3)
        Its integral from time zero, m/s; negative times have what was missed before.
    step : ndarray, shape (n,)
    w : ndarray, shape (n, 3), optional
        V axes now, rad/s; None, too, where too many are missing in the blow.
    gyro_gap : float
        Longest time within the blow between two rates of a gyro that has usually less, s; else 0.
    """

    t: Floats
    zero: int
    end: int
    last: int
    C: Floats
    a: Floats
    v: Floats
    step: Floats
    w: Floats | None
    gyro_gap: float

    def velocity(self, a: Floats) -> Floats:
        """Integral from time zero of accelerations on these samples, shape (n, 3).

        Parameters
        ----------
        a : ndarray, shape (n, 3)
            m/s², in V axes at time zero.

        Returns
        -------
        ndarray, shape (n, 3)
            m/s, 0 at time zero.
        """
        v = integrate(a, self.step)
        return v - v[self.zero]


def blow_of(stream: Stream, window: Window, steady: Gravity, w_v: Floats | None, *, margin: float, tail: float) -> Blow:
    """The samples from `margin` before time zero to `tail` after the end of integration, s.

    `window` is of the stream; `w_v` (n, 3) are the stream's angular rates in V, NaN where not sampled, or None.

    Parameters
    ----------
    stream : Stream
        Specific force, V axes, m/s².
    window : Window
        Indices into `stream` of time zero, the end, and the end of integration.
    steady : Gravity
        Specific force just before, V axes, m/s²: taken off.
    w_v : ndarray, shape (m, 3) or None
        Angular rate at the samples of `stream`, rad/s, V axes.
    margin, tail : float
        s.

    Returns
    -------
    Blow
        Accelerations in V axes at time zero, m/s².
    """
    t = stream.t
    first = int(np.searchsorted(t, t[window.zero] - margin))
    stop = int(np.searchsorted(t, t[window.last] + tail, side="right"))
    part = slice(first, stop)
    zero = window.zero - first
    f, step = stream.f[part], stream.step[part]
    w, gyro_gap = None, 0.0
    if w_v is not None and np.isfinite(w_v[part]).all(axis=1).any():
        gyro_gap, usual = _unturned(t[part], w_v[part], float(t[window.zero]), float(t[window.last]))
        if gyro_gap <= max(GYRO_GAP, 2.5 * usual):
            w = _filled(t[part], w_v[part])
        if gyro_gap <= 2.5 * usual:
            gyro_gap = 0.0
    since = np.broadcast_to(np.eye(3), (f.shape[0], 3, 3)) if w is None else turn_since(t[part], w)
    C = since[zero].T @ since
    a = np.einsum("nij,nj->ni", C, f) - steady.f
    v = integrate(a, step)
    return Blow(t[part], zero, window.end - first, window.last - first, C, a, v - v[zero], step, w, gyro_gap)


def _unturned(t: Floats, w: Floats, begin: float, end: float) -> tuple[float, float]:
    """Longest time without a rate between two moments, and the usual one, s."""
    known = t[np.isfinite(w).all(axis=1)]
    usual = float(np.median(np.diff(known))) if known.size > 1 else float(t[-1] - t[0])
    edges = np.concatenate([t[:1] - usual, known, t[-1:] + usual])
    across = (edges[1:] > begin) & (edges[:-1] < end)
    return float(np.diff(edges)[across].max(initial=0.0)), usual


def _filled(t: Floats, w: Floats) -> Floats:
    """Rates with those not sampled taken from their neighbours."""
    known = np.isfinite(w).all(axis=1)
    if known.all():
        return w
    return np.column_stack([np.interp(t, t[known], w[known, axis]) for axis in range(3)])
