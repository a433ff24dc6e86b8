"""Fewer points for the same picture: per bucket of time the smallest and the largest value."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.typing import Flags, Floats, Integers


@dataclass(frozen=True)
class Curve:
    """Columns that were sampled together."""

    t: Floats
    columns: dict[str, Floats]

    def part(self, rows: Integers | Flags | slice) -> Curve:
        """The same columns at some of the rows."""
        return Curve(self.t[rows], {name: values[rows] for name, values in self.columns.items()})


def gaps(t: Floats, *, at_least: float) -> list[tuple[float, float]]:
    """Where sampling paused for longer than `at_least` and than five usual steps; (last before, first after), s."""
    if t.size < 2:
        return []
    steps = np.diff(t)
    limit = max(at_least, 5.0 * float(np.median(steps)))
    before = np.flatnonzero(steps > limit)
    return list(zip(t[before].tolist(), t[before + 1].tolist(), strict=True))


def min_max(curve: Curve, points: int) -> Curve:
    """At most about `points` rows with every extreme kept; a curve that has no more is returned as it is.

    A bucket gives two rows: the smallest values at its first time, the largest at its last.  The
    true times of the extremes differ by less than a bucket, which is less than a pixel.
    """
    n = curve.t.size
    if n <= points:
        return curve
    buckets = max(points // 2, 1)
    edges = np.linspace(curve.t[0], curve.t[-1], buckets + 1)[:-1]
    return extremes(curve, np.unique(np.searchsorted(curve.t, edges, side="left")))


def extremes(curve: Curve, starts: Integers) -> Curve:
    """Two rows for each run of rows that begins at one of `starts`: the smallest values, then the largest."""
    n = curve.t.size
    ends = np.append(starts[1:], n) - 1
    paired = ends > starts
    # A bucket of one row stays one row: times must increase.
    order = np.repeat(np.arange(starts.size), np.where(paired, 2, 1))
    second = np.zeros(order.size, dtype=np.bool_)
    second[1:] = order[1:] == order[:-1]

    def woven(low: Floats, high: Floats) -> Floats:
        return np.where(second, high[order], low[order])

    columns = {
        name: woven(np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts))
        for name, values in curve.columns.items()
    }
    return Curve(woven(curve.t[starts], curve.t[ends]), columns)


def broken_at(curve: Curve, pauses: list[tuple[float, float]]) -> Curve:
    """The curve with a row of NaN within each pause, so that a line drawn through it is interrupted."""
    if not pauses or curve.t.size == 0:
        return curve
    middle = np.array([0.5 * (a + b) for a, b in pauses])
    at = np.searchsorted(curve.t, middle)
    columns = {name: np.insert(values, at, np.nan) for name, values in curve.columns.items()}
    return Curve(np.insert(curve.t, at, middle), columns)
