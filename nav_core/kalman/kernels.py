"""Kalman steps on plain arrays, compiled: they work in place and can be called from other kernels.

Measurements are folded in one after the other; with independent noise that is the joint update of 000 eqs. 3.3.21,
3.3.22 without an inverse.  `correlated` measurements are made independent first (`linear.decorrelated`).

The matrices are small: what costs is each number touched, each array made and each page of memory written for the
first time.  So zeros are skipped, of a covariance the upper triangle is worked on alone and mirrored at the end of a
step, and steps take their room from the caller (`room_for`).
"""

from __future__ import annotations

import numpy as np

from nav_core.typing import Floats, kernel


@kernel
def room_for(n: int) -> Floats:
    """Working room of the steps of a filter with `n` states.

    Parameters
    ----------
    n : int
        States.

    Returns
    -------
    ndarray, shape (n + 3, n)
        Uninitialised.
    """
    return np.empty((n + 3, n))


@kernel
def mirror(P: Floats) -> None:
    """Write the upper triangle of `P` below its diagonal: what is worked on in one half alone is exactly symmetric.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Overwritten below the diagonal.
    """
    for i in range(P.shape[0]):
        for j in range(i):
            P[i, j] = P[j, i]


@kernel
def turned_product(P: Floats, Phi: Floats, room: Floats) -> None:
    """Set the first n rows of `room` to ``P Phi'`` of a symmetric `P`.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance.
    Phi : ndarray, shape (n, n)
        Transition over the step; its zeros off the diagonal cost nothing.
    room : ndarray, shape (n + 3, n)
        Of `room_for`; overwritten.
    """
    n = P.shape[0]
    column = room[n]
    for i in range(n):
        own = Phi[i, i]
        for j in range(n):
            column[j] = own * P[i, j]
        for k in range(n):
            factor = Phi[i, k]
            if factor != 0.0 and k != i:
                for j in range(n):
                    column[j] += factor * P[k, j]
        for j in range(n):
            room[j, i] = column[j]


@kernel
def propagate_into(P: Floats, Phi: Floats, Q: Floats, out: Floats, room: Floats) -> None:
    """Set `out`, which may be `P` itself, to ``Phi P Phi' + Q``, exactly symmetric (000 eq. 3.6.25).

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance.
    Phi : ndarray, shape (n, n)
        Transition over the step; its zeros off the diagonal cost nothing.
    Q : ndarray, shape (n, n)
        Noise of the step, symmetric.
    out : ndarray, shape (n, n)
        Overwritten.
    room : ndarray, shape (n + 3, n)
        Of `room_for`; overwritten.
    """
    n = P.shape[0]
    turned_product(P, Phi, room)
    for i in range(n):
        own, row = Phi[i, i], out[i]
        for j in range(i, n):
            row[j] = Q[i, j] + own * room[i, j]
        for k in range(n):
            factor = Phi[i, k]
            if factor != 0.0 and k != i:
                for j in range(i, n):
                    row[j] += factor * room[k, j]
    mirror(out)


@kernel
def propagate_state(x: Floats, Phi: Floats, out: Floats) -> None:
    """Set `out`, another array, to ``Phi x`` (000 eq. 3.6.21).

    Parameters
    ----------
    x : ndarray, shape (n,)
        State.
    Phi : ndarray, shape (n, n)
        Transition over the step.
    out : ndarray, shape (n,)
        Overwritten.
    """
    n = x.shape[0]
    for i in range(n):
        total = 0.0
        for j in range(n):
            # Adding up one by one is slow, and most are zeros.
            if Phi[i, j] != 0.0:
                total += Phi[i, j] * x[j]
        out[i] = total


@kernel
def project(P: Floats, h: Floats, Ph: Floats) -> None:
    """Set `Ph` to ``P h``; of `P` the upper triangle is read, and zeros of `h`, of which it mostly consists, are not.

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
            for i in range(j):
                Ph[i] += P[i, j] * factor
            for i in range(j, n):
                Ph[i] += P[j, i] * factor


@kernel
def joseph(P: Floats, Ph: Floats, h: Floats, r: float, gain: Floats, rest: Floats) -> None:
    """`joseph_scalar` of a known ``P h``, in the upper triangle of `P` alone; `rest` is room for n numbers.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance; its upper triangle is read and overwritten.
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
        factor, spread = h[j], Ph[j]
        if factor != 0.0:
            # ``(I - k h') P h`` entry by entry: as ``P h - k (h' P h)``, the difference of large numbers would lose its
            # digits.
            for i in range(j):
                rest[i] -= (P[i, j] - gain[i] * spread) * factor
            for i in range(j, n):
                rest[i] -= (P[j, i] - gain[i] * spread) * factor
    for i in range(n):
        # What stays the same in a row has a name: the compiler cannot know that writing `P` does not change it.
        in_row, left, row = gain[i], rest[i], P[i]
        for j in range(i, n):
            row[j] = (row[j] - in_row * Ph[j]) + left * gain[j]


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
    room = room_for(P.shape[0])
    project(P, h, room[0])
    joseph(P, room[0], h, r, gain, room[1])
    mirror(P)


@kernel
def fold(dx: Floats, P: Floats, residual: float, h: Floats, r: float, gate: float, room: Floats) -> float:
    """`update_scalar` in the upper triangle of `P` alone.

    Parameters
    ----------
    dx : ndarray, shape (n,)
        Correction so far; changed.
    P : ndarray, shape (n, n)
        Covariance; its upper triangle is read and changed.
    residual : float
        Measurement minus its prediction, both before any correction.
    h : ndarray, shape (n,)
        Measurement row.
    r : float
        Variance of the measurement's noise.
    gate : float
        On the squared normalised innovation.
    room : ndarray, shape (n + 3, n)
        Of `room_for`; overwritten.

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
    chi2 = fold(dx, P, residual, h, r, gate, room_for(dx.shape[0]))
    mirror(P)
    return chi2


@kernel
def update_sequential(
    dx: Floats, P: Floats, residual: Floats, H: Floats, r: Floats, gate: float, chi2: Floats, room: Floats
) -> int:
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
    room : ndarray, shape (n + 3, n)
        Of `room_for`; overwritten.

    Returns
    -------
    int
        How many were used.
    """
    used = 0
    for i in range(residual.shape[0]):
        if np.isnan(residual[i]):
            chi2[i] = np.nan
            continue
        chi2[i] = fold(dx, P, residual[i], H[i], r[i], gate, room)
        if chi2[i] >= 0.0:
            used += 1
    mirror(P)
    return used
