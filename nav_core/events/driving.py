"""Harsh driving: accelerations that last, against thresholds of the vehicle's class."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.events.level import usual_force
from nav_core.events.record import EventKind, VehicleClass
from nav_core.events.trigger import groups
from nav_core.records import Gnss, Inertial
from nav_core.signal import decimate
from nav_core.typing import Flags, Floats


class Thresholds(NamedTuple):
    """Acceleration beyond which driving is harsh, m/s²."""

    braking: float
    acceleration: float
    cornering: float


THRESHOLDS: dict[VehicleClass, Thresholds] = {
    "car": Thresholds(4.4, 4.4, 5.5),
    "van": Thresholds(4.0, 3.8, 4.6),
    "truck": Thresholds(3.2, 2.6, 3.4),
    "bus": Thresholds(2.8, 2.4, 3.2),
    "motorcycle": Thresholds(5.5, 5.0, 6.5),
}
"""Of cars: Digital Matter's defaults.  The others are ours: less for what may topple or carries standing people."""

LASTING = 0.4
"""How long the threshold must be exceeded, s."""

SLOWEST = 10.0 / 3.6
"""Below this speed parking and handling look alike, m/s."""

LEVEL_SPAN = 15.0
"""Slope and bias are taken from this long before and after, s."""


class Manoeuvre(NamedTuple):
    """Harsh driving from..to, box clock, s, and its largest acceleration, m/s²."""

    kind: EventKind
    begin: float
    end: float
    peak: float


def manoeuvres(
    inertial: Inertial, R_va: Floats, gnss: Gnss | None, speed_lag: float, vehicle_class: VehicleClass
) -> list[Manoeuvre]:
    """Harsh braking, acceleration and cornering of a recording.

    Parameters
    ----------
    inertial : Inertial
        A-frame.
    R_va : ndarray, shape (3, 3)
        From A to V.
    gnss : Gnss, optional
        Usable fixes.  Without, slope and driving cannot be told apart from one another as well, and standstill
        is not told at all.
    speed_lag : float
        s.
    vehicle_class : VehicleClass
        Sets the thresholds.

    Returns
    -------
    list of Manoeuvre
        In order of time, box clock, s; m/s².
    """
    if inertial.t.size < 2 or inertial.t[-1] - inertial.t[0] < 2.0:
        return []
    ticks = decimate(inertial)
    valid = ticks.valid
    t, f = ticks.t[valid], ticks.f[valid] @ R_va.T
    if t.size < 3:
        return []
    speed = _speed(t, gnss, speed_lag)
    usual = usual_force(t, f)
    along, across = f[:, 0] - _level(t, f[:, 0], speed, float(usual[0])), f[:, 1] - usual[1]
    # An upright box on a road; one that is carried about is not driving.
    sane = np.abs(f[:, 2] + 9.8) < 4.0
    moving = sane & ((speed > SLOWEST) | np.isnan(speed))
    limits = THRESHOLDS[vehicle_class]
    out = _runs("harsh_braking", t, -along, limits.braking, moving)
    out += _runs("harsh_acceleration", t, along, limits.acceleration, moving)
    out += _runs("harsh_cornering", t, np.abs(across), limits.cornering, moving)
    return sorted(out, key=lambda each: each.begin)


def _runs(kind: EventKind, t: Floats, a: Floats, limit: float, moving: Flags) -> list[Manoeuvre]:
    out: list[Manoeuvre] = []
    for first, last in groups(a > limit, t, 0.35):
        # Braking may end at standstill: it counts by how it began.
        if t[last] - t[first] >= LASTING - 1e-9 and moving[first]:
            out.append(Manoeuvre(kind, float(t[first]), float(t[last]), float(a[first : last + 1].max())))
    return out


def _speed(t: Floats, gnss: Gnss | None, lag: float) -> Floats:
    """Speed by GPS at these moments, m/s; NaN without a fix within 2 s."""
    if gnss is None:
        return np.full(t.size, np.nan)
    at = gnss.t - lag
    k = np.clip(np.searchsorted(at, t), 1, max(at.size - 1, 1))
    near = np.minimum(np.abs(at[np.minimum(k, at.size - 1)] - t), np.abs(at[k - 1] - t)) < 2.0
    return np.where(near, np.interp(t, at, gnss.speed), np.nan)


def _level(t: Floats, f: Floats, speed: Floats, usual: float) -> Floats:
    """Slope and bias along the vehicle, m/s²: the mean force around each moment less what GPS says was gained.

    Without fixes, `usual`.
    """
    first, last = np.searchsorted(t, t - LEVEL_SPAN), np.searchsorted(t, t + LEVEL_SPAN, side="right") - 1
    total = np.concatenate([[0.0], np.cumsum(f)])
    mean = (total[last + 1] - total[first]) / (last + 1 - first)
    gained = (speed[last] - speed[first]) / np.maximum(t[last] - t[first], 1.0)
    return np.where(np.isfinite(gained), mean - gained, usual)
