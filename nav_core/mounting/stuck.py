"""Axes of an accelerometer that stopped feeling anything."""

from __future__ import annotations

import numpy as np

from nav_core.mounting.stretch import Span
from nav_core.signal import Ticks, runs

STUCK = 20.0
SHAKEN = 0.3
"""An axis that gives one and the same number for so long, s, while force about all axes scatters by so much, m/s²,
is broken: vibration reaches every axis of a box in a car."""


def stuck_axis(ticks: Ticks) -> tuple[Span, ...]:
    """Stretches in which one axis of the accelerometer, or two, stay at a number while another feels the drive.

    Parameters
    ----------
    ticks : Ticks
        Of the specific force.

    Returns
    -------
    tuple of Span
        In order of time.
    """
    valid = ticks.valid
    t, f, scatter = ticks.t[valid], ticks.f[valid], ticks.scatter[valid]
    spans: list[Span] = []
    for axis in range(3):
        # Means of equal samples differ by their rounding.
        same = np.abs(np.diff(f[:, axis])) < 1e-9
        for first, last in runs(same):  # of steps: the tick after the last of them is still the same
            part = slice(first, last + 1)
            if t[last] - t[first] < STUCK:
                continue
            shaking = f[part].var(axis=0).sum() + np.mean(scatter[part] ** 2)
            if shaking > SHAKEN**2 and not any(span.begin <= t[first] and t[last] <= span.end for span in spans):
                spans.append(Span(float(t[first]), float(t[last])))
    return tuple(sorted(spans))
