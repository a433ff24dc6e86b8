"""Does a logger give specific force, or its negative (gravity as a pull down)?  Told by turns and braking.

A mirrored triad cannot be rotated onto the vehicle's axes.  With "down" taken against the mean reading, the
horizontal readings follow the accelerations that GPS tells by a rotation when the sign is right, and by a reflection
when it is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from server.formats.columns import Floats

_LAGS_S = (0.0, 0.3, 0.6, 1.0, 1.5)
_LONGEST_STEP_S = 3.0
_SLOWEST_MPS = 3.0
_FEWEST_STEPS = 30
_LEAST_CORRELATION = 0.3
_LEAST_RATIO = 1.5


@dataclass(frozen=True, slots=True)
class Sign:
    """+1, -1, or 0 where the drive does not tell; and how well each fits, 0..1."""

    sign: int
    rotated: float
    mirrored: float


def specific_force_sign(t: Floats, f: Floats, gps_t: Floats, speed: Floats, course_deg: Floats) -> Sign:
    """Sign of readings `f`, shape (n, 3), against reports of speed in m/s and course clockwise from north."""
    undecided = Sign(0, 0.0, 0.0)
    steps = np.diff(gps_t)
    middle = 0.5 * (speed[1:] + speed[:-1])
    turn = np.radians((np.diff(course_deg) + 180.0) % 360.0 - 180.0)
    use = (steps > 0.0) & (steps < _LONGEST_STEP_S) & (middle > _SLOWEST_MPS) & np.isfinite(turn) & np.isfinite(middle)
    if np.count_nonzero(use) < _FEWEST_STEPS or t.size < 2:
        return undecided
    known = (np.diff(speed)[use] + 1j * middle[use] * turn[use]) / steps[use]
    mean = np.mean(f, axis=0)
    length = float(np.linalg.norm(mean))
    if length < 1.0:
        return undecided
    down = -mean / length
    first = np.cross(down, np.eye(3)[int(np.argmin(np.abs(down)))])
    first /= np.linalg.norm(first)
    horizontal = f @ first + 1j * (f @ np.cross(down, first))
    total = np.concatenate([[0.0], np.cumsum(horizontal)])
    best = undecided
    for lag in _LAGS_S:
        begin = np.searchsorted(t, gps_t[:-1][use] - lag)
        end = np.searchsorted(t, gps_t[1:][use] - lag)
        full = end > begin
        if np.count_nonzero(full) < _FEWEST_STEPS:
            continue
        seen = (total[end[full]] - total[begin[full]]) / (end[full] - begin[full])
        seen = seen - seen.mean()
        a = known[full] - known[full].mean()
        scale = float(np.sqrt(np.sum(np.abs(seen) ** 2) * np.sum(np.abs(a) ** 2)))
        if scale == 0.0:
            continue
        rotated, mirrored = float(abs(np.sum(np.conj(a) * seen)) / scale), float(abs(np.sum(a * seen)) / scale)
        if max(rotated, mirrored) > max(best.rotated, best.mirrored):
            best = Sign(0, rotated, mirrored)
    high, low = max(best.rotated, best.mirrored), min(best.rotated, best.mirrored)
    if high < _LEAST_CORRELATION or high < _LEAST_RATIO * low:
        return best
    return Sign(1 if best.rotated > best.mirrored else -1, best.rotated, best.mirrored)
