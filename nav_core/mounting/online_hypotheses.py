"""The filters of a box from one piece of the drive to the next: which hypotheses are left, and how rough it is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from nav_core.mounting.online_model import (
    ACROSS,
    ALONG,
    BEYOND_DOUBT,
    BIAS,
    OF_CLIMB,
    OF_COURSE,
    OF_SIDE,
    OF_SPEED,
    TURN,
    UNLIKELY,
    UP,
    Filters,
    Tuning,
    prior_sigma,
)
from nav_core.mounting.online_tally import innovation_ratios
from nav_core.typing import Floats, Integers

SAME_YAW = 0.4
"""Hypotheses that have come this near to the best are the same, rad; the best then stands alone once it is sure."""

SURE_YAW = 0.12
"""rad."""

ROUGHEST = 20.0
"""Most that noise is scaled by."""


def settled(filters: Filters) -> bool:
    """Whether one hypothesis is left; a mirrored one may stay beside it until a turn tells.

    Parameters
    ----------
    filters : Filters
        Of one box.

    Returns
    -------
    bool
        True also with a mirrored one beside it.
    """
    return int(np.count_nonzero(filters.mirrored == filters.mirrored[filters.best])) == 1


def handed(filters: Filters) -> float:
    """Evidence for right-handed axes so far, see `trouble.handedness`; infinite once the mirrored ones are given up.

    Parameters
    ----------
    filters : Filters
        Of one box.

    Returns
    -------
    float
        Twice the log of likelihoods.
    """
    right, mirrored = filters.likelihood[~filters.mirrored], filters.likelihood[filters.mirrored]
    return 2.0 * float(right.max(initial=-np.inf) - mirrored.max()) if mirrored.size else np.inf


def stack(filters: Sequence[Filters | None], rows: Sequence[Floats]) -> tuple[Filters, Integers, Integers, Floats]:
    """Filters of many boxes side by side (copied), the ranges of their rows, and the rows.

    Parameters
    ----------
    filters : sequence of Filters or None
        One per box; None where a box has none: left out.
    rows : sequence of ndarray, shape (k, 30)
        One array per box that has filters.

    Returns
    -------
    filters : Filters
        Of all boxes.
    first : ndarray of int, shape (m,)
        First row of each filter.
    last : ndarray of int, shape (m,)
        One past its last row.
    rows : ndarray, shape (n, 30)
        Of all boxes.
    """
    present = [each for each in filters if each is not None]
    stacked = Filters(*(np.concatenate(columns) for columns in zip(*present, strict=True)))
    ends = np.cumsum([each.shape[0] for each in rows])
    sizes = [each.x.shape[0] for each in present]
    last = np.repeat(ends, sizes)
    first = np.repeat(ends - [each.shape[0] for each in rows], sizes)
    return stacked, first, last, np.concatenate(rows)


def adapted(filters: Filters, tuning: Tuning) -> Filters:
    """Noise levels moved towards what the innovations ask for; never below the tuning's.

    Where they rise, what has been learned so far was believed too much: the covariance of the drive's
    constants is widened along, up to what was known at the start.

    Parameters
    ----------
    filters : Filters
        Of one box.
    tuning : Tuning
        What was known at the start.

    Returns
    -------
    Filters
        With other scales, statistics and covariances.
    """
    ratio = innovation_ratios(filters)
    wanted = np.where((ratio > 1.15) | (ratio < 0.8), np.clip(np.sqrt(ratio), 0.8, 1.6), 1.0)
    scale = np.clip(filters.scale * wanted, 1.0, ROUGHEST)
    factor = scale / filters.scale
    notes, P = filters.notes.copy(), filters.P.copy()
    for kind, of in ((OF_SPEED, ALONG), (OF_CLIMB, UP), (OF_COURSE, ACROSS), (OF_SIDE, ACROSS)):
        notes[:, kind, 0] /= factor[:, of] ** 2
    deviation = np.sqrt(np.einsum("kii->ki", P))
    room = np.maximum(prior_sigma(tuning) / np.maximum(deviation, 1e-12), 1.0)
    grown = np.minimum(np.maximum(factor.max(axis=1), 1.0)[:, None], room)
    grown[:, :TURN] = 1.0
    return filters._replace(scale=scale, notes=notes, P=P * grown[:, :, None] * grown[:, None, :])


def likely_bias(filters: Filters, expected: float, tuning: Tuning) -> float:
    """The deviation of the two level biases once the vertical one has been seen; it never shrinks.

    The vertical bias shows in the magnitude of gravity, and a bad accelerometer is bad in all axes.
    Inverse-gamma prior of the variance with two degrees of freedom, as for the whole drive.

    Parameters
    ----------
    filters : Filters
        Of one box.
    expected : float
        Deviation so far, m/s².
    tuning : Tuning
        What to expect of boxes.

    Returns
    -------
    float
        m/s².
    """
    down, best = BIAS + 2, filters.best
    if filters.P[best, down, down] > 0.25 * tuning.bias**2:
        return expected
    return max(expected, float(np.sqrt((2.0 * tuning.bias**2 + filters.x[best, down] ** 2) / 3.0)))


def likely(filters: Filters) -> Filters:
    """The hypotheses that are still possible; of those alike, the best once it is sure and they have come together.

    Parameters
    ----------
    filters : Filters
        Of one box.

    Returns
    -------
    Filters
        One or more of them.
    """
    margin = innovation_ratios(filters).max(initial=1.0)
    mountings = Rotation.from_rotvec(filters.x[:, TURN : TURN + 3]).as_matrix() @ filters.R_va
    kept = np.zeros(filters.likelihood.size, dtype=np.bool_)
    for side in (False, True):
        alike = np.flatnonzero(filters.mirrored == side)
        if not alike.size:
            continue
        first = alike[np.argmax(filters.likelihood[alike])]
        if filters.likelihood[first] < filters.likelihood.max() - BEYOND_DOUBT * margin:
            continue
        alike = alike[filters.likelihood[alike] > filters.likelihood[first] - UNLIKELY * margin]
        # The trace of a rotation by an angle is 1 + 2 cos; both are proper or both are mirrored.
        together = np.einsum("ij,kij->k", mountings[first], mountings[alike]) > 1.0 + 2.0 * np.cos(SAME_YAW)
        sure = filters.P[first, TURN + 2, TURN + 2] < SURE_YAW**2
        kept[first if sure and together.all() else alike] = True
    return Filters(*(column[kept] for column in filters))
