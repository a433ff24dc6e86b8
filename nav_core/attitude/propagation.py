"""Attitude from angular rate: quaternions and direction cosines, in closed form, by Euler and by Runge-Kutta.

Rates are those of b against n in b axes unless said otherwise; q and C turn b into n.  The rule of Runge-Kutta
needs rates in the middle of its steps, so its rate arrays have two rows a step and one more.
Attitudes are returned before the first step and after each.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from nav_core.attitude.kernels import multiply, normalise, quaternion_of
from nav_core.errors import RangeError, ShapeError
from nav_core.rotation import normalised
from nav_core.typing import Floats, finite, kernel, trailing

Normalisation = Literal["exact", "series", "feedback"]


def propagate_closed(q_nb: Floats, turns: Floats) -> Floats:
    """Quaternions after successive rotations of b, in closed form.

    Parameters
    ----------
    q_nb : ndarray, shape (4,)
        At the start.
    turns : ndarray, shape (n, 3)
        Rotation vectors, each in the b axes at its start, rad: rate times period where the rate is constant, else
        with the coning correction of `nav_core.strapdown.increments`.

    Returns
    -------
    ndarray, shape (n + 1, 4)
        Unit quaternions.

    Notes
    -----
    Exact for a rate of constant direction: the solution of 000 eq. 2.6.44 over a step is ``q exp(turn / 2)``.
    """
    return _closed(normalised(trailing("q_nb", q_nb, 4)), _rows("turns", turns))


def propagate_euler(q_nb: Floats, w_b: Floats, period: float, *, normalisation: Normalisation = "exact") -> Floats:
    """Quaternions by Euler's rule ``q + q' T``.

    Parameters
    ----------
    q_nb : ndarray, shape (4,)
    w_b : ndarray, shape (n, 3)
        At the start of each step, rad/s.
    period : float
        T, s.
    normalisation : {"exact", "series", "feedback"}
        After each step divide by the length; or multiply by ``1 + D/2`` (004); or within each add
        ``(1 - |q|²) q T`` (000 eqs. 2.8.3-2.8.5), which pulls the length to 1 with a time constant of half a second.

    Returns
    -------
    ndarray, shape (n + 1, 4)
        First-order accurate (000 eq. 2.8.5; 004 "metodo di Eulero").
    """
    kind = ("exact", "series", "feedback").index(normalisation)
    return _euler(normalised(trailing("q_nb", q_nb, 4)), _rows("w_b", w_b), _period(period), kind)


def propagate_rk4(q_nb: Floats, w_b: Floats, period: float) -> Floats:
    """Quaternions by the classical Runge-Kutta rule (004), normalised after each step.

    Parameters
    ----------
    q_nb : ndarray, shape (4,)
    w_b : ndarray, shape (2 n + 1, 3)
        At the start, middle and end of each of n steps, rad/s.
    period : float
        Of a whole step, s.

    Returns
    -------
    ndarray, shape (n + 1, 4)
        Fourth-order accurate.
    """
    return _rk4(normalised(trailing("q_nb", q_nb, 4)), _halves("w_b", w_b), _period(period))


def propagate_two_speed(q_nb: Floats, turns: Floats, w_in: Floats, period: float) -> Floats:
    """Quaternions with the gyros' part of the rate taken fast and the turning of n slowly.

    Parameters
    ----------
    q_nb : ndarray, shape (4,)
    turns : ndarray, shape (n * m, 3)
        Rotation vectors of b against i as in `propagate_closed`, m of them in each slow step.
    w_in : ndarray, shape (n, 3)
        Turning of n against i in n axes over each slow step, rad/s: Earth and transport rate.
    period : float
        Of a slow step, s.

    Returns
    -------
    ndarray, shape (n + 1, 4)
        At the ends of slow steps: ``q <- exp(-w_in T / 2) q exp(turn_1 / 2) ... exp(turn_m / 2)``.

    Notes
    -----
    004's ``(p', q', r') = (p, q, r) - C_n^b w_in`` split in two.  Both rotations are exact for constant `w_in`,
    whatever b does; `body_rate_against` is the unsplit form.
    """
    slow, fast = _rows("w_in", w_in), _rows("turns", turns)
    if slow.shape[0] == 0 or fast.shape[0] % slow.shape[0] != 0:
        raise ShapeError("turns", fast.shape, f"(m * {slow.shape[0]}, 3)")
    return _two_speed(normalised(trailing("q_nb", q_nb, 4)), fast, slow, _period(period))


def body_rate_against(w_ib: Floats, C_nb: Floats, w_in: Floats) -> Floats:
    """Rate of b against n, b axes, shape (..., 3), rad/s: ``w_ib - C_nb' w_in`` (004; 000 eq. 2.5.22).

    Parameters
    ----------
    w_ib : ndarray, shape (..., 3)
        Rate of b against i, rad/s, b axes.
    C_nb : ndarray, shape (..., 3, 3)
        From b to n.
    w_in : ndarray, shape (..., 3)
        Rate of n against i, rad/s, n axes.

    Returns
    -------
    ndarray, shape (..., 3)
        rad/s, b axes.

    Raises
    ------
    ShapeError
    """
    turning = np.einsum("...ji,...j->...i", trailing("C_nb", C_nb, 3, 3), trailing("w_in", w_in, 3))
    return trailing("w_ib", w_ib, 3) - turning


def propagate_cosines(
    C_nb: Floats, w_ib: Floats, w_in: Floats, period: float, *, rule: Literal["euler", "rk4"] = "rk4"
) -> Floats:
    """Direction cosines integrated directly, six equations and orthogonality for the other three.

    Parameters
    ----------
    C_nb : ndarray, shape (3, 3)
        From b to n, at the start.
    w_ib : ndarray, shape (2 n + 1, 3)
        Body rate against i at the start, middle and end of each of n steps, b axes, rad/s.
    w_in : ndarray, shape (2 n + 1, 3)
        Turning of n against i at the same moments, n axes, rad/s.
    period : float
        Of a whole step, s.
    rule : {"euler", "rk4"}
        Euler's rule uses the first of each step's rates.

    Returns
    -------
    ndarray, shape (n + 1, 3, 3)
        Not orthonormalised: the first two rows are what integration makes of them, see
        `nav_core.attitude.orthonormal`.

    Notes
    -----
    004: ``C' = C [w_ib]x - [w_in]x C``, its first two rows integrated and the third their cross product.
    """
    body, frame = _halves("w_ib", w_ib), _halves("w_in", w_in)
    if body.shape != frame.shape:
        raise ShapeError("w_in", frame.shape, f"{body.shape}")
    return _cosines(trailing("C_nb", C_nb, 3, 3), body, frame, _period(period), rule == "rk4")


def _rows(name: str, values: Floats) -> Floats:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ShapeError(name, array.shape, "(n, 3)")
    return finite(name, array)


def _halves(name: str, values: Floats) -> Floats:
    array = _rows(name, values)
    if array.shape[0] % 2 == 0:
        raise ShapeError(name, array.shape, "(2 n + 1, 3)")
    return array


def _period(period: float) -> float:
    if not (np.isfinite(period) and period > 0.0):
        raise RangeError("period", period, "> 0 s")
    return float(period)


@kernel
def _closed(q: Floats, turns: Floats) -> Floats:
    out, turn = np.empty((turns.shape[0] + 1, 4)), np.empty(4)
    out[0] = q
    for k in range(turns.shape[0]):
        quaternion_of(turns[k], turn)
        multiply(out[k], turn, out[k + 1])
        normalise(out[k + 1])
    return out


@kernel
def _slope(q: Floats, w: Floats, out: Floats) -> None:
    """``q' = q w / 2`` (000 eq. 2.6.46)."""
    out[0] = 0.5 * (q[3] * w[0] - q[2] * w[1] + q[1] * w[2])
    out[1] = 0.5 * (q[2] * w[0] + q[3] * w[1] - q[0] * w[2])
    out[2] = 0.5 * (q[0] * w[1] - q[1] * w[0] + q[3] * w[2])
    out[3] = -0.5 * (q[0] * w[0] + q[1] * w[1] + q[2] * w[2])


