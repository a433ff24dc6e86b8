"""The thesis' self-test: forty seconds of specific force, integrated, against GPS speed (001 §5.4)."""

from __future__ import annotations

import numpy as np

from nav_core.mounting.model import GRAVITY, Record, at, integrate, steps_of
from nav_core.records import SelfTest
from nav_core.typing import Floats

DURATION = 40.0
LIMIT = 2.5
"""s and m/s, 001 §5.4."""

_MIN_SPEED = 3.0


def self_test(record: Record, R_va: Floats, bias_x: float, lag: float) -> SelfTest | None:
    """Integrate longitudinal specific force over the last 40 s of driving and compare with GPS speed.

    Parameters
    ----------
    record : Record
    R_va : ndarray, shape (3, 3)
    bias_x : float
        Estimated bias along V x, m/s².
    lag : float
        Of GPS speed, s.

    Returns
    -------
    SelfTest or None
        None when there were no 40 s with unbroken data at driving speed.

    Notes
    -----
    The slope is taken off with the rise of the GPS height over the 40 s: without that, half a
    degree of road fails a perfect mounting.
    """
    steps = steps_of(record, lag)
    fixes = record.fixes
    velocity = at(record, steps.when, integrate(record, record.f @ R_va[0] - bias_x))
    broken = np.cumsum(steps.broken)
    fast = np.cumsum(fixes.speed < _MIN_SPEED)
    begin = np.searchsorted(steps.when, steps.when - DURATION)
    end = np.arange(steps.when.size)
    whole = steps.when - steps.when[begin] > 0.95 * DURATION
    usable = whole & (broken[end] == broken[begin]) & (fast[end] == fast[begin])
    usable &= np.isfinite(fixes.alt[begin]) & np.isfinite(fixes.alt)
    if not usable.any():
        return None
    last = int(np.flatnonzero(usable)[-1])
    first = int(begin[last])
    duration = float(steps.when[last] - steps.when[first])
    rise = fixes.alt[last] - fixes.alt[first]
    distance = float(steps.distance[first + 1 : last + 1].sum())
    predicted = velocity[last] - velocity[first] - GRAVITY * rise / max(distance, 1.0) * duration
    drift = float(predicted - (fixes.speed[last] - fixes.speed[first]))
    return SelfTest(passed=abs(drift) <= LIMIT, drift=drift, duration=duration)
