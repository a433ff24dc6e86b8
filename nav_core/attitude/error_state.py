"""Attitude and gyro bias from a star tracker, or from directions such as gravity and the magnetic field (002 ch. 7).

The filter carries a quaternion and a bias and estimates their errors: ``R_nb = R_estimate exp([d_theta]x)``, so
`d_theta` is about the b axes, and `bias + d_bias` is what the gyro adds to the true rate.  002 writes quaternions by
JPL's rule; its ``q(N to B)`` has the components of the Hamilton quaternion from b to n that stands here, and its
product of a and b is the Hamilton product ``b a``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from nav_core.attitude.error_state_kernel import run
from nav_core.errors import RangeError, ShapeError
from nav_core.rotation import normalised, skew
from nav_core.typing import Floats, Integers, finite, trailing

Discretisation = Literal["exact", "approximate"]

_SMALL = 0.1
"""Angle of a step, rad, below which the closed forms are summed as series: they divide by its fifth power."""


class GyroNoise(NamedTuple):
    """What the gyros add, alike on all axes.

    Attributes
    ----------
    N : float
        Angle random walk, rad/s/√Hz.
    K : float
        Rate random walk that drives the bias, rad/s²/√Hz.
    """

    N: float
    K: float


@dataclass(frozen=True, slots=True)
class Start:
    """Attitude before the first step.

    Attributes
    ----------
    q_nb : ndarray, shape (4,)
        (x, y, z, w), from b to n.
    bias : ndarray, shape (3,)
        Of the gyro, b axes, rad/s; 002 takes the mean of a second at rest (7.42) or zero (7.40).
    P : ndarray, shape (6, 6)
        Covariance of `d_theta` and `d_bias`, rad², rad²/s, rad²/s².
    """

    q_nb: Floats
    bias: Floats
    P: Floats

    @classmethod
    def of(cls, q_nb: Floats, bias: Floats, sigma_attitude: float, sigma_bias: float) -> Start:
        """With independent errors, alike on all axes, rad and rad/s.

        Parameters
        ----------
        q_nb : ndarray, shape (4,)
            Attitude at the start, b to n.
        bias : ndarray, shape (3,)
            Of the gyro, rad/s, b axes.
        sigma_attitude : float
            1-sigma of the attitude about each axis of b, rad.
        sigma_bias : float
            1-sigma of the bias on each axis, rad/s.

        Returns
        -------
        Start
            With a diagonal covariance.
        """
        return cls(q_nb, bias, np.diag(np.repeat([sigma_attitude**2, sigma_bias**2], 3)))


@dataclass(frozen=True, slots=True)
class StarTracker:
    """Attitudes measured as a whole.

    Attributes
    ----------
    q_nb : ndarray, shape (n, 4)
        At the end of each step; NaN where there is none.  Either sign.
    sigma : float
        1-sigma of the rotation about each axis of b, rad; twice the sigma of 002 eq. 8.9, which is the quaternion's.
    """

    q_nb: Floats
    sigma: float


@dataclass(frozen=True, slots=True)
class Direction:
    """A vector that is known in n and measured in b.

    Attributes
    ----------
    reference : ndarray, shape (3,)
        In n: (0, 0, -g) for an accelerometer without other acceleration, the Earth's field for a magnetometer.
    measured : ndarray, shape (n, 3)
        In b, calibrated, at the end of each step; NaN where there is none.
    sigma : float
        1-sigma of each component, in the unit of both.
    """

    reference: Floats
    measured: Floats
    sigma: float


@dataclass(frozen=True, slots=True)
class Estimates:
    """Attitude after each step.

    Attributes
    ----------
    q_nb : ndarray, shape (n, 4)
    bias : ndarray, shape (n, 3)
        rad/s.
    P : ndarray, shape (n, 6, 6)
        Covariance of `d_theta` and `d_bias`.
    nis : ndarray, shape (n,)
        Sum of the squared normalised innovations of what was used in the step.
    used, rejected : ndarray, shape (n,)
        Components used and left out in the step.
    """

    q_nb: Floats
    bias: Floats
    P: Floats
    nis: Floats
    used: Integers
    rejected: Integers


def transition(w: Floats, dt: float, discretisation: Discretisation = "exact") -> Floats:
    """Transition matrix of the errors over a step of constant rate.

    Parameters
    ----------
    w : ndarray, shape (3,)
        Rate of b against n, bias taken off, rad/s.
    dt : float
        s.
    discretisation : {"exact", "approximate"}
        002 eqs. 7.22-7.24, or 8.1, 8.2.

    Returns
    -------
    ndarray, shape (6, 6)
        ``exp(F dt)`` with ``F = [[-[w]x, -I], [0, 0]]`` (7.16).

    Raises
    ------
    ShapeError
    """
    W, Phi = skew(_vector("w", w)), np.eye(6)
    if discretisation == "approximate":
        Phi[:3, :3] -= dt * W
        Phi[:3, 3:] = -dt * np.eye(3)
        return Phi
    size = float(np.linalg.norm(w))
    sine, cosine, third, _, _ = _series(size * dt)
    Phi[:3, :3] += -dt * sine * W + dt**2 * cosine * W @ W
    Phi[:3, 3:] = -dt * np.eye(3) + dt**2 * cosine * W - dt**3 * third * W @ W
    return Phi


def process_noise(w: Floats, dt: float, noise: GyroNoise, discretisation: Discretisation = "exact") -> Floats:
    """Covariance that a step adds to the errors.

    Parameters
    ----------
    w : ndarray, shape (3,)
        As for `transition`, rad/s; without influence when approximate.
    dt : float
        s.
    noise : GyroNoise
    discretisation : {"exact", "approximate"}
        002 eqs. 7.26-7.29 with brackets and signs corrected, or 8.3-8.5 with ``sigma_w² = N² dt`` and
        ``sigma_b² = K² dt`` (docs/equations.md).

    Returns
    -------
    ndarray, shape (6, 6)

    Raises
    ------
    ShapeError
    """
    W, one = skew(_vector("w", w)), np.eye(3)
    angle2, bias2 = noise.N**2, noise.K**2
    Q = np.zeros((6, 6))
    Q[:3, :3] = (angle2 * dt + bias2 * dt**3 / 3.0) * one
    Q[:3, 3:] = -0.5 * bias2 * dt**2 * one
    Q[3:, 3:] = bias2 * dt * one
    if discretisation == "exact":
        _, _, third, fourth, fifth = _series(float(np.linalg.norm(w)) * dt)
        Q[:3, :3] += bias2 * dt**5 * fifth * W @ W
        Q[:3, 3:] += bias2 * (dt**3 * third * W - dt**4 * fourth * W @ W)
    Q[3:, :3] = Q[:3, 3:].T
    return Q


def _series(x: float) -> tuple[float, float, float, float, float]:
    """Coefficients of the closed forms at the angle `x` of a step.

    ``sin x / x``, ``(1 - cos x) / x²``, ``(x - sin x) / x³``, ``(x²/2 + cos x - 1) / x⁴`` and
    ``(x³/3 + 2 sin x - 2 x) / x⁵``.
    """
    if x < _SMALL:
        y = x * x
        return (
            1 - y / 6 * (1 - y / 20 * (1 - y / 42)),
            0.5 - y / 24 * (1 - y / 30 * (1 - y / 56)),
            1 / 6 - y / 120 * (1 - y / 42 * (1 - y / 72)),
            1 / 24 - y / 720 * (1 - y / 56 * (1 - y / 90)),
            1 / 60 - y / 2520 * (1 - y / 72 * (1 - y / 110)),
        )
    s, c = float(np.sin(x)), float(np.cos(x))
    fifth = (x**3 / 3 + 2 * s - 2 * x) / x**5
    fourth = (x * x / 2 + c - 1) / x**4
    return s / x, (1 - c) / x**2, (x - s) / x**3, fourth, fifth


def estimate(
    start: Start,
    w: Floats,
    period: float,
    noise: GyroNoise,
    *,
    tracker: StarTracker | None = None,
    directions: Sequence[Direction] = (),
    discretisation: Discretisation = "exact",
    gate: float = np.inf,
) -> Estimates:
    """Attitude and bias over a record (002 section 7.7).

    Parameters
    ----------
    start : Start
    w : ndarray, shape (n, 3)
        Calibrated rate over each step, rad/s.  002 eq. 7.45 takes the sample at the step's end; the mean of those at
        both its ends errs by the square of the period instead of its first power.
    period : float
        Of a step, s.
    noise : GyroNoise
    tracker : StarTracker, optional
    directions : sequence of Direction
    discretisation : {"exact", "approximate"}
    gate : float
        A component whose squared normalised innovation exceeds this is left out (`nav_core.kalman.gate`).

    Returns
    -------
    Estimates

    Raises
    ------
    ShapeError
        An array does not fit `w`.
    NotFiniteError
        A rate is missing: the attitude cannot be carried over it.
    RangeError
        The period or a sigma is not positive.

    Notes
    -----
    Each step predicts by 7.44-7.47 and updates by 7.48-7.57.  Components are folded in one after the other, linearised
    once, which is the joint update for independent noise (000 eq. 3.3.21).
    """
    w = np.ascontiguousarray(w, dtype=np.float64)
    if w.ndim != 2 or w.shape[1] != 3:
        raise ShapeError("w", w.shape, "(n, 3)")
    n = finite("w", w).shape[0]
    _positive("period", period)
    P = np.array(start.P, dtype=np.float64)
    if P.shape != (6, 6):
        raise ShapeError("P", P.shape, "(6, 6)")
    stars, spread = np.full((0, 4), np.nan), 1.0
    if tracker is not None:
        stars, spread = _measured("q_nb", tracker.q_nb, (n, 4)), _positive("sigma", tracker.sigma)
    seen, known = np.empty((n, len(directions), 3)), np.empty((len(directions), 3))
    variances = np.empty(len(directions))
    for i, direction in enumerate(directions):
        seen[:, i] = _measured("measured", direction.measured, (n, 3))
        known[i] = _vector("reference", direction.reference)
        variances[i] = _positive("sigma", direction.sigma) ** 2
    q_out, b_out, P_out = np.empty((n, 4)), np.empty((n, 3)), np.empty((n, 6, 6))
    nis, used, rejected = np.zeros(n), np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    run(
        normalised(trailing("q_nb", start.q_nb, 4)),
        _vector("bias", start.bias).copy(),
        P,
        w,
        float(period),
        (noise.N**2, noise.K**2),
        discretisation == "exact",
        (stars, spread**2),
        (seen, known, variances),
        float(gate),
        (q_out, b_out, P_out),
        (nis, used, rejected),
    )
    return Estimates(q_out, b_out, P_out, nis, used, rejected)


def mean_rates(w: Floats) -> Floats:
    """Rate over each step as the mean of the samples at its ends, shape (n + 1, 3) to (n, 3).

    Parameters
    ----------
    w : ndarray, shape (n + 1, 3)
        Angular rate at the ends of the steps, rad/s, b axes.

    Returns
    -------
    ndarray, shape (n, 3)
        rad/s, b axes.
    """
    return 0.5 * (w[1:] + w[:-1])


def _vector(name: str, values: Floats) -> Floats:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != (3,):
        raise ShapeError(name, array.shape, "(3,)")
    return array


def _measured(name: str, values: Floats, shape: tuple[int, int]) -> Floats:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != shape:
        raise ShapeError(name, array.shape, str(shape))
    return array


def _positive(name: str, value: float) -> float:
    if not (np.isfinite(value) and value > 0.0):
        raise RangeError(name, value, "> 0")
    return float(value)
