"""Steps of the wander-azimuth mechanisation, compiled (000 §2.5.4)."""

from __future__ import annotations

import numpy as np

from nav_core import earth
from nav_core.attitude.kernels import Vector, cross, total, turn
from nav_core.strapdown.kernels import ECCENTRICITY2, RATE, curvatures, gained, gravity_at
from nav_core.typing import Floats, kernel


@kernel
def wander_transport(axis: Vector, height: float, v: Vector) -> Vector:
    """Transport rate in w axes, rad/s: its vertical component is zero (000 §2.5.4).

    `axis` is the Earth's axis in w axes: ``cos(lat)`` times north in its first two components, ``-sin(lat)`` in the
    third.  The curvatures along and across the meridian differ by a term in ``cos(lat)²``, so that `axis` itself, and
    not the direction of north, says where they lie: no pole is singular.

    Parameters
    ----------
    axis : tuple of 3 floats
        Without unit.
    height : float
        m.
    v : tuple of 3 floats
        w axes, m/s.

    Returns
    -------
    tuple of 3 floats
        rad/s.
    """
    along, across = curvatures(axis[2], height)
    bulge = 1.0 - ECCENTRICITY2 * axis[2] * axis[2]
    excess = earth.SEMI_MAJOR * ECCENTRICITY2 / (bulge * np.sqrt(bulge)) * along * across
    excess *= axis[0] * v[0] + axis[1] * v[1]
    return v[1] * across + excess * axis[1], -v[0] * across - excess * axis[0], 0.0


@kernel
def step_wander(
    R_ew: Floats, height: float, v: Floats, C: Floats, rotation: Floats, velocity: Floats, T: float, hold: bool
) -> float:
    """Advance in wander azimuth (000 §2.5.4); returns the new height, m.

    `R_ew` (3, 3) turns w into e, `v` (3,) is in w axes (z down), m/s, `C` (3, 3) turns b into w.

    Parameters
    ----------
    R_ew : ndarray, shape (3, 3)
        Overwritten.
    height : float
        m.
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
    hold : bool
        Whether the height is held.

    Returns
    -------
    float
        m.
    """
    now = (v[0], v[1], v[2])
    free = 0.0 if hold else 1.0
    axis = (R_ew[2, 0], R_ew[2, 1], R_ew[2, 2])
    # Half a step on, the axis has turned the other way round than w.
    axis = total(axis, -0.5 * T, cross(wander_transport(axis, height, now), axis))
    halfway = height - 0.5 * T * now[2]
    down = float(gravity_at(axis[2] * axis[2], halfway))
    spin = (RATE * axis[0], RATE * axis[1], RATE * axis[2])

    transport = wander_transport(axis, halfway, now)
    middle = total(now, 0.5, gained(C, velocity, spin, transport, now, down, T))
    middle = (middle[0], middle[1], free * middle[2])
    transport = wander_transport(axis, halfway, middle)
    after = total(now, 1.0, gained(C, velocity, spin, transport, middle, down, T))
    v[0], v[1], v[2] = after[0], after[1], free * after[2]

    middle = (0.5 * (now[0] + v[0]), 0.5 * (now[1] + v[1]), 0.5 * (now[2] + v[2]))
    transport = wander_transport(axis, halfway, middle)
    turn(C, total((T * spin[0], T * spin[1], T * spin[2]), T, transport), (rotation[0], rotation[1], rotation[2]))
    # Position is the attitude of w against e.
    turn(R_ew, (0.0, 0.0, 0.0), (T * transport[0], T * transport[1], T * transport[2]))
    return height - T * middle[2]


@kernel
def run_wander(
    R_ew: Floats,
    height: float,
    v: Floats,
    C: Floats,
    rotation: Floats,
    velocity: Floats,
    periods: Floats,
    hold: bool,
) -> tuple[Floats, Floats, Floats, Floats]:
    """``R_ew`` (n + 1, 3, 3), heights (n + 1,), velocities and attitudes of `step_wander`.

    Parameters
    ----------
    R_ew : ndarray, shape (3, 3)
        From w to e, at the start.
    height : float
        m.
    v : ndarray, shape (3,)
        w axes, m/s.
    C : ndarray, shape (3, 3)
        From b to w.
    rotation : ndarray, shape (n, 3)
        Of the body over each step, b axes, rad.
    velocity : ndarray, shape (n, 3)
        Its velocity changes, b axes, m/s.
    periods : ndarray, shape (n,)
        s.
    hold : bool
        Whether the height is held.

    Returns
    -------
    R_ew : ndarray, shape (n + 1, 3, 3)
        From w to e.
    heights : ndarray, shape (n + 1,)
        m.
    velocities : ndarray, shape (n + 1, 3)
        w axes, m/s.
    attitudes : ndarray, shape (n + 1, 3, 3)
        From b to w.
    """
    n = periods.size
    frames, heights = np.empty((n + 1, 3, 3)), np.empty(n + 1)
    speeds, attitudes = np.empty((n + 1, 3)), np.empty((n + 1, 3, 3))
    frames[0], heights[0], speeds[0], attitudes[0] = R_ew, height, v, C
    for k in range(n):
        frames[k + 1], speeds[k + 1], attitudes[k + 1] = frames[k], speeds[k], attitudes[k]
        heights[k + 1] = step_wander(
            frames[k + 1],
            heights[k],
            speeds[k + 1],
            attitudes[k + 1],
            rotation[k],
            velocity[k],
            periods[k],
            hold,
        )
    return frames, heights, speeds, attitudes
