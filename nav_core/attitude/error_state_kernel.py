"""The error-state attitude filter of `error_state` step by step, compiled.

State errors are in the order `d_theta` about b, then `d_bias`.
"""

from __future__ import annotations

import numpy as np

from nav_core.attitude.kernels import Vector, cross, multiply, normalise, quaternion_of
from nav_core.typing import Floats, Integers, kernel

_SMALL = 1e-3


@kernel
def matrices(w: Vector, dt: float, N2: float, K2: float, exact: bool, Phi: Floats, Q: Floats) -> None:
    """Write transition and noise of a step into `Phi` and `Q` (`error_state.transition`, `error_state.process_noise`).

    Only what depends on the rate is written: `Phi` must come as the identity, `Q` as zeros.

    Parameters
    ----------
    w : tuple of 3 floats
        Angular rate of the step, rad/s, b axes.
    dt : float
        s.
    N2 : float
        Square of the gyro's white noise, (rad/s)²/Hz.
    K2 : float
        Square of its rate random walk, (rad/s²)²/Hz.
    exact : bool
        Closed forms (002 eqs. 7.23-7.28); else the approximation of first order.
    Phi, Q : ndarray, shape (6, 6)
        Attitude error (rad, b axes) and bias error (rad/s); overwritten.
    """
    x, y, z = w
    sine, cosine, third, fourth, fifth = 1.0, 0.0, 0.0, 0.0, 0.0
    square = (x * x + y * y + z * z) * dt * dt
    if exact:
        if square < _SMALL * _SMALL:
            sine, cosine = 1.0 - square / 6.0, 0.5 - square / 24.0
            third, fourth, fifth = 1.0 / 6.0 - square / 120.0, 1.0 / 24.0 - square / 720.0, 1.0 / 60.0 - square / 2520.0
        else:
            a = np.sqrt(square)
            s, c = np.sin(a), np.cos(a)
            sine, cosine, third = s / a, (1.0 - c) / square, (a - s) / (a * square)
            fourth = (0.5 * square + c - 1.0) / (square * square)
            fifth = (a * square / 3.0 + 2.0 * s - 2.0 * a) / (a * square * square)
    first, second = dt * sine, dt * dt * cosine
    cubed, bias = dt * dt * dt * third, K2 * dt
    for i in range(3):
        u = w[i]
        for j in range(3):
            # [w]x and its square, ``w w' - |w|² I``.
            W2 = u * w[j] - (x * x + y * y + z * z if i == j else 0.0)
            # Negative where (i, j) is one step of the cycle x, y, z, positive where two.
            step = (j - i) % 3
            cross_ij = 0.0 if step == 0 else (-w[3 - i - j] if step == 1 else w[3 - i - j])
            unit = 1.0 if i == j else 0.0
            Phi[i, j] = unit - first * cross_ij + second * W2
            Phi[i, 3 + j] = -dt * unit + second * cross_ij - cubed * W2
            Q[i, j] = (N2 * dt + bias * dt * dt / 3.0) * unit + bias * dt**4 * fifth * W2
            Q[i, 3 + j] = bias * (-0.5 * dt * unit + dt * dt * third * cross_ij - dt**3 * fourth * W2)
            Q[3 + j, i] = Q[i, 3 + j]
            Q[3 + i, 3 + j] = bias * unit


@kernel
def propagate(P: Floats, Phi: Floats, Q: Floats, half: Floats) -> None:
    """Replace `P` by ``Phi P Phi' + Q`` where the lower half of `Phi` is ``[0 I]``; `half` (3, 6) is scratch.

    Parameters
    ----------
    P, Phi, Q : ndarray, shape (6, 6)
        Of `matrices`; `P` is overwritten.
    half : ndarray, shape (3, 6)
        Overwritten.
    """
    for i in range(3):
        for j in range(6):
            total = 0.0
            for k in range(6):
                total += Phi[i, k] * P[k, j]
            half[i, j] = total
    for i in range(3):
        for j in range(i + 1):
            total = Q[i, j]
            for k in range(6):
                total += half[i, k] * Phi[j, k]
            P[i, j] = P[j, i] = total
        for j in range(3, 6):
            P[i, j] = P[j, i] = half[i, j] + Q[i, j]
        P[3 + i, 3 + i] += Q[3 + i, 3 + i]


