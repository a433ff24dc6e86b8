"""The clock of a boot: how box time maps to UTC."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.typing import Floats

DRIFT_SPAN_S = 600.0
"""Drift is fitted over at least this span; over less it would be the fixes' lag jitter."""

PAIRS = 720
"""Batches whose fixes take part in the fit, the newest."""

MAX_DRIFT = 1e-3
"""No crystal is that wrong; a larger slope means that the fixes lie about UTC."""

LAG_SIGMA_S = 0.3
"""A fix reaches the box 0 to some 0.6 s after its moment, by an amount that stays unknown."""

ARRIVAL_SIGMA_S = 30.0
"""Without UTC from fixes: a batch arrives some time after its last sample, how long is not known."""


@dataclass(frozen=True, slots=True)
class BootClock:
    """``utc = offset + (1 + drift) * t``, its standard deviation, and where it came from."""

    offset_s: float
    drift: float
    sigma_s: float
    source: str


def from_fixes(t: Floats, offset: Floats) -> BootClock:
    """Clock from pairs of box time and UTC minus box time, one per batch: a robust line.

    The slope is the median of the slopes between pairs in the first and the second half (Theil-Sen
    on a thinned set), so a few receivers' lies about UTC do not bend it.
    """
    order = np.argsort(t, kind="stable")
    t, offset = t[order], offset[order]
    drift = 0.0
    if t.size >= 4 and t[-1] - t[0] >= DRIFT_SPAN_S:
        half = t.size // 2
        drift = float(np.median((offset[-half:] - offset[:half]) / (t[-half:] - t[:half])))
        drift = drift if abs(drift) <= MAX_DRIFT else 0.0
    residual = offset - drift * t
    middle = float(np.median(residual))
    scatter = 1.4826 * float(np.median(np.abs(residual - middle)))
    return BootClock(middle, drift, float(np.hypot(scatter, LAG_SIGMA_S)), "gnss")


def from_arrival(offset_s: float) -> BootClock:
    """Clock from the smallest time of arrival minus box time."""
    return BootClock(offset_s, 0.0, ARRIVAL_SIGMA_S, "arrival")
