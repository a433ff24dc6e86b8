"""A linear filter over a record and its smoother, compiled: `linear.filter_record` and `linear.smooth`."""

from __future__ import annotations

import numpy as np

from nav_core.kalman.kernels import Pattern, pattern_of, propagate_into, propagate_state, room_for, update_sequential
from nav_core.typing import Floats, kernel


@kernel
def common_pattern(Phi: Floats) -> Pattern:
    """Pattern of all transition matrices of a record.

    Parameters
    ----------
    Phi : ndarray, shape (k, n, n)

    Returns
    -------
    Pattern
    """
    steps, n = Phi.shape[0], Phi.shape[1]
    flat, seen = Phi.reshape((steps, n * n)), np.zeros(n * n)
    for k in range(steps):
        for j in range(n * n):
            seen[j] += abs(flat[k, j])
    return pattern_of(seen.reshape((n, n)))


@kernel
def run_filter(
    start: tuple[Floats, Floats],
    Phi: Floats,
    Q: Floats,
    z: Floats,
    H: Floats,
    r: Floats,
    gate: float,
    pattern: Pattern,
    prior: tuple[Floats, Floats],
    after: tuple[Floats, Floats],
    chi2: Floats,
) -> None:
    """Predict and update over a record of k epochs.

    The first measurement belongs to the start; before each of the others there is one prediction.  Matrices that are
    the same for all epochs come once, with a first axis of length one.

    Parameters
    ----------
    start : tuple of ndarray, shape (n,), (n, n)
        State and covariance.
    Phi, Q : ndarray, shape (k - 1 or 1, n, n)
    z : ndarray, shape (k, m)
        NaN where not measured.
    H : ndarray, shape (k or 1, m, n)
    r : ndarray, shape (k or 1, m)
    gate : float
    pattern : Pattern
        Of `common_pattern`.
    prior, after : tuple of ndarray, shape (k, n), (k or 1, n, n)
        States and covariances before and after each update; overwritten.  With one covariance the last one stays:
        writing all of them into fresh memory takes longer than the filter.
    chi2 : ndarray, shape (k, m)
        What `update_scalar` returns; overwritten.
    """
    x_prior, P_prior = prior
    x_after, P_after = after
    steps, m = z.shape
    n, kept = start[0].shape[0], P_after.shape[0] - 1
    room, residual, dx = room_for(n), np.empty(m), np.empty(n)
    for k in range(steps):
        x, P, updated = x_prior[k], P_prior[min(k, kept)], P_after[min(k, kept)]
        if k == 0:
            x[:], P[:] = start[0], start[1]
        else:
            before = min(k - 1, kept)
            transition, noise = Phi[min(k, Phi.shape[0]) - 1], Q[min(k, Q.shape[0]) - 1]
            propagate_state(x_after[k - 1], transition, pattern, x)
            propagate_into(P_after[before], transition, noise, P, pattern, room)
        rows = H[min(k, H.shape[0] - 1)]
        for i in range(m):
            residual[i] = z[k, i]
            for j in range(n):
                if rows[i, j] != 0.0:
                    residual[i] -= rows[i, j] * x[j]
        for i in range(n):
            dx[i] = 0.0
            for j in range(n):
                updated[i, j] = P[i, j]
        update_sequential(dx, updated, residual, rows, r[min(k, r.shape[0] - 1)], gate, chi2[k], room)
        for j in range(n):
            x_after[k, j] = x[j] + dx[j]


@kernel
def symmetrise(P: Floats) -> None:
    """Make both halves of `P` equal: rounding differs between them, and over hours would tear them apart.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Overwritten.
    """
    for i in range(P.shape[0]):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])


@kernel
def smooth_backwards(x_prior: Floats, P_prior: Floats, x: Floats, P: Floats, Phi: Floats) -> None:
    """Rauch-Tung-Striebel smoother in place: `x` (k, n) and `P` (k, n, n) go in filtered and come out smoothed.

    ``C = P Phi' P_prior^-1`` needs invertible predicted covariances.

    Parameters
    ----------
    x_prior : ndarray, shape (k, n)
        Predicted states; the first is not used.
    P_prior : ndarray, shape (k, n, n)
        Their covariances.
    x : ndarray, shape (k, n)
        Filtered states; overwritten.
    P : ndarray, shape (k, n, n)
        Their covariances; overwritten.
    Phi : ndarray, shape (k - 1, n, n)
        Transition from each epoch to the next.
    """
    for k in range(x.shape[0] - 2, -1, -1):
        C = np.linalg.solve(P_prior[k + 1], Phi[k] @ P[k]).T.copy()
        x[k] += C @ (x[k + 1] - x_prior[k + 1])
        P[k] += C @ (P[k + 1] - P_prior[k + 1]) @ C.T
        symmetrise(P[k])