@kernel
def into_body(q: Floats, v: Floats) -> Vector:
    """``R_bn v``: a vector of n in b, by the quaternion from b to n.

    Parameters
    ----------
    q : ndarray, shape (4,)
        From b to n.
    v : ndarray, shape (3,)
        n axes.

    Returns
    -------
    tuple of 3 floats
        b axes, in the unit of `v`.
    """
    u = (-q[0], -q[1], -q[2])
    r = (v[0], v[1], v[2])
    t = cross(u, r)
    t = (2.0 * t[0], 2.0 * t[1], 2.0 * t[2])
    s = cross(u, t)
    return r[0] + q[3] * t[0] + s[0], r[1] + q[3] * t[1] + s[1], r[2] + q[3] * t[2] + s[2]


@kernel
def correct(q: Floats, b: Floats, dx: Floats, turn: Floats) -> None:
    """Fold the estimated errors into quaternion and bias (002 eqs. 7.51-7.55); `turn` is scratch.

    Parameters
    ----------
    q : ndarray, shape (4,)
        From b to n; overwritten.
    b : ndarray, shape (3,)
        Bias of the gyro, rad/s, b axes; overwritten.
    dx : ndarray, shape (6,)
        Attitude error, rad, b axes, and bias error, rad/s.
    turn : ndarray, shape (4,)
        Overwritten.
    """
    half2 = 0.25 * (dx[0] * dx[0] + dx[1] * dx[1] + dx[2] * dx[2])
    for i in range(3):
        turn[i] = 0.5 * dx[i]
        b[i] += dx[3 + i]
    # A correction beyond 180° has no half sine; it is taken for half of a tangent (7.54) and scaled below.
    turn[3] = np.sqrt(1.0 - half2) if half2 <= 1.0 else 1.0
    multiply(q, turn, q)
    normalise(q)


@kernel
def star_residual(q: Floats, star: Floats, turn: Floats, residual: Floats) -> None:
    """Rotation from the estimate to the measured attitude about b, rad (002 eq. 7.30); `turn` is scratch.

    Parameters
    ----------
    q, star : ndarray, shape (4,)
        From b to n, estimated and measured.
    turn : ndarray, shape (4,)
        Overwritten.
    residual : ndarray, shape (3,)
        rad, b axes; overwritten.
    """
    turn[0], turn[1], turn[2], turn[3] = -q[0], -q[1], -q[2], q[3]
    multiply(turn, star, turn)
    sign = 2.0 if turn[3] >= 0.0 else -2.0
    for i in range(3):
        residual[i] = sign * turn[i]


@kernel
def direction_residual(q: Floats, known: Floats, seen: Floats, residual: Floats, H: Floats) -> None:
    """Measured less expected vector in b, and ``H = [[expected]x 0]`` (002 eqs. 7.38, 7.39).

    Parameters
    ----------
    q : ndarray, shape (4,)
        From b to n.
    known : ndarray, shape (3,)
        The vector in n axes.
    seen : ndarray, shape (3,)
        As measured, in b axes and the unit of `known`.
    residual : ndarray, shape (3,)
        In that unit; overwritten.
    H : ndarray, shape (3, 6)
        Derivative by attitude error (rad, b axes) and bias error; the left half is overwritten.
    """
    x, y, z = into_body(q, known)
    residual[0], residual[1], residual[2] = seen[0] - x, seen[1] - y, seen[2] - z
    H[0, 1], H[0, 2], H[1, 0] = -z, y, z
    H[1, 2], H[2, 0], H[2, 1] = -x, -y, x


