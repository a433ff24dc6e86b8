"""Steps of the mechanisations in e and i, compiled (000 §§2.5.1, 2.5.2)."""

from __future__ import annotations

import numpy as np

from nav_core.attitude.kernels import Vector, cross, total, turn
from nav_core.strapdown.kernels import RATE, gravity_at, meridian_of, resolved
from nav_core.typing import Floats, kernel


@kernel
def pull(x: float, y: float, z: float) -> Vector:
    """Gravity at a position in e or i, m (both have z through the pole), in the same axes, m/s².

    Parameters
    ----------
    x, y, z : float
        m.

    Returns
    -------
    tuple of 3 floats
        m/s².
    """
    p = np.hypot(x, y)
    sin_lat, cos_lat, height = meridian_of(p, z)
    g = float(gravity_at(sin_lat * sin_lat, height))
    outward = g * cos_lat / p if p > 0.0 else 0.0
    return -outward * x, -outward * y, float(-g * sin_lat)


@kernel
def settle(r: Floats, v: Floats, height: float) -> None:
    """Put a position in e or i back to `height`, m, and take the vertical part off its velocity.

    Parameters
    ----------
    r : ndarray, shape (3,)
        m; overwritten.
    v : ndarray, shape (3,)
        Against the Earth, m/s; overwritten.
    height : float
        Above the ellipsoid, m.
    """
    p = np.hypot(r[0], r[1])
    sin_lat, cos_lat, now = meridian_of(p, r[2])
    outward = cos_lat / p if p > 0.0 else 0.0
    x, y, z = outward * r[0], outward * r[1], sin_lat
    climb = x * v[0] + y * v[1] + z * v[2]
    r[0], r[1], r[2] = r[0] + (height - now) * x, r[1] + (height - now) * y, r[2] + (height - now) * z
    v[0], v[1], v[2] = v[0] - climb * x, v[1] - climb * y, v[2] - climb * z


@kernel
def step_cartesian(
    r: Floats, v: Floats, C: Floats, rotation: Floats, velocity: Floats, T: float, frame_rate: float
) -> None:
    """Advance in e (000 §2.5.2) or i (§2.5.1), which turn with `frame_rate`: the Earth's, or none, rad/s.

    `r` (3,) m; `v` (3,) the velocity against the Earth, m/s; `C` (3, 3) turns b into the frame.  With the Earth rate W
    and the frame's F, ``v' = f - (W + F) x v + g`` (2.5.13, 2.5.9) and ``r' = v + (W - F) x r`` (2.5.1).

    Parameters
    ----------
    r : ndarray, shape (3,)
        Overwritten.
    v : ndarray, shape (3,)
        Overwritten.
    C : ndarray, shape (3, 3)
        Overwritten.
    rotation : ndarray, shape (3,)
        Of the body over the step, b axes, rad.
    velocity : ndarray, shape (3,)
        Its velocity change, b axes, m/s.
    T : float
        s.
    frame_rate : float
        About z, rad/s.
    """
    frame, both, drag = (0.0, 0.0, T * frame_rate), (0.0, 0.0, RATE + frame_rate), (0.0, 0.0, RATE - frame_rate)
    now, place = (v[0], v[1], v[2]), (r[0], r[1], r[2])
    middle = total(total(place, 0.5 * T, now), 0.5 * T, cross(drag, place))
    force = total(resolved(C, velocity, frame), T, pull(middle[0], middle[1], middle[2]))
    mean = total(now, 0.5, total(force, -T, cross(both, now)))
    after = total(total(now, 1.0, force), -T, cross(both, mean))
    place = total(total(total(place, 0.5 * T, now), 0.5 * T, after), T, cross(drag, middle))
    v[0], v[1], v[2] = after[0], after[1], after[2]
    r[0], r[1], r[2] = place[0], place[1], place[2]
    turn(C, frame, (rotation[0], rotation[1], rotation[2]))


@kernel
def run_cartesian(
    r: Floats,
    v: Floats,
    C: Floats,
    rotation: Floats,
    velocity: Floats,
    periods: Floats,
    hold: bool,
    inertial: bool,
) -> tuple[Floats, Floats, Floats]:
    """Positions, velocities and attitudes of `step_cartesian` in e or, with `inertial`, in i.

    Parameters
    ----------
    r : ndarray, shape (3,)
        m, at the start.
    v : ndarray, shape (3,)
        Against the Earth, m/s.
    C : ndarray, shape (3, 3)
        From b to the frame.
    rotation : ndarray, shape (n, 3)
        Of the body over each step, b axes, rad.
    velocity : ndarray, shape (n, 3)
        Its velocity changes, b axes, m/s.
    periods : ndarray, shape (n,)
        s.
    hold : bool
        Whether the height is held.
    inertial : bool
        Whether the frame is i.

    Returns
    -------
    positions : ndarray, shape (n + 1, 3)
        m.
    velocities : ndarray, shape (n + 1, 3)
        Against the Earth, m/s.
    attitudes : ndarray, shape (n + 1, 3, 3)
        From b to the frame.
    """
    n = periods.size
    places, speeds, attitudes = np.empty((n + 1, 3)), np.empty((n + 1, 3)), np.empty((n + 1, 3, 3))
    places[0], speeds[0], attitudes[0] = r, v, C
    _, _, height = meridian_of(np.hypot(r[0], r[1]), r[2])
    frame_rate = 0.0 if inertial else RATE
    for k in range(n):
        places[k + 1], speeds[k + 1], attitudes[k + 1] = places[k], speeds[k], attitudes[k]
        step_cartesian(places[k + 1], speeds[k + 1], attitudes[k + 1], rotation[k], velocity[k], periods[k], frame_rate)
        if hold:
            settle(places[k + 1], speeds[k + 1], float(height))
    return places, speeds, attitudes
