"""Strapdown navigation in two dimensions: in a plane at rest, and around a round Earth (000 §2.2).

Two accelerometers and one gyro: x and z in the plane, y out of it; a positive turn takes z to x.  The systems of the
chapter, for seeing how errors grow without the third dimension in the way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.errors import RangeError, ShapeError
from nav_core.typing import Floats, kernel


@dataclass(frozen=True, slots=True)
class PlanarStart:
    """Where a planar system begins; all zero unless given.

    Attributes
    ----------
    theta : float
        Angle of b against the plane's (or the local) axes about y, rad.
    v_x, v_z : float
        m/s.
    x, z : float
        m; over the meridian x is distance on the ground and z height.
    """

    theta: float = 0.0
    v_x: float = 0.0
    v_z: float = 0.0
    x: float = 0.0
    z: float = 0.0


@dataclass(frozen=True, slots=True)
class PlanarTrack:
    """Motion in two dimensions at n moments; attributes as `PlanarStart`, each of shape (n,)."""

    theta: Floats
    v_x: Floats
    v_z: Floats
    x: Floats
    z: Floats


def navigate_plane(
    f_b: Floats, w_y: Floats, period: float, *, gravity: tuple[float, float], start: PlanarStart | None = None
) -> PlanarTrack:
    """Navigate in a plane that is at rest (000 table 2.2.1).

    Parameters
    ----------
    f_b : ndarray, shape (n, 2)
        Specific force along x and z of the body, m/s².
    w_y : ndarray, shape (n,)
        Angular rate, rad/s.
    period : float
        Between samples, s.
    gravity : tuple of float
        Along x and z of the plane, m/s².
    start : PlanarStart, optional

    Returns
    -------
    PlanarTrack
        At the samples, the first being the start; second-order accurate.
    """
    begin = start or PlanarStart()
    f_b, w_y, period = _checked(f_b, w_y, period)
    theta = begin.theta + _integral(w_y, period)
    cosine, sine = np.cos(theta), np.sin(theta)
    a_x = f_b[:, 0] * cosine + f_b[:, 1] * sine + gravity[0]
    a_z = -f_b[:, 0] * sine + f_b[:, 1] * cosine + gravity[1]
    v_x, v_z = begin.v_x + _integral(a_x, period), begin.v_z + _integral(a_z, period)
    return PlanarTrack(theta, v_x, v_z, begin.x + _integral(v_x, period), begin.z + _integral(v_z, period))


def navigate_meridian(
    f_b: Floats, w_y: Floats, period: float, *, gravity: float, radius: float, start: PlanarStart | None = None
) -> PlanarTrack:
    """Navigate along a great circle of a round Earth that does not turn (000 table 2.2.2, corrected).

    Parameters
    ----------
    f_b : ndarray, shape (n, 2)
        Specific force along x and z of the body, m/s²; without turning, x is along the ground and z up.
    w_y : ndarray, shape (n,)
        Angular rate, rad/s.
    period : float
        Between samples, s.
    start : PlanarStart, optional
        As for `navigate_plane`.
    gravity : float
        Downwards, constant, m/s².
    radius : float
        Of the Earth, m.

    Returns
    -------
    PlanarTrack
        Second-order accurate.

    Notes
    -----
    With r = radius + z: ``theta' = w_y - v_x / r``, ``v_x' = f_x - v_x v_z / r``, ``v_z' = f_z - g + v_x² / r``,
    ``x' = v_x radius / r``, ``z' = v_z``.  The table prints the signs of a z that points down for an axis it calls
    upwards, and the flown distance for x (docs/equations.md).
    """
    begin = start or PlanarStart()
    f_b, w_y, period = _checked(f_b, w_y, period)
    if not radius > 0.0:
        raise RangeError("radius", radius, "> 0 m")
    first = np.array([begin.theta, begin.v_x, begin.v_z, begin.x, begin.z])
    states = around(first, f_b, w_y, period, gravity, radius)
    return PlanarTrack(*states.T)


@kernel
def slope(state: Floats, f_x: float, f_z: float, w_y: float, g: float, radius: float, out: Floats) -> None:
    """Write the rates of theta, v_x, v_z, x and z over a meridian into `out` (5,).

    Parameters
    ----------
    state : ndarray, shape (5,)
        rad, m/s, m/s, m, m.
    f_x, f_z : float
        Specific force, b axes, m/s².
    w_y : float
        rad/s.
    g : float
        m/s².
    radius : float
        Of the Earth, m.
    out : ndarray, shape (5,)
        rad/s, m/s², m/s², m/s, m/s; overwritten.
    """
    cosine, sine = np.cos(state[0]), np.sin(state[0])
    r = radius + state[4]
    out[0] = w_y - state[1] / r
    out[1] = f_x * cosine + f_z * sine - state[1] * state[2] / r
    out[2] = -f_x * sine + f_z * cosine - g + state[1] * state[1] / r
    out[3] = state[1] * radius / r
    out[4] = state[2]


@kernel
def around(first: Floats, f_b: Floats, w_y: Floats, T: float, g: float, radius: float) -> Floats:
    """States (n, 5) of `navigate_meridian` by Heun's rule.

    Parameters
    ----------
    first : ndarray, shape (5,)
        rad, m/s, m/s, m, m.
    f_b : ndarray, shape (n, 2)
        Specific force, b axes, m/s².
    w_y : ndarray, shape (n,)
        rad/s.
    T : float
        s.
    g : float
        m/s².
    radius : float
        Of the Earth, m.

    Returns
    -------
    ndarray, shape (n, 5)
        In the units of `first`.
    """
    n = w_y.size
    states, one, other = np.empty((n, 5)), np.empty(5), np.empty(5)
    states[0] = first
    for k in range(n - 1):
        slope(states[k], f_b[k, 0], f_b[k, 1], w_y[k], g, radius, one)
        ahead = states[k] + T * one
        slope(ahead, f_b[k + 1, 0], f_b[k + 1, 1], w_y[k + 1], g, radius, other)
        states[k + 1] = states[k] + 0.5 * T * (one + other)
    return states


def _checked(f_b: Floats, w_y: Floats, period: float) -> tuple[Floats, Floats, float]:
    force, rate = np.ascontiguousarray(f_b, dtype=np.float64), np.ascontiguousarray(w_y, dtype=np.float64)
    if rate.ndim != 1 or rate.size < 1:
        raise ShapeError("w_y", rate.shape, "(n,)")
    if force.shape != (rate.size, 2):
        raise ShapeError("f_b", force.shape, f"({rate.size}, 2)")
    if not (np.isfinite(period) and period > 0.0):
        raise RangeError("period", period, "> 0 s")
    return force, rate, float(period)


def _integral(rate: Floats, period: float) -> Floats:
    return np.concatenate(([0.0], np.cumsum(0.5 * period * (rate[1:] + rate[:-1]))))
