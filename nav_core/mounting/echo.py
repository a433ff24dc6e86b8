"""What the noise of the accelerometer passes for when its readings stand in the derivatives."""

from __future__ import annotations

import numpy as np

from nav_core.mounting.planes import Sizes, carried, carried_back, padded, seen, taken_in
from nav_core.mounting.whitening import Channel
from nav_core.typing import Floats, Integers, kernel


@kernel
def _echo(
    x0: Sizes,
    P0: Floats,
    carry: Floats,
    Q: Floats,
    observed: Integers,
    share: Floats,
    r: Floats,
    told: Floats,
) -> None:
    """Set `told` to what the later innovations tell of an impulse in each state after each step.

    Forwards the filter, which keeps its gains; backwards the information that is still to come.
    """
    n, p, k, steps = len(x0), padded(len(x0)), observed.shape[0], carry.shape[1]
    z, t = np.zeros(n * p), np.zeros(p)
    gains, variances = np.zeros((steps, k, n)), np.zeros((steps, k))
    for a in range(n):
        for b in range(n):
            z[a * p + b] = P0[a, b]
    for i in range(steps):
        carried(z, x0, (), carry, i, Q)
        for m in range(k):
            if np.isfinite(r[i, m]):
                variances[i, m] = seen(z, x0, (), observed[m], share[m, i], r[i, m], t)
                taken_in(z, x0, (), t, variances[i, m], gains[i, m])
    z[:] = 0.0
    for i in range(steps - 1, -1, -1):
        for m in range(k - 1, -1, -1):
            if np.isfinite(r[i, m]):
                _given_back(z, x0, observed[m], share[m, i], variances[i, m], gains[i, m], t)
        for a in range(n):
            told[i, a] = z[a * p + a]
        carried_back(z, x0, carry, i)


@kernel
def _given_back(z: Floats, x0: Sizes, rows: Integers, share: float, variance: float, gain: Floats, Mk: Floats) -> None:
    """``M <- (I - k h')' M (I - k h') + h h' / s`` in place."""
    n, p = len(x0), padded(len(x0))
    for j in range(p):
        Mk[j] = 0.0
    for b in range(n):
        for j in range(p):
            Mk[j] += gain[b] * z[b * p + j]
    told = 1.0 / variance
    for b in range(n):
        told += gain[b] * Mk[b]
    for a, h in ((rows[0], 1.0), (rows[1], share)):
        for j in range(n):
            z[a * p + j] -= h * Mk[j]
            z[j * p + a] -= h * Mk[j]
    first, other = rows[0], rows[1]
    z[first * p + first] += told
    z[first * p + other] += told * share
    z[other * p + first] += told * share
    z[other * p + other] += told * share * share


def echo(channel: Channel) -> Floats:
    """What sensor noise in the inputs would pass for in the derivatives.

    The derivative with respect to a turn is specific force about another axis, and as noisy as that.
    Noise raises the sums of products of the whitened derivatives as signal does; this much of them
    is not information.

    Parameters
    ----------
    channel : Channel

    Returns
    -------
    ndarray, shape (d,)
        Expected sum of squares of the whitened innovations that the noise of each driven state causes.
    """
    P0, carry, Q, share, r = map(np.ascontiguousarray, (channel.P0, channel.carry, channel.Q, channel.share, channel.r))
    told = np.empty((carry.shape[1], channel.x0.size))
    _echo(tuple(channel.x0.tolist()), P0, carry, Q, channel.observed, share, r, told)
    return np.asarray((channel.grain * told[:, channel.driven]).sum(axis=0), dtype=np.float64)
