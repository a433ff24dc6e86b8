"""Find what was driven backwards."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.mounting.stretch import Span
from nav_core.records import Gnss
from nav_core.signal import runs
from nav_core.timebase import stale
from nav_core.typing import Floats

ROLLING = 0.8
"""A leg of driving is faster than this, m/s."""

TURNED_BACK = np.radians(120.0)
"""Course changes by more than this from one leg to the next when the vehicle goes back where it came from."""

STOOD = 15.0
"""It does so on the spot, m."""

LONGEST_BACK = 300.0
FASTEST_BACK = 8.0
"""What is longer (m) or faster (m/s) is no reversing."""


class _Leg(NamedTuple):
    """Driving without a stop: first and last fix, courses there, distance and highest speed."""

    first: int
    last: int
    set_out: float
    arrived: float
    distance: float
    fastest: float


def reversals(gnss: Gnss) -> tuple[Span, ...]:
    """Stretches driven backwards.

    Parameters
    ----------
    gnss : Gnss

    Returns
    -------
    tuple of Span
        From the stop before to the stop after.

    Notes
    -----
    A receiver knows the direction of travel, not where the vehicle points.  A vehicle that stops and
    goes back where it came from has changed gear; of the two kinds of legs between such stops, the
    shorter one in sum is the one driven backwards.
    """
    good = gnss.fix & np.isfinite(gnss.speed) & np.isfinite(gnss.course) & ~stale(gnss)
    t, speed, course = gnss.t[good], gnss.speed[good], gnss.course[good]
    legs = _legs(t, speed, course)
    lat, lon = gnss.lat[good], gnss.lon[good]
    spans: list[Span] = []
    run: list[int] = []
    flips: list[bool] = []
    for k, leg in enumerate(legs):
        together = k > 0 and not _displaced(lat, lon, legs[k - 1].last, leg.first)
        if not together and run:
            spans += _backwards(t, legs, run, flips)
            run, flips = [], []
        turn = 0.0 if not run else float(np.angle(np.exp(1j * (leg.set_out - legs[k - 1].arrived))))
        flips.append(bool(flips and flips[-1]) != bool(abs(turn) > TURNED_BACK))
        run.append(k)
    return (*spans, *_backwards(t, legs, run, flips))


def _displaced(lat: Floats, lon: Floats, before: int, after: int) -> bool:
    way = distances(lat[[before, after]], lon[[before, after]])
    return bool(way[0] > STOOD)


def _legs(t: Floats, speed: Floats, course: Floats) -> list[_Leg]:
    legs: list[_Leg] = []
    for first, after in runs(speed > ROLLING):
        inside = slice(first, after)
        sure = np.flatnonzero(speed[inside] > 1.5 * ROLLING) + first
        if sure.size < 2:
            continue
        few = min(4, sure.size)
        legs.append(
            _Leg(
                first,
                after - 1,
                float(np.angle(np.exp(1j * course[sure[:few]]).mean())),
                float(np.angle(np.exp(1j * course[sure[-few:]]).mean())),
                float((speed[inside][1:] * np.diff(t[inside])).sum()),
                float(speed[inside].max()),
            )
        )
    return legs


def _backwards(t: Floats, legs: list[_Leg], run: list[int], flips: list[bool]) -> list[Span]:
    """Spans of the shorter kind of legs, joined where they follow each other."""
    if len(set(flips)) < 2:
        return []
    distance = [
        sum(legs[k].distance for k, flip in zip(run, flips, strict=True) if flip is kind) for kind in (False, True)
    ]
    back = distance[1] < distance[0]
    spans: list[Span] = []
    for place, (k, flip) in enumerate(zip(run, flips, strict=True)):
        leg = legs[k]
        if flip != back or leg.distance > LONGEST_BACK or leg.fastest > FASTEST_BACK:
            continue
        begin = float(t[legs[run[place - 1]].last]) if place else float(t[leg.first]) - 1.0
        end = float(t[legs[run[place + 1]].first]) if place + 1 < len(run) else float(t[leg.last]) + 1.0
        spans.append(Span(begin, end))
    return spans


def distances(lat: Floats, lon: Floats) -> Floats:
    """From fix to fix on the ground, m, shape (n - 1,); `lat` and `lon` in rad.

    Parameters
    ----------
    lat, lon : ndarray, shape (n,)
        Geodetic, rad.

    Returns
    -------
    ndarray, shape (n - 1,)
        m, on a sphere.
    """
    radius = 6.371e6
    east = np.diff(lon) * np.cos(0.5 * (lat[1:] + lat[:-1]))
    return radius * np.hypot(np.diff(lat), east)
