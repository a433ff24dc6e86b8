"""From a record during which the box did not move to its mounting: start, noise levels, refinement."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.mounting.adapt import adapted
from nav_core.mounting.closed_form import Start, start
from nav_core.mounting.fixes import Fixes
from nav_core.mounting.model import Noise
from nav_core.mounting.refine import HUBER, Fit, refine
from nav_core.mounting.smoothing import as_received, smoothing_time
from nav_core.mounting.stretch import Record

_ROUGHLY = 1.0
"""Sigmas within which the rough fit has settled: it tells noise levels, and the fine one goes on from it."""

EXCERPT = 400.0
"""Length of the stretch that start and noise levels are taken from, s."""


class Solution(NamedTuple):
    """A fit and where it came from."""

    start: Start
    rough: Fit
    """With the noise levels of an ordinary drive, on the excerpt."""
    fit: Fit
    record: Record
    """What `fit` is of: the record `as_received`."""
    smoothing: float
    """Time constant of the receiver's low-pass, s; 0 for none."""


_ROUNDS = 4
_SETTLED = 0.05
"""Mounting and time constant are found in turn, at most so often, until the latter changes by less than this, s."""


def solve(record: Record, noise: Noise) -> Solution:
    """Best mounting of a record during which the box did not move, from a receiver that does not smooth.

    Parameters
    ----------
    record : Record
        With at least three fixes and some ticks.
    noise : Noise
        Least noise levels.

    Returns
    -------
    Solution
    """
    part = excerpt(record, EXCERPT)
    first = start(part, noise)
    rough = refine(part, first, noise, within=_ROUGHLY)
    suited = adapted(part, rough.view, noise, rough.p, HUBER)
    return Solution(first, rough, refine(record, _near(first, rough), suited, rough.p), record, 0.0)


def matched(solution: Solution, noise: Noise) -> Solution:
    """The solution with the receiver's smoothing taken into account, where it clearly smooths.

    Parameters
    ----------
    solution : Solution
        Of a record as it was logged.
    noise : Noise
        Least noise levels.

    Returns
    -------
    Solution
        The same where nothing speaks for smoothing.
    """
    record, first, rough = solution.record, solution.start, solution.rough
    part = excerpt(record, EXCERPT)
    seen, smoothing = part, 0.0
    for _ in range(_ROUNDS):
        time = smoothing_time(part, rough, noise, smoothing)
        if abs(time - smoothing) < _SETTLED:
            break
        lag = max(rough.speed_lag + smoothing - time, 0.0)
        seen = as_received(part, time, rough.R_va, lag)
        better = first._replace(
            R_va=rough.R_va, speed_lag=lag, course_lag=max(rough.course_lag + smoothing - time, 0.0)
        )
        rough, smoothing = refine(seen, better, noise, rough.p, within=_ROUGHLY), time
    if smoothing == 0.0:
        return solution
    suited = adapted(seen, rough.view, noise, rough.p, HUBER)
    first = start(seen, noise)
    whole = as_received(record, smoothing, rough.R_va, rough.speed_lag)
    return Solution(first, rough, refine(whole, _near(first, rough), suited, rough.p), whole, smoothing)


def _near(first: Start, rough: Fit) -> Start:
    """Where a finer fit begins."""
    return first._replace(R_va=rough.R_va, speed_lag=rough.speed_lag, course_lag=rough.course_lag)


def excerpt(record: Record, length: float) -> Record:
    """The most eventful stretch of a record, at most `length` seconds long.

    Parameters
    ----------
    record : Record
        Ticks and fixes.
    length : float
        s.

    Returns
    -------
    Record
        `record` itself where it is no longer.
    """
    t = record.fixes.t
    if t[-1] - t[0] <= length:
        return record
    events = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(record.fixes.speed)))])
    end = np.searchsorted(t, t + length, side="right") - 1
    first = int(np.argmax(events[end] - events))
    return between(record, t[first], t[int(end[first])])


def between(record: Record, begin: float, end: float) -> Record:
    """The part of a record from one box time to another, s; its first step counts from nowhere.

    Parameters
    ----------
    record : Record
        Ticks and fixes.
    begin, end : float
        Box clock, s; both included.

    Returns
    -------
    Record
        Of the same ticks and fixes.
    """
    inside = (record.fixes.t >= begin) & (record.fixes.t <= end)
    ticks = (record.t >= begin) & (record.t <= end)
    step = record.step[ticks].copy()
    step[:1] = 0.0
    fixes = Fixes(*(column[inside] for column in record.fixes))
    return Record(record.t[ticks], record.f[ticks], step, fixes, record.density[ticks])
