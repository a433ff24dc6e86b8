"""Many trips of one installation, fused in information form.

What a trip says of the mounting fits into one small matrix, so a new trip costs its own length and
no more.  The mounting, the car's gains and lever arm are the same in all trips and keep their prior
once; the accelerometer's bias, the receiver's lags, the roads' mean bank and what the load does to the
car come anew in part, and that part is summed out before a trip joins the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from nav_core.errors import ShapeError
from nav_core.mounting.again import without_own
from nav_core.mounting.confidence import FLOOR, Confidence, assess
from nav_core.mounting.model import COURSE_LAG, SPEED_LAG, TURN, UNKNOWNS, Noise, prior
from nav_core.mounting.refine import BLOCK, Fit, likely_bias
from nav_core.rotation import error_between
from nav_core.typing import Floats

DOUBTFUL = 16.3
"""Disagreement that one in a thousand trips of an untouched box reaches (three degrees of freedom)."""


@dataclass(frozen=True, slots=True)
class TripEvidence:
    """All that one trip, or many, say of a mounting.

    Attributes
    ----------
    R_va : ndarray, shape (3, 3)
        Where `gram` was linearised; its turn is relative to this.
    speed_lag, course_lag : float
        The same for the lags, s.
    gram : ndarray, shape (15, 15)
        Products of the whitened innovations and their derivatives, without any prior, less what the
        trip's own doubts (innovations, disagreement of its stretches) take from them.
    duration : float
        Of the stretches behind it, s; pauses between the trips of one fit included.
    trips : int
        How many were joined; what is of one fit counts as one.
    handed : float
        Twice the log of likelihoods in favour of right-handed axes; see `trouble.handedness`.
    """

    R_va: Floats
    speed_lag: float
    course_lag: float
    gram: Floats
    duration: float
    trips: int = 1
    handed: float = 0.0

    def __post_init__(self) -> None:
        for name, shape in (("R_va", (3, 3)), ("gram", (1 + UNKNOWNS, 1 + UNKNOWNS))):
            if getattr(self, name).shape != shape:
                raise ShapeError(name, getattr(self, name).shape, str(shape))


def trip_evidence(fit: Fit, handed: float = 0.0, found: Confidence | None = None) -> TripEvidence:
    """What a fit of one trip, or of several, has to say to others.

    Parameters
    ----------
    fit : Fit
    handed : float
        See `TripEvidence`.
    found : Confidence, optional
        In the fit, where that is known already.

    Returns
    -------
    TripEvidence
    """
    found = found or assess(fit)
    scale = np.ones(1 + UNKNOWNS)
    scale[1:4] = 1.0 / found.widening
    gram = np.sum([without_own(fit.gram[trip].sum(0) * np.outer(scale, scale)) for trip in fit.trips()], axis=0)
    return TripEvidence(fit.R_va, fit.speed_lag, fit.course_lag, gram, BLOCK * len(fit.gram), handed=handed)


def weakened(evidence: TripEvidence, share: float) -> TripEvidence:
    """The same with only a share of its weight, for what may no longer hold.

    Parameters
    ----------
    evidence : TripEvidence
        Of one trip or many.
    share : float
        0 to 1.

    Returns
    -------
    TripEvidence
        Linearised where `evidence` is.
    """
    return replace(evidence, gram=share * evidence.gram, handed=share * evidence.handed)


def joined(trips: Sequence[TripEvidence]) -> TripEvidence:
    """The sum of several trips, linearised where the last one is.

    Parameters
    ----------
    trips : sequence of TripEvidence
        At least one.

    Returns
    -------
    TripEvidence

    Raises
    ------
    ShapeError
        If there are none.
    """
    if not trips:
        raise ShapeError("trips", (0,), "at least one")
    last = trips[-1]
    gram = np.sum([_seen_from(trip, last) for trip in trips], axis=0)
    return TripEvidence(
        last.R_va,
        last.speed_lag,
        last.course_lag,
        gram,
        sum(trip.duration for trip in trips),
        sum(trip.trips for trip in trips),
        sum(trip.handed for trip in trips),
    )


def solved(evidence: TripEvidence, noise: Noise) -> tuple[Floats, Floats]:
    """Mounting and covariance from evidence and prior.

    Parameters
    ----------
    evidence : TripEvidence
    noise : Noise

    Returns
    -------
    R_va : ndarray, shape (3, 3)
    covariance : ndarray, shape (3, 3)
        About the V axes, rad², without the mean bank common to all roads.
    """
    lags = (evidence.speed_lag, evidence.course_lag)
    diagonal, mean = prior(likely_bias(noise, evidence.gram, lags), lags)
    covariance = np.linalg.inv(evidence.gram[1:, 1:] + np.diag(diagonal + 1e-6))
    turn = (covariance @ (diagonal * mean - evidence.gram[1:, 0]))[TURN]
    R_va: Floats = Rotation.from_rotvec(turn).as_matrix() @ evidence.R_va
    return R_va, covariance[TURN, TURN] + FLOOR**2 * np.eye(3)


def disagreement(
    one: TripEvidence, other: TripEvidence, noise: Noise, axes: slice = slice(0, 3)
) -> tuple[float, Floats]:
    """How far two sets of trips are apart.

    Parameters
    ----------
    one, other : TripEvidence
    noise : Noise
    axes : slice
        Those that count: all, or tilt alone.

    Returns
    -------
    chi2 : float
        Squared difference over its covariance, a degree of freedom for each of the axes.
    apart : ndarray, shape (3,)
        The small rotation from `one` to `other` about the V axes, rad.
    """
    R_one, C_one = solved(one, noise)
    R_other, C_other = solved(other, noise)
    e = error_between(R_other, R_one)
    return float(e[axes] @ np.linalg.solve((C_one + C_other)[axes, axes], e[axes])), e


def _seen_from(trip: TripEvidence, last: TripEvidence) -> Floats:
    """A trip's evidence with the unknowns counted from where another one stands."""
    shift = np.zeros(UNKNOWNS)
    shift[TURN] = error_between(last.R_va, trip.R_va)
    shift[SPEED_LAG] = last.speed_lag - trip.speed_lag
    shift[COURSE_LAG] = last.course_lag - trip.course_lag
    basis = np.eye(1 + UNKNOWNS)
    basis[1:, 0] = shift
    return basis.T @ trip.gram @ basis
