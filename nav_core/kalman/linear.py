"""The linear Kalman filter in matrices, over a record, and smoothed (000 sections 3.3, 3.7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from nav_core.errors import CovarianceError, RangeError, ShapeError
from nav_core.kalman import record_kernels
from nav_core.typing import Flags, Floats


class State(NamedTuple):
    """Estimate `x` (n,) and its covariance `P` (n, n)."""

    x: Floats
    P: Floats


class Update(NamedTuple):
    """Outcome of one joint update.

    Attributes
    ----------
    x : ndarray, shape (n,)
    P : ndarray, shape (n, n)
    innovation : ndarray, shape (m,)
        Measurement minus its prediction.
    S : ndarray, shape (m, m)
        Covariance of the innovation.
    nis : float
        Innovation squared, normalised by `S`: chi square with m degrees of freedom if all is as modelled.
    accepted : bool
        Whether the innovation passed the gate; if not, `x` and `P` are as before.
    """

    x: Floats
    P: Floats
    innovation: Floats
    S: Floats
    nis: float
    accepted: bool


def predict(x: Floats, P: Floats, Phi: Floats, Q: Floats) -> State:
    """State and covariance one step later (000 eqs. 3.6.21, 3.6.25).

    Parameters
    ----------
    x : ndarray, shape (n,)
    P, Phi, Q : ndarray, shape (n, n)

    Returns
    -------
    State
    """
    after = Phi @ P @ Phi.T + Q
    return State(Phi @ x, np.add(after, after.T) / 2.0)


def joseph(P: Floats, H: Floats, R: Floats, K: Floats) -> Floats:
    """``(I - K H) P (I - K H)' + K R K'``: the covariance after an update with any gain (000 eq. 3.11.24).

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance before the update.
    H : ndarray, shape (m, n)
        Measurement matrix.
    R : ndarray, shape (m, m)
        Covariance of the measurements' noise.
    K : ndarray, shape (n, m)
        Gain.

    Returns
    -------
    ndarray, shape (n, n)
        Symmetric.
    """
    keep = np.eye(P.shape[0]) - K @ H
    after = keep @ P @ keep.T + K @ R @ K.T
    return np.add(after, after.T) / 2.0


def update(x: Floats, P: Floats, innovation: Floats, H: Floats, R: Floats, *, gate: float | None = None) -> Update:
    """Joint update with `m` measurements, Joseph's form (000 eqs. 3.3.21, 3.3.22, 3.11.24).

    Parameters
    ----------
    x : ndarray, shape (n,)
    P : ndarray, shape (n, n)
    innovation : ndarray, shape (m,)
        Measurement minus its prediction: ``z - H x``, or ``z - h(x)`` of an extended filter.
    H : ndarray, shape (m, n)
    R : ndarray, shape (m, m)
        May have correlations.
    gate : float, optional
        The measurement is rejected as a whole when its NIS exceeds this (`consistency.gate`).

    Returns
    -------
    Update

    Raises
    ------
    CovarianceError
        If the innovation's covariance is not positive definite.
    """
    from scipy.linalg import cho_factor, cho_solve

    S = H @ P @ H.T + R
    try:
        factor = cho_factor(S)
    except np.linalg.LinAlgError as error:
        raise CovarianceError("S", float(np.linalg.eigvalsh(S)[0])) from error
    nis = float(innovation @ cho_solve(factor, innovation))
    if gate is not None and nis > gate:
        return Update(x, P, innovation, S, nis, accepted=False)
    K = cho_solve(factor, H @ P).T
    return Update(x + K @ innovation, joseph(P, H, R, K), innovation, S, nis, accepted=True)


def decorrelated(z: Floats, H: Floats, R: Floats) -> tuple[Floats, Floats]:
    """Measurements with unit, independent noise out of correlated ones, for an update one by one.

    Parameters
    ----------
    z : ndarray, shape (m,)
    H : ndarray, shape (m, n)
    R : ndarray, shape (m, m)

    Returns
    -------
    z, H : ndarray
        Both multiplied by the inverse of `R`'s Cholesky factor.

    Raises
    ------
    CovarianceError
        If `R` is not positive definite.
    """
    from scipy.linalg import solve_triangular

    try:
        L = np.linalg.cholesky(R)
    except np.linalg.LinAlgError as error:
        raise CovarianceError("R", float(np.linalg.eigvalsh(R)[0])) from error
    both = np.asarray(solve_triangular(L, np.column_stack([z, H]), lower=True), dtype=np.float64)
    return both[:, 0].copy(), both[:, 1:].copy()


@dataclass(frozen=True, slots=True)
class Filtered:
    """A filter over a record of k epochs.

    Attributes
    ----------
    x_prior, x : ndarray, shape (k, n)
        Before and after the update of each epoch.
    P_prior, P : ndarray, shape (k, n, n)
        Or (1, n, n), of the last epoch.
    nis : ndarray, shape (k, m)
        Squared normalised innovations, one by one; NaN where not measured.  Those used add up to the joint NIS.
    rejected : ndarray of bool, shape (k, m)
        Measured, but beyond the gate.
    """

    x_prior: Floats
    P_prior: Floats
    x: Floats
    P: Floats
    nis: Floats
    rejected: Flags


def _per_step(name: str, values: Floats, count: int, shape: tuple[int, ...]) -> Floats:
    """`values` for each of `count` steps, or once, with a first axis of length one, for all of them."""
    if values.shape == shape:
        values = values[None]
    elif values.shape != (count, *shape):
        raise ShapeError(name, values.shape, f"{shape} or {(count, *shape)}")
    return np.ascontiguousarray(values, dtype=np.float64)


def filter_record(
    x: Floats,
    P: Floats,
    *,
    Phi: Floats,
    Q: Floats,
    z: Floats,
    H: Floats,
    r: Floats,
    gate: float = np.inf,
    keep_covariances: bool = True,
) -> Filtered:
    """Linear Kalman filter over a record, compiled, with measurements folded in one by one.

    Parameters
    ----------
    x : ndarray, shape (n,)
        State at the first epoch, before its measurement.
    P : ndarray, shape (n, n)
    Phi, Q : ndarray, shape (n, n) or (k - 1, n, n)
        From each epoch to the next.
    z : ndarray, shape (k, m)
        NaN where not measured.
    H : ndarray, shape (m, n) or (k, m, n)
    r : ndarray, shape (m,) or (k, m)
        Variances of independent measurement noise; correlated ones go through `decorrelated`.
    gate : float
        A single measurement whose squared normalised innovation exceeds this is left out.
    keep_covariances : bool
        Without, `P_prior` and `P` hold the last epoch's alone, shape (1, n, n): enough to follow a state, too little
        to `smooth`, and twice as fast for large states.

    Returns
    -------
    Filtered

    Raises
    ------
    ShapeError, RangeError

    Notes
    -----
    000 eqs. 3.6.21-3.6.25, 3.3.21, 3.3.22, 3.11.24; Groves 2013 §3.2, sequential update §3.2.7.
    """
    if z.ndim != 2:
        raise ShapeError("z", z.shape, "(k, m)")
    (steps, m), n = z.shape, x.size
    variances = _per_step("r", r, steps, (m,))
    if variances.size and not variances.min() > 0.0:
        raise RangeError("r", float(variances.min()), "more than 0")
    kept = steps if keep_covariances else min(steps, 1)
    prior, after = ((np.empty((steps, n)), np.empty((kept, n, n))) for _ in range(2))
    nis = np.empty((steps, m))
    every = _per_step("Phi", Phi, steps - 1, (n, n))
    record_kernels.run_filter(
        (np.array(x, dtype=np.float64), _per_step("P", P, 1, (n, n))[0].copy()),
        every,
        _per_step("Q", Q, steps - 1, (n, n)),
        np.ascontiguousarray(z, dtype=np.float64),
        _per_step("H", H, steps, (m, n)),
        variances,
        float(gate),
        record_kernels.common_pattern(every),
        prior,
        after,
        nis,
    )
    return Filtered(*prior, *after, np.abs(nis), nis < 0.0)


def smooth(filtered: Filtered, Phi: Floats) -> State:
    """Rauch-Tung-Striebel smoother: each epoch's estimate from all measurements, later ones too.

    Parameters
    ----------
    filtered : Filtered
    Phi : ndarray, shape (n, n) or (k - 1, n, n)
        The transition matrices the filter used.

    Returns
    -------
    State
        `x` (k, n) and `P` (k, n, n).

    Raises
    ------
    ShapeError

    Notes
    -----
    Rauch, Tung and Striebel 1965; Groves 2013 §3.4.2.
    """
    steps, n = filtered.x.shape
    if filtered.P.shape[0] != steps:
        raise ShapeError("filtered.P", filtered.P.shape, f"({steps}, {n}, {n}): keep_covariances is needed")
    x, P = filtered.x.copy(), filtered.P.copy()
    every = np.ascontiguousarray(np.broadcast_to(_per_step("Phi", Phi, steps - 1, (n, n)), (steps - 1, n, n)))
    record_kernels.smooth_backwards(filtered.x_prior, filtered.P_prior, x, P, every)
    return State(x, P)
