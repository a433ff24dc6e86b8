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
    grain: Floats
    """Variance of sensor noise in the inputs, part of Q, shape (N, d)."""
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
    number: Floats
    """Of measurements, shape (blocks, k)."""
    log_det: Floats
    """Sum of log innovation variances, shape (blocks, k)."""

    def misfit(self, p: Floats) -> Floats:
        """Sum of squared whitened innovations at `p`, shape (blocks, k).

        Parameters
        ----------
        p : ndarray, shape (size of p,)
            The unknowns.

        Returns
        -------
        ndarray, shape (blocks, k)
            Chi squares.
        """
        e = np.concatenate([[1.0], p])
        return self.gram @ e @ e


Sizes = tuple[float, ...]
"""A vector as a tuple: its length is part of its type, so kernels are compiled for it and their loops unrolled."""


@kernel
def _lay(places: Integers, values: Floats, out: Floats) -> None:
    for i in range(out.shape[0]):
        for e in range(places.shape[0]):
            out[i, places[e, 0], places[e, 1]] = values[e, i]


def matrices(count: int, size: int, entries: dict[tuple[int, int], Floats | float]) -> Floats:
    """A matrix for each step, zero but for some entries; written step by step, as the filter reads it.

    Parameters
    ----------
    count, size : int
        Of steps; of rows and columns.
    entries : dict of (int, int) to ndarray, shape (count,), or float
        By row and column.

    Returns
    -------
    ndarray, shape (count, size, size)
    """
    out = np.zeros((count, size, size))
    values = np.empty((len(entries), count))
    for e, value in enumerate(entries.values()):
        values[e] = value
    _lay(np.array(list(entries)), values, out)
    return out


@kernel
def predict(  # noqa: C901, PLR0912  unrolled products that skip zeros
    Phi: Floats, Q: Floats, X: Floats, P: Floats, carried: Floats, half: Floats, x0: Sizes, weights: Sizes
) -> None:
    """``X <- Phi X``, ``P <- Phi P Phi' + Q`` in place; most of Phi is zero.

    Parameters
    ----------
    Phi, Q : ndarray, shape (n, n)
        Transition of a step and its noise.
    X : ndarray, shape (n, c)
        States, and what each column of the unknowns does to them.
    P : ndarray, shape (n, n)
        Covariance.
    carried : ndarray, shape (n, c)
        Room for the product with X.
    half : ndarray, shape (n, n)
        Room for that with P.
    x0 : tuple
        n of anything: its length is known when the kernel is compiled.
    weights : tuple
        c of anything.
    """
    n, c = len(x0), len(weights)
    for a in range(n):
        for j in range(c):
            carried[a, j] = 0.0
        for j in range(n):
            half[a, j] = 0.0
        for b in range(n):
            g = Phi[a, b]
            if g != 0.0:
                for j in range(c):
                    carried[a, j] += g * X[b, j]
                for j in range(n):
                    half[a, j] += g * P[b, j]
    for a in range(n):
        for j in range(c):
            X[a, j] = carried[a, j]
        for j in range(n):
            P[a, j] = Q[a, j]
    for b in range(n):
        for m in range(n):
            g = Phi[b, m]
            if g != 0.0:
                for a in range(n):
                    P[b, a] += half[a, m] * g  # symmetric: filled by rows


@kernel
def _correct(  # noqa: C901, PLR0912  unrolled products that skip zeros
    h: Floats,
    y: Floats,
    r: float,
    period: float,
    x0: Sizes,
    weights: Sizes,
    limit: float,
    X: Floats,
    P: Floats,
    e: Floats,
    Ph: Floats,
) -> float:
    """One scalar measurement: fills the innovation `e`, updates X and P, gives the variance used."""
    n, c = len(x0), len(weights)
    for a in range(n):
        Ph[a] = 0.0
    for j in range(c):
        e[j] = y[j]
    for b in range(n):
        g = h[b]
        if g != 0.0:
            for a in range(n):
                Ph[a] += P[b, a] * g
            for j in range(c):
                e[j] -= g * X[b, j]
    variance = r
    for a in range(n):
        variance += h[a] * Ph[a]
    residual = e[0]
    for j in range(1, c):
        residual += e[j] * weights[j]
    if period > 0.0:
        turns = period * np.round(residual / period)
        e[0] -= turns
        residual -= turns
    size = np.abs(residual) / np.sqrt(variance)
    if size > limit:
        variance *= size / limit  # Huber: the pull of an outlier stays that of one at the limit
    for a in range(n):
        gain = Ph[a] / variance
        for j in range(c):
            X[a, j] += gain * e[j]
        for b in range(n):
            P[a, b] -= gain * Ph[b]
    return variance


