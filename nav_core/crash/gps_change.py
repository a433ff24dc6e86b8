"""What the fixes say of a blow by themselves: speed before it; `gps_after` has the velocity after it.

A fix describes a moment before its stamp.  From there to the blow, and from the blow to there, the accelerometer
carries the velocity on; it is not clipped then.  So the fixes give the change over the blow alone, clipped or not.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.events.level import Gravity
from nav_core.events.trigger import Stream
from nav_core.records import Gnss
from nav_core.rotation import wrap
from nav_core.timebase import stale
from nav_core.typing import Floats

SPEED_NOISE = 0.08
"""1 sigma of a fix's speed, and of its velocity across, m/s; half of the variance repeats itself."""

REPEAT = 4.0
"""Over which time the repeating half does, s."""

LAG_SIGMA = 0.06
"""1 sigma of a lag that the drive has told, s."""

LONGEST_LAG_SIGMA = 0.2
"""Of a lag less sure than this the fixes do not tell gravity and bias, s."""

UNKNOWN_LAG, UNKNOWN_LAG_SIGMA = 0.35, 0.35
"""Of a receiver of which nothing is known, s."""

BEFORE = 4.0
"""Fixes that are used describe moments at most this long before a blow, s."""

SLOW = 1.0
"""Below this speed a course is not to be relied on, m/s."""


LEVEL = 0.08
"""Least 1 sigma of gravity and bias along the vehicle in the seconds before a blow, m/s²."""

LOOK_BACK = 4.0
"""Gravity and bias are taken from at most this long before a blow, s."""

DIVE, DIVE_SIGMA = 0.015, 0.02
"""Share by which pitching makes a braking look stronger, and its 1 sigma: cars dive by 0 to 3° per g."""

UNSEEN = 1.5
"""Presumed acceleration where the recording has no samples, m/s²."""


class Lags(NamedTuple):
    """Of the receiver, s, and their 1 sigma."""

    speed: float
    course: float
    sigma: float


class Before(NamedTuple):
    """The vehicle's speed at time zero and its 1 sigma, m/s; its course, rad, with 1 sigma; fixes that told."""

    speed: float
    sigma: float
    course: float
    course_sigma: float
    fixes: int


class Level(NamedTuple):
    """Specific force of gravity and bias forward and to the right, m/s², (2,), and 1 sigma of the less sure."""

    f: Floats
    sigma: float


def lags_of(speed: float | None, course: float | None) -> Lags:
    """Lags from a mounting estimate; what is not known is taken from the other, or from ordinary receivers.

    Parameters
    ----------
    speed, course : float or None
        s; None where not known.

    Returns
    -------
    Lags
        s, with their 1-sigma.
    """
    known = [each for each in (speed, course) if each is not None]
    if not known:
        return Lags(UNKNOWN_LAG, UNKNOWN_LAG, UNKNOWN_LAG_SIGMA)
    sigma = LAG_SIGMA if len(known) == 2 else 0.15
    return Lags(known[0] if speed is None else speed, known[-1] if course is None else course, sigma)


def usable(gnss: Gnss) -> Gnss | None:
    """Fixes with a speed that are not mere repetitions; None without any.

    Parameters
    ----------
    gnss : Gnss
        Of a recording.

    Returns
    -------
    Gnss or None
        Without `hdop`, `sats` and `utc`.
    """
    keep = gnss.fix & np.isfinite(gnss.speed)
    # A receiver whose position never changes gives none: by it, no fix is told from a repetition.
    if np.unique(gnss.lat[keep & np.isfinite(gnss.lat)]).size > 1:
        keep &= ~stale(gnss)
    if not keep.any():
        return None
    columns = (gnss.t, gnss.lat, gnss.lon, gnss.alt, gnss.speed, gnss.course)
    return Gnss(*(column[keep] for column in columns), fix=gnss.fix[keep])


def repeating(t: Floats, sigma: float) -> Floats:
    """Covariance of the errors of fixes at these moments, shape (n, n): half white, half repeating.

    Parameters
    ----------
    t : ndarray, shape (n,)
        s.
    sigma : float
        Of one fix, in any unit.

    Returns
    -------
    ndarray, shape (n, n)
        In the square of that unit.
    """
    apart = np.abs(t[:, None] - t[None, :])
    return 0.5 * sigma**2 * (np.eye(t.size) + np.exp(-apart / REPEAT))


