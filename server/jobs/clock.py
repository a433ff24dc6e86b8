"""The clock of a boot: how box time maps to UTC."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.timebase import fit_clock
from nav_core.typing import Floats

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
    """Clock from pairs of box time and UTC minus box time, one per batch."""
    order = np.argsort(t, kind="stable")  # sums round alike whichever batch came first
    fit = fit_clock(t[order], t[order] + offset[order])
    if abs(fit.drift) > MAX_DRIFT:
        return BootClock(float(np.median(offset)), 0.0, ARRIVAL_SIGMA_S, "gnss")
    sigma = float(np.sqrt(fit.sigma**2 + fit.scatter**2 + LAG_SIGMA_S**2))
    return BootClock(fit.utc_ref - (1.0 + fit.drift) * fit.t_ref, fit.drift, sigma, "gnss")


def from_arrival(offset_s: float) -> BootClock:
    """Clock from the smallest time of arrival minus box time."""
    return BootClock(offset_s, 0.0, ARRIVAL_SIGMA_S, "arrival")
