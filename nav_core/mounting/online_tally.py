"""What the online estimator remembers of a drive beside its filters: excitation, how sure it was, its self-test."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from nav_core.mounting.confidence import CONVERGED
from nav_core.mounting.model import CROWN
from nav_core.mounting.online_measurements import CLIPPED, FADE
from nav_core.mounting.online_model import (
    ACROSS,
    ALONG,
    BROKEN,
    ELAPSED,
    GPS_CHANGE,
    GPS_COURSE,
    GPS_SPEED,
    OF_CLIMB,
    OF_COURSE,
    OF_SIDE,
    OF_SPEED,
    TURN,
    TURNED,
    Filters,
)
from nav_core.mounting.quality import NOTICEABLE
from nav_core.mounting.self_test import DURATION, LIMIT
from nav_core.records import SelfTest
from nav_core.typing import Floats

PIECE = 5.0
"""Lags and hypotheses are looked at when box time passes a multiple of this, and notes are kept by it, s."""

MOVING = 2.0
"""m/s."""

FLOOR = np.radians(0.1)
"""What a box's triad and a car's springs do that the model does not know, rad per axis."""

SHORT = 20.0
"""A road of this many seconds is one sample of what roads are like: sigma is widened by ``sqrt(1 + SHORT / T)``."""

TRUST = 40.0
"""So many innovations of the expected size come before the drive's own."""

SETTLING = np.radians(6.0)
LEAST_SHARE = 0.003
CALM = 8.0
"""Moves count once sigma is under the first, rad, and while its square shrinks by more than the second share; so many
moves of the expected size come before the drive's own."""

REMEMBERED = 14
"""Pieces of the past that are kept."""

SLOWEST = 3.0
"""Least speed throughout the self-test, m/s."""


def piece_of(t: float) -> float:
    """Number of the piece that a box time falls into.

    Parameters
    ----------
    t : float
        Box clock, s.

    Returns
    -------
    float
        A whole number.
    """
    return float(np.floor(t / PIECE))


def _no_moves() -> Floats:
    return np.zeros((3, 2))


def _no_news() -> Floats:
    return np.zeros((2, 2))


def _no_trail() -> Floats:
    return np.empty((0, 14))


@dataclass(frozen=True, slots=True)
class Tally:
    """What has been driven and found.

    Attributes
    ----------
    driven, moving, followed, along, across : float
        Time since the first moving fix, in motion, that with a course, and with noticeable acceleration along and
        across, s.
    turned : float
        Sum of all turning, rad.
    sure_since : float, optional
        `driven` from which on every sigma has stayed under `CONVERGED`, s.
    restless : ndarray, shape (3, 2)
        Squared moves of the estimate over the variance that they should have, and their number, by axis.
    news : ndarray, shape (2, 2)
        Squared normalised innovations of the last piece and their number: speed and course.
    news_until : float
        Box time of the last of them, s.
    trail : ndarray, shape (k, 14)
        One row for each of the last pieces: box time, mounting (9), change of speed as the force told it,
        GPS change, least speed, sound (1) or broken (0).
    """

    driven: float = 0.0
    moving: float = 0.0
    followed: float = 0.0
    along: float = 0.0
    across: float = 0.0
    turned: float = 0.0
    sure_since: float | None = None
    restless: Floats = field(default_factory=_no_moves)
    news: Floats = field(default_factory=_no_news)
    news_until: float = -np.inf
    trail: Floats = field(default_factory=_no_trail)