def combine(z: Floats, C: Floats) -> tuple[float, float]:
    """Best mean of measurements of one number with covariance `C`, and its 1 sigma.

    Parameters
    ----------
    z : ndarray, shape (n,)
        In any unit.
    C : ndarray, shape (n, n)
        In its square; invertible.

    Returns
    -------
    tuple of float
        Weighted mean, no weight below zero, and its 1 sigma, in the unit of `z`.
    """
    weight = np.linalg.solve(C, np.ones(z.size))
    total = float(weight.sum())
    # Strong correlation asks for weights beyond 0..1; they would amplify what is not modelled.
    weight = np.maximum(weight / total, 0.0)
    weight /= weight.sum()
    return float(weight @ z), float(np.sqrt(weight @ C @ weight))


def level_before(gnss: Gnss, lags: Lags, stream: Stream, t0: float) -> Level | None:
    """Gravity and bias in the seconds before a blow: what the integral gains over the fixes, per second.

    Both are compared at the moments that the fixes describe, so it does not matter how the vehicle braked between
    them: ``v_i + int_ti^t0 f dt = v_0 + s (t0 - t_i)`` is fitted for `s`, and ``a_y = v dpsi/dt`` likewise across.

    Parameters
    ----------
    gnss : Gnss
        As `usable` gave it.
    lags : Lags
    stream : Stream
        In V axes.
    t0 : float
        Box clock, s.

    Returns
    -------
    Level or None
        None of fewer than four fixes, of a short span, and of a lag that is not known.
    """
    first, last = np.searchsorted(stream.t, [t0 - LOOK_BACK - 0.5, t0 + 1e-9])
    cut = first + 1 + np.flatnonzero(stream.step[first + 1 : last] == 0.0)
    first = int(cut[-1]) if cut.size else int(first)
    part = stream.rows(slice(first, int(last)))
    if part.t.size < 2 or lags.sigma > LONGEST_LAG_SIGMA:
        return None
    at = gnss.t - lags.speed
    use = (at >= part.t[0]) & (gnss.t <= t0)
    if use.sum() < 4 or np.ptp(at[use]) < 0.4 * LOOK_BACK:
        return None
    at, speed = at[use], gnss.speed[use]
    x = np.column_stack([(1.0 - DIVE) * part.f[:, 0], np.ones(part.t.size)])
    forward, sigma = _fit(part, x, at, speed, np.full(at.size, SPEED_NOISE), lags.sigma, t0)
    forward /= 1.0 - DIVE
    v = np.interp(part.t, at, speed)
    at = gnss.t - lags.course
    use = (at >= part.t[0]) & (gnss.t <= t0)
    course, noise = gnss.course[use], SPEED_NOISE / np.maximum(gnss.speed[use], SLOW)
    if use.sum() < 4 or not np.isfinite(course).all() or speed.min() < 3.0:
        return Level(np.array([forward, float(part.f[:, 1].mean())]), sigma)
    y = np.column_stack([part.f[:, 1] / v, 1.0 / v])
    right, across = _fit(part, y, at[use], np.asarray(wrap(course - course[-1])), noise, lags.sigma, t0)
    return Level(np.array([forward, right]), max(sigma, across))


def _fit(
    part: Stream, rates: Floats, at: Floats, z: Floats, noise: Floats, lag_sigma: float, t0: float
) -> tuple[float, float]:
    """Constant `s` and its 1 sigma, by which z + int(rates_0 - s rates_1) is the same at each of `at`."""
    columns = np.column_stack([rates, np.zeros(part.t.size)])
    stream, zero = part._replace(f=columns), np.zeros(3)
    gained = _gained(stream, zero, at, t0)[0]
    late = _gained(stream, zero, at - lag_sigma, t0)[0] - gained
    x = gained[:, 1] - gained[:, 1].mean()
    weight = x / (x @ x)
    value = float(weight @ (z + gained[:, 0]))
    own = gained[:, 0] - value * gained[:, 1]
    left = z + own
    left = (left - left.mean()) / noise
    # A fit worse than the fixes' noise says so.
    worse = max(1.0, float(left @ left) / max(at.size - 2, 1))
    shift = late[:, 0] - value * late[:, 1]
    C = (
        worse * repeating(at, 1.0) * np.outer(noise, noise)
        + np.outer(shift, shift)
        + DIVE_SIGMA**2 * np.outer(own, own)
    )
    return value, float(np.sqrt(weight @ C @ weight))


