"""Kalman steps on plain arrays, compiled: they work in place and can be called from other kernels.

Measurements are folded in one after the other; with independent noise that is the joint update of 000 eqs. 3.3.21,
3.3.22 without an inverse.  `correlated` measurements are made independent first (`linear.decorrelated`).

The matrices are small: what costs is each number touched, each array made and each page of memory written for the
first time.  So the zeros of a transition matrix are known beforehand (`pattern_of`), steps take their room from the
caller (`room_for`), and whole rows are worked on, of symmetric matrices too: half rows are too short for vector
registers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.typing import Floats, Integers, kernel


class Room(NamedTuple):
    """What the steps of a filter write to and forget.

    Attributes
    ----------
    product : ndarray, shape (n, n)
    row, spread, gain, rest : ndarray, shape (n,)
    """

    product: Floats
    row: Floats
    spread: Floats
    gain: Floats
    rest: Floats


@kernel
def room_for(n: int) -> Room:
    """Room for the steps of a filter with `n` states.

    Parameters
    ----------
    n : int
        States.

    Returns
    -------
    Room
        Uninitialised.
    """
    return Room(np.empty((n, n)), np.empty(n), np.empty(n), np.empty(n), np.empty(n))


@kernel
def mirror(P: Floats) -> None:
    """Write the upper triangle of `P` below its diagonal: rounding tears the two apart.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Overwritten below the diagonal.
    """
    for i in range(P.shape[0]):
        for j in range(i):
            P[i, j] = P[j, i]


class Pattern(NamedTuple):
    """Where a transition matrix can differ from zero off its diagonal.

    Attributes
    ----------
    columns : ndarray of int64, shape (c,)
        Row by row.
    begins : ndarray of int64, shape (n + 1,)
        Of each row in `columns`, and their end.
    """

    columns: Integers
    begins: Integers


@kernel
def pattern_of(Phi: Floats) -> Pattern:
    """Pattern of a matrix.

    Parameters
    ----------
    Phi : ndarray, shape (n, n)
        Not zero wherever one of the transition matrices is not.

    Returns
    -------
    Pattern
    """
    n = Phi.shape[0]
    columns, begins, count = np.empty(n * n, dtype=np.int64), np.zeros(n + 1, dtype=np.int64), 0
    for i in range(n):
        for j in range(n):
            if i != j and Phi[i, j] != 0.0:
                columns[count] = j
                count += 1
        begins[i + 1] = count
    return Pattern(columns[:count].copy(), begins)


@kernel
def turned_product(P: Floats, Phi: Floats, pattern: Pattern, room: Room) -> None:
    """Set the product in `room` to ``P Phi'`` of a symmetric `P`.

    Two rows are added at a time, for the sum is loaded and stored anew each time.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance.
    Phi : ndarray, shape (n, n)
        Transition over the step.
    pattern : Pattern
        Of `Phi`.
    room : Room
        Of `room_for`; overwritten.
    """
    n = P.shape[0]
    columns, begins, column, product = pattern.columns, pattern.begins, room.row, room.product
    for i in range(n):
        own, first, end = Phi[i, i], begins[i], begins[i + 1]
        if (end - first) % 2 == 1:
            k = columns[first]
            factor = Phi[i, k]
            for j in range(n):
                column[j] = own * P[i, j] + factor * P[k, j]
            first += 1
        else:
            for j in range(n):
                column[j] = own * P[i, j]
        for c in range(first, end, 2):
            k, m = columns[c], columns[c + 1]
            factor, other = Phi[i, k], Phi[i, m]
            for j in range(n):
                column[j] += factor * P[k, j] + other * P[m, j]
        for j in range(n):
            product[j, i] = column[j]


@kernel
def propagate_into(P: Floats, Phi: Floats, Q: Floats, out: Floats, pattern: Pattern, room: Room) -> None:
    """Set `out`, which may be `P` itself, to ``Phi P Phi' + Q`` (000 eq. 3.6.25), symmetric but for rounding.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance.
    Phi : ndarray, shape (n, n)
        Transition over the step.
    Q : ndarray, shape (n, n)
        Noise of the step, symmetric.
    out : ndarray, shape (n, n)
        Overwritten.
    pattern : Pattern
        Of `Phi`.
    room : Room
        Of `room_for`; overwritten.
    """
    n = P.shape[0]
    columns, begins, product = pattern.columns, pattern.begins, room.product
    turned_product(P, Phi, pattern, room)
    for i in range(n):
        own, first, end, row = Phi[i, i], begins[i], begins[i + 1], out[i]
        if (end - first) % 2 == 1:
            k = columns[first]
            factor = Phi[i, k]
            for j in range(n):
                row[j] = Q[i, j] + own * product[i, j] + factor * product[k, j]
            first += 1
        else:
            for j in range(n):
                row[j] = Q[i, j] + own * product[i, j]
        for c in range(first, end, 2):
            k, m = columns[c], columns[c + 1]
            factor, other = Phi[i, k], Phi[i, m]
            for j in range(n):
                row[j] += factor * product[k, j] + other * product[m, j]


@kernel
def propagate_state(x: Floats, Phi: Floats, pattern: Pattern, out: Floats) -> None:
    """Set `out`, another array, to ``Phi x`` (000 eq. 3.6.21).

    Parameters
    ----------
    x : ndarray, shape (n,)
        State.
    Phi : ndarray, shape (n, n)
        Transition over the step.
    pattern : Pattern
        Of `Phi`.
    out : ndarray, shape (n,)
        Overwritten.
    """
    for i in range(x.shape[0]):
        total = Phi[i, i] * x[i]
        for c in range(pattern.begins[i], pattern.begins[i + 1]):
            k = pattern.columns[c]
            total += Phi[i, k] * x[k]
        out[i] = total


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
        factor, spread = h[j], Ph[j]
        if factor != 0.0:
            # ``(I - k h') P h`` entry by entry: as ``P h - k (h' P h)``, the difference of large numbers would lose its
            # digits.
            for i in range(n):
                rest[i] -= (P[j, i] - gain[i] * spread) * factor
    for i in range(n):
        # What stays the same in a row has a name: the compiler cannot know that writing `P` does not change it.
        in_row, left, row = gain[i], rest[i], P[i]
        for j in range(n):
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
    project(P, h, room.spread)
    joseph(P, room.spread, h, r, gain, room.rest)
    mirror(P)


@kernel
def fold(dx: Floats, P: Floats, residual: float, h: Floats, r: float, gate: float, room: Room) -> float:
    """`update_scalar` without making `P` exactly symmetric.

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
    room : Room
        Of `room_for`; overwritten.

    Returns
    -------
    float
        As `update_scalar`.
    """
    n = dx.shape[0]
    Ph, gain = room.spread, room.gain
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
    joseph(P, Ph, h, r, gain, room.rest)
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
    dx: Floats, P: Floats, residual: Floats, H: Floats, r: Floats, gate: float, chi2: Floats, room: Room
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
    room : Room
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
