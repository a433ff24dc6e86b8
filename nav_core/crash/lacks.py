"""What a recording lacks of a blow: samples within it, its start, its end; and what that could have held."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.crash.pulse import Blow
from nav_core.events.trigger import AFTER_END
from nav_core.typing import Floats

MISSING = 2.5
"""Steps longer than this share of the usual one lack samples."""

LONGEST = 0.2
"""Blows last at most about this long, s."""

NEAR = 0.01
"""The force where samples are missing is the largest within this time of it, s."""


class Lacks(NamedTuple):
    """Of a blow.

    Attributes
    ----------
    starts, ends : bool
        The recording starts or ends within it.
    gap : float
        Time without samples within it, s.
    unsure : float
        1 sigma of the velocity that gaps leave open, m/s.
    hidden : float
        Velocity that a missing start or end may have added, 95 %, m/s.
    """

    starts: bool
    ends: bool
    gap: float
    unsure: float
    hidden: float

    @property
    def any(self) -> bool:
        """Whether anything lacks."""
        return self.starts or self.ends or self.gap > 0.0


def lacks_of(blow: Blow, rate: float) -> Lacks:
    """What a blow lacks, at this many samples per second.

    Parameters
    ----------
    blow : Blow
        Samples about an impact, m/s², box clock, s.
    rate : float
        Hz.

    Returns
    -------
    Lacks
        Missing start and end, s missing inside, and what both may hide, m/s.
    """
    t, size = blow.t, np.hypot(blow.a[:, 0], blow.a[:, 1])
    starts = blow.zero == 0
    ends = bool(t[blow.last] < t[blow.end] + AFTER_END - 1.5 / rate)
    gap = unsure = 0.0
    step, steepest = np.diff(t), _steepest(blow, rate)
    for k in range(max(blow.zero - 1, 0), min(blow.last, step.size)):
        if step[k] > MISSING / rate:
            lost = float(step[k]) - 1.0 / rate
            gap += lost
            # Between its edges a pulse bulges by what its steepest slope allows, or rings by part of its force.
            near = max(_near(t, size, k), _near(t, size, k + 1))
            unsure += max(0.25 * steepest * float(step[k]) ** 2, 0.25 * near * lost) / 1.96
    # As if it had gone on as strong as it was at the edge.
    left = max(LONGEST - float(t[blow.last] - t[blow.zero]), AFTER_END)
    hidden = starts * _near(t, size, 0) * left + ends * _near(t, size, blow.last) * left
    return Lacks(starts, ends, gap, unsure, hidden)


def _steepest(blow: Blow, rate: float) -> float:
    """Largest change of the horizontal acceleration, over at least 5 ms, per second, m/s³."""
    part = slice(max(blow.zero - 1, 0), blow.last + 1)
    t, a = blow.t[part], blow.a[part, :2]
    stride = min(max(int(np.ceil(0.005 * rate - 1e-3)), 1), t.size - 1)
    change = a[stride:] - a[:-stride]
    return float((np.hypot(change[:, 0], change[:, 1]) / (t[stride:] - t[:-stride])).max()) if stride > 0 else 0.0


def _near(t: Floats, size: Floats, k: int) -> float:
    """Largest acceleration near a sample, m/s²."""
    return float(size[np.abs(t - t[k]) <= NEAR].max())
