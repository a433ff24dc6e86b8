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

from nav_core.mounting.planes import (
    PITCH_CURVED,
    PITCH_STATES,
    Sizes,
    carried,
    padded,
    seen,
    taken_in,
    transitions,
)
from nav_core.typing import Floats, Integers, kernel


class Channel(NamedTuple):
    """A linear system whose inputs and measurements depend linearly on the unknowns.

    With `n` states, `d` driven states, `k` scalar measurements, ``c = 1 + unknowns`` and `N` steps;
    column 0 is the value at ``p = 0``, column `j` the derivative with respect to unknown `j`.
    The number of states says which plane it is, and so what `carry` means.
    """

    x0: Floats
    """Initial state, shape (n,)."""
    P0: Floats
    """Its covariance, shape (n, n)."""
    carry: Floats
    """Coefficients of the transition into each step, see `planes`, shape (K, N)."""
    Q: Floats
    """Process noise: variances, and the covariance of slope and curvature if there are any, shape (n or n + 1, N)."""
    driven: Integers
    """States that have an input, shape (d,)."""
    U: Floats
    """Inputs, shape (N, d, c)."""
    grain: Floats
    """Variance of sensor noise in the inputs, part of Q, shape (N, d)."""
    observed: Integers
    """Each measurement is of one state and a share of another: which two, shape (k, 2)."""
    share: Floats
    """Of the other, shape (k, N)."""
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


@kernel
def _whiten(
    x0: Sizes,
    P0: Floats,
    carry: Floats,
    Q: Floats,
    driven: Integers,
    U: Floats,
    observed: Integers,
    share: Floats,
    Y: Floats,
    r: Floats,
    period: Floats,
    block: Integers,
    weights: Sizes,
    limit: float,
    restart: bool,
    E: Floats,
    number: Floats,
    log_det: Floats,
) -> None:
    n, c, p = len(x0), len(weights), padded(len(x0))
    w = p + padded(c)
    z, t, gain = np.zeros(n * w), np.zeros(w), np.zeros(n)
    for i in range(U.shape[0]):
        if i == 0 or (restart and block[i] != block[i - 1]):
            z[:] = 0.0
            for a in range(n):
                z[a * w + p] = x0[a]
                for b in range(n):
                    z[a * w + b] = P0[a, b]
        carried(z, x0, weights, carry, i, Q)
        for d in range(driven.size):
            for j in range(c):
                z[driven[d] * w + p + j] += U[i, d, j]
        for m in range(observed.shape[0]):
            if np.isfinite(r[i, m]):
                variance = seen(z, x0, weights, observed[m], share[m, i], r[i, m], t)
                variance = _judged(t, p, Y[i, m], period[m], weights, variance, limit)
                taken_in(z, x0, weights, t, variance, gain)
                whole = 1.0 / np.sqrt(variance)
                for j in range(c):
                    E[m, i, j] = whole * t[p + j]
                number[block[i], m] += 1.0
                log_det[block[i], m] += np.log(variance)


@kernel
def _judged(t: Floats, p: int, y: Floats, period: float, weights: Sizes, variance: float, limit: float) -> float:
    """Take what was measured from the prediction in `t`; gives the variance, larger for an outlier."""
    residual = 0.0
    for j in range(len(weights)):
        t[p + j] -= y[j]
        residual += t[p + j] * weights[j]
    if period > 0.0:
        turns = period * np.round(residual / period)
        t[p] -= turns
        residual -= turns
    if residual * residual > limit * limit * variance:
        variance *= np.abs(residual) / np.sqrt(variance) / limit  # Huber: an outlier pulls like one at the limit
    return variance


@kernel
def _multiplied(E: Floats, block: Integers, gram: Floats) -> None:
    """Add the products of whitened innovations to those of their stretches; steps of one stretch follow one another."""
    begin = 0
    while begin < block.size:
        end = begin
        while end < block.size and block[end] == block[begin]:
            end += 1
        for m in range(E.shape[0]):
            part = E[m, begin:end]
            gram[block[begin], m] += np.dot(part.T, part)
        begin = end


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
    E = np.zeros((k, block.size, c))
    whole = np.ascontiguousarray  # one compiled form for every layout
    _whiten(
        tuple(channel.x0.tolist()),
        whole(channel.P0),
        whole(channel.carry),
        whole(channel.Q),
        whole(channel.driven),
        whole(channel.U),
        whole(channel.observed),
        whole(channel.share),
        whole(channel.Y),
        whole(channel.r),
        whole(channel.period),
        block,
        (1.0, *p[channel.unknowns].tolist()),
        float(limit),
        restart,
        E,
        number,
        log_det,
    )
    _multiplied(E, block, gram)
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

    def there(values: Floats) -> Floats:
        return (values.reshape(-1, weights.size) @ weights).reshape(
            *values.shape[:-1], 1
        )  # one product, not a step each

    return channel._replace(U=there(channel.U), Y=there(channel.Y), unknowns=nothing)


def process_noise(channel: Channel) -> Floats:
    """Matrices of a channel's process noise, as the reference and the tests need them.

    Parameters
    ----------
    channel : Channel

    Returns
    -------
    ndarray, shape (N, n, n)
    """
    n = channel.x0.size
    out = np.zeros((channel.Q.shape[1], n, n))
    out[:, np.arange(n), np.arange(n)] = channel.Q[:n].T
    if n == PITCH_STATES:
        a, b = PITCH_CURVED
        out[:, a, b] = out[:, b, a] = channel.Q[n]
    return out


def measurements(channel: Channel) -> Floats:
    """Measurement rows of a channel, as the reference and the tests need them.

    Parameters
    ----------
    channel : Channel

    Returns
    -------
    ndarray, shape (N, k, n)
    """
    out = np.zeros((channel.share.shape[1], len(channel.observed), channel.x0.size))
    for m, (a, b) in enumerate(channel.observed.tolist()):
        out[:, m, a], out[:, m, b] = 1.0, channel.share[m]
    return out


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
    states = channel.x0.size
    Phi, Q, H = transitions(channel.carry, states), process_noise(channel), measurements(channel)
    state = np.zeros((states, c))
    state[:, 0] = channel.x0
    covariance = channel.P0
    weights = np.concatenate([[1.0], p[channel.unknowns]])
    for i in range(block.size):
        state = Phi[i] @ state
        state[channel.driven] += channel.U[i]
        covariance = Phi[i] @ covariance @ Phi[i].T + Q[i]
        for m in np.flatnonzero(np.isfinite(channel.r[i])):
            h = H[i, m]
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
