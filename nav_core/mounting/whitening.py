"""Least squares with coloured noise: a Kalman filter as the whitener.

The unknowns `p` (mounting, biases, gains, lags) enter the motion of a car linearly, the road and
the receiver add coloured noise.  One filter pass over the *sensitivities* to `p`, beside the state
itself, leaves innovations ``e0 - E p`` that are white; their sums of products hold all that the
recording says about `p`.  The sums of different stretches add up, which is what the split-half
test, the search for a moved box and the history of convergence live on.

References
----------
P. de Jong, "The diffuse Kalman filter", Annals of Statistics 19 (1991).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.typing import Floats, Integers, kernel


class Channel(NamedTuple):
    """A linear system whose inputs and measurements depend linearly on the unknowns.

    With `n` states, `d` driven states, `k` scalar measurements, ``c = 1 + unknowns`` and `N` steps;
    column 0 is the value at ``p = 0``, column `j` the derivative with respect to unknown `j`.
    """

    x0: Floats
    """Initial state, shape (n,)."""
    P0: Floats
    """Its covariance, shape (n, n)."""
    Phi: Floats
    """Transition into each step, shape (N, n, n)."""
    Q: Floats
    """Process noise, shape (N, n, n)."""
    driven: Integers
    """States that have an input, shape (d,)."""
    U: Floats
    """Inputs, shape (N, d, c)."""
    H: Floats
    """Measurement rows, shape (N, k, n)."""
    Y: Floats
    """Column 0: measured value; column j: derivative of ``-prediction``, without the state's; (N, k, c)."""
    r: Floats
    """Measurement variance, NaN where there is none, shape (N, k)."""
    period: Floats
    """Period of each measurement (2 pi for an angle), 0 for none, shape (k,)."""
    unknowns: Integers
    """Places in `p` of the c - 1 unknowns that act here."""


class Evidence(NamedTuple):
    """Sums of products of whitened innovations ``[e0, E]``, by stretch and kind of measurement."""

    gram: Floats
    """For all of `p`, shape (blocks, k, 1 + size of p, 1 + size of p)."""
    count: Floats
    """Measurements, shape (blocks, k)."""
    log_det: Floats
    """Sum of log innovation variances, shape (blocks, k)."""

    def misfit(self, p: Floats) -> Floats:
        """Sum of squared whitened innovations at `p`, shape (blocks, k)."""
        e = np.concatenate([[1.0], p])
        return self.gram @ e @ e


def _whiten(
    x0: Floats,
    P0: Floats,
    Phi: Floats,
    Q: Floats,
    driven: Integers,
    U: Floats,
    H: Floats,
    Y: Floats,
    r: Floats,
    period: Floats,
    block: Integers,
    p: Floats,
    limit: float,
    restart: bool,
    gram: Floats,
    count: Floats,
    log_det: Floats,
) -> None:
    steps, n = Phi.shape[0], Phi.shape[1]
    k, c = Y.shape[1], Y.shape[2]
    X, X1 = np.zeros((n, c)), np.zeros((n, c))
    P, M = np.zeros((n, n)), np.zeros((n, n))
    e, PH = np.zeros(c), np.zeros(n)
    for i in range(steps):
        if i == 0 or (restart and block[i] != block[i - 1]):
            for a in range(n):
                for j in range(c):
                    X[a, j] = 0.0
                X[a, 0] = x0[a]
                for b in range(n):
                    P[a, b] = P0[a, b]
        for a in range(n):
            for j in range(c):
                X1[a, j] = 0.0
            for j in range(n):
                M[a, j] = 0.0
        for a in range(n):
            for b in range(n):
                g = Phi[i, a, b]
                if g != 0.0:
                    for j in range(c):
                        X1[a, j] += g * X[b, j]
                    for j in range(n):
                        M[a, j] += g * P[b, j]
        for d in range(driven.size):
            for j in range(c):
                X1[driven[d], j] += U[i, d, j]
        for a in range(n):
            for j in range(c):
                X[a, j] = X1[a, j]
        for a in range(n):
            for b in range(n):
                P[a, b] = Q[i, a, b]
        for b in range(n):
            for l in range(n):
                g = Phi[i, b, l]
                if g != 0.0:
                    for a in range(n):
                        P[b, a] += M[a, l] * g  # symmetric: filled by rows
        for m in range(k):
            if not np.isfinite(r[i, m]):
                continue
            PH[:] = 0.0
            for j in range(c):
                e[j] = Y[i, m, j]
            for b in range(n):
                h = H[i, m, b]
                if h != 0.0:
                    for a in range(n):
                        PH[a] += P[b, a] * h
                    for j in range(c):
                        e[j] -= h * X[b, j]
            S = r[i, m]
            for a in range(n):
                S += H[i, m, a] * PH[a]
            residual = e[0]
            for j in range(1, c):
                # columns of e are derivatives of the innovation
                residual += e[j] * p[j - 1]
            if period[m] > 0.0:
                turns = period[m] * np.round(residual / period[m])
                e[0] -= turns
                residual -= turns
            size = np.abs(residual) / np.sqrt(S)
            if size > limit:
                S *= size / limit  # Huber: the pull of an outlier stays that of one at the limit
            for a in range(n):
                gain = PH[a] / S
                for j in range(c):
                    X[a, j] += gain * e[j]
            for a in range(n):
                gain = PH[a] / S
                for b in range(n):
                    P[a, b] -= gain * PH[b]
            z = block[i]
            for a in range(c):
                scaled = e[a] / S
                for j in range(a + 1):
                    gram[z, m, a, j] += scaled * e[j]
            count[z, m] += 1.0
            log_det[z, m] += np.log(S)


_whiten_fast = kernel(_whiten)


def whiten(
    channel: Channel,
    block: Integers,
    blocks: int,
    p: Floats,
    *,
    limit: float = np.inf,
    restart: bool = False,
    compiled: bool = True,
) -> Evidence:
    """Run the whitening filter over one channel.

    Parameters
    ----------
    channel : Channel
    block : ndarray of int, shape (N,)
        Which stretch each step belongs to.
    blocks : int
    p : ndarray
        Where all unknowns stand now; only the robust weights and the wrapping of angles use it.
    limit : float
        Innovations beyond this many sigmas are weighted down (Huber); infinite for none.
    restart : bool
        Begin every stretch anew from the initial state: stretches that know nothing of each other.
    compiled : bool
        False runs the same steps as plain Python, for tests.

    Returns
    -------
    Evidence
    """
    k, c = channel.Y.shape[1], channel.Y.shape[2]
    gram, count, log_det = np.zeros((blocks, k, c, c)), np.zeros((blocks, k)), np.zeros((blocks, k))
    run = _whiten_fast if compiled else _whiten
    arrays = [np.ascontiguousarray(array) for array in channel[:-1]]  # one compiled form for every layout
    run(*arrays, block, p[channel.unknowns], float(limit), restart, gram, count, log_det)
    gram += np.swapaxes(np.tril(gram, -1), -1, -2)
    place = np.concatenate([[0], 1 + channel.unknowns])
    everything = np.zeros((blocks, k, 1 + p.size, 1 + p.size))
    everything[:, :, place[:, None], place] = gram
    return Evidence(everything, count, log_det)
