"""Jumps of the box clock and of the receiver's, told apart (equations MT8)."""

from __future__ import annotations

import numpy as np

from nav_core.mounting.reasons import reason
from nav_core.mounting.reversing import distances
from nav_core.mounting.stretch import Span
from nav_core.records import Gnss, Reason
from nav_core.typing import Flags, Floats

JUMP = 1.0
"""Least jump between two clocks, s."""

AROUND_JUMP = 5.0
"""Left out around a jump back of the box clock, s."""


def clock_jumps(gnss: Gnss) -> tuple[tuple[Span, ...], list[Reason]]:
    """Jumps of the box clock and of UTC.

    Parameters
    ----------
    gnss : Gnss

    Returns
    -------
    torn : tuple of Span
        Where two times lie on top of each other, or next to each other, because the box clock jumped back.
    remarks : list of Reason
        ``clock_jump``, ``utc_jump``.
    """
    good = gnss.fix & np.isfinite(gnss.lat) & np.isfinite(gnss.lon) & np.isfinite(gnss.speed)
    # Not `stale`: it takes a fix that is older than the one before for a repeated one.
    good[1:] &= (np.diff(gnss.lat) != 0.0) | (np.diff(gnss.lon) != 0.0) | (np.diff(gnss.speed) != 0.0)
    t = gnss.t[good]
    if t.size < 10:
        return (), []
    offset = np.full(t.size, np.nan) if gnss.utc is None else gnss.utc[good] - t
    torn = np.concatenate([[False], _beyond_reach(gnss, good)])
    back = torn | np.concatenate([[False], np.diff(offset) + np.diff(t) < -JUMP])
    spans = _clusters(t[back])
    remarks: list[Reason] = []
    for place, jump in _lasting(t, offset, spans):
        hole = float(t[place + 1] - t[place])
        if jump < 0.0 and abs(hole + jump) < max(0.5 * abs(jump), JUMP):
            remarks.append(reason("clock_jump", f"{-jump:+.0f}"))  # the hole says it: the box's clock went on
        elif torn[place + 1]:
            spans = (*spans, Span(float(t[place]) - AROUND_JUMP, float(t[place + 1]) + AROUND_JUMP))
        else:
            remarks.append(reason("utc_jump", f"{jump:+.0f}"))
    if spans:
        remarks.insert(0, reason("clock_torn", f"{sum(span.end - span.begin for span in spans):.0f}"))
    return spans, remarks


def _beyond_reach(gnss: Gnss, good: Flags) -> Flags:
    """Steps from fix to fix that are farther than any vehicle gets, shape (n - 1,)."""
    speed = gnss.speed[good]
    way = distances(gnss.lat[good], gnss.lon[good])
    return way > (np.maximum(speed[1:], speed[:-1]) + 5.0) * np.diff(gnss.t[good]) + 25.0


def _clusters(t: Floats, least: int = 3) -> tuple[Span, ...]:
    """Spans in which events follow each other closely, at least so many."""
    if t.size < least:
        return ()
    groups = np.split(t, np.flatnonzero(np.diff(t) > AROUND_JUMP) + 1)
    return tuple(Span(float(g[0]) - AROUND_JUMP, float(g[-1]) + AROUND_JUMP) for g in groups if g.size >= least)


def _lasting(t: Floats, offset: Floats, spans: tuple[Span, ...], reach: int = 4) -> list[tuple[int, float]]:
    """Steps after which UTC and box clock stay apart otherwise than before: index and jump, s."""
    usable = np.flatnonzero(np.isfinite(offset) & ~_inside(t, spans))
    if usable.size < 2 * reach:
        return []
    windows = np.median(np.lib.stride_tricks.sliding_window_view(offset[usable], reach), axis=1)
    change = windows[reach:] - windows[:-reach]
    found: list[tuple[int, float]] = []
    after = 0
    for i in np.flatnonzero(np.abs(change) > JUMP).tolist():
        if i < after:
            continue
        near = np.diff(offset[usable])[i : i + 2 * reach - 1]
        place = usable[i + int(np.argmax(np.abs(near)))]
        found.append((int(place), float(near[np.argmax(np.abs(near))])))
        after = i + 2 * reach
    return [(place, jump) for place, jump in found if not _inside(t[place + 1 : place + 2], spans).any()]


def _inside(t: Floats, spans: tuple[Span, ...]) -> Flags:
    out = np.zeros(t.size, dtype=np.bool_)
    for span in spans:
        out |= (t >= span.begin) & (t <= span.end)
    return out