@kernel
def _whiten(
    x0: Sizes,
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
    weights: Sizes,
    limit: float,
    restart: bool,
    gram: Floats,
    number: Floats,
    log_det: Floats,
) -> None:
    steps, n, k, c = Phi.shape[0], len(x0), Y.shape[1], len(weights)
    X, carried = np.zeros((n, c)), np.zeros((n, c))
    P, half = np.zeros((n, n)), np.zeros((n, n))
    e, Ph = np.zeros(c), np.zeros(n)
    for i in range(steps):
        z = block[i]
        if i == 0 or (restart and z != block[i - 1]):
            X[:, :] = 0.0
            for a in range(n):
                X[a, 0] = x0[a]
            P[:, :] = P0
        predict(Phi[i], Q[i], X, P, carried, half, x0, weights)
        for d in range(driven.size):
            for j in range(c):
                X[driven[d], j] += U[i, d, j]
        for m in range(k):
            if np.isfinite(r[i, m]):
                variance = _correct(H[i, m], Y[i, m], r[i, m], period[m], x0, weights, limit, X, P, e, Ph)
                for a in range(c):
                    scaled = e[a] / variance
                    for j in range(a + 1):
                        gram[z, m, a, j] += scaled * e[j]
                number[z, m] += 1.0
                log_det[z, m] += np.log(variance)


def whiten(
    channel: Channel,
    block: Integers,
    blocks: int,
    p: Floats,
    *,
    limit: float = np.inf,
    restart: bool = False,
) -> Evidence:
    """Run the whitening filter over one channel.

    Parameters
    ----------
    channel : Channel
    block : ndarray of int, shape (N,)
        Which stretch each step belongs to.
    blocks : int
        How many.
    p : ndarray, shape (size of p,)
        Where all unknowns stand now; only the robust weights and the wrapping of angles use it.
    limit : float
        Innovations beyond this many sigmas are weighted down (Huber); infinite for none.
    restart : bool
        Begin every stretch anew from the initial state: stretches that know nothing of each other.

    Returns
    -------
    Evidence
    """
    k, c = channel.Y.shape[1], channel.Y.shape[2]
    gram, number, log_det = np.zeros((blocks, k, c, c)), np.zeros((blocks, k)), np.zeros((blocks, k))
    whole = np.ascontiguousarray  # one compiled form for every layout
    _whiten(
        tuple(channel.x0.tolist()),
        whole(channel.P0),
        whole(channel.Phi),
        whole(channel.Q),
        whole(channel.driven),
        whole(channel.U),
        whole(channel.H),
        whole(channel.Y),
        whole(channel.r),
        whole(channel.period),
        block,
        (1.0, *p[channel.unknowns].tolist()),
        float(limit),
        restart,
        gram,
        number,
        log_det,
    )
    gram += np.swapaxes(np.tril(gram, -1), -1, -2)
    return Evidence(_spread(gram, channel.unknowns, p.size), number, log_det)


def at_point(channel: Channel, p: Floats) -> Channel:
    """The channel with its unknowns fixed: what the recording says where all of them are known.

    Parameters
    ----------
    channel : Channel
    p : ndarray, shape (size of p,)
        All unknowns.

    Returns
    -------
    Channel
        Of no unknowns; its innovations are those of `channel` at `p`.
    """
    weights = np.concatenate([[1.0], p[channel.unknowns]])
    nothing = channel.unknowns[:0]
    return channel._replace(U=(channel.U @ weights)[..., None], Y=(channel.Y @ weights)[..., None], unknowns=nothing)


def whiten_reference(channel: Channel, block: Integers, blocks: int, p: Floats, *, limit: float = np.inf) -> Evidence:
    """What `whiten` computes, in plain array code.

    Parameters
    ----------
    channel : Channel
        The linear model of one plane, n fixes.
    block : ndarray of int, shape (n,)
        Stretch of each fix.
    blocks : int
        How many.
    p : ndarray, shape (size of p,)
        The unknowns.
    limit : float
        Sigmas beyond which an innovation is weighted down.

    Returns
    -------
    Evidence
        By stretch and kind.
    """
    k, c = channel.Y.shape[1], channel.Y.shape[2]
    gram, number, log_det = np.zeros((blocks, k, c, c)), np.zeros((blocks, k)), np.zeros((blocks, k))
    state = np.zeros((channel.x0.size, c))
    state[:, 0] = channel.x0
    covariance = channel.P0
    weights = np.concatenate([[1.0], p[channel.unknowns]])
    for i in range(block.size):
        state = channel.Phi[i] @ state
        state[channel.driven] += channel.U[i]
        covariance = channel.Phi[i] @ covariance @ channel.Phi[i].T + channel.Q[i]
        for m in np.flatnonzero(np.isfinite(channel.r[i])):
            h = channel.H[i, m]
            e = channel.Y[i, m] - h @ state
            if channel.period[m] > 0.0:
                e[0] -= channel.period[m] * np.round(e @ weights / channel.period[m])
            variance = h @ covariance @ h + channel.r[i, m]
            variance *= max(1.0, abs(e @ weights) / np.sqrt(variance) / limit)
            gain = covariance @ h / variance
            state = state + np.outer(gain, e)
            covariance = covariance - np.outer(gain, covariance @ h)
            gram[block[i], m] += np.outer(e, e) / variance
            number[block[i], m] += 1.0
            log_det[block[i], m] += np.log(variance)
    return Evidence(_spread(gram, channel.unknowns, p.size), number, log_det)


def _spread(gram: Floats, unknowns: Integers, size: int) -> Floats:
    """Products of the unknowns that act in a channel, at their places among all."""
    place = np.concatenate([[0], 1 + unknowns])
    everything = np.zeros((*gram.shape[:2], 1 + size, 1 + size))
    everything[:, :, place[:, None], place] = gram
    return everything
