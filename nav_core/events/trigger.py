"""Moments worth a look: the trigger, time zero and end of event of 49 CFR 563 on a stream of specific force.

Delta-V is integrated over all horizontal directions at once, so the longitudinal and lateral triggers of the
regulation are met whichever way the blow comes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.earth import STANDARD_GRAVITY
from nav_core.records import Inertial
from nav_core.typing import Flags, Floats, Integers, kernel

KMH = 1.0 / 3.6

TRIGGER = 8.0 * KMH
"""Change of velocity within `TRIGGER_WINDOW` that makes an event (§563.5), m/s and s."""

TRIGGER_WINDOW = 0.150

FAINTEST = 0.45
"""No change smaller than this within `TRIGGER_WINDOW` is looked at, m/s: a bump of a parked vehicle."""

BLOCK = 64
"""Samples that are ruled out together."""

THRESHOLD = 0.8 * KMH
"""Change within `WINDOW` that starts an event; at most this much ends it (§563.5), m/s and s."""

WINDOW = 0.020

QUIET = 0.030
"""The end counts when it stays quiet for this long, s: a pulse that swings through zero has not ended."""

MULTI_EVENT = 5.0
"""Blows that start within this time of the first belong to one event (§563.5), s."""

AFTER_END = 0.030
"""Integration goes on this long after the end of the event, s."""

REST_SPAN = (2.5, 0.25)
"""What is taken off before integrating is the mean from 2.5 to 0.25 s ago: slope, bias, cornering, braking."""


class Stream(NamedTuple):
    """Specific force on the way to velocity.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Box clock, s.
    f : ndarray, shape (n, 3)
        V axes (or levelled ones of unknown heading), m/s².
    step : ndarray, shape (n,)
        Since the sample before, s; 0 at the start and after a gap.
    rest : ndarray, shape (n, 3)
        Running mean of `f` shortly before each sample, m/s².
    v : ndarray, shape (n, 3)
        Running integral of ``f - rest``, m/s.
    calm : ndarray of bool, shape (n,)
        Samples outside of anything that meets the trigger; only those are in `rest`.
    strongest : ndarray, shape (n,)
        `strongest_change`.
    """

    t: Floats
    f: Floats
    step: Floats
    rest: Floats
    v: Floats
    calm: Flags
    strongest: Floats

    def at(self, t: Floats) -> Floats:
        """`v` between the samples, shape (k, 3).

        Parameters
        ----------
        t : ndarray, shape (k,)
            Box clock, s.

        Returns
        -------
        ndarray, shape (k, 3)
            Integral of the force off its surroundings, V axes, m/s.
        """
        return np.column_stack([np.interp(t, self.t, self.v[:, axis]) for axis in range(3)])

    def rows(self, part: slice) -> Stream:
        """Some of the samples.

        Parameters
        ----------
        part : slice
            Of the n samples.

        Returns
        -------
        Stream
            Views of the same arrays; `rest`, `v` and `strongest` are not taken anew.
        """
        t, f, step, rest, v = (column[part] for column in (self.t, self.f, self.step, self.rest, self.v))
        return Stream(t, f, step, rest, v, self.calm[part], self.strongest[part])

    def mean(self, begin: float, end: float) -> Floats | None:
        """Mean specific force from..to, box clock, s; None without samples.

        Parameters
        ----------
        begin, end : float
            Box clock, s; `end` is not included.

        Returns
        -------
        ndarray, shape (3,) or None
            V axes, m/s².
        """
        first, last = np.searchsorted(self.t, [begin, end])
        return None if last <= first else self.f[first:last].mean(axis=0)


def stream_of(inertial: Inertial, R_va: Floats) -> Stream:
    """Stream of a recording, any rate, any gaps.

    Parameters
    ----------
    inertial : Inertial
        A-frame.
    R_va : ndarray, shape (3, 3)
        From A to V.

    Returns
    -------
    Stream
        V axes; steps of 0 s over gaps.
    """
    t, f = inertial.t, inertial.f @ R_va.T
    step = np.diff(t, prepend=t[:1])
    if t.size > 1:
        usual = float(np.median(step[1:]))
        step[step > max(5.0 * usual, 0.1)] = 0.0
    calm = np.ones(t.size, dtype=np.bool_)
    stream = _integrated(t, f, step, calm)
    violent = np.flatnonzero(stream.strongest >= TRIGGER)
    # What follows a blow must not be judged against a mean that holds the blow.
    return stream if violent.size == 0 else _integrated(t, f, step, _calm(t, violent))


def _integrated(t: Floats, f: Floats, step: Floats, calm: Flags) -> Stream:
    """The stream of a force and of the samples that its running mean is taken from."""
    rest = _rest(t, f, calm)
    v = integrate(f - rest, step)
    return Stream(t, f, step, rest, v, calm, strongest_change(t, v))


def _calm(t: Floats, violent: Integers) -> Flags:
    """Samples that no window over the trigger covers; `violent` are where such windows begin."""
    until = np.searchsorted(t, t[violent] + TRIGGER_WINDOW, side="right")
    edges = np.bincount(violent, minlength=t.size + 1) - np.bincount(until, minlength=t.size + 1)
    return np.cumsum(edges)[: t.size] <= 0


def integrate(a: Floats, step: Floats) -> Floats:
    """Running integral by trapezia, shape (n, k), 0 at the first sample and unchanged over gaps.

    Parameters
    ----------
    a : ndarray, shape (n, k)
        In any unit.
    step : ndarray, shape (n,)
        From the sample before, s; 0 over a gap.

    Returns
    -------
    ndarray, shape (n, k)
        That unit times s.
    """
    out = np.zeros(a.shape)
    _add_up(np.ascontiguousarray(a), np.ascontiguousarray(step), out)
    return out


@kernel
def _add_up(a: Floats, step: Floats, out: Floats) -> None:
    for i in range(1, a.shape[0]):
        for axis in range(a.shape[1]):
            out[i, axis] = out[i - 1, axis] + 0.5 * (a[i, axis] + a[i - 1, axis]) * step[i]


@kernel
def _before(t: Floats, f: Floats, calm: Flags, opening: Floats, hold: bool, rest: Floats) -> None:
    """Set `rest` to the mean of `f` over the calm samples shortly before each, or what stands for it."""
    n, first, last = t.size, 0, 0
    total, counted = np.zeros((n + 1, 3)), np.zeros(n + 1)
    for i in range(n):
        counted[i + 1] = counted[i] + calm[i]
        for axis in range(3):
            total[i + 1, axis] = total[i, axis] + f[i, axis] * calm[i]
    held = -1  # the last sample whose mean is known
    for i in range(n):
        while first < n and t[first] < t[i] - REST_SPAN[0]:
            first += 1
        while last < n and t[last] < t[i] - REST_SPAN[1]:
            last += 1
        count = counted[last] - counted[first]
        known = count > 0.0 and t[i] - REST_SPAN[1] - t[first] >= 0.5 * REST_SPAN[1]
        for axis in range(3):
            if known:
                rest[i, axis] = (total[last, axis] - total[first, axis]) / count
            elif held >= 0:
                rest[i, axis] = rest[held, axis]
            else:
                rest[i, axis] = opening[axis]
        if known and hold:
            held = i


def _rest(t: Floats, f: Floats, calm: Flags) -> Floats:
    """Running mean of the force shortly before each sample; at the start of a recording, of its first moments."""
    rest = np.empty(f.shape)
    hold = not calm.all()  # violent for longer than the span: as it was when that began
    _before(np.ascontiguousarray(t), np.ascontiguousarray(f), calm, opening_mean(t, f), hold, rest)
    return rest


def rest_reference(t: Floats, f: Floats, calm: Flags) -> Floats:
    """What the kernel computes, in plain array code.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Increasing, s.
    f : ndarray, shape (n, 3)
        Specific force, V axes, m/s².
    calm : ndarray of bool, shape (n,)
        Samples that count.

    Returns
    -------
    ndarray, shape (n, 3)
        V axes, m/s².
    """
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(f * calm[:, None], axis=0)])
    counted = np.concatenate([[0], np.cumsum(calm)])
    first, last = np.searchsorted(t, t - REST_SPAN[0]), np.searchsorted(t, t - REST_SPAN[1])
    count = counted[last] - counted[first]
    opening = opening_mean(t, f)
    known = (count > 0) & (t - REST_SPAN[1] - t[first] >= 0.5 * REST_SPAN[1]) if t.size else count > 0
    mean = (total[last] - total[first]) / np.maximum(count, 1)[:, None]
    if calm.all():
        return np.where(known[:, None], mean, opening)
    held = np.maximum.accumulate(np.where(known, np.arange(t.size), -1))
    return np.where((held >= 0)[:, None], mean[held], opening)


def opening_mean(t: Floats, f: Floats) -> Floats:
    """Mean force of the first 40 ms while nothing happens in them; else gravity, as on a level road.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Box clock, s.
    f : ndarray, shape (n, 3)
        Specific force, V axes, m/s².

    Returns
    -------
    ndarray, shape (3,)
        V axes, m/s².
    """
    level = np.array([0.0, 0.0, -STANDARD_GRAVITY])
    if t.size == 0:
        return level
    first = f[: max(int(np.searchsorted(t, t[0] + 0.04)), 1)]
    # Wide enough for the vibration of a box that is badly held, too narrow for the start of a blow.
    calm = np.abs(first - first.mean(axis=0)).max() < 0.8 * STANDARD_GRAVITY
    return first.mean(axis=0) if calm else level


@kernel
def _lively(t: Floats, v: Floats, window: float, floor: float, begin: int) -> bool:
    """Whether any change of `v` within a window that begins in the block from `begin` on could reach `floor`."""
    stop = min(begin + BLOCK, t.size)
    until = t[stop - 1] + window
    low_x = high_x = v[begin, 0]
    low_y = high_y = v[begin, 1]
    for i in range(begin, t.size):
        low_x, high_x = min(low_x, v[i, 0]), max(high_x, v[i, 0])
        low_y, high_y = min(low_y, v[i, 1]), max(high_y, v[i, 1])
        if i >= stop - 1 and t[i] >= until:
            break
    return high_x - low_x + (high_y - low_y) >= floor


@kernel
def _strongest(t: Floats, v: Floats, windows: Floats, floor: float, best: Floats) -> None:
    """Raise `best` to the largest horizontal change of `v` over any of the windows that begin at each sample.

    Blocks in which nothing reaches `floor` keep their zeros; the windows are in order, the longest is the last.
    """
    last = t.size - 1
    for begin in range(0, t.size, BLOCK):
        if not _lively(t, v, windows[-1], floor, begin):
            continue
        for window in windows:
            j = begin
            for i in range(begin, min(begin + BLOCK, t.size)):
                until = t[i] + window
                while j < last and t[j] < until:
                    j += 1
                dx, dy = v[j, 0] - v[i, 0], v[j, 1] - v[i, 1]
                if abs(dx) + abs(dy) > best[i]:  # a root is the dearest part, and this bounds it
                    best[i] = max(best[i], np.hypot(dx, dy))


def strongest_reference(t: Floats, v: Floats, windows: Floats) -> Floats:
    """What the kernel computes, in plain array code, m/s, shape (n,).

    Parameters
    ----------
    t : ndarray, shape (n,)
        Not decreasing, s.
    v : ndarray, shape (n, 3)
        m/s.
    windows : ndarray, shape (k,)
        s.

    Returns
    -------
    ndarray, shape (n,)
        m/s.
    """
    best = np.zeros(t.size)
    for window in windows.tolist():
        j = np.minimum(np.searchsorted(t, t + window), max(t.size - 1, 0))
        change = v[j, :2] - v[:, :2]
        np.maximum(best, np.hypot(change[:, 0], change[:, 1]), out=best)
    return best


def _changes(t: Floats, v: Floats, windows: Floats, floor: float = 0.0) -> Floats:
    best = np.zeros(t.size)
    _strongest(np.ascontiguousarray(t), np.ascontiguousarray(v), windows, floor, best)
    return best


def off_rest(stream: Stream) -> Floats:
    """Size of the force off its surroundings, ``norm(f - rest)``, m/s², shape (n,).

    Parameters
    ----------
    stream : Stream
        Specific force, any axes.

    Returns
    -------
    ndarray, shape (n,)
        m/s².
    """
    # Not `linalg.norm`: along so short an axis that takes five times as long.
    x, y, z = (stream.f - stream.rest).T
    out: Floats = np.sqrt(x * x + y * y + z * z)
    return out


@kernel
def _sideways(t: Floats, v: Floats, window: float, out: Floats) -> None:
    j = 0
    for i in range(t.size):
        while j < t.size - 1 and t[j] < t[i] + window:
            j += 1
        out[i] = v[j, 1] - v[i, 1]


def sideways_within(stream: Stream, window: float) -> Floats:
    """Change of the velocity across the vehicle from each sample over the following window, m/s, shape (n,).

    Parameters
    ----------
    stream : Stream
        V axes.
    window : float
        s.

    Returns
    -------
    ndarray, shape (n,)
        m/s, right positive.
    """
    out = np.empty(stream.t.size)
    _sideways(np.ascontiguousarray(stream.t), np.ascontiguousarray(stream.v), window, out)
    return out


def change_within(stream: Stream, window: float) -> Floats:
    """Horizontal change of velocity from each sample over the following window, m/s, shape (n,).

    Parameters
    ----------
    stream : Stream
        V axes.
    window : float
        s.

    Returns
    -------
    ndarray, shape (n,)
        m/s.
    """
    return _changes(stream.t, stream.v, np.array([window]))


def strongest_change(t: Floats, v: Floats, floor: float = FAINTEST) -> Floats:
    """Largest horizontal change within `TRIGGER_WINDOW` of each sample, m/s, shape (n,).

    A pulse may be over before the window is: shorter windows are looked at as well.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Not decreasing, s.
    v : ndarray, shape (n, 3)
        Integral of the specific force off its surroundings, V axes, m/s.
    floor : float
        Changes below this may be given as 0, m/s: most of a drive is quiet, and is told so quickly.

    Returns
    -------
    ndarray, shape (n,)
        m/s.
    """
    return _changes(t, v, np.array([0.2, 0.4, 0.6, 0.8, 1.0]) * TRIGGER_WINDOW, floor)


def groups(flags: Flags, t: Floats, apart: float) -> list[tuple[int, int]]:
    """First and last index of every run of flags; runs closer than `apart`, s, are one.

    Parameters
    ----------
    flags : ndarray of bool, shape (n,)
        Which samples are meant.
    t : ndarray, shape (n,)
        Increasing, s.
    apart : float
        s.

    Returns
    -------
    list of tuple[int, int]
        Inclusive, in order of time.
    """
    index: Integers = np.flatnonzero(flags)
    if index.size == 0:
        return []
    cut = np.flatnonzero(np.diff(t[index]) > apart)
    begins = np.concatenate([index[:1], index[cut + 1]])
    ends = np.concatenate([index[cut], index[-1:]])
    return list(zip(begins.tolist(), ends.tolist(), strict=True))


class Window(NamedTuple):
    """Indices of an event in its stream: time zero, end of event, end of integration."""

    zero: int
    end: int
    last: int


def window_around(
    t: Floats, v: Floats, core: int, *, threshold: float = THRESHOLD, level: Floats | None = None
) -> Window:
    """Time zero and end of the event that has its strongest change at `core`.

    Parameters
    ----------
    t : ndarray, shape (n,)
    v : ndarray, shape (n, 2)
        Horizontal velocity from the integrated specific force, m/s.
    core : int
        A sample within the pulse.
    threshold : float
        Lower for what stays below the trigger and would have no window by the regulation, m/s.
    level : ndarray, shape (n, 2), optional
        The same velocity less gravity alone, m/s: after braking the event has also ended once nothing brakes any more.

    Returns
    -------
    Window
        `zero` is the start of the first 20 ms window over the threshold, of those that lead to the core without a
        pause of 20 ms; `end` closes the first window at or under it after the core.
    """
    n = t.size
    j = np.minimum(np.searchsorted(t, t + WINDOW - 1e-9), n - 1)
    over = np.hypot(*(v[j] - v).T) > threshold
    if not over[core]:  # the strongest window of all may start a sample or two off
        near = np.flatnonzero(over)
        if near.size == 0:
            return Window(core, core, core)
        core = int(near[np.argmin(np.abs(t[near] - t[core]))])
    apart = max(WINDOW, 1.5 * float(np.median(np.diff(t)))) + 1e-9
    before = np.flatnonzero(over[: core + 1])
    breaks = np.flatnonzero(np.diff(t[before]) > apart)
    zero = int(before[breaks[-1] + 1]) if breaks.size else int(before[0])
    if zero and t[zero] - t[zero - 1] > 0.75 * WINDOW:
        zero -= 1  # the window starts between two samples this far apart
    going = over if level is None else over & (np.hypot(*(level[j] - level).T) > threshold)
    going[core] = True
    after = core + np.flatnonzero(going[core:])
    breaks = np.flatnonzero(np.diff(t[after]) > max(QUIET, apart))
    final = int(after[breaks[0]]) if breaks.size else int(after[-1])
    end = int(min(j[min(final + 1, n - 1)], n - 1))
    last = int(min(np.searchsorted(t, t[end] + AFTER_END), n - 1))
    return Window(zero, end, last)
