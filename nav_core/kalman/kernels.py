"""Kalman steps on plain arrays, compiled: they work in place and can be called from other kernels.

Measurements are folded in one after the other; with independent noise that is the joint update of 000 eqs. 3.3.21,
3.3.22 without an inverse.  `correlated` measurements are made independent first (`linear.decorrelated`).
"""

from __future__ import annotations

import numpy as np

from nav_core.typing import Floats, kernel


@kernel
def sparse_product(A: Floats, B: Floats, out: Floats) -> None:
    """Add ``A B`` to `out`; zeros of `A`, of which a transition matrix mostly consists, cost nothing.

    Parameters
    ----------
    A, B : ndarray, shape (n, n)
        Of any matrices whose units fit.
    out : ndarray, shape (n, n)
        Added to.
    """
    n = A.shape[0]
    for i in range(n):
        for k in range(n):
            factor = A[i, k]
            if factor != 0.0:
                for j in range(n):
                    out[i, j] += factor * B[k, j]


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
def propagate_covariance(P: Floats, Phi: Floats, Q: Floats) -> None:
    """Replace `P` by ``Phi P Phi' + Q``, exactly symmetric (000 eq. 3.6.25).

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Overwritten.
    Phi : ndarray, shape (n, n)
        Transition over the step.
    Q : ndarray, shape (n, n)
        Noise of the step.
    """
    n = P.shape[0]
    half, turned = np.zeros((n, n)), np.empty((n, n))
    sparse_product(Phi, P, half)
    for i in range(n):
        for j in range(n):
            turned[j, i] = half[i, j]
            P[i, j] = Q[i, j]
    sparse_product(Phi, turned, P)
    symmetrise(P)


@kernel
def propagate_state(x: Floats, Phi: Floats) -> None:
    """Replace `x` by ``Phi x`` (000 eq. 3.6.21).

    Parameters
    ----------
    x : ndarray, shape (n,)
        Overwritten.
    Phi : ndarray, shape (n, n)
        Transition over the step.
    """
    n = x.shape[0]
    before = x.copy()
    for i in range(n):
        total = 0.0
        for j in range(n):
            # Adding up one by one is slow, and most are zeros.
            if Phi[i, j] != 0.0:
                total += Phi[i, j] * before[j]
        x[i] = total


@kernel
def project(P: Floats, h: Floats, Ph: Floats) -> None:
    """Set `Ph` to ``P h`` of a symmetric `P`; zeros of `h`, of which a measurement row mostly consists, cost nothing.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance.
    h : ndarray, shape (n,)
        Measurement row.
    Ph : ndarray, shape (n,)
        Covariance of the states with the measurement; overwritten.
    """
    n = P.shape[0]
    Ph[:] = 0.0
    for j in range(n):
        factor = h[j]
        if factor != 0.0:
            for i in range(n):
                Ph[i] += P[j, i] * factor


@kernel
def projected(P: Floats, h: Floats) -> Floats:
    """``P h`` of a symmetric `P`.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance.
    h : ndarray, shape (n,)
        Measurement row.

    Returns
    -------
    ndarray, shape (n,)
        Covariance of the states with the measurement.
    """
    Ph = np.empty(P.shape[0])
    project(P, h, Ph)
    return Ph


@kernel
def joseph(P: Floats, Ph: Floats, h: Floats, r: float, gain: Floats, rest: Floats) -> None:
    """`joseph_scalar` of a known ``P h``, without making `P` exactly symmetric; `rest` is room for n numbers.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance; overwritten.
    Ph : ndarray, shape (n,)
        Of `project`.
    h : ndarray, shape (n,)
        Measurement row.
    r : float
        Variance of the measurement's noise.
    gain : ndarray, shape (n,)
        k.
    rest : ndarray, shape (n,)
        Overwritten.
    """
    n = P.shape[0]
    for i in range(n):
        rest[i] = gain[i] * r
    for j in range(n):
        if h[j] != 0.0:
            # ``(I - k h') P h`` entry by entry: as ``P h - k (h' P h)``, the difference of large numbers would lose its
            # digits.
            for i in range(n):
                rest[i] -= (P[j, i] - gain[i] * Ph[j]) * h[j]
    for i in range(n):
        # What stays the same in a row has a name: the compiler cannot know that writing `P` does not change it.
        in_row, left = gain[i], rest[i]
        for j in range(n):
            P[i, j] = (P[i, j] - in_row * Ph[j]) + left * gain[j]


@kernel
def joseph_scalar(P: Floats, h: Floats, r: float, gain: Floats) -> None:
    """Replace `P` by ``(I - k h') P (I - k h')' + k r k'``, valid for any gain (000 eq. 3.11.24, one measurement).

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance; overwritten.
    h : ndarray, shape (n,)
        Measurement row.
    r : float
        Variance of the measurement's noise.
    gain : ndarray, shape (n,)
        k.
    """
    joseph(P, projected(P, h), h, r, gain, np.empty(P.shape[0]))
    symmetrise(P)