def noted(tally: Tally, rows: Floats, until: float, filters: Filters, trace: Floats) -> Tally:
    """The tally after a piece.

    Parameters
    ----------
    tally : Tally
    rows : ndarray, shape (k, 30)
    until : float
        Box time of the last row, s.
    filters : Filters
        After the piece.
    trace : ndarray, shape (k, 4) or (0, 4)
        Of the only filter that counts; without rows while there are several.

    Returns
    -------
    Tally
    """
    span = np.clip(rows[:, ELAPSED], 0.0, 2.0)
    fast = rows[:, GPS_SPEED] > MOVING
    started = np.logical_or.accumulate(fast) | (tally.driven > 0.0)
    step = np.where(started, np.maximum(rows[:, ELAPSED], 0.0), 0.0)
    safe = np.maximum(span, 1e-3)
    turn = np.abs(np.nan_to_num(rows[:, TURNED])) * fast
    along = np.abs(rows[:, GPS_CHANGE]) / safe > NOTICEABLE
    across = turn * rows[:, GPS_SPEED] / safe > NOTICEABLE
    driven = tally.driven + np.cumsum(step)
    sure_since = tally.sure_since
    if trace.shape[0] == 0:
        sure_since = None
    else:
        variance = (
            trace[:, :3]
            * (widening(filters) * restlessness(tally)) ** 2
            * (1.0 + SHORT / np.maximum(driven, 1.0))[:, None]
        )
        variance += FLOOR**2 + np.array([CROWN**2, 0.0, 0.0])
        wide = np.flatnonzero((variance >= CONVERGED**2).any(axis=1))
        if wide.size:
            sure_since = float(driven[wide[-1] + 1]) if wide[-1] + 1 < driven.size else None
        elif sure_since is None:
            sure_since = float(driven[0])
    entry = np.empty((1, 14))
    entry[0, 0], entry[0, 1:10] = until, mounting_of(filters).ravel()
    entry[0, 10] = trace[:, 3].sum()
    entry[0, 11], entry[0, 12] = rows[:, GPS_CHANGE].sum(), rows[:, GPS_SPEED].min()
    entry[0, 13] = trace.shape[0] > 0 and not rows[:, BROKEN].any()
    trail = tally.trail
    if trail.shape[0] and piece_of(trail[-1, 0]) == piece_of(until):
        entry[0, 10:12] += trail[-1, 10:12]
        entry[0, 12:14] = np.minimum(entry[0, 12:14], trail[-1, 12:14])
        trail = trail[:-1]
    return replace(
        tally,
        driven=float(driven[-1]),
        moving=tally.moving + float(span[fast].sum()),
        followed=tally.followed + float(span[fast & np.isfinite(rows[:, GPS_COURSE])].sum()),
        along=tally.along + float(span[along].sum()),
        across=tally.across + float(span[across].sum()),
        turned=tally.turned + float(turn.sum()),
        sure_since=sure_since,
        trail=np.concatenate([trail[1 - REMEMBERED :], entry]),
    )


def moved_on(tally: Tally, before: Filters, after: Filters) -> Tally:
    """The tally with the estimate's move between two looks at it.

    An estimate that is worth its covariance moves by as much as the covariance shrinks.

    Parameters
    ----------
    tally : Tally
        What has been found so far.
    before, after : Filters
        At the two looks.

    Returns
    -------
    Tally
        `tally` itself where another hypothesis has become the best.
    """
    one, other = before.best, after.best
    if before.mirrored[one] != after.mirrored[other]:
        return tally
    shrunk = np.diag(before.P[one] - after.P[other])[TURN : TURN + 3]
    known = np.diag(after.P[other])[TURN : TURN + 3]
    R = mounting_of(after) @ mounting_of(before).T
    move = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    telling = (known < SETTLING**2) & (shrunk > LEAST_SHARE * known)
    restless = tally.restless.copy()
    restless[telling, 0] += np.minimum(move[telling] ** 2 / shrunk[telling], CLIPPED)
    restless[telling, 1] += 1.0
    return replace(tally, restless=restless)


def heard(tally: Tally, rows: Floats, before: Filters, after: Filters) -> Tally:
    """The tally with the innovations of these rows, added to those of the same piece.

    Parameters
    ----------
    tally : Tally
        What has been found so far, these rows included.
    rows : ndarray, shape (k, 30)
        Of one piece, or a part of it.
    before, after : Filters
        The same filters before and after the rows.

    Returns
    -------
    Tally
    """
    kinds = [OF_SPEED, OF_COURSE]
    number = np.array([rows.shape[0], np.count_nonzero(np.isfinite(rows[:, GPS_COURSE]))])
    kept = (1.0 - 1.0 / FADE) ** number
    best = after.best
    squares = after.notes[best, kinds, 0] - kept * before.notes[best, kinds, 0]
    news = np.column_stack([squares, number])
    trail = tally.trail
    same = trail.shape[0] > 0 and piece_of(tally.news_until) == piece_of(trail[-1, 0])
    return replace(tally, news=tally.news + news if same else news, news_until=float(trail[-1, 0]))