@kernel
def _euler(q: Floats, w: Floats, T: float, kind: int) -> Floats:
    out, rate = np.empty((w.shape[0] + 1, 4)), np.empty(4)
    out[0] = q
    for k in range(w.shape[0]):
        now, after = out[k], out[k + 1]
        _slope(now, w[k], rate)
        lack = 1.0 - np.sum(now * now)
        for i in range(4):
            after[i] = now[i] + T * (rate[i] + (lack * now[i] if kind == 2 else 0.0))
        if kind == 0:
            normalise(after)
        elif kind == 1:
            after *= 1.0 + 0.5 * (1.0 - np.sum(after * after))
    return out


@kernel
def _rk4(q: Floats, w: Floats, T: float) -> Floats:
    steps = w.shape[0] // 2
    out, m = np.empty((steps + 1, 4)), np.empty((4, 4))
    out[0] = q
    for k in range(steps):
        now = out[k]
        _slope(now, w[2 * k], m[0])
        _slope(now + 0.5 * T * m[0], w[2 * k + 1], m[1])
        _slope(now + 0.5 * T * m[1], w[2 * k + 1], m[2])
        _slope(now + T * m[2], w[2 * k + 2], m[3])
        out[k + 1] = now + T / 6.0 * (m[0] + 2.0 * m[1] + 2.0 * m[2] + m[3])
        normalise(out[k + 1])
    return out