@kernel
def fold(dx: Floats, P: Floats, residual: float, h: Floats, r: float, gate: float, room: Floats) -> float:
    """`update_scalar` without making `P` exactly symmetric; `room` is for three times n numbers.

    Parameters
    ----------
    dx : ndarray, shape (n,)
        Correction so far; changed.
    P : ndarray, shape (n, n)
        Covariance; changed.
    residual : float
        Measurement minus its prediction, both before any correction.
    h : ndarray, shape (n,)
        Measurement row.
    r : float
        Variance of the measurement's noise.
    gate : float
        On the squared normalised innovation.
    room : ndarray, shape (3, n)
        Overwritten.

    Returns
    -------
    float
        As `update_scalar`.
    """
    n = dx.shape[0]
    Ph, gain = room[0], room[1]
    project(P, h, Ph)
    variance, innovation = r, residual
    for i in range(n):
        if h[i] != 0.0:
            variance += h[i] * Ph[i]
            innovation -= h[i] * dx[i]
    chi2 = innovation * innovation / variance
    if chi2 > gate:
        return -chi2
    for i in range(n):
        gain[i] = Ph[i] / variance
        dx[i] += gain[i] * innovation
    joseph(P, Ph, h, r, gain, room[2])
    return chi2


@kernel
def update_scalar(dx: Floats, P: Floats, residual: float, h: Floats, r: float, gate: float) -> float:
    """Fold one measurement into the correction `dx` and into `P`.

    Parameters
    ----------
    dx : ndarray, shape (n,)
        Correction so far; changed.
    P : ndarray, shape (n, n)
        Changed.
    residual : float
        Measurement minus its prediction, both before any correction.
    h : ndarray, shape (n,)
        Row of the measurement matrix.
    r : float
        Variance of the measurement's noise.
    gate : float
        The measurement is left out when its squared normalised innovation exceeds this; infinity takes all.

    Returns
    -------
    float
        Squared normalised innovation; with its sign turned when the measurement was left out.
    """
    chi2 = fold(dx, P, residual, h, r, gate, np.empty((3, dx.shape[0])))
    symmetrise(P)
    return chi2


@kernel
def update_sequential(dx: Floats, P: Floats, residual: Floats, H: Floats, r: Floats, gate: float, chi2: Floats) -> int:
    """Fold in measurements one after the other, linearised once; NaN residuals are skipped.

    Parameters
    ----------
    dx : ndarray, shape (n,)
        Zero at the start, the correction at the end.
    P : ndarray, shape (n, n)
        Changed.
    residual, r, chi2 : ndarray, shape (m,)
        Residuals; variances; receives what `update_scalar` returns, NaN where skipped.
    H : ndarray, shape (m, n)
    gate : float

    Returns
    -------
    int
        How many were used.
    """
    used = 0
    room = np.empty((3, dx.shape[0]))
    for i in range(residual.shape[0]):
        if np.isnan(residual[i]):
            chi2[i] = np.nan
            continue
        chi2[i] = fold(dx, P, residual[i], H[i], r[i], gate, room)
        if chi2[i] >= 0.0:
            used += 1
    symmetrise(P)
    return used


@kernel
def run_filter(
    x: Floats, P: Floats, Phi: Floats, Q: Floats, z: Floats, H: Floats, r: Floats, gate: float
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Predict and update over a record; `x` and `P` are the start and become the end.

    The first measurement belongs to the start; before each of the others there is one prediction.

    Parameters
    ----------
    x : ndarray, shape (n,)
    P : ndarray, shape (n, n)
    Phi, Q : ndarray, shape (k - 1, n, n)
    z : ndarray, shape (k, m)
        NaN where not measured.
    H : ndarray, shape (k, m, n)
    r : ndarray, shape (k, m)
    gate : float

    Returns
    -------
    tuple of ndarray
        State and covariance before the update (k, n), (k, n, n); after it; `update_scalar`'s returns (k, m).
    """
    steps, m = z.shape
    n = x.shape[0]
    x_prior, P_prior = np.empty((steps, n)), np.empty((steps, n, n))
    x_after, P_after = np.empty((steps, n)), np.empty((steps, n, n))
    chi2, residual, dx = np.empty((steps, m)), np.empty(m), np.empty(n)
    for k in range(steps):
        if k > 0:
            propagate_state(x, Phi[k - 1])
            propagate_covariance(P, Phi[k - 1], Q[k - 1])
        x_prior[k], P_prior[k] = x, P
        for i in range(m):
            residual[i] = z[k, i]
            for j in range(n):
                residual[i] -= H[k, i, j] * x[j]
        dx[:] = 0.0
        update_sequential(dx, P, residual, H[k], r[k], gate, chi2[k])
        for j in range(n):
            x[j] += dx[j]
        x_after[k], P_after[k] = x, P
    return x_prior, P_prior, x_after, P_after, chi2


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
