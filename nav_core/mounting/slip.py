"""Whether a mounting turns steadily: a box that slips in its holder, or a bias that runs away.

A straight line through the whole recording, beside all that every trip has of its own: the roads' bank,
the load and the bias of two drives differ without any slipping.
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc

from nav_core.mounting.again import without_own
from nav_core.mounting.model import UNKNOWNS
from nav_core.mounting.refine import Fit
from nav_core.typing import Floats

STRETCHES = 16
"""Parts of equal length, whose scatter about the line tells how far it can be believed."""

CHANCE = 5e-4
"""Of an axis of a fixed box to be taken for one that slips."""

LEAST_SLIP = np.radians(1.0)
"""From begin to end, rad; less is no matter."""

_LINE = slice(1 + UNKNOWNS, 1 + UNKNOWNS + 3)


def steady_slip(fit: Fit) -> Floats:
    """How far the mounting turns steadily from the begin of a recording to its end.

    Parameters
    ----------
    fit : Fit
        Of one record, of one trip or several.

    Returns
    -------
    ndarray, shape (3,)
        About the V axes, rad; 0 where none is clear.

    Notes
    -----
    The unknowns of the fit, a turn about each axis in proportion to time, and in every trip deviations of its own
    (`again`), by least squares.  The square of the turn over its variance, and over the scatter of the stretches about
    the line, is an F variable.
    """
    turn, variance = _line(fit)
    information, deviation = by_stretch(fit, STRETCHES)
    when = np.linspace(-0.5, 0.5, information.shape[0])[:, None]
    left = deviation - turn * when
    left = left - (information * left).sum(0) / np.maximum(information.sum(0), 1e-12)
    degrees = np.maximum((information > 0.0).sum(0) - 2, 1)
    scatter = np.maximum((information * left**2).sum(0) / degrees, 1.0)
    clear = fdtrc(1, degrees, turn**2 / (variance * scatter)) < CHANCE
    return np.where(clear & (np.abs(turn) > LEAST_SLIP), turn, 0.0)


def by_stretch(fit: Fit, count: int) -> tuple[Floats, Floats]:
    """Information and deviation of each stretch of a drive about each axis, with all else held.

    Parameters
    ----------
    fit : Fit
    count : int
        Of the stretches, of equal length.

    Returns
    -------
    information, deviation : ndarray, shape (n, 3)
        1/rad² and rad, n at most `count`; 0 where a stretch holds under a hundredth of the whole.
    """
    grams = np.array([part.sum(0) for part in np.array_split(fit.gram, count) if part.size])
    pull = -(grams @ np.concatenate([[1.0], fit.p]))[:, 1:4]
    information = np.einsum("kii->ki", grams[:, 1:4, 1:4])
    used = information > 1e-2 * information.sum(0)
    information = np.where(used, information, 0.0)
    return information, np.where(used, pull / np.maximum(information, 1e-12), 0.0)


def _line(fit: Fit) -> tuple[Floats, Floats]:
    """The turn about each axis from begin to end, and its variance, rad and rad², shape (3,)."""
    when = np.linspace(-0.5, 0.5, fit.gram.shape[0])
    total = sum(without_own(_with_line(fit.gram[trip], when[trip])) for trip in fit.trips())
    information = np.asarray(total)[1:, 1:]
    information[:UNKNOWNS, :UNKNOWNS] += np.diag(fit.prior + 1e-6)
    information[_LINE.start - 1 :, _LINE.start - 1 :] += 1e-6 * np.eye(3)
    pull = -np.asarray(total)[1:, 0]
    pull[:UNKNOWNS] += fit.prior_pull
    covariance = np.linalg.inv(information)
    return (covariance @ pull)[-3:], np.diag(covariance)[-3:]


def _with_line(gram: Floats, when: Floats) -> Floats:
    """Evidence of a trip with turns in proportion to time as three more unknowns, shape (18, 18)."""
    turns = np.r_[1:4]
    slope, square = np.tensordot(when, gram, 1), np.tensordot(when**2, gram, 1)
    made = np.zeros((_LINE.stop, _LINE.stop))
    made[: _LINE.start, : _LINE.start] = gram.sum(0)
    made[: _LINE.start, _LINE] = slope[:, turns]
    made[_LINE, : _LINE.start] = slope[turns]
    made[_LINE, _LINE] = square[np.ix_(turns, turns)]
    return made
