"""The stream of a box in chunks: cut, joined, and what of it a state must carry along."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from nav_core.mounting.clocks import JUMP
from nav_core.records import Drive, Gnss, Inertial
from nav_core.signal import Ticks, decimate
from nav_core.typing import Flags, Floats

WELL_BEFORE = 10.0
"""Fixes that begin so long before the last one tell of another clock, s."""


@dataclass(frozen=True, slots=True)
class Chunk:
    """What has arrived of one box.

    Attributes
    ----------
    ticks : Ticks
        Decimated specific force.
    gnss : Gnss
    spin : Ticks, optional
        Decimated angular rate, see `decimated_rate`.
    """

    ticks: Ticks
    gnss: Gnss
    spin: Ticks | None = None


def chunks_of(drive: Drive, stride: float) -> list[Chunk]:
    """A recording cut into chunks of `stride` seconds, as its box would have sent it.

    Parameters
    ----------
    drive : Drive
        One recording.
    stride : float
        s.

    Returns
    -------
    list of Chunk
        In order of time.
    """
    inertial, gnss = drive.inertial, drive.gnss
    ends = [float(t[i]) for t in (inertial.t, gnss.t) if t.size for i in (0, -1)]
    edges = np.append(np.arange(min(ends, default=0.0), max(ends, default=0.0), stride), np.inf)
    chunks: list[Chunk] = []
    for low, high in pairwise(edges.tolist()):
        first, last = np.searchsorted(inertial.t, [low, high]).tolist()
        t = inertial.t[first:last]
        spin = None if inertial.w is None else decimated_rate(t, inertial.w[first:last])
        fixes = fixes_where(gnss, (gnss.t >= low) & (gnss.t < high))
        chunks.append(Chunk(decimate(Inertial(t, inertial.f[first:last])), fixes, spin))
    return chunks


def decimated_rate(t: Floats, w: Floats) -> Ticks:
    """Ticks of a gyro's rate, made as those of the specific force; samples without it are left out.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Box clock, s.
    w : ndarray, shape (n, 3)
        Angular rate, A-frame, rad/s; NaN where not sampled.

    Returns
    -------
    Ticks
        A-frame, rad/s.
    """
    known = np.isfinite(w).all(axis=1)
    return decimate(Inertial(t[known], w[known]))


def fixes_where(gnss: Gnss, kept: Flags) -> Gnss:
    """Some of the fixes.

    Parameters
    ----------
    gnss : Gnss
        n fixes.
    kept : ndarray of bool, shape (n,)
        Which of them.

    Returns
    -------
    Gnss
        Without `hdop` and `sats`, which the online estimator does not use.
    """
    return Gnss(
        t=gnss.t[kept],
        lat=gnss.lat[kept],
        lon=gnss.lon[kept],
        alt=gnss.alt[kept],
        speed=gnss.speed[kept],
        course=gnss.course[kept],
        fix=gnss.fix[kept],
        utc=None if gnss.utc is None else gnss.utc[kept],
    )


def joined(before: Gnss, after: Gnss) -> Gnss:
    """Fixes and those that follow; what is not later is left out, UTC that either lacks is dropped.

    Parameters
    ----------
    before, after : Gnss
        Box clock, s.

    Returns
    -------
    Gnss
        In order of time, without `hdop` and `sats`.
    """
    later = after.t > (before.t[-1] if before.t.size else -np.inf)
    utc = None
    if before.utc is not None and after.utc is not None:
        utc = np.concatenate([before.utc, after.utc[later]])
    return Gnss(
        t=np.concatenate([before.t, after.t[later]]),
        lat=np.concatenate([before.lat, after.lat[later]]),
        lon=np.concatenate([before.lon, after.lon[later]]),
        alt=np.concatenate([before.alt, after.alt[later]]),
        speed=np.concatenate([before.speed, after.speed[later]]),
        course=np.concatenate([before.course, after.course[later]]),
        fix=np.concatenate([before.fix, after.fix[later]]),
        utc=utc,
    )


def jumped_back(before: Gnss, after: Gnss) -> float | None:
    """By how much the box clock jumped back between fixes and those that follow, s; None if it did not.

    Fixes of the same UTC by the box clock as before were merely sent again.

    Parameters
    ----------
    before, after : Gnss
        Box clock, s.

    Returns
    -------
    float or None
        s, more than 0.
    """
    if not before.t.size or not after.t.size:
        return None
    back = float(before.t[-1] - after.t[0])
    if back < WELL_BEFORE:
        return None
    was, now = _utc_at_boot(before), _utc_at_boot(after)
    return back if was is None or now is None or abs(now - was) > JUMP else None


def _utc_at_boot(gnss: Gnss) -> float | None:
    """UTC less box clock, s."""
    if gnss.utc is None or not np.isfinite(gnss.utc).any():
        return None
    return float(np.nanmedian(gnss.utc - gnss.t))


def ticks_since(ticks: Ticks, t: float) -> Ticks:
    """Ticks from a box time on.

    Parameters
    ----------
    ticks : Ticks
        Of any sensor.
    t : float
        Box clock, s.

    Returns
    -------
    Ticks
        Those at `t` and later.
    """
    kept = ticks.t >= t
    return Ticks(ticks.rate, ticks.index[kept], ticks.weight[kept], ticks.moment[kept], ticks.square[kept])
