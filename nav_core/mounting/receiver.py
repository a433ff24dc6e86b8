"""What a satellite receiver does wrong, told from its own fixes: slow, frozen, late."""

from __future__ import annotations

import numpy as np

from nav_core.mounting.reasons import reason
from nav_core.records import Gnss, Reason
from nav_core.signal import runs
from nav_core.timebase import stale

SLOW_FIXES = 1.3
"""Hz; up to here named as slow."""

FROZEN = 3.0
"""Repeated fixes that last this long are named, s."""

LATE = 0.8
"""A receiver later than this is named, s."""


def slow_fixes(gnss: Gnss) -> Reason | None:
    """Whether the receiver is slow.

    Parameters
    ----------
    gnss : Gnss
        Of a recording.

    Returns
    -------
    Reason or None
        None of a rate that is high enough, or of too few fixes.
    """
    t = gnss.t[gnss.fix & ~stale(gnss)]
    if t.size < 10:
        return None
    rate = 1.0 / float(np.median(np.diff(t)))
    return reason("slow_gps", f"{rate:.2g}") if rate < SLOW_FIXES else None


def frozen(gnss: Gnss) -> Reason | None:
    """Whether the receiver repeated old fixes for long.

    Parameters
    ----------
    gnss : Gnss
        Of a recording.

    Returns
    -------
    Reason or None
        With the time that was lost, s; None where there was none.
    """
    repeated = stale(gnss)
    if not repeated.any():
        return None
    first, after = np.array(runs(repeated)).T
    begin, end = gnss.t[np.maximum(first - 1, 0)], gnss.t[after - 1]
    long = end - begin >= FROZEN
    return reason("gps_frozen", f"{float((end - begin)[long].sum()):.0f}") if long.any() else None


def late(speed_lag: float | None, course_lag: float | None) -> tuple[Reason, ...]:
    """Whether the receiver is late, from lags that are known, s.

    Parameters
    ----------
    speed_lag, course_lag : float or None
        s; None where unknown.

    Returns
    -------
    tuple of Reason
        One or none.
    """
    worst = max(speed_lag or 0.0, course_lag or 0.0)
    return (reason("gps_late", f"{worst:.1f}"),) if worst > LATE else ()
