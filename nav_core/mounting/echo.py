"""What the noise of the accelerometer passes for when its readings stand in the derivatives."""

from __future__ import annotations

import numpy as np

from nav_core.mounting.whitening import Channel, Sizes, predict
from nav_core.typing import Floats, kernel


@kernel
def _echo(  # noqa: C901, PLR0912  unrolled products that skip zeros
    x0: Sizes, P0: Floats, Phi: Floats, Q: Floats, H: Floats, r: Floats, seen: Floats
) -> None:
    """Set `seen` to what the later innovations tell of an impulse in each state after each step.

    Forwards the filter, which keeps its gains; backwards the information that is still to come.
    """
    steps, k, n = Phi.shape[0], H.shape[1], len(x0)
    X, P, half = np.zeros((n, 0)), P0.copy(), np.zeros((n, n))
    gains, variances = np.zeros((steps, k, n)), np.zeros((steps, k))
    for i in range(steps):
        predict(Phi[i], Q[i], X, P, X, half, x0, ())
        for m in range(k):
            if np.isfinite(r[i, m]):
                h, gain, s = H[i, m], gains[i, m], r[i, m]
                for b in range(n):
                    if h[b] != 0.0:
                        for a in range(n):
                            gain[a] += P[a, b] * h[b]
                for a in range(n):
                    s += h[a] * gain[a]
                for a in range(n):
                    for b in range(n):
                        P[a, b] -= gain[a] / s * gain[b]
                for a in range(n):
                    gain[a] /= s
                variances[i, m] = s
    M, Mk, nothing = np.zeros((n, n)), np.zeros(n), np.zeros((n, n))
    for i in range(steps - 1, -1, -1):
        for m in range(k - 1, -1, -1):
            if np.isfinite(r[i, m]):
                # M <- (I - k h')' M (I - k h') + h h' / s
                h, gain, told = H[i, m], gains[i, m], 1.0 / variances[i, m]
                for a in range(n):
                    Mk[a] = 0.0
                    for b in range(n):
                        Mk[a] += M[a, b] * gain[b]
                    told += gain[a] * Mk[a]
                for a in range(n):
                    if h[a] != 0.0:
                        for b in range(n):
                            M[a, b] -= h[a] * Mk[b]
                            M[b, a] -= h[a] * Mk[b]
                        for b in range(n):
                            M[a, b] += told * h[a] * h[b]
        for a in range(n):
            seen[i, a] = M[a, a]
        predict(Phi[i].T, nothing, X, M, X, half, x0, ())  # information goes back as covariance goes on


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
    P0, Phi, Q, H, r = map(np.ascontiguousarray, (channel.P0, channel.Phi, channel.Q, channel.H, channel.r))
    seen = np.empty(Phi.shape[:2])
    _echo(tuple(channel.x0.tolist()), P0, Phi, Q, H, r, seen)
    return np.asarray((channel.grain * seen[:, channel.driven]).sum(axis=0), dtype=np.float64)
