"""Receivers that smooth: the low-pass a receiver puts its velocity through, found and matched.

Smoothing is no delay: slow changes come late, quick ones small, and a velocity that turns while it is
averaged loses length.  Undoing it would raise the receiver's noise; so the box's specific force goes through
the same low-pass, and both tell of the same motion again.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from nav_core.mounting.model import Noise, turned
from nav_core.mounting.refine import HUBER, Fit, view_of, weigh
from nav_core.mounting.stretch import Record, at, smoothed
from nav_core.typing import Floats

LADDER = (0.4, 0.7, 1.0, 1.4, 2.0, 2.8)
"""Time constants that are tried, s."""

CLEAR = 30.0
"""Twice the log likelihood that smoothing must gain; of a receiver that does not smooth it loses."""

CALM = 0.4
"""Half width of the mean that takes vibration away as a low-pass does, s."""

EARLY = 0.3
"""By how much the lag that smoothing looks like may fall short of its time constant, s."""

QUIET = 1.0
"""Over so many seconds the force's noise must add less to a speed than the receiver's own: any low-pass takes a louder
one away, and a few samples a second are loud, because vibration folds down into them."""

SPEED, COURSE = 0, 3
"""Kinds of measurement in what `weigh` gives."""


def low_passed(record: Record, values: Floats, time: float) -> Floats:
    """Values at the ticks behind a first-order low-pass, linear between ticks; each gap begins anew.

    Parameters
    ----------
    record : Record
        m ticks.
    values : ndarray, shape (m, ...)
        Real or complex, in any unit.
    time : float
        Time constant, s.

    Returns
    -------
    ndarray, shape (m, ...)
        In that unit.
    """
    out = values.copy()
    if record.t.size < 2:
        return out
    edges = np.flatnonzero(record.step == 0.0).tolist()
    step = float(np.median(np.diff(record.t)))
    keep = float(np.exp(-step / time))
    now = 1.0 - (1.0 - keep) * time / step
    for begin, end in zip(edges, [*edges[1:], record.t.size], strict=True):
        part = values[begin:end]
        out[begin:end], _ = lfilter([now, 1.0 - keep - now], [1.0, -keep], part, axis=0, zi=part[:1] * (1.0 - now))
    return out


def as_received(record: Record, time: float, R_va: Floats, lag: float) -> Record:
    """A record whose specific force went through the receiver's low-pass, and whose velocity is as long as before it.

    Parameters
    ----------
    record : Record
        Ticks, A-frame, and fixes.
    time : float
        Time constant of the receiver, s.
    R_va : ndarray, shape (3, 3)
        From A to V, for how fast the vehicle turns.
    lag : float
        Of the receiver beside its low-pass, s.

    Returns
    -------
    Record
        Speed and course corrected by what smoothing a turning vector does to its length and its
        direction, beyond smoothing either of them.
    """
    if time == 0.0:
        return record
    fixes = record.fixes
    frame = turned(record, R_va, lag + time)
    speed = np.interp(record.t + lag + time, fixes.t, fixes.speed)
    when = fixes.t - lag
    heading = np.cumsum(frame.w * record.step)
    # What the receiver says is too short already: its length is made up once, then weighed.
    short = low_passed(record, speed, time) - np.abs(low_passed(record, speed * np.exp(1j * heading), time))
    full = speed + short
    vector = low_passed(record, full * np.exp(1j * heading), time)
    lost = low_passed(record, full, time) - np.abs(vector)
    ahead = np.angle(vector * np.exp(-1j * low_passed(record, heading, time)))
    corrected = fixes._replace(
        speed=fixes.speed + at(record, when, lost), course=fixes.course - at(record, when, ahead)
    )
    return record._replace(f=low_passed(record, record.f, time), fixes=corrected)


def smoothing_time(record: Record, fit: Fit, noise: Noise, present: float = 0.0) -> float:
    """Time constant with which the receiver seems to smooth, s; 0 where it does not clearly.

    Parameters
    ----------
    record : Record
        As it was logged.
    fit : Fit
        Of it `as_received`; what of the smoothing is not in that looks like a lag.
    noise : Noise
        What to expect.
    present : float
        Time constant that `fit` reckons with, s.

    Returns
    -------
    float
        s.
    """
    if QUIET * float(np.median(record.density)) > noise.speed_white**2:
        return 0.0
    late = fit.speed_lag + present, fit.course_lag + present

    def cost(time: float, seen: Record | None = None) -> float:
        lags = max(late[0] - time, 0.0), max(late[1] - time, 0.0)
        seen = seen or as_received(record, time, fit.R_va, lags[0])
        # What is tried with is what the fit is of, seen from there already, unless it is another record.
        same = seen is record and present == 0.0
        view = fit.view if same else view_of(seen, fit.R_va, lags)
        evidence = weigh(seen, view, noise, fit.p, HUBER)
        # Not by the climb: any low-pass takes heave and vibration away.
        return float((evidence.misfit(fit.p) + evidence.log_det)[:, [SPEED, COURSE]].sum())

    tried, costs = [0.0], [cost(0.0) - CLEAR]
    for time in LADDER:
        if time > late[0] + EARLY:
            break
        tried.append(time)
        costs.append(cost(time))
        if costs[-1] >= costs[-2]:
            break
    best = int(np.argmin(costs))
    if best == 0 or costs[best] > cost(0.0, _calmed(record)) - CLEAR:
        return 0.0
    if best == len(tried) - 1:
        return tried[best]
    return _lowest(np.array(tried[best - 1 : best + 2]), np.array(costs[best - 1 : best + 2]))


def _calmed(record: Record) -> Record:
    """Specific force without its quickest part and without delay: what that gains, any low-pass does."""
    mean = [smoothed(record, record.f[:, axis], CALM) for axis in range(3)]
    return record._replace(f=np.column_stack(mean))


def _lowest(at: Floats, values: Floats) -> float:
    """Where the parabola through three points is lowest, the middle one being the lowest of them."""
    left, right = (values[1] - values[0]) / (at[1] - at[0]), (values[2] - values[1]) / (at[2] - at[1])
    middle = 0.5 * (at[:-1] + at[1:])
    return float(middle[0] - left * (middle[1] - middle[0]) / (right - left))