@kernel
def _two_speed(q: Floats, turns: Floats, w_in: Floats, T: float) -> Floats:
    steps = w_in.shape[0]
    per_step = turns.shape[0] // steps
    out, turn = np.empty((steps + 1, 4)), np.empty(4)
    out[0] = q
    for k in range(steps):
        now = out[k + 1]
        now[:] = out[k]
        for j in range(k * per_step, (k + 1) * per_step):
            quaternion_of(turns[j], turn)
            multiply(now, turn, now)
        quaternion_of(-T * w_in[k], turn)
        multiply(turn, now, now)
        normalise(now)
    return out


@kernel
def _cosine_rates(C: Floats, w: Floats, W: Floats, out: Floats) -> None:
    """The six equations of 004: rates of the first two rows of `C`, whose third is their cross product."""
    C[2, 0] = C[0, 1] * C[1, 2] - C[0, 2] * C[1, 1]
    C[2, 1] = C[0, 2] * C[1, 0] - C[0, 0] * C[1, 2]
    C[2, 2] = C[0, 0] * C[1, 1] - C[0, 1] * C[1, 0]
    for i in range(2):
        out[i, 0] = C[i, 1] * w[2] - C[i, 2] * w[1]
        out[i, 1] = C[i, 2] * w[0] - C[i, 0] * w[2]
        out[i, 2] = C[i, 0] * w[1] - C[i, 1] * w[0]
    for j in range(3):
        out[0, j] += C[1, j] * W[2] - C[2, j] * W[1]
        out[1, j] += C[2, j] * W[0] - C[0, j] * W[2]


@kernel
def _cosines(C: Floats, w: Floats, W: Floats, T: float, fourth_order: bool) -> Floats:
    steps = w.shape[0] // 2
    out, m, trial = np.empty((steps + 1, 3, 3)), np.zeros((4, 3, 3)), np.empty((3, 3))
    out[0] = C
    for k in range(steps):
        now, h = out[k], 2 * k
        trial[:] = now
        _cosine_rates(trial, w[h], W[h], m[0])
        if fourth_order:
            trial[:] = now + 0.5 * T * m[0]
            _cosine_rates(trial, w[h + 1], W[h + 1], m[1])
            trial[:] = now + 0.5 * T * m[1]
            _cosine_rates(trial, w[h + 1], W[h + 1], m[2])
            trial[:] = now + T * m[2]
            _cosine_rates(trial, w[h + 2], W[h + 2], m[3])
            trial[:] = now + T / 6.0 * (m[0] + 2.0 * m[1] + 2.0 * m[2] + m[3])
        else:
            trial[:] = now + T * m[0]
        # The last call only completes the third row.
        _cosine_rates(trial, w[h], W[h], m[0])
        out[k + 1] = trial
    return out