def restlessness(tally: Tally) -> Floats:
    """Factor on sigma by which the estimate has moved more than its covariance said, by axis, shape (3,).

    Parameters
    ----------
    tally : Tally
        What has been found so far.

    Returns
    -------
    ndarray, shape (3,)
        V axes, 1 or more.
    """
    return np.sqrt(np.maximum((tally.restless[:, 0] + CALM) / (tally.restless[:, 1] + CALM), 1.0))


def mounting_of(filters: Filters) -> Floats:
    """The likeliest filter's mounting, shape (3, 3).

    Parameters
    ----------
    filters : Filters
        Of one box.

    Returns
    -------
    ndarray, shape (3, 3)
        From A to V.
    """
    best = filters.best
    return Rotation.from_rotvec(filters.x[best, TURN : TURN + 3]).as_matrix() @ filters.R_va[best]


def widening(filters: Filters) -> float:
    """Factor on sigma by which the innovations exceed what the filter expected of them.

    Parameters
    ----------
    filters : Filters
        Of one box.

    Returns
    -------
    float
        1 or more.
    """
    return float(np.sqrt(max(innovation_ratios(filters).max(), 1.0)))


def strangeness(filters: Filters) -> float:
    """How many times noisier than usual the data are to the likeliest filter, the worse of along and across.

    Parameters
    ----------
    filters : Filters
        Of one box.

    Returns
    -------
    float
        1 is as usual.
    """
    return widening(filters) * float(filters.scale[filters.best, [ALONG, ACROSS]].max())


def innovation_ratios(filters: Filters) -> Floats:
    """Mean square of the likeliest filter's normalised innovations along, up and across, shape (3,).

    Parameters
    ----------
    filters : Filters
        Of one box.

    Returns
    -------
    ndarray, shape (3,)
        1 in the mean where the filter is right.
    """
    notes = filters.notes[filters.best]
    ratio = (notes[:, 0] + TRUST) / (notes[:, 1] + TRUST)
    return np.array([ratio[OF_SPEED], ratio[OF_CLIMB], max(ratio[OF_COURSE], ratio[OF_SIDE])])


def covariance_of(filters: Filters, tally: Tally) -> Floats:
    """Covariance of the mounting with all that the filter does not know, rad², shape (3, 3).

    Parameters
    ----------
    filters : Filters
        Of one box.
    tally : Tally
        What has been found so far.

    Returns
    -------
    ndarray, shape (3, 3)
        About the V axes, rad².
    """
    best = filters.best
    block = filters.P[best, TURN : TURN + 3, TURN : TURN + 3]
    factor = widening(filters) * restlessness(tally)
    covariance = block * np.outer(factor, factor) * (1.0 + SHORT / max(tally.driven, 1.0))
    return covariance + np.diag([FLOOR**2 + CROWN**2, FLOOR**2, FLOOR**2])


def recent_test(tally: Tally) -> SelfTest | None:
    """The thesis' 40 s test (001 §5.4) over the latest pieces; None without so long an unbroken drive.

    Slope-compensated: the force is integrated with the slope and biases that the filter held at the time.

    Parameters
    ----------
    tally : Tally
        What has been found so far.

    Returns
    -------
    SelfTest or None
        Difference to GPS, m/s, and duration, s.
    """
    trail = tally.trail
    if trail.shape[0] < 2:
        return None
    begin = int(np.searchsorted(trail[:, 0], trail[-1, 0] - DURATION, side="right")) - 1
    if begin < 0:
        return None
    part = trail[begin + 1 :]
    if part[:, 12].min() < SLOWEST or not part[:, 13].all():
        return None
    drift = float(abs(part[:, 10].sum() - part[:, 11].sum()))
    return SelfTest(drift < LIMIT, drift, float(trail[-1, 0] - trail[begin, 0]))
