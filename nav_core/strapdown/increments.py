"""From inertial samples to the rotation and the velocity change of whole intervals: coning and sculling.

While the body turns, neither its rotation over an interval nor the velocity it gains is the plain integral of what its
sensors say.  The corrections here take angular rate and specific force as linear in time (Savage 1998, parts 1 and 2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.attitude.kernels import cross, total
from nav_core.errors import OrderError, RangeError, ShapeError, TooLittleDataError
from nav_core.typing import Floats, finite, kernel


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
            finite(f"increments.{name}", getattr(self, name))

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
    ShapeError, NotFiniteError, OrderError, TooLittleDataError
    """
    w, f, t = _readings("w", w, t, 0), _readings("f", f, t, 0), _check_times(t)
    T = np.diff(t)[:, None]
    angle, thrust = 0.5 * T * (w[:-1] + w[1:]), 0.5 * T * (f[:-1] + f[1:])
    # Half the integral of (angle so far) x w for linear w; likewise with f.
    coning = T**2 / 12.0 * np.cross(w[:-1], w[1:])
    sculling = T**2 / 12.0 * (np.cross(w[:-1], f[1:]) + np.cross(f[:-1], w[1:]))
    return Increments(t, angle + coning, _as_it_turns(angle, thrust) + sculling)


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
    ShapeError, NotFiniteError, OrderError, RangeError, TooLittleDataError

    Notes
    -----
    Savage's recursions (1998, parts 1 and 2): each reading takes its predecessor's to know how rate and force change.
    The very first has none and counts as constant.
    """
    angle, thrust, t = _readings("angle", angle, t, 1), _readings("thrust", thrust, t, 1), _check_times(t)
    if per_interval < 1:
        raise RangeError("per_interval", float(per_interval), ">= 1")
    if angle.shape[0] % per_interval != 0:
        raise ShapeError("angle", angle.shape, f"(m * {per_interval}, 3)")
    angle, thrust, coning, sculling = gather(angle, thrust, per_interval)
    return Increments(t[::per_interval], angle + coning, _as_it_turns(angle, thrust) + sculling)


@kernel
def gather(angle: Floats, thrust: Floats, per_interval: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Sums of readings (n, 3) over intervals, and their coning (rad) and sculling (m/s), each (n / per_interval, 3).

    Parameters
    ----------
    angle : ndarray, shape (n, 3)
        Integrated rates between readings, rad, b axes.
    thrust : ndarray, shape (n, 3)
        Integrated specific force, m/s, b axes.
    per_interval : int
        Readings per interval.

    Returns
    -------
    angle : ndarray, shape (m, 3)
        rad.
    thrust : ndarray, shape (m, 3)
        m/s.
    coning : ndarray, shape (m, 3)
        rad.
    sculling : ndarray, shape (m, 3)
        m/s.
    """
    count = angle.shape[0] // per_interval
    angles, thrusts = np.zeros((count, 3)), np.zeros((count, 3))
    coning, sculling = np.zeros((count, 3)), np.zeros((count, 3))
    for m in range(count):
        alpha = upsilon = (0.0, 0.0, 0.0)
        for k in range(m * per_interval, (m + 1) * per_interval):
            turned = (angle[k, 0], angle[k, 1], angle[k, 2])
            gained = (thrust[k, 0], thrust[k, 1], thrust[k, 2])
            # Of a reading crossed with itself nothing is left: so much for the first one's predecessor.
            before = max(k - 1, 0)
            a = total(alpha, 1.0 / 6.0, (angle[before, 0], angle[before, 1], angle[before, 2]))
            u = total(upsilon, 1.0 / 6.0, (thrust[before, 0], thrust[before, 1], thrust[before, 2]))
            cone = cross(a, turned)
            scull = total(cross(a, gained), 1.0, cross(u, turned))
            for i in range(3):
                coning[m, i] += 0.5 * cone[i]
                sculling[m, i] += 0.5 * scull[i]
            alpha, upsilon = total(alpha, 1.0, turned), total(upsilon, 1.0, gained)
        for i in range(3):
            angles[m, i], thrusts[m, i] = alpha[i], upsilon[i]
    return angles, thrusts, coning, sculling


def _as_it_turns(angle: Floats, thrust: Floats) -> Floats:
    """Velocity change in the axes of the interval's start, exact for constant rate and force (Savage 1998 part 2)."""
    size = np.linalg.norm(angle, axis=-1, keepdims=True)
    first = 0.5 * np.sinc(size / (2.0 * np.pi)) ** 2
    # (1 - sin(x) / x) / x² loses its digits where x is small.
    small = size < 1e-2
    second = np.where(small, 1.0 / 6.0 - size**2 / 120.0, (1.0 - np.sinc(size / np.pi)) / np.where(small, 1.0, size**2))
    once = np.cross(angle, thrust)
    return thrust + first * once + second * np.cross(angle, once)


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
    return finite(name, array)
