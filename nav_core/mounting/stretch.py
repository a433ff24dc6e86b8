"""A stretch of driving, prepared: ticks with the fixes among them, their integrals, and the steps between fixes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import erf

from nav_core.mounting.fixes import Fixes
from nav_core.signal import KERNEL_TICKS, Ticks
from nav_core.typing import Flags, Floats, Integers, kernel


class Span(NamedTuple):
    """Box times from..until, s."""

    begin: float
    end: float


PAUSE = 60.0
"""Without data for so long, s, one trip has ended and another begins."""


class Record(NamedTuple):
    """Ticks and fixes of a stretch of driving, prepared for repeated evaluation."""

    t: Floats
    """Tick times, s, shape (m,)."""
    f: Floats
    """Specific force in the A-frame, m/s², shape (m, 3)."""
    step: Floats
    """Valid time that ends at each tick, s: 0 after a gap, shape (m,)."""
    fixes: Fixes
    density: Floats
    """Noise of specific force, spectral density of each axis, (m/s²)²/Hz, shape (m,)."""


GRAIN_REACH = 1.5
"""Half width of the mean of noise densities, s."""

FOLDS = 45.0
"""Vibration of wheels and body reaches 20 Hz and more (001 §4.6): sampled slower than this, Hz, it is folded."""

UNFOLDED = 0.04
"""Share of the samples' variance that is noise of its own when vibration is sampled fast enough to be filtered."""


def grain(ticks: Ticks) -> Floats:
    """Spectral density of the noise of specific force at each tick, of one axis, (m/s²)²/Hz, shape (n,).

    The samples' scatter about their tick is vibration for the most.  Folded by slow sampling it is
    as good as white noise; otherwise the decimation filters it away, all but a share.  The effective
    number of samples under a Hann window is ``(sum w)² / sum w²``, four thirds of its weight.

    Parameters
    ----------
    ticks : Ticks
        n ticks of the specific force, m/s².

    Returns
    -------
    ndarray, shape (n,)
        (m/s²)²/Hz.
    """
    independent = np.maximum(4.0 / 3.0 * ticks.weight, 1.5)
    variance = ticks.scatter**2 / 3.0 / (1.0 - 1.0 / independent)
    per_second = np.maximum(ticks.weight, 1e-9) * ticks.rate * 2.0 / KERNEL_TICKS
    return np.where(per_second < FOLDS, 1.0, UNFOLDED) * variance / per_second


def prepare(ticks: Ticks, fixes: Fixes) -> Record:
    """Valid ticks around the fixes, with the gaps marked.

    Parameters
    ----------
    ticks : Ticks
        Of the specific force, A-frame, m/s².
    fixes : Fixes
        Usable ones.

    Returns
    -------
    Record
        Steps of 0 s over gaps.
    """
    inside = ticks.valid
    if fixes.t.size:
        inside &= (ticks.t >= fixes.t[0] - 3.0) & (ticks.t <= fixes.t[-1] + 1.0)
    t, f = ticks.t[inside], ticks.f[inside]
    step = np.diff(t, prepend=t[:1])
    step[step > 3.5 / ticks.rate] = 0.0
    bare = Record(t, f, step, fixes, np.zeros(t.size))
    return bare._replace(density=smoothed(bare, grain(ticks)[inside], GRAIN_REACH))


def integrate(record: Record, values: Floats) -> Floats:
    """Running trapezoid integral of tick values over valid time, shape like `values`.

    Parameters
    ----------
    record : Record
        m ticks.
    values : ndarray, shape (m, ...)
        In any unit.

    Returns
    -------
    ndarray, shape (m, ...)
        That unit times s.
    """
    step = record.step if values.ndim == 1 else record.step[:, None]
    mean = values.copy()
    mean[1:] += values[:-1]
    return np.cumsum(0.5 * step * mean, axis=0)


