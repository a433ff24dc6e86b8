"""Noise levels that suit the drive at hand, by likelihood.

Receivers, roads and cars differ by factors.  A drive that is rougher than the model would make its
own estimate look better than it is, and weigh the wrong measurements; so the levels are raised
while that makes the recording more likely.  They are never lowered: a smooth drive earns no credit.
So is the time over which the receiver's height wanders: height that is believed too much passes for slope.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from nav_core.mounting.model import Noise
from nav_core.mounting.pitch_plane import pitch_plane
from nav_core.mounting.refine import View
from nav_core.mounting.stretch import Record
from nav_core.mounting.whitening import Channel, at_point, whiten
from nav_core.mounting.yaw_plane import yaw_plane
from nav_core.typing import Floats

_LADDER = (1.0, 1.5, 2.2, 3.3, 5.0, 8.0)
_MOST: dict[tuple[str, ...], float] = {("drift",): 10.0}
"""No accelerometer drifts faster; left free, drift would explain away what tilt and slope should."""

_PITCH_LEVELS = (
    ("speed_white", "speed_slow"),
    ("heave",),
    ("force", "relative"),
    ("slope",),
    ("drift",),
    ("height_time",),
)
_YAW_LEVELS = (("across_white", "across_slow"), ("bank",), ("relative_turn",))
GAIN = 6.0
"""A step up must raise twice the log likelihood by this much."""


def adapted(record: Record, view: View, noise: Noise, p: Floats, limit: float) -> Noise:
    """Noise levels that explain the record at a given mounting.

    Parameters
    ----------
    record : Record
        A representative stretch.
    view : View
        Of the record, at that mounting.
    noise : Noise
        Where to begin.
    p : ndarray, shape (14,)
    limit : float
        Robust limit, sigmas.

    Returns
    -------
    Noise
        No level below that of `noise`.
    """
    block = np.zeros(record.fixes.t.size, dtype=np.int64)

    def cost(channel: Channel) -> float:
        evidence = whiten(at_point(channel, p), block, 1, p, limit=limit)
        return float((evidence.misfit(p) + evidence.log_det).sum())

    def pitch_cost(trial: Noise) -> float:
        return cost(pitch_plane(record, view.along, trial))

    def yaw_cost(trial: Noise) -> float:
        return cost(yaw_plane(record, view.across, trial))

    found = noise
    for groups, of_trial in ((_PITCH_LEVELS, pitch_cost), (_YAW_LEVELS, yaw_cost)):
        found = _climb(found, noise, groups, of_trial)
    return found


def _climb(found: Noise, base: Noise, groups: tuple[tuple[str, ...], ...], cost: Callable[[Noise], float]) -> Noise:
    """One step up at a time, always the one that gains most."""
    best = cost(found)
    height = dict.fromkeys(groups, 0)
    while True:
        trials: list[tuple[float, tuple[str, ...], Noise]] = []
        for group, level in height.items():
            if level + 1 < len(_LADDER) and _LADDER[level + 1] <= _MOST.get(group, np.inf):
                scale = _LADDER[level + 1]
                trial = replace(found, **{name: getattr(base, name) * scale for name in group})
                trials.append((cost(trial), group, trial))
        if not trials:
            return found
        now, group, trial = min(trials, key=lambda entry: entry[0])
        if now > best - GAIN:
            return found
        best, found = now, trial
        height[group] += 1
