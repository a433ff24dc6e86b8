"""The whole-drive estimator: the product's default answer to "how does this box sit?".

Closed-form start, maximum a posteriori refinement, noise levels that suit the drive, a search for
moves of the box, and a verdict.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.mounting.adapt import adapted
from nav_core.mounting.closed_form import Start, start
from nav_core.mounting.confidence import assess
from nav_core.mounting.model import BIAS, Noise, Record, prepare, usable_fixes
from nav_core.mounting.quality import Verdict, after_fit, before_fit, excitation
from nav_core.mounting.refine import HUBER, Fit, refine
from nav_core.mounting.self_test import self_test
from nav_core.records import Gnss, MountingEstimate
from nav_core.signal import Ticks

EXCERPT = 600.0
"""Length of the excerpt that start and noise levels are taken from, s."""


class Solution(NamedTuple):
    """A fit with where it came from."""

    start: Start
    fit: Fit


def solve(record: Record, noise: Noise) -> Solution:
    """Best mounting of a record during which the box did not move."""
    part = excerpt(record, EXCERPT)
    first = start(part, noise)
    rough = refine(part, first, noise)
    lags = (rough.speed_lag, rough.course_lag)
    suited = adapted(part, rough.R_va, lags, noise, rough.p, HUBER)
    if part is record and suited == noise:
        return Solution(first, rough)
    better = first._replace(R_va=rough.R_va, speed_lag=lags[0], course_lag=lags[1])
    return Solution(first, refine(record, better, suited))


def excerpt(record: Record, length: float) -> Record:
    """The most eventful stretch of a record, at most `length` seconds long."""
    t = record.fixes.t
    if t[-1] - t[0] <= length:
        return record
    events = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(record.fixes.speed)))])
    end = np.searchsorted(t, t + length, side="right") - 1
    first = int(np.argmax(events[end] - events))
    return between(record, t[first], t[int(end[first])])


def between(record: Record, begin: float, end: float) -> Record:
    """The part of a record from one box time to another, s."""
    fixes = record.fixes
    inside = (fixes.t >= begin) & (fixes.t <= end)
    ticks = (record.t >= begin - 3.0) & (record.t <= end + 1.0)
    kept = type(fixes)(*(column[inside] for column in fixes))
    return Record(record.t[ticks], record.f[ticks], record.step[ticks], kept)


def estimate(ticks: Ticks, gnss: Gnss, *, noise: Noise | None = None) -> MountingEstimate:
    """Mounting of a box from a whole recording.

    Parameters
    ----------
    ticks : Ticks
        Decimated specific force, A-frame; merged from as many batches as there are.
    gnss : Gnss
    noise : Noise, optional
        Prior knowledge; ordinary cars, roads and receivers by default.

    Returns
    -------
    MountingEstimate
        Sigmas include what the drive cannot tell (accelerometer bias, mean bank of the roads).
    """
    noise = noise or Noise()
    record = prepare(ticks, usable_fixes(gnss))
    offered = excitation(record)
    verdict = before_fit(record, offered)
    if verdict is not None:
        return _without(verdict)
    solution = solve(record, noise)
    found = assess(solution.fit)
    verdict = after_fit(solution.start, found, offered)
    if verdict.status in ("insufficient", "not_fixed"):
        return _without(verdict)
    fit = solution.fit
    return MountingEstimate(
        status=verdict.status,
        method="whole-drive",
        R_va=fit.R_va,
        covariance=found.covariance,
        progress=verdict.progress,
        observability=found.observability,
        stable=found.stable,
        reliable=verdict.reliable,
        self_test=self_test(record, fit.R_va, float(fit.p[BIAS][0]), fit.speed_lag),
        converged_after=None
        if found.converged_after is None
        else max(found.converged_after - (offered.first_moving - fit.begin), 0.0),
        speed_lag=fit.speed_lag,
        course_lag=fit.course_lag,
        reasons=verdict.reasons,
    )


def _without(verdict: Verdict) -> MountingEstimate:
    return MountingEstimate(
        status=verdict.status,
        method="whole-drive",
        progress=verdict.progress,
        reliable=verdict.reliable,
        reasons=verdict.reasons,
    )
