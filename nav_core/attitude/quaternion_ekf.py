"""Extended Kalman filter of 000 section 7.2: the quaternion's four components and the gyros' three biases.

The state is the sensor's bias, ``w_true = w - bias``; 000 adds its `b` to the rate (7.2.38), which is minus this one.
The quaternion (x, y, z, w) turns b into n.  Its covariance counts four components, of which the length is none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from nav_core.attitude.kernels import multiply, normalise, quaternion_of
from nav_core.errors import RangeError, ShapeError
from nav_core.kalman import joseph
from nav_core.kalman.kernels import pattern_of, propagate_into, room_for
from nav_core.processes import Discrete, transition_series
from nav_core.rotation import normalised
from nav_core.typing import Floats, kernel, trailing


@dataclass(frozen=True, slots=True)
class QuaternionState:
    """Estimate of the filter.

    Attributes
    ----------
    q_nb : ndarray, shape (4,)
    bias : ndarray, shape (3,)
        rad/s.
    P : ndarray, shape (7, 7)
        Of the errors of both, true less estimated.
    """

    q_nb: Floats
    bias: Floats
    P: Floats


class Correction(NamedTuple):
    """Outcome of an update.

    Attributes
    ----------
    state : QuaternionState
    residual : ndarray, shape (4,)
        Measured less estimated quaternion, of the two signs the nearer.
    nis : float
    """

    state: QuaternionState
    residual: Floats
    nis: float


def rate_matrix(q: Floats) -> Floats:
    """``X`` with ``q' = X w / 2``, shape (4, 3): twice ``D_q`` of 000 eq. 7.2.9, in the order (x, y, z, w).

    Parameters
    ----------
    q : ndarray, shape (4,)
        Order (x, y, z, w).

    Returns
    -------
    ndarray, shape (4, 3)
        Times the rate in b axes, rad/s, halved: the derivative of `q`, 1/s.

    Raises
    ------
    ShapeError
    """
    x, y, z, w = trailing("q", q, 4)
    return np.array([[w, -z, y], [z, w, -x], [-y, x, w], [-x, -y, -z]])


def dynamics(q: Floats, rate: Floats) -> tuple[Floats, Floats]:
    """Perturbation model in quaternion and bias.

    Parameters
    ----------
    q : ndarray, shape (4,)
        Of unit length.
    rate : ndarray, shape (3,)
        Bias taken off, rad/s.

    Returns
    -------
    F : ndarray, shape (7, 7)
    D : ndarray, shape (7, 6)
        ``dx' = F dx + D (v, eta)`` with the gyros' noise `v`, rad/s, and the walk `eta` of their biases, rad/s²
        (000 eqs. 7.2.7-7.2.22).

    Notes
    -----
    7.2.1 pulls the length to one: ``e q``, ``e = 1 / |q| - 1`` (7.2.2), whose derivative at unit length is ``-q q'``;
    7.2.8 prints twice that (docs/equations.md).
    """
    q = trailing("q", q, 4)
    p, r, s = trailing("rate", rate, 3)
    turning = np.array([[0.0, s, -r, p], [-s, 0.0, p, r], [r, -p, 0.0, s], [-p, -r, -s, 0.0]])
    X = 0.5 * rate_matrix(q)
    F, D = np.zeros((7, 7)), np.zeros((7, 6))
    F[:4, :4] = 0.5 * turning - np.outer(q, q)
    F[:4, 4:] = D[:4, :3] = -X
    D[4:, 3:] = np.eye(3)
    return F, D


def discretise(q: Floats, rate: Floats, dt: float, gyro_density: float, walk_density: float) -> Discrete:
    """Transition and noise of a step with the model frozen at its start.

    Parameters
    ----------
    q, rate : ndarray, shape (4,), (3,)
        As for `dynamics`.
    dt : float
        s, short against the turning: the exponential of 7.2.28 is cut after the second power.
    gyro_density, walk_density : float
        Gyrcov, (rad/s)²/Hz, and RWncov, (rad/s²)²/Hz.

    Returns
    -------
    Discrete
        `Phi` and ``D Q D' dt`` (000 eqs. 7.2.24-7.2.30); Q is 6 x 6, of the noises and not of the states.
    """
    F, D = dynamics(q, rate)
    noise = np.diag(np.repeat([gyro_density, walk_density], 3))
    return Discrete(transition_series(F, dt, 2), D @ noise @ D.T * dt)


def propagate(
    state: QuaternionState, w: Floats, period: float, gyro_density: float, walk_density: float
) -> tuple[QuaternionState, Floats]:
    """Carry the filter along by measured rates.

    Parameters
    ----------
    state : QuaternionState
    w : ndarray, shape (n, 3)
        Measured rate over each step, rad/s.
    period : float
        Of a step, s.
    gyro_density, walk_density : float
        As for `discretise`.

    Returns
    -------
    state : QuaternionState
        After the last step.
    q_nb : ndarray, shape (n, 4)
        After each.

    Raises
    ------
    ShapeError, RangeError

    Notes
    -----
    The quaternion turns in closed form and is normalised (000 section 7.4); the covariance goes by `discretise`.
    """
    w = np.ascontiguousarray(w, dtype=np.float64)
    if w.ndim != 2 or w.shape[1] != 3:
        raise ShapeError("w", w.shape, "(n, 3)")
    if not period > 0.0:
        raise RangeError("period", period, "> 0 s")
    q, P = normalised(state.q_nb), np.array(state.P, dtype=np.float64)
    if P.shape != (7, 7):
        raise ShapeError("P", P.shape, "(7, 7)")
    bias = np.ascontiguousarray(state.bias, dtype=np.float64)
    history = np.empty((w.shape[0], 4))
    _propagate(q, bias, P, w, float(period), float(gyro_density), float(walk_density), history)
    return QuaternionState(q, bias.copy(), P), history


def correct(state: QuaternionState, measured: Floats, variance: float, *, hold_bias: bool = False) -> Correction:
    """Update with a measured attitude (000 eqs. 7.2.32-7.2.35, 7.7.4-7.7.6).

    Parameters
    ----------
    state : QuaternionState
    measured : ndarray, shape (4,)
        Quaternion from b to n, of either sign.
    variance : float
        Qcov, of each component.
    hold_bias : bool
        The bias stays as it is, and its uncertainty too: the gain of its rows is zero.

    Returns
    -------
    Correction
    """
    residual = nearest(measured, state.q_nb) - state.q_nb
    H, R = np.eye(4, 7), variance * np.eye(4)
    S = state.P[:4, :4] + R
    K: Floats = np.asarray(np.linalg.solve(S, state.P[:4]).T, dtype=np.float64)
    if hold_bias:
        K[4:] = 0.0
    dx = K @ residual
    after = QuaternionState(normalised(state.q_nb + dx[:4]), state.bias + dx[4:], joseph(state.P, H, R, K))
    return Correction(after, residual, float(residual @ np.linalg.solve(S, residual)))


def nearest(q: Floats, other: Floats) -> Floats:
    """`q` or its negative, which is the same rotation, whichever is nearer to `other`, shape (4,) (000 section 7.8).

    Parameters
    ----------
    q, other : ndarray, shape (4,)
        Order (x, y, z, w).

    Returns
    -------
    ndarray, shape (4,)
        Its scalar product with `other` is not negative.
    """
    return -q if float(q @ other) < 0.0 else q


@kernel
def _propagate(
    q: Floats, b: Floats, P: Floats, w: Floats, dt: float, gyro: float, walk: float, history: Floats
) -> None:
    Phi, Q, A = np.eye(7), np.zeros((7, 7)), np.empty((4, 4))
    angle, turn, room = np.empty(3), np.empty(4), room_for(7)
    written = np.zeros((7, 7))
    written[:4] = 1.0
    pattern = pattern_of(written)
    for k in range(w.shape[0]):
        p, r, s = w[k, 0] - b[0], w[k, 1] - b[1], w[k, 2] - b[2]
        A[0, 0], A[0, 1], A[0, 2], A[0, 3] = 0.0, s, -r, p
        A[1, 0], A[1, 1], A[1, 2], A[1, 3] = -s, 0.0, p, r
        A[2, 0], A[2, 1], A[2, 2], A[2, 3] = r, -p, 0.0, s
        A[3, 0], A[3, 1], A[3, 2], A[3, 3] = -p, -r, -s, 0.0
        for i in range(4):
            for j in range(4):
                outer = q[i] * q[j]
                A[i, j] = dt * (0.5 * A[i, j] - outer)
                Q[i, j] = 0.25 * gyro * dt * ((1.0 if i == j else 0.0) - outer)
        h = -0.5 * dt
        Phi[0, 4], Phi[0, 5], Phi[0, 6] = h * q[3], -h * q[2], h * q[1]
        Phi[1, 4], Phi[1, 5], Phi[1, 6] = h * q[2], h * q[3], -h * q[0]
        Phi[2, 4], Phi[2, 5], Phi[2, 6] = -h * q[1], h * q[0], h * q[3]
        Phi[3, 4], Phi[3, 5], Phi[3, 6] = -h * q[0], -h * q[1], -h * q[2]
        _second_order(A, Phi)
        for i in range(3):
            Q[4 + i, 4 + i] = walk * dt
        propagate_into(P, Phi, Q, P, pattern, room)
        angle[0], angle[1], angle[2] = dt * p, dt * r, dt * s
        quaternion_of(angle, turn)
        multiply(q, turn, q)
        normalise(q)
        history[k] = q


@kernel
def _second_order(A: Floats, Phi: Floats) -> None:
    """``I + A + A² / 2`` in the upper left of `Phi`; what stands in the upper right becomes ``B + A B / 2``."""
    for j in range(3):
        b = (Phi[0, 4 + j], Phi[1, 4 + j], Phi[2, 4 + j], Phi[3, 4 + j])
        for i in range(4):
            Phi[i, 4 + j] = b[i] + 0.5 * (A[i, 0] * b[0] + A[i, 1] * b[1] + A[i, 2] * b[2] + A[i, 3] * b[3])
    for i in range(4):
        for j in range(4):
            square = A[i, 0] * A[0, j] + A[i, 1] * A[1, j] + A[i, 2] * A[2, j] + A[i, 3] * A[3, j]
            Phi[i, j] = (1.0 if i == j else 0.0) + A[i, j] + 0.5 * square