@kernel
def run(
    q: Floats,
    b: Floats,
    P: Floats,
    w: Floats,
    dt: float,
    noise: tuple[float, float],
    exact: bool,
    tracker: tuple[Floats, float],
    directions: tuple[Floats, Floats, Floats],
    gate: float,
    out: tuple[Floats, Floats, Floats],
    checks: tuple[Floats, Integers, Integers],
) -> None:
    """The filter over a record; see `error_state.estimate`.

    Parameters
    ----------
    q, b, P : ndarray, shape (4,), (3,), (6, 6)
        Quaternion from b to n, bias of the gyro, rad/s, and covariance at the start; changed.
    w : ndarray, shape (n, 3)
        Angular rate over each step, b axes, rad/s.
    dt : float
        s.
    noise : tuple of 2 floats
        N², (rad/s)²/Hz, and K², (rad/s²)²/Hz.
    exact : bool
        As in `matrices`.
    tracker : tuple
        Measured attitudes, shape (n, 4), or (0, 4) for none, and their variance, rad².
    directions : tuple of ndarray
        Measured (n, m, 3), b axes, known (m, 3), n axes, variances (m,).
    gate : float
        On the squared normalised innovation.
    out : tuple of ndarray
        Quaternions (n, 4), biases (n, 3), covariances (n, 6, 6); overwritten.
    checks : tuple of ndarray
        NIS, components used, components left out, each of shape (n,); overwritten.
    """
    stars, star_variance = tracker
    seen, known, variances = directions
    Phi, Q = np.eye(6), np.zeros((6, 6))
    dx, turn, residual = np.zeros(6), np.empty(4), np.empty(3)
    unit, H, angle = np.eye(3, 6), np.zeros((known.shape[0], 3, 6)), np.empty(3)
    errors, half = np.empty((known.shape[0], 3)), np.empty((3, 6))
    for k in range(w.shape[0]):
        rate = (w[k, 0] - b[0], w[k, 1] - b[1], w[k, 2] - b[2])
        angle[0], angle[1], angle[2] = dt * rate[0], dt * rate[1], dt * rate[2]
        quaternion_of(angle, turn)
        multiply(q, turn, q)
        normalise(q)
        matrices(rate, dt, noise[0], noise[1], exact, Phi, Q)
        propagate(P, Phi, Q, half)
        dx[:] = 0.0
        if stars.shape[0] > 0 and not np.isnan(stars[k, 0]):
            star_residual(q, stars[k], turn, residual)
            for i in range(3):
                _fold(dx, P, residual[i], unit[i], star_variance, gate, checks, k)
        # All are linearised at the prediction, before any is folded in.
        for m in range(known.shape[0]):
            direction_residual(q, known[m], seen[k, m], errors[m], H[m])
        for m in range(known.shape[0]):
            for i in range(3):
                _fold(dx, P, errors[m, i], H[m, i], variances[m], gate, checks, k)
        correct(q, b, dx, turn)
        for i in range(6):
            for j in range(i):
                P[j, i] = P[i, j]
        out[0][k], out[1][k], out[2][k] = q, b, P


@kernel
def _fold(
    dx: Floats,
    P: Floats,
    residual: float,
    h: Floats,
    variance: float,
    gate: float,
    checks: tuple[Floats, Integers, Integers],
    k: int,
) -> None:
    """One component that depends on the attitude alone, `h` of shape (3,); NaN is skipped.

    `kalman.kernels.fold` for six states, half of whose `h` is zero, without arrays of its own.  Joseph's form
    with the optimal gain is ``P - g g' / S``; only its lower triangle is read and written.
    """
    if np.isnan(residual):
        return
    x, y, z = h[0], h[1], h[2]
    g0 = P[0, 0] * x + P[1, 0] * y + P[2, 0] * z
    g1 = P[1, 0] * x + P[1, 1] * y + P[2, 1] * z
    g2 = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z
    g3 = P[3, 0] * x + P[3, 1] * y + P[3, 2] * z
    g4 = P[4, 0] * x + P[4, 1] * y + P[4, 2] * z
    g5 = P[5, 0] * x + P[5, 1] * y + P[5, 2] * z
    S = x * g0 + y * g1 + z * g2 + variance
    innovation = residual - x * dx[0] - y * dx[1] - z * dx[2]
    chi2 = innovation * innovation / S
    if chi2 > gate:
        checks[2][k] += 1
        return
    checks[0][k] += chi2
    checks[1][k] += 1
    g, inverse = (g0, g1, g2, g3, g4, g5), 1.0 / S
    for i in range(6):
        gain = g[i] * inverse
        dx[i] += gain * innovation
        for j in range(i + 1):
            P[i, j] -= gain * g[j]
