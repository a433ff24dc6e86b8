"""How far an estimate can be trusted: sigma that is meant, its history, and what repeats.

The covariance of the model is widened by what the drive itself shows: innovations larger than the
model's, and stretches of the drive that disagree by more than their own sigmas.  Then comes what no
single drive can show: the mean sideways tilt of its roads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.mounting.model import TURN
from nav_core.mounting.refine import BLOCK, Fit
from nav_core.mounting.slip import by_stretch, steady_slip
from nav_core.typing import Floats

FLOOR = np.radians(0.04)
"""What a box's triad and a car's body do that the model does not know, rad per axis: axes square to 0.7 mrad."""

CONVERGED = np.radians(2.0)
"""Limit of each sigma for "converged" and "ready", rad."""

STRETCHES = 8
"""Parts of equal length whose estimates are compared."""

_TRUST = 6.0
"""Degrees of freedom with which the model's own scatter is believed before the drive's."""

SHORT = 5.0
"""A road of this many seconds is one sample of what roads are like: sigma of a drive of duration T is
widened by ``sqrt(1 + SHORT / T)``."""

STEADY_SPAN = 60.0
STEADY = np.radians(0.7)
"""Stable: the estimate of `STEADY_SPAN` seconds ago lies within this (or within its own sigma)."""


@dataclass(frozen=True, slots=True)
class Confidence:
    """What is known about the error of a fit.

    Attributes
    ----------
    covariance : ndarray, shape (3, 3)
        About the V axes, rad², everything included, as far as what a trip has of its own is the same throughout.
    observability : float
    widening : ndarray, shape (3,)
        Factors on sigma by which the drive widened the model's, per axis.
    scatter : ndarray, shape (3,)
        Mean square of the stretches' deviations over their own variances; 1 when the model holds.
    spread : ndarray, shape (3,)
        Size of what the deviations have beyond their own noise, rad.
    slip : ndarray, shape (3,)
        Steady turn about the V axes from begin to end, rad; 0 where none is clear.
    converged_after : float, optional
        Since the first stretch, s.
    stable : bool
    """

    covariance: Floats
    observability: float
    widening: Floats
    scatter: Floats
    spread: Floats
    slip: Floats
    converged_after: float | None
    stable: bool


def observability(covariance: Floats) -> float:
    """``(1 - lmax / trace) n / (n - 1)``: 0 when one direction holds all the doubt, 1 when all share it.

    Parameters
    ----------
    covariance : ndarray, shape (n, n)
        Of n small rotations or states alike in unit; n at least 2.

    Returns
    -------
    float
        0 to 1.
    """
    n = covariance.shape[0]
    lmax = float(np.linalg.eigvalsh(covariance)[-1])
    return float(np.clip((1.0 - lmax / float(np.trace(covariance))) * n / (n - 1), 0.0, 1.0))


def stretch_scatter(fit: Fit) -> tuple[Floats, int, Floats]:
    """Disagreement of the stretches of a drive, axis by axis.

    Each stretch moves one axis of the mounting with all else held.  Its deviations are weighed with
    its own information.

    Parameters
    ----------
    fit : Fit
        Of one record.

    Returns
    -------
    scatter : ndarray, shape (3,)
        1 in the mean when the model holds.
    degrees : int
        Of freedom, per axis.
    spread : ndarray, shape (3,)
        Of the deviations beyond their own noise, rad.
    """
    information, deviation = by_stretch(fit, STRETCHES)
    used = information > 0.0
    mean = (information * deviation).sum(0) / np.maximum(information.sum(0), 1e-12)
    degrees = np.maximum(used.sum(0) - 1, 1)
    scatter = (information * (deviation - mean) ** 2).sum(0) / degrees
    usual = information.sum(0) / np.maximum(used.sum(0), 1)
    return scatter, int(degrees.min()), np.sqrt(np.maximum(scatter - 1.0, 0.0) / np.maximum(usual, 1e-12))


def _innovation_ratio(fit: Fit) -> float:
    """Worst mean square of the whitened innovations among speed, climb and course."""
    count = fit.count.sum(0)
    ratio = fit.misfit.sum(0) / np.maximum(count, 1.0)
    return float(max(ratio[[0, 2, 3]].max(), 1.0))


def assess(fit: Fit) -> Confidence:
    """Confidence in a fit.

    Parameters
    ----------
    fit : Fit

    Returns
    -------
    Confidence
    """
    scatter, degrees, spread = stretch_scatter(fit)
    shrunk = (_TRUST + degrees * scatter) / (_TRUST + degrees)
    widening = np.sqrt(np.maximum(shrunk, 1.0) * _innovation_ratio(fit))
    cumulative = np.cumsum(fit.gram, axis=0)
    p, covariances = fit.solve(cumulative)
    elapsed = BLOCK * np.arange(1, covariances.shape[0] + 1)
    short = 1.0 + SHORT / elapsed
    history = covariances[:, TURN, TURN] * np.outer(widening, widening) * short[:, None, None]
    history[:, [0, 1, 2], [0, 1, 2]] += FLOOR**2
    history[:, 0, 0] += fit.noise.crown**2
    sigma = np.sqrt(np.einsum("kii->ki", history))
    slip = steady_slip(fit)
    covariance = history[-1] + np.diag((0.5 * slip) ** 2)
    sigma[-1] = np.sqrt(np.diag(covariance))
    above = np.flatnonzero((sigma >= CONVERGED).any(axis=1))
    first_good = int(above[-1]) + 1 if above.size else 0
    converged_after = (first_good + 1) * BLOCK if first_good < sigma.shape[0] else None
    back = max(sigma.shape[0] - 1 - round(STEADY_SPAN / BLOCK), 0)
    moved = np.abs(p[back, TURN] - p[-1, TURN])
    allowed = np.maximum(STEADY, np.sqrt(np.maximum(sigma[back] ** 2 - sigma[-1] ** 2, 0.0)))
    return Confidence(
        covariance=covariance,
        observability=observability(covariance),
        widening=widening,
        scatter=scatter,
        spread=spread,
        slip=slip,
        converged_after=converged_after,
        stable=bool(back > 0 and np.all(moved <= allowed)),
    )
