"""The two planes' transitions, written out: what whitening and its echo spend their time on.

A filter's memory is one flat array of ``n`` rows, a row for each state: first its covariances with all states, from
`padded(n)` on its value and what each unknown does to it.  A transition mixes rows, and so acts on every column alike:
one loop over the columns, of a length the compiler knows, which it turns into vector code.  Of matrices it could not,
for any two rows might be the same; nor would it pass over their zeros, which most of them are.
"""

from __future__ import annotations

import numpy as np

from nav_core.typing import Floats, Integers, kernel

Sizes = tuple[float, ...]
"""A vector as a tuple: its length is part of its type, so kernels are compiled for it and their loops unrolled."""

PITCH_STATES, YAW_STATES = 10, 4

# Entries of the transition that are not 0 and not 1: (row, column) of each coefficient, in the order of `states` in
# `pitch_plane` (speed, climb, slope, curvature, height, errors of speed and height, tilt, drifts) and `yaw_plane`
# (course, bank, slow error, drift).  One coefficient serves both drifts.
_PITCH_PLACES = (
    ((0, 8), (1, 9)),
    ((1, 2),),
    ((1, 7),),
    ((0, 2),),
    ((0, 3),),
    ((4, 2),),
    ((4, 3),),
    ((2, 2),),
    ((2, 3),),
    ((3, 2),),
    ((3, 3),),
    ((7, 7),),
    ((5, 5),),
    ((6, 6),),
)
_YAW_PLACES = (((0, 1),), ((0, 3),), ((1, 1),), ((2, 2),))
PITCH_CURVED = (2, 3)
"""Slope and curvature: the one pair of states whose process noise is correlated."""


def transitions(carry: Floats, states: int) -> Floats:
    """Matrices of a plane's transitions, as the reference and the tests need them.

    Parameters
    ----------
    carry : ndarray, shape (K, N)
        Coefficients.
    states : int
        `PITCH_STATES` or `YAW_STATES`.

    Returns
    -------
    ndarray, shape (N, states, states)
    """
    out = np.tile(np.eye(states), (carry.shape[1], 1, 1))
    places = _PITCH_PLACES if states == PITCH_STATES else _YAW_PLACES
    for coefficient, where in zip(carry, places, strict=True):
        for row, column in where:
            out[:, row, column] = coefficient
    return out


@kernel
def padded(n: int) -> int:
    """Room for n columns: whole vectors of four.

    Parameters
    ----------
    n : int
        Columns.

    Returns
    -------
    int
        At least n.
    """
    return (n + 3) // 4 * 4


@kernel
def _pitch(z: Floats, x0: Sizes, weights: Sizes, lanes: int, c: Floats, i: int) -> None:
    w = padded(len(x0)) + padded(len(weights))
    drift, rise, swing = c[0, i], c[1, i], c[2, i]
    vs, vk, hs, hk = c[3, i], c[4, i], c[5, i], c[6, i]
    ss, sk, ks, kk = c[7, i], c[8, i], c[9, i], c[10, i]
    along, speed_kept, height_kept = c[11, i], c[12, i], c[13, i]
    for j in range(lanes):
        slope, curve, tilt = z[2 * w + j], z[3 * w + j], z[7 * w + j]
        z[j] += vs * slope + vk * curve + drift * z[8 * w + j]
        z[w + j] += rise * slope + swing * tilt + drift * z[9 * w + j]
        z[2 * w + j] = ss * slope + sk * curve
        z[3 * w + j] = ks * slope + kk * curve
        z[4 * w + j] += hs * slope + hk * curve
        z[5 * w + j] *= speed_kept
        z[6 * w + j] *= height_kept
        z[7 * w + j] = along * tilt


@kernel
def _pitch_back(z: Floats, x0: Sizes, lanes: int, c: Floats, i: int) -> None:
    w = padded(len(x0))
    drift, rise, swing = c[0, i], c[1, i], c[2, i]
    vs, vk, hs, hk = c[3, i], c[4, i], c[5, i], c[6, i]
    ss, sk, ks, kk = c[7, i], c[8, i], c[9, i], c[10, i]
    along, speed_kept, height_kept = c[11, i], c[12, i], c[13, i]
    for j in range(lanes):
        v, climb, slope, curve, height = z[j], z[w + j], z[2 * w + j], z[3 * w + j], z[4 * w + j]
        z[2 * w + j] = vs * v + rise * climb + ss * slope + ks * curve + hs * height
        z[3 * w + j] = vk * v + sk * slope + kk * curve + hk * height
        z[5 * w + j] *= speed_kept
        z[6 * w + j] *= height_kept
        z[7 * w + j] = swing * climb + along * z[7 * w + j]
        z[8 * w + j] += drift * v
        z[9 * w + j] += drift * climb