def smoothed(record: Record, values: Floats, reach: float) -> Floats:
    """Mean of tick values over `reach` seconds either side, shape (m,).

    Parameters
    ----------
    record : Record
        m ticks.
    values : ndarray, shape (m,)
        In any unit.
    reach : float
        s.

    Returns
    -------
    ndarray, shape (m,)
        In that unit.
    """
    out = np.empty(values.size)
    _mean_around(np.ascontiguousarray(record.t), np.ascontiguousarray(values), reach, out)
    return out


@kernel
def _mean_around(t: Floats, values: Floats, reach: float, out: Floats) -> None:
    n, first, last = t.size, 0, 0
    total = np.empty(n + 1)
    total[0] = 0.0
    for i in range(n):
        total[i + 1] = total[i] + values[i]
    for i in range(n):
        while t[first] < t[i] - reach:
            first += 1
        while last < n and t[last] <= t[i] + reach:
            last += 1
        out[i] = (total[last] - total[first]) / (last - first)


def smoothed_reference(record: Record, values: Floats, reach: float) -> Floats:
    """What `smoothed` computes, in plain array code.

    Parameters
    ----------
    record : Record
        m ticks.
    values : ndarray, shape (m,)
        In any unit.
    reach : float
        s.

    Returns
    -------
    ndarray, shape (m,)
        In that unit.
    """
    total = np.concatenate([[0.0], np.cumsum(values)])
    first = np.searchsorted(record.t, record.t - reach)
    last = np.searchsorted(record.t, record.t + reach, side="right")
    return (total[last] - total[first]) / (last - first)


def at(record: Record, when: Floats, values: Floats) -> Floats:
    """Tick values at any times, linear in between, shape (n,) or (n, k).

    Parameters
    ----------
    record : Record
        m ticks.
    when : ndarray, shape (n,)
        Box clock, s; the ends hold beyond the ticks.
    values : ndarray, shape (m, ...)
        In any unit.

    Returns
    -------
    ndarray, shape (n, ...)
        In that unit.
    """
    if record.t.size == 0:
        return np.zeros((when.size, *values.shape[1:]))
    right = np.clip(np.searchsorted(record.t, when), 1, max(record.t.size - 1, 1))
    left = right - 1
    right = np.minimum(right, record.t.size - 1)
    span = np.maximum(record.t[right] - record.t[left], 1e-9)
    share = np.clip((when - record.t[left]) / span, 0.0, 1.0)
    if values.ndim == 2:
        share = share[:, None]
    return values[left] + share * (values[right] - values[left])


LONGEST_HOLE = 10.0
"""Between fixes further apart nothing is followed, s: what the road did to the speed, and stops, is anyone's guess."""


class Steps(NamedTuple):
    """From fix to fix at one lag: durations, distances, and where the thread breaks."""

    when: Floats
    dt: Floats
    """Valid time, s."""
    distance: Floats
    """m."""
    broken: Flags
    """Accelerometer data are missing in the step, or fixes for longer than `LONGEST_HOLE`."""


def steps_of(record: Record, lag: float) -> Steps:
    """Steps that end at each fix's own moment, ``t - lag``.

    Parameters
    ----------
    record : Record
        Ticks and n fixes.
    lag : float
        s.

    Returns
    -------
    Steps
        n of them; the first has no data.
    """
    when = record.fixes.t - lag
    elapsed = np.diff(when, prepend=when[:1])
    covered = np.diff(at(record, when, np.cumsum(record.step)), prepend=0.0)
    covered[0] = 0.0
    speed = record.fixes.speed
    before = np.concatenate([speed[:1], speed[:-1]])
    broken = (np.abs(elapsed - covered) > 0.15) | (elapsed > LONGEST_HOLE)
    broken[0] = True
    return Steps(when, covered, 0.5 * (speed + before) * elapsed, broken)


def gained(record: Record, steps: Steps, columns: Sequence[Floats]) -> Floats:
    """What running integrals of tick values (`integrate`) gain over each step.

    Parameters
    ----------
    record : Record
        m ticks, n fixes.
    steps : Steps
        n of them.
    columns : sequence of ndarray, shape (m,)
        k of them, each in any unit.

    Returns
    -------
    ndarray, shape (n, k)
        That unit times s; 0 where the step is broken.
    """
    return _gained(record, steps.when, steps.broken, columns)


