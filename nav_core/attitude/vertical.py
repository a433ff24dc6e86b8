"""Gravity in vehicle axes, with the vehicle's own acceleration taken off by GPS speed (000 section 7.5)."""

from __future__ import annotations

import numpy as np

from nav_core.errors import ShapeError
from nav_core.typing import Floats, trailing


def vehicle_acceleration(u: Floats, u_rate: Floats, w_v: Floats) -> Floats:
    """Acceleration of a vehicle that moves along its own x axis only.

    Parameters
    ----------
    u, u_rate : ndarray, shape (...)
        Speed, m/s, and its derivative, m/s².
    w_v : ndarray, shape (..., 3)
        Turn rate (p, q, r), V axes, rad/s.

    Returns
    -------
    ndarray, shape (..., 3)
        ``(u', u r, -u q)``, V axes, m/s² (000 eqs. 7.5.7-7.5.9).

    Notes
    -----
    Earth's turning is left out; 7.5.5 prints its Coriolis term with the wrong rate (docs/equations.md).
    """
    _, q, r = np.moveaxis(trailing("w_v", w_v, 3), -1, 0)
    return np.stack(np.broadcast_arrays(u_rate, u * r, -u * q), axis=-1)


def speed_and_rate(t: Floats, t_gps: Floats, speed: Floats, *, oldest: float = 2.5) -> tuple[Floats, Floats]:
    """GPS speed and its rate of change as they are known at other times.

    Parameters
    ----------
    t : ndarray, shape (n,)
        s.
    t_gps, speed : ndarray, shape (m,)
        Fixes, s, increasing, and m/s.
    oldest : float
        s after which a fix is no longer taken.

    Returns
    -------
    u, u_rate : ndarray, shape (n,)
        The last fix carried on with the slope of the last two; NaN before the second fix, after `oldest`, and where the
        two fixes are farther apart than that.

    Raises
    ------
    ShapeError
    """
    if t_gps.shape != speed.shape or t_gps.ndim != 1:
        raise ShapeError("speed", speed.shape, str(t_gps.shape))
    last = np.searchsorted(t_gps, t, side="right") - 1
    u, u_rate = np.full(t.shape, np.nan), np.full(t.shape, np.nan)
    known = last >= 1
    k = last[known]
    apart, age = t_gps[k] - t_gps[k - 1], t[known] - t_gps[k]
    slope = np.where((apart <= oldest) & (age <= oldest), (speed[k] - speed[k - 1]) / apart, np.nan)
    u[known], u_rate[known] = speed[k] + slope * age, slope
    return u, u_rate


def force_at_rest(f_v: Floats, w_v: Floats, u: Floats, u_rate: Floats) -> Floats:
    """What the accelerometer would read if the vehicle stood: minus gravity.

    Parameters
    ----------
    f_v, w_v : ndarray, shape (..., 3)
        Specific force, m/s², and turn rate, rad/s, V axes.
    u, u_rate : ndarray, shape (...)
        As of `speed_and_rate`; where NaN, the specific force is taken as it is (7.5.2).

    Returns
    -------
    ndarray, shape (..., 3)
        ``f - a = -g``, V axes, m/s² (7.5.4).
    """
    a = vehicle_acceleration(u, u_rate, w_v)
    return trailing("f_v", f_v, 3) - np.where(np.isnan(a).any(axis=-1, keepdims=True), 0.0, a)
