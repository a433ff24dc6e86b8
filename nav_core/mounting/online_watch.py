"""Whether the box has been moved, found out while it drives: a second filter that begins anew.

An estimate that is sure of itself follows a moved box by and by and calls the mixture of two mountings its own.
So a second filter runs beside it that has forgotten the mounting, and nothing else; every few minutes it
forgets it again.  It is compared with what was known before it began, and before the one before it began: a move
during one filter's time is a mixture to that filter as well, but not to the next.

Most moves need not wait for that: the first seconds after them startle the filter.  Then the second one forgets at
once, and until it has been asked nothing is called ready.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.mounting.model import CROWN
from nav_core.mounting.moved import LEAST_ANGLE, LEAST_NEWS, STARTLING, SURE
from nav_core.mounting.online_model import (
    BIAS,
    HEIGHT,
    SPEED,
    TRACK,
    TURN,
    Filters,
    Tuning,
    prior_sigma,
)
from nav_core.mounting.online_tally import FLOOR, PIECE, SHORT, Tally, covariance_of, mounting_of, widening
from nav_core.rotation import error_between
from nav_core.typing import Floats

TERM = 180.0
"""s of driving after which the second filter forgets again."""

LONGEST_TERM = 360.0
"""While it speaks against the mounting it goes on for so long, s of driving, to be proved right or wrong."""

LEAST = 20.0
"""s of driving before it is asked."""

KNOWN_TO = np.radians(3.0)
"""An estimate with a larger sigma is nothing to compare with, rad."""

AGREES = 6.0
SUSPECT = 14.0
"""Squared difference over its covariance (three degrees of freedom) up to which the filters agree, and from which an
estimate is not called ready."""

LEAST_SUSPECT = np.radians(2.0)
"""A smaller difference raises no suspicion, rad."""

ANY_TILT = 0.5
"""Of the mounting once the filter is startled, rad: nobody has levelled it since."""

OTHER_ROADS = np.radians(0.5)
"""By so much the mean slope and bank of one stretch of road may differ from another's, rad."""


class Known(NamedTuple):
    """A mounting as it was known at a box time, s."""

    t: float
    R_va: Floats
    covariance: Floats


class Watch(NamedTuple):
    """What the second filter is there for.

    Attributes
    ----------
    second : Filters, optional
        One filter; None while there is nothing to compare it with.
    begun : Known, optional
        The mounting when it began.
    anchor : Known, optional
        The mounting it is compared with.
    driven : float
        `Tally.driven` when it began, s.
    doubt : float
        Squared difference over its covariance.
    angle : float
        Of the difference, rad.
    quiet : float
        Box time at which it last agreed, or began, s.
    startled : bool
        Whether it began because of what has just been measured and has not been asked yet.
    """

    second: Filters | None = None
    begun: Known | None = None
    anchor: Known | None = None
    driven: float = 0.0
    doubt: float = 0.0
    angle: float = 0.0
    quiet: float = 0.0
    startled: bool = False

    @property
    def suspicious(self) -> bool:
        """Whether it speaks against the mounting as it was."""
        return self.doubt > SUSPECT and self.angle > LEAST_SUSPECT

    @property
    def moved(self) -> bool:
        """Whether the box has been moved."""
        return self.doubt > SURE and self.angle > LEAST_ANGLE


class Move(NamedTuple):
    """A move of the box: when, the mounting before it, and by what angle at least, s and rad."""

    t: float
    before: Floats
    angle: float


def startling(news: Floats) -> bool:
    """Whether a piece is not what a box that stayed in place measures.

    Parameters
    ----------
    news : ndarray, shape (2, 2)
        Squared normalised innovations of the piece and their number: speed and course.  Every turn shows there;
        climb tells more of the road.

    Returns
    -------
    bool
        False where there are too few.
    """
    enough = news[:, 1] >= LEAST_NEWS
    return bool((news[enough, 0] > STARTLING * news[enough, 1]).any())


def looked_after(watch: Watch, filters: Filters, tally: Tally, tuning: Tuning) -> Watch:
    """The watch at the end of a piece.

    Parameters
    ----------
    watch : Watch
        Its filter worked off as far as the others.
    filters : Filters
        Settled.
    tally : Tally
        Of the drive with this piece.
    tuning : Tuning

    Returns
    -------
    Watch
    """
    age, t = tally.driven - watch.driven, float(tally.trail[-1, 0])
    if watch.second is not None and watch.begun is not None and not watch.suspicious and startling(tally.news):
        if watch.startled and age <= LEAST:
            return watch
        return Watch(
            _anew(filters, watch.begun.R_va, tuning),
            watch.begun,
            watch.begun,
            tally.driven,
            quiet=t - PIECE,
            startled=True,
        )
    if watch.second is not None and watch.anchor is not None:
        if age > LEAST:
            watch = _compared(watch, watch.second, watch.anchor, age, t)
        if age < (LONGEST_TERM if watch.suspicious else TERM):
            return watch
    covariance = covariance_of(filters, tally)
    if np.diag(covariance).max() > KNOWN_TO**2:
        return watch
    now = Known(t, mounting_of(filters), covariance)
    # A suspicion stays until the next one has been asked.
    return Watch(_forgetful(filters, tuning), now, watch.begun or now, tally.driven, watch.doubt, watch.angle, quiet=t)


def _forgetful(filters: Filters, tuning: Tuning) -> Filters:
    """The best filter, its mounting as unknown as after levelling."""
    one = slice(filters.best, filters.best + 1)
    second = Filters(*(column[one].copy() for column in filters))
    _forget(second.P, [TURN, TURN + 1, TURN + 2], np.array([tuning.tilt, tuning.tilt, tuning.yaw]))
    return second


def _anew(filters: Filters, R_va: Floats, tuning: Tuning) -> Filters:
    """A filter that knows the car and the receiver and begins at a mounting without trusting it.

    What a turn of the box does passes for bank and bias at first: they begin anew as well.
    """
    one = slice(filters.best, filters.best + 1)
    second = Filters(*(column[one].copy() for column in filters))
    lost = [*range(SPEED, BIAS + 3)]
    sigma = prior_sigma(tuning)
    sigma[TURN : TURN + 3] = ANY_TILT, ANY_TILT, tuning.yaw
    kept = second.x[0, [SPEED, HEIGHT, TRACK]]
    second.x[:, lost] = 0.0
    second.x[0, [SPEED, HEIGHT, TRACK]] = kept
    _forget(second.P, lost, sigma[lost])
    return second._replace(R_va=R_va[None].copy(), notes=np.zeros_like(second.notes))


def _forget(P: Floats, states: list[int], sigma: Floats) -> None:
    """Make some states as unknown as `sigma` and independent of the others, in place."""
    P[:, states, :] = 0.0
    P[:, :, states] = 0.0
    P[:, states, states] = sigma**2


def _compared(watch: Watch, second: Filters, anchor: Known, age: float, t: float) -> Watch:
    e = error_between(mounting_of(second), anchor.R_va)
    doubt = second.P[0, TURN : TURN + 3, TURN : TURN + 3] * (widening(second) ** 2 * (1.0 + SHORT / age))
    # The roads' mean bank is common to both.
    doubt = doubt + anchor.covariance - np.diag([CROWN**2, 0.0, 0.0])
    doubt += (FLOOR**2 + OTHER_ROADS**2) * np.eye(3)
    square = float(e @ np.linalg.solve(doubt, e))
    quiet = t if square < AGREES else watch.quiet
    return watch._replace(doubt=square, angle=float(np.linalg.norm(e)), quiet=quiet, startled=False)