def gained_between(record: Record, edges: Floats, columns: Sequence[Floats]) -> Floats:
    """What running integrals of tick values (`integrate`) gain from each of some moments to the next.

    Parameters
    ----------
    record : Record
        m ticks.
    edges : ndarray, shape (n,)
        Box clock, s; they may go back, and what is gained there is taken away.
    columns : sequence of ndarray, shape (m,)
        k of them, each in any unit.

    Returns
    -------
    ndarray, shape (n - 1, k)
        That unit times s.
    """
    return _gained(record, edges, np.zeros(edges.size, dtype=np.bool_), columns)[1:]


def _gained(record: Record, when: Floats, broken: Flags, columns: Sequence[Floats]) -> Floats:
    out = np.zeros((when.size, len(columns)))
    if record.t.size > 1:
        _gain(record.t, record.step, np.stack(columns), when, broken, out)
    return out


@kernel
def _gain(t: Floats, step: Floats, columns: Floats, when: Floats, broken: Flags, out: Floats) -> None:
    """One walk along ticks and steps for each column; between ticks the integral is taken as straight."""
    for c in range(columns.shape[0]):
        values = columns[c]
        right, before, now, last = 0, 0.0, 0.0, 0.0
        for i in range(when.size):
            while right < t.size - 1 and (right == 0 or t[right] < when[i]):
                right += 1
                before = now
                now += 0.5 * step[right] * (values[right] + values[right - 1])
            while right > 1 and t[right - 1] > when[i]:
                right -= 1
                now = before
                before -= 0.5 * step[right] * (values[right] + values[right - 1])
            share = (when[i] - t[right - 1]) / max(t[right] - t[right - 1], 1e-9)
            there = before + min(max(share, 0.0), 1.0) * (now - before)
            out[i, c] = 0.0 if broken[i] or i == 0 else there - last
            last = there


def gained_reference(record: Record, steps: Steps, columns: Sequence[Floats]) -> Floats:
    """What `gained` computes, in plain array code.

    Parameters
    ----------
    record : Record
        m ticks, n fixes.
    steps : Steps
        n of them.
    columns : sequence of ndarray, shape (m,)
        k of them, each in any unit.

    Returns
    -------
    ndarray, shape (n, k)
        That unit times s; 0 where the step is broken.
    """
    total = at(record, steps.when, integrate(record, np.column_stack(columns)))
    out = np.diff(total, axis=0, prepend=total[:1])
    out[steps.broken] = 0.0
    return out


WINDOW_SPREAD = 0.0723
"""Standard deviation of the decimation's Hann window at the default tick rate, s."""


def rough_share(dt: Floats) -> Floats:
    """Share of white noise, integrated over `dt` seconds, that the decimation leaves, shape (n,).

    ``E max(dt - |d|, 0) / dt`` with d the distance of two draws from the window, taken as normal.

    Parameters
    ----------
    dt : ndarray, shape (n,)
        s.

    Returns
    -------
    ndarray, shape (n,)
        0 to 1.
    """
    s = np.sqrt(2.0) * WINDOW_SPREAD
    z = np.maximum(dt, 1e-3) / s
    return erf(z / np.sqrt(2.0)) - np.sqrt(2.0 / np.pi) / z * (1.0 - np.exp(-0.5 * z**2))


def blocks_of(t: Floats, origin: float, length: float) -> Integers:
    """Number of the stretch of `length` seconds that each time falls into.

    Parameters
    ----------
    t : ndarray, shape (n,)
        s.
    origin : float
        Start of stretch 0, s; what is earlier belongs to it.
    length : float
        s.

    Returns
    -------
    ndarray of int, shape (n,)
        From 0.
    """
    return np.maximum(np.floor((t - origin) / length), 0).astype(np.int64)
