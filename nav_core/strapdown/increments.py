"""From inertial samples to the rotation and the velocity change of whole intervals: coning and sculling.

While the body turns, neither its rotation over an interval nor the velocity it gains is the plain integral of what its
sensors say.  The corrections here take angular rate and specific force as linear in time (Savage 1998, parts 1 and 2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.errors import OrderError, RangeError, ShapeError, TooLittleDataError
from nav_core.typing import Floats, kernel


@dataclass(frozen=True, slots=True)
class Increments:
    """What the body did over n successive intervals.

    Attributes
    ----------
    t : ndarray, shape (n + 1,)
        Ends of the intervals, the first one's start before them, s.
    rotation : ndarray, shape (n, 3)
        Rotation vector of b at the end against b at the start, against i, rad.
    velocity : ndarray, shape (n, 3)
        Specific force integrated over the interval, in the b axes of its start, m/s.
    """

    t: Floats
    rotation: Floats
    velocity: Floats

    def __post_init__(self) -> None:
        _check_times(self.t)
        for name in ("rotation", "velocity"):
            shape = getattr(self, name).shape
            if shape != (self.t.size - 1, 3):
                raise ShapeError(f"increments.{name}", shape, f"({self.t.size - 1}, 3)")

    @property
    def periods(self) -> Floats:
        """Lengths of the intervals, s, shape (n,)."""
        return np.diff(self.t)


def from_rates(t: Floats, w: Floats, f: Floats) -> Increments:
    """Increments from samples of angular rate and specific force.

    Parameters
    ----------
    t : ndarray, shape (n + 1,)
        s, strictly increasing.
    w, f : ndarray, shape (n + 1, 3)
        Angular rate against i, rad/s, and specific force, m/s², b axes, at these moments.

    Returns
    -------
    Increments
        n intervals, each between two samples, over which both are taken as linear.

    Raises
    ------
    ShapeError, OrderError, TooLittleDataError
    """
    w, f, t = _readings("w", w, t, 0), _readings("f", f, t, 0), _check_times(t)
    T = np.diff(t)[:, None]
    angle, thrust = 0.5 * T * (w[:-1] + w[1:]), 0.5 * T * (f[:-1] + f[1:])
    # Half the integral of (angle so far) x w for linear w; likewise with f.
    coning = T**2 / 12.0 * np.cross(w[:-1], w[1:])
    sculling = T**2 / 12.0 * (np.cross(w[:-1], f[1:]) + np.cross(f[:-1], w[1:]))
    return Increments(t, angle + coning, thrust + 0.5 * np.cross(angle, thrust) + sculling)


def from_integrals(t: Floats, angle: Floats, thrust: Floats, *, per_interval: int = 1) -> Increments:
    """Increments from sensors that integrate by themselves, or from integrals of fast samples.

    Parameters
    ----------
    t : ndarray, shape (n + 1,)
        Ends of the readings, the first one's start before them, s; equally spaced within an interval.
    angle, thrust : ndarray, shape (n, 3)
        Integrals of angular rate, rad, and of specific force, m/s, each over one reading, b axes.
    per_interval : int
        Readings gathered into one interval; n is a multiple of it.

    Returns
    -------
    Increments
        ``n / per_interval`` intervals.

    Raises
    ------
    ShapeError, OrderError, RangeError, TooLittleDataError

    Notes
    -----
    Savage 1998 part 1 eqs. 46-49 and part 2 eqs. 39-44: each reading takes its predecessor's to know how rate and
    force change.  The very first has none and counts as constant.
    """
    angle, thrust, t = _readings("angle", angle, t, 1), _readings("thrust", thrust, t, 1), _check_times(t)
    if per_interval < 1:
        raise RangeError("per_interval", float(per_interval), ">= 1")
    if angle.shape[0] % per_interval != 0:
        raise ShapeError("angle", angle.shape, f"(m * {per_interval}, 3)")
    rotation, velocity = gather(angle, thrust, per_interval)
    return Increments(t[::per_interval], rotation, velocity)


@kernel
def gather(angle: Floats, thrust: Floats, per_interval: int) -> tuple[Floats, Floats]:
    """Rotation vectors and velocity changes, each (n / per_interval, 3), of readings (n, 3); see `from_integrals`."""
    count = angle.shape[0] // per_interval
    rotation, velocity = np.empty((count, 3)), np.empty((count, 3))
    for m in range(count):
        # Sums so far within the interval: angle, thrust, coning, sculling.
        ax = ay = az = vx = vy = vz = cx = cy = cz = sx = sy = sz = 0.0
        for k in range(m * per_interval, (m + 1) * per_interval):
            dx, dy, dz = angle[k, 0], angle[k, 1], angle[k, 2]
            ux, uy, uz = thrust[k, 0], thrust[k, 1], thrust[k, 2]
            before = k - 1 if k > 0 else 0
            px = ax + angle[before, 0] / 6.0
            py = ay + angle[before, 1] / 6.0
            pz = az + angle[before, 2] / 6.0
            qx = vx + thrust[before, 0] / 6.0
            qy = vy + thrust[before, 1] / 6.0
            qz = vz + thrust[before, 2] / 6.0
            cx += 0.5 * (py * dz - pz * dy)
            cy += 0.5 * (pz * dx - px * dz)
            cz += 0.5 * (px * dy - py * dx)
            sx += 0.5 * (py * uz - pz * uy + qy * dz - qz * dy)
            sy += 0.5 * (pz * ux - px * uz + qz * dx - qx * dz)
            sz += 0.5 * (px * uy - py * ux + qx * dy - qy * dx)
            ax, ay, az = ax + dx, ay + dy, az + dz
            vx, vy, vz = vx + ux, vy + uy, vz + uz
        rotation[m, 0], rotation[m, 1], rotation[m, 2] = ax + cx, ay + cy, az + cz
        velocity[m, 0] = vx + sx + 0.5 * (ay * vz - az * vy)
        velocity[m, 1] = vy + sy + 0.5 * (az * vx - ax * vz)
        velocity[m, 2] = vz + sz + 0.5 * (ax * vy - ay * vx)
    return rotation, velocity


def _check_times(t: Floats) -> Floats:
    times = np.asarray(t, dtype=np.float64)
    if times.ndim != 1:
        raise ShapeError("t", times.shape, "(n + 1,)")
    if times.size < 2:
        raise TooLittleDataError("t", times.size, 2)
    backwards = np.diff(times) <= 0.0
    if backwards.any():
        raise OrderError("t", int(np.argmax(backwards)) + 1)
    return times


def _readings(name: str, values: Floats, t: Floats, fewer: int) -> Floats:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != (np.size(t) - fewer, 3):
        raise ShapeError(name, array.shape, f"({np.size(t) - fewer}, 3)")
    return array
