"""Linearised and extended Kalman filters over a record (000 section 3.11, 003).

Both run the linear filter on the deviation from a reference: the linearised filter's reference is a trajectory
known beforehand, the extended filter's is its own last estimate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from nav_core.errors import ShapeError
from nav_core.kalman.linear import Filtered, State, predict, update
from nav_core.processes import transition_series
from nav_core.typing import Floats


class Step(NamedTuple):
    """Dynamics over one step, linearised.

    Attributes
    ----------
    x : ndarray, shape (n,)
        State at its end, without noise.
    Phi, Q : ndarray, shape (n, n)
        Derivative of `x` with respect to the state at its start; covariance of the noise it adds.
    """

    x: Floats
    Phi: Floats
    Q: Floats


class Observation(NamedTuple):
    """Measurement that a state lets expect.

    Attributes
    ----------
    h : ndarray, shape (m,)
    H : ndarray, shape (m, n)
        Derivative of `h` with respect to the state.
    R : ndarray, shape (m, m)
        Covariance of the measurement's noise.
    """

    h: Floats
    H: Floats
    R: Floats


class Model(Protocol):
    """A nonlinear process and its measurements; `k` counts epochs from 0."""

    def step(self, x: Floats, k: int) -> Step:
        """From epoch `k` to the next (000 eqs. 3.11.18, 3.11.26).

        Parameters
        ----------
        x : ndarray, shape (n,)
            State at the epoch.
        k : int
            Index of the epoch.

        Returns
        -------
        Step
            State at the next epoch, transition and noise in between.
        """
        ...

    def observe(self, x: Floats, k: int) -> Observation:
        """At epoch `k` (000 eqs. 3.11.2, 3.11.15).

        Parameters
        ----------
        x : ndarray, shape (n,)
            State at the epoch.
        k : int
            Index of the epoch.

        Returns
        -------
        Observation
            Expected measurements, matrix and noise.
        """
        ...


@dataclass(frozen=True, slots=True)
class ContinuousModel:
    """A `Model` out of differential equations ``x' = f(x, t) + G w`` (000 eqs. 3.11.1, 3.11.2).

    Attributes
    ----------
    t : ndarray, shape (k,)
        Epochs, s.
    f : callable
        ``f(x, t)``, shape (n,).
    F : callable
        Its derivative with respect to `x`, shape (n, n).
    diffusion : ndarray, shape (n, n)
        ``G Q G'``.
    observation : callable
        ``observation(x, k)``.
    """

    t: Floats
    f: Callable[[Floats, float], Floats]
    F: Callable[[Floats, float], Floats]
    diffusion: Floats
    observation: Callable[[Floats, int], Observation]

    def step(self, x: Floats, k: int) -> Step:
        """State by Runge-Kutta of order 4; matrices with the derivative in the middle of the step.

        The series of `Phi` and Simpson's rule on the noise (000 eq. 3.6.28) are of the same order as the state.

        Parameters
        ----------
        x : ndarray, shape (n,)
            State at the epoch.
        k : int
            Index of the epoch.

        Returns
        -------
        Step
            State at the next epoch, transition and noise in between.
        """
        t, dt = float(self.t[k]), float(self.t[k + 1] - self.t[k])
        a = self.f(x, t)
        b = self.f(x + 0.5 * dt * a, t + 0.5 * dt)
        c = self.f(x + 0.5 * dt * b, t + 0.5 * dt)
        d = self.f(x + dt * c, t + dt)
        after = x + dt / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        half = transition_series(self.F(0.5 * (x + after), t + 0.5 * dt), 0.5 * dt, 4)
        Phi = half @ half
        noise = self.diffusion + 4.0 * half @ self.diffusion @ half.T + Phi @ self.diffusion @ Phi.T
        return Step(after, Phi, dt / 6.0 * noise)

    def observe(self, x: Floats, k: int) -> Observation:
        """`observation`.

        Parameters
        ----------
        x : ndarray, shape (n,)
            State at the epoch.
        k : int
            Index of the epoch.

        Returns
        -------
        Observation
            Expected measurements, matrix and noise.
        """
        return self.observation(x, k)


def jacobian(function: Callable[[Floats], Floats], x: Floats, step: float = 1e-6) -> Floats:
    """Derivative of a vector function by central differences.

    Parameters
    ----------
    function : callable
        From shape (n,) to shape (m,).
    x : ndarray, shape (n,)
    step : float
        Relative to the larger of 1 and each component.

    Returns
    -------
    ndarray, shape (m, n)
        Error about ``step²`` of the third derivative.
    """
    columns: list[Floats] = []
    for j in range(x.size):
        shift = np.zeros(x.size)
        shift[j] = step * max(1.0, abs(float(x[j])))
        columns.append((function(x + shift) - function(x - shift)) / (2.0 * shift[j]))
    return np.column_stack(columns)


def extended(model: Model, x: Floats, P: Floats, z: Floats, *, gate: float | None = None) -> Filtered:
    """Extended Kalman filter: linearised around its own estimate (000 section 3.11.3, eqs. 3.11.18-3.11.26).

    Parameters
    ----------
    model : Model
    x : ndarray, shape (n,)
        State at the first epoch, before its measurement.
    P : ndarray, shape (n, n)
    z : ndarray, shape (k, m)
        An epoch with any NaN is not measured.
    gate : float, optional
        Epochs whose joint NIS exceeds this are left out.

    Returns
    -------
    Filtered
        `nis` and `rejected` have one column: epochs are taken or left as a whole.

    Raises
    ------
    ShapeError
    """
    return _run(model, None, x, P, z, gate)


def linearised(
    model: Model, reference: Floats, x: Floats, P: Floats, z: Floats, *, gate: float | None = None
) -> Filtered:
    """Linearised Kalman filter: linearised around a reference trajectory (000 section 3.11.2, eqs. 3.11.6-3.11.15).

    Parameters
    ----------
    model : Model
    reference : ndarray, shape (k, n)
        Trajectory that fulfils the model's dynamics without noise (3.11.6).
    x, P, z : ndarray, shape (n,), (n, n), (k, m)
        As for `extended`.
    gate : float, optional
        As for `extended`.

    Returns
    -------
    Filtered

    Raises
    ------
    ShapeError
    """
    if reference.shape != (z.shape[0], x.size):
        raise ShapeError("reference", reference.shape, f"({z.shape[0]}, {x.size})")
    return _run(model, reference, x, P, z, gate)


def _run(model: Model, reference: Floats | None, x: Floats, P: Floats, z: Floats, gate: float | None) -> Filtered:
    if z.ndim != 2:
        raise ShapeError("z", z.shape, "(k, m)")
    steps, n = z.shape[0], x.size
    x_prior, P_prior = np.empty((steps, n)), np.empty((steps, n, n))
    x_after, P_after = np.empty((steps, n)), np.empty((steps, n, n))
    nis, rejected = np.full((steps, 1), np.nan), np.zeros((steps, 1), dtype=np.bool_)
    now = State(x, P)
    for k in range(steps):
        if k > 0:
            around = now.x if reference is None else reference[k - 1]
            step = model.step(around, k - 1)
            deviation = predict(now.x - around, now.P, step.Phi, step.Q)
            now = State(step.x + deviation.x, deviation.P)
        x_prior[k], P_prior[k] = now
        if np.isfinite(z[k]).all():
            around = now.x if reference is None else reference[k]
            seen = model.observe(around, k)
            innovation = z[k] - seen.h - seen.H @ (now.x - around)
            outcome = update(now.x, now.P, innovation, seen.H, seen.R, gate=gate)
            now = State(outcome.x, outcome.P)
            nis[k], rejected[k] = outcome.nis, not outcome.accepted
        x_after[k], P_after[k] = now
    return Filtered(x_prior, P_prior, x_after, P_after, nis, rejected)
