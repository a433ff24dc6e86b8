"""The online estimator's steps, compiled: one fix after another, one filter after another.

`online_prediction` and `online_measurements` are the halves of a step; `online_reference` says the same in matrices.
"""

from __future__ import annotations

import numpy as np

from nav_core.mounting.online_measurements import compare_gyro, receive
from nav_core.mounting.online_model import BIAS, N_STATES, SPEED, TURN, Filters, Tuning
from nav_core.mounting.online_prediction import MOVING, predict, vectors
from nav_core.typing import Floats, Integers, kernel

FOLLOW = 0.035
"""The reference mounting follows once the estimate has left it by this angle, rad: derivatives stay put between."""


@kernel
def move_reference(x: Floats, P: Floats, R: Floats) -> None:
    """Put the small rotation into the reference and turn the biases, which belong to the box, with the axes.

    Parameters
    ----------
    x : ndarray, shape (22,)
        Its turn becomes zero.
    P : ndarray, shape (22, 22)
        Overwritten.
    R : ndarray, shape (3, 3)
        From A to V; overwritten.
    """
    a, b, c = x[TURN], x[TURN + 1], x[TURN + 2]
    angle = np.sqrt(a * a + b * b + c * c)
    s = np.sin(angle) / angle
    q = (1.0 - np.cos(angle)) / (angle * angle)
    M = np.empty((3, 3))
    M[0, 0], M[0, 1], M[0, 2] = 1.0 - q * (b * b + c * c), q * a * b - s * c, q * a * c + s * b
    M[1, 0], M[1, 1], M[1, 2] = q * a * b + s * c, 1.0 - q * (a * a + c * c), q * b * c - s * a
    M[2, 0], M[2, 1], M[2, 2] = q * a * c - s * b, q * b * c + s * a, 1.0 - q * (a * a + b * b)
    R[:] = M @ R
    x[TURN : TURN + 3] = 0.0
    x[BIAS : BIAS + 3] = M @ x[BIAS : BIAS + 3]
    block = np.ascontiguousarray(P[BIAS : BIAS + 3])
    P[BIAS : BIAS + 3] = M @ block
    P[:, BIAS : BIAS + 3] = np.ascontiguousarray(P[BIAS : BIAS + 3]).T
    block = np.ascontiguousarray(P[BIAS : BIAS + 3, BIAS : BIAS + 3])
    P[BIAS : BIAS + 3, BIAS : BIAS + 3] = M @ block
    for i in range(3):
        for j in range(i):
            mean = 0.5 * (P[BIAS + i, BIAS + j] + P[BIAS + j, BIAS + i])
            P[BIAS + i, BIAS + j] = P[BIAS + j, BIAS + i] = mean


@kernel
def step(
    x: Floats,
    P: Floats,
    R: Floats,
    row: Floats,
    tuning: Tuning,
    scale: Floats,
    notes: Floats,
    F: Floats,
    V: Floats,
    spread: Floats,
) -> tuple[float, float]:
    """One fix: returns the log likelihood and the change of speed that the force told, m/s.

    Parameters
    ----------
    x : ndarray, shape (22,)
        Overwritten.
    P : ndarray, shape (22, 22)
        Overwritten.
    R : ndarray, shape (3, 3)
        From A to V; overwritten.
    row : ndarray, shape (30,)
        What is known at the fix.
    tuning : Tuning
        What to expect.
    scale : ndarray, shape (3,)
        Factors on the noise along, up and across.
    notes : ndarray, shape (5, 2)
        Innovation statistics by kind; overwritten.
    F : ndarray, shape (10, 22)
        Overwritten.
    V : ndarray, shape (4, 3)
        Overwritten.
    spread : ndarray, shape (22,)
        Overwritten.

    Returns
    -------
    tuple of float
        Log likelihood without unit, and m/s.
    """
    vectors(R, row, V)
    forward = predict(x, P, row, V, tuning, scale, F)
    likelihood = receive(x, P, row, tuning, scale, notes, spread)
    if V[2, 2] == V[2, 2]:
        likelihood += compare_gyro(x, P, row, V, tuning, scale, notes, spread)
    x[SPEED] = max(x[SPEED], 0.0)
    if x[TURN] ** 2 + x[TURN + 1] ** 2 + x[TURN + 2] ** 2 > FOLLOW**2:
        move_reference(x, P, R)
    return likelihood, forward


@kernel
def run(filters: Filters, rows: Floats, first: Integers, last: Integers, tuning: Tuning, trace: Floats) -> None:
    """Run filter `i` over ``rows[first[i]:last[i]]``; overwrites the filters.

    `trace` (steps of all filters one after the other, 4), or without rows if nobody wants to know, gets after each
    step the variances of the turn (3) and the change of speed that the force told.

    Parameters
    ----------
    filters : Filters
        m of them; overwritten.
    rows : ndarray, shape (n, 30)
        What is known at the fixes.
    first, last : ndarray of int, shape (m,)
        Range of each filter's rows; `last` is not included.
    tuning : Tuning
        What to expect.
    trace : ndarray, shape (k, 4)
        rad² and m/s; overwritten.
    """
    F, V, spread = np.zeros((MOVING, N_STATES)), np.empty((4, 3)), np.empty(N_STATES)
    done = 0
    for i in range(first.size):
        x, P, R, notes = filters.x[i], filters.P[i], filters.R_va[i], filters.notes[i]
        for k in range(first[i], last[i]):
            likelihood, forward = step(x, P, R, rows[k], tuning, filters.scale[i], notes, F, V, spread)
            filters.likelihood[i] += likelihood
            if trace.shape[0] > 0:
                for m in range(3):
                    trace[done, m] = P[TURN + m, TURN + m]
                trace[done, 3] = forward
                done += 1