@kernel
def _yaw(z: Floats, x0: Sizes, weights: Sizes, lanes: int, c: Floats, i: int) -> None:
    w = padded(len(x0)) + padded(len(weights))
    banked, drift, along, kept = c[0, i], c[1, i], c[2, i], c[3, i]
    for j in range(lanes):
        bank = z[w + j]
        z[j] += banked * bank + drift * z[3 * w + j]
        z[w + j] = along * bank
        z[2 * w + j] *= kept


@kernel
def _yaw_back(z: Floats, x0: Sizes, lanes: int, c: Floats, i: int) -> None:
    w = padded(len(x0))
    banked, drift, along, kept = c[0, i], c[1, i], c[2, i], c[3, i]
    for j in range(lanes):
        course = z[j]
        z[w + j] = banked * course + along * z[w + j]
        z[2 * w + j] *= kept
        z[3 * w + j] += drift * course


@kernel
def _across(z: Floats, x0: Sizes, w: int) -> None:
    """Transpose the covariance in place."""
    for a in range(len(x0)):
        for b in range(a):
            z[a * w + b], z[b * w + a] = z[b * w + a], z[a * w + b]


@kernel
def carried(z: Floats, x0: Sizes, weights: Sizes, carry: Floats, i: int, Q: Floats) -> None:
    """Step i: ``X <- Phi X``, ``P <- Phi P Phi' + Q`` in place.

    Parameters
    ----------
    z : ndarray, shape (n w,)
        The filter's memory: n rows of w.
    x0 : tuple
        n of anything; n says which plane it is.
    weights : tuple
        One of anything for each column of values.
    carry : ndarray, shape (K, N)
        Coefficients of the transitions.
    i : int
        Step.
    Q : ndarray, shape (n or n + 1, N)
        Process noise: variances, and the covariance of `PITCH_CURVED`.
    """
    n, p = len(x0), padded(len(x0))
    w = p + padded(len(weights))
    # (Phi P)' is P Phi', for P is symmetric: the same transition twice.
    if n == PITCH_STATES:
        _pitch(z, x0, weights, w, carry, i)
        _across(z, x0, w)
        _pitch(z, x0, weights, p, carry, i)
        a, b = PITCH_CURVED
        z[a * w + b] += Q[n, i]
        z[b * w + a] += Q[n, i]
    else:
        _yaw(z, x0, weights, w, carry, i)
        _across(z, x0, w)
        _yaw(z, x0, weights, p, carry, i)
    for a in range(n):
        z[a * w + a] += Q[a, i]


@kernel
def carried_back(z: Floats, x0: Sizes, carry: Floats, i: int) -> None:
    """``M <- Phi' M Phi`` in place, of a memory without values: information goes back as covariance goes on.

    Parameters
    ----------
    z : ndarray, shape (n w,)
        The memory.
    x0 : tuple
        n of anything; n says which plane it is.
    carry : ndarray, shape (K, N)
        Coefficients of the transitions.
    i : int
        Step.
    """
    p = padded(len(x0))
    if len(x0) == PITCH_STATES:
        _pitch_back(z, x0, p, carry, i)
        _across(z, x0, p)
        _pitch_back(z, x0, p, carry, i)
    else:
        _yaw_back(z, x0, p, carry, i)
        _across(z, x0, p)
        _yaw_back(z, x0, p, carry, i)


@kernel
def seen(z: Floats, x0: Sizes, weights: Sizes, rows: Integers, share: float, r: float, t: Floats) -> float:
    """What a measurement of ``state a + share * state b`` sees: fills `t` with its covariances and values.

    Parameters
    ----------
    z : ndarray, shape (n w,)
        The filter's memory: n rows of w.
    x0, weights : tuple
        n, and one for each column of values, of anything.
    rows : ndarray of int, shape (2,)
        The states a and b.
    share : float
        Of b.
    r : float
        Variance of the measurement.
    t : ndarray, shape (w,)
        A row of the memory.

    Returns
    -------
    float
        Variance of the innovation.
    """
    w = padded(len(x0)) + padded(len(weights))
    a, b = int(rows[0]), int(rows[1])
    for j in range(w):
        t[j] = z[a * w + j] + share * z[b * w + j]
    return float(r + t[a] + share * t[b])


@kernel
def taken_in(z: Floats, x0: Sizes, weights: Sizes, t: Floats, variance: float, gain: Floats) -> None:
    """Correct the memory by an innovation whose values `t` has from `padded(n)` on, with the sign of the prediction.

    Parameters
    ----------
    z : ndarray, shape (n w,)
        The filter's memory: n rows of w.
    x0, weights : tuple
        n, and one for each column of values, of anything.
    t : ndarray, shape (w,)
        As `seen` left it, less what was measured.
    variance : float
        Of the innovation.
    gain : ndarray, shape (n,)
        Room for the gains, which stay there.
    """
    w = padded(len(x0)) + padded(len(weights))
    for a in range(len(x0)):
        gain[a] = t[a] / variance
    for j in range(w):
        for a in range(len(x0)):
            z[a * w + j] -= gain[a] * t[j]