def before(gnss: Gnss, lags: Lags, stream: Stream, steady: Gravity, t0: float) -> Before | None:
    """Speed and course at `t0` from the fixes before it.

    Parameters
    ----------
    gnss : Gnss
        As `usable` gave it.
    lags : Lags
    stream : Stream
        In V axes.
    steady : Gravity
        Gravity and bias, V axes.
    t0 : float
        Box clock, s.

    Returns
    -------
    Before or None
        None without a fix of the last 4 s.  The course is NaN at a crawl.
    """
    described = gnss.t - lags.speed
    # Stamped before the blow, a fix is from before it, whatever the lag.
    use = (gnss.t <= t0) & (described >= t0 - BEFORE - lags.sigma)
    if not use.any():
        return None
    at, speed = described[use], gnss.speed[use]
    gained, uncertain = _gained(stream, steady.f, at, t0, _unsteady(at, speed), steady.sigma)
    gained[:, 0] *= 1.0 - DIVE
    z = speed + gained[:, 0]
    # One error of the level runs through all of them, and one of how far the body pitches.
    C = repeating(at, SPEED_NOISE) + np.outer(uncertain, uncertain)
    pitched = DIVE_SIGMA**2 * np.outer(gained[:, 0], gained[:, 0])
    shift = (1.0 - DIVE) * _gained(stream, steady.f, at - lags.sigma, t0)[0][:, 0] - gained[:, 0]
    value, sigma = combine(z, C + pitched + np.outer(shift, shift))
    course, course_sigma = _course(gnss, lags, stream, steady, t0)
    return Before(max(value, 0.0), sigma, course, course_sigma, int(use.sum()))


def _course(gnss: Gnss, lags: Lags, stream: Stream, steady: Gravity, t0: float) -> tuple[float, float]:
    described = gnss.t - lags.course
    use = (gnss.t <= t0) & (described >= t0 - BEFORE - lags.sigma) & (gnss.speed > SLOW) & np.isfinite(gnss.course)
    if not use.any():
        return float("nan"), float("nan")
    at, speed = described[use], gnss.speed[use]
    gained, uncertain = _gained(stream, steady.f, at, t0, level=steady.sigma)
    # dpsi/dt = a_y / v: what the vehicle still turned until the blow.
    turned = gained[:, 1] / speed
    angles = gnss.course[use] + turned
    reference = angles[-1]
    share, level = SPEED_NOISE / speed, uncertain / speed
    C = repeating(at, 1.0) * np.outer(share, share) + np.outer(level, level)
    late = (_gained(stream, steady.f, at - lags.sigma, t0)[0][:, 1] - gained[:, 1]) / speed
    offset, sigma = combine(np.asarray(wrap(angles - reference)), C + np.outer(late, late))
    return float(wrap(np.array(reference + offset))), float(np.hypot(sigma, np.radians(0.3)))


def _unsteady(at: Floats, speed: Floats) -> float:
    """Usual acceleration where no samples are, m/s²: as presumed, then as the fixes show it."""
    step = np.maximum(np.diff(at), 0.05)
    shown = np.maximum(np.diff(speed) ** 2 - SPEED_NOISE**2, 0.0) / step**2
    return float(np.sqrt((UNSEEN**2 + shown.sum()) / (1.0 + shown.size)))


def _gained(
    stream: Stream, steady: Floats, at: Floats, t0: float, unsteady: float = UNSEEN, level: float = LEVEL
) -> tuple[Floats, Floats]:
    """Velocity gained from each moment until `t0`, m/s, shape (k, 3), and its 1 sigma, (k,)."""
    inside = np.clip(at, stream.t[0], t0)
    first, last = np.searchsorted(stream.t, [inside.min(), t0 + 1e-9])
    part = slice(max(int(first) - 1, 0), int(last) + 1)
    t, f, step = stream.t[part], stream.f[part] - steady, stream.step[part]
    v = np.cumsum(np.concatenate([np.zeros((1, 3)), 0.5 * (f[1:] + f[:-1]) * step[1:, None]]), axis=0)
    now = np.array([np.interp(t0, t, v[:, axis]) for axis in range(3)])
    then = np.column_stack([np.interp(inside, t, v[:, axis]) for axis in range(3)])
    unseen = np.maximum(inside - at, 0.0)
    return now - then, level * (t0 - inside) + unsteady * unseen
