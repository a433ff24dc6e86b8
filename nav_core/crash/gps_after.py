"""What the fixes after a blow say of the velocity right after it, in the V axes at time zero."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.crash.gps_change import LAG_SIGMA, SLOW, SPEED_NOISE, Before, Lags, combine, repeating
from nav_core.records import Gnss
from nav_core.typing import Flags, Floats

AFTER = 2.5
"""Fixes that are used describe moments at most this long after a blow, s."""

WALK = 0.6
GAP_WALK = 3.0
"""How fast velocity is presumed to stray from what the accelerometer says after a blow, m/s/√s, and where it says
nothing; the fixes that follow may show that it strays less, or more."""

SETTLED, COURSE_SETTLED = 0.12, 0.4
"""Speeds and courses from within this time after a blow may still be from before, s: lags are not known exactly, that
of the course least."""

MEMORIES = ((0.0, 0.5), (0.1, 0.125), (0.2, 0.125), (0.35, 0.125), (0.5, 0.125))
"""Receivers filter: time constants of what is left of the velocity before a blow, s, and how likely each is."""


class After(NamedTuple):
    """Horizontal velocity at the end of the window, V axes at time zero, m/s, (2,), with covariance (2, 2)."""

    velocity: Floats
    covariance: Floats
    fixes: int


def _walks(t: Floats, v: Floats) -> tuple[float, float]:
    """How fast velocity strays, m²/s³, with samples and without: as presumed, then as the fixes show it.

    Mean of an inverse-gamma posterior whose prior weighs half as much as one step in two axes.
    """
    steps = np.diff(v, axis=0)
    noise = 2.0 * 0.5 * SPEED_NOISE**2
    shown = np.maximum((steps**2).sum(axis=1) - 2.0 * noise, 0.0) / np.maximum(np.diff(t), 0.05)
    count = 1.0 + 2.0 * shown.size
    total = float(shown.sum())
    return (WALK**2 + total) / count, (GAP_WALK**2 + total) / count


def after(
    gnss: Gnss, lags: Lags, known: Before, blow: tuple[float, float], path: tuple[Floats, Floats], until: float
) -> After | None:
    """Velocity right after the blow from the fixes that follow it.

    A receiver that filters by ``1/(1 + tau s)`` lags by `tau` and shows of the change ``1 - exp(-(t + tau)/tau)``, `t`
    from the middle of the blow to the moment described.  Each of `MEMORIES` is tried; the fixes say which holds.

    Parameters
    ----------
    gnss : Gnss
        As `usable` gave it.
    lags : Lags
    known : Before
        Its course is where V x pointed at time zero.
    blow : tuple of float
        Time zero and the moment asked for, box clock, s.
    path : tuple of ndarray
        Moments from the second of them on, s, shape (m,), and the horizontal velocity gained since, V axes at time
        zero, m/s, shape (m, 2).
    until : float
        Fixes of later moments are left out, box clock, s.

    Returns
    -------
    After or None
        None without a fix, or without a course before.
    """
    began, t_end = blow
    described = gnss.t - lags.speed
    late = 2.0 * lags.sigma * (lags.sigma > LAG_SIGMA)
    use = (described >= t_end + SETTLED + late) & (gnss.t - lags.course >= t_end + COURSE_SETTLED + late)
    use &= described <= min(t_end + AFTER, until)
    if not use.any() or not np.isfinite(known.course):
        return None
    at, speed = described[use], gnss.speed[use]
    # Speed and course of a fix describe two moments: the course must not be that of a crawl.
    then = np.interp(gnss.t[use] - lags.course, described, gnss.speed)
    told = np.isfinite(gnss.course[use]) & (np.minimum(speed, then) >= SLOW)
    course = np.where(told, gnss.course[use] - known.course, 0.0)
    z = np.where(told, speed, 0.0)[:, None] * np.stack((np.cos(course), np.sin(course)), axis=1)
    moments, gained = path
    seen = np.column_stack([np.interp(at, moments, gained[:, axis]) for axis in range(2)])
    later = np.column_stack([np.interp(at + lags.sigma, moments, gained[:, axis]) for axis in range(2)])
    rest = _Rest(
        at - t_end,
        np.clip(moments[-1] - t_end, 0.0, at - t_end),
        told,
        np.where(told, 0.0, 0.5 * speed**2),
        later - seen,
    )
    tries: list[tuple[float, Floats, Floats]] = []
    # A filter alone makes a receiver late by its time constant.
    for tau, odds in (each for each in MEMORIES if each[0] <= lags.speed + 2.0 * lags.sigma):
        left = np.exp(-1.0 - (at - 0.5 * (began + t_end)) / tau) if tau else np.zeros(at.size)
        y = (z - seen - left[:, None] * [known.speed, 0.0]) / (1.0 - left)[:, None]
        likely, values, P = _settled(rest, y, left)
        tries.append((np.log(odds) + likely, values, P))
    best = max(each[0] for each in tries)
    weights = np.exp([each[0] - best for each in tries])
    weights /= weights.sum()
    mean = np.sum([w * values for w, (_, values, _) in zip(weights, tries, strict=True)], axis=0)
    spreads = [cov + np.outer(v - mean, v - mean) for _, v, cov in tries]
    total = np.einsum("k,kij->ij", weights, np.array(spreads))
    across = np.array([-mean[1], mean[0]]) * known.course_sigma
    return After(mean, total + np.outer(across, across), int(use.sum()))


class _Rest(NamedTuple):
    """Of k fixes after a blow.

    Time since it, and how much of that has samples, s; whether they tell a course; variance of those that do not,
    m²/s²; what the path gains within 1 sigma of the lag, m/s, (k, 2).
    """

    elapsed: Floats
    covered: Floats
    told: Flags
    crawl: Floats
    late: Floats


def _settled(rest: _Rest, y: Floats, left: Floats) -> tuple[float, Floats, Floats]:
    """How likely the velocities (k, 2) carried back to the blow are, logarithm, and their mean with covariance."""
    walk, gap_walk = _walks(rest.elapsed[rest.told], y[rest.told])
    spread = walk * rest.covered + gap_walk * (rest.elapsed - rest.covered)
    scale = 1.0 / (1.0 - left)
    noise = repeating(rest.elapsed, SPEED_NOISE) + np.diag(rest.crawl)
    C = noise * np.outer(scale, scale) + np.minimum(spread[:, None], spread[None, :])
    # Of the fixes as they are: what they were divided by is in their density.
    likely, values, P = -2.0 * float(np.log(1.0 - left).sum()), np.empty(2), np.zeros((2, 2))
    for axis in range(2):
        whole = C + np.outer(rest.late[:, axis], rest.late[:, axis])
        values[axis], sigma = combine(y[:, axis], whole)
        P[axis, axis] = sigma**2
        r, ones = y[:, axis] - values[axis], np.ones(left.size)
        precision = np.linalg.inv(whole)
        likely -= 0.5 * float(r @ precision @ r + np.linalg.slogdet(whole)[1] + np.log(ones @ precision @ ones))
    return likely, values, P
