"""The thesis' multiplicative extended Kalman filter over a whole recording, compiled (001 ch. 4).

Every step predicts from fix to fix (4.14-4.17, 4.37-4.51), updates with the seven measurements of
4.62 one after the other, and moves the reference quaternions (4.29, 4.30).  `thesis_reference` says the
same in matrices.

Measurements one by one, linearised once at the prediction, give exactly the joint update of 4.20-4.22
because their noise is independent (4.71); nothing is inverted.
"""

from __future__ import annotations

import numpy as np

from nav_core.mounting.thesis_model import (
    GRAVITY,
    MOVING,
    N_STATES,
    THESIS_PERIOD,
    VEHICLE_START,
    Errata,
    Steps,
    Tuning,
)
from nav_core.mounting.thesis_rotations import move_references, rotation_of, small_rotation
from nav_core.typing import Flags, Floats, kernel

N_MEASUREMENTS = 7

EIGENVALUE_PERIOD = 10.0
"""s between two looks at the eigenvalues, each of which costs several filter steps."""


@kernel
def process_noise(P: Floats, v_x: float, omega: float, T: float, tuning: Tuning, errata: Errata) -> None:
    """Add ``G(x) Q_w G(x)'`` of 001 eqs. 4.63-4.70 to `P`.

    Parameters
    ----------
    P : ndarray, shape (9, 9)
        Added to.
    v_x : float
        m/s.
    omega : float
        rad/s.
    T : float
        s.
    tuning : Tuning
        Of table 5.1, in SI units.
    errata : Errata
        Which corrections hold.
    """
    P[0, 0] += tuning.acceleration * T * T * T / 3.0
    P[0, 1] += tuning.acceleration * T * T / 2.0
    P[1, 0] += tuning.acceleration * T * T / 2.0
    P[1, 1] += tuning.acceleration * T
    speed, attitude, mounting = abs(v_x), abs(omega), abs(omega)
    if errata.floor:
        speed = max(speed, tuning.floor_speed)
        attitude = max(attitude, tuning.floor_attitude)
        mounting = max(mounting, tuning.floor_mounting)
    if tuning.steering:
        speed = 1.0
    share = T / THESIS_PERIOD
    P[2, 2] += share * tuning.turn * speed * speed
    for i in range(3):
        P[3 + i, 3 + i] += share * tuning.attitude * attitude * attitude
        P[6 + i, 6 + i] += share * tuning.mounting * mounting * mounting


@kernel
def predict(x: Floats, P: Floats, T: float, tuning: Tuning, errata: Errata) -> None:
    """Predict state and covariance over `T` (001 eqs. 4.14-4.17 with 4.46); `a_V` and `a_A` start at zero.

    Parameters
    ----------
    x : ndarray, shape (9,)
        v_x (m/s), a_x (m/s²), omega_z (rad/s), a_V, a_A (rad); overwritten.
    P : ndarray, shape (9, 9)
        Overwritten.
    T : float
        s.
    tuning : Tuning
        Of table 5.1, in SI units.
    errata : Errata
        Which corrections hold.
    """
    v_x = x[0]
    omega = x[2] * v_x if tuning.steering else x[2]
    clockwise = 1.0 if errata.course else -1.0
    x[0] += T * x[1]
    x[5] = clockwise * omega * T
    # 4.50 as printed holds for the left error of a clockwise rate; the correction follows the sense of the rate.
    half = 0.5 * omega * T * (clockwise if errata.jacobian else 1.0)
    lever = clockwise * T if errata.jacobian else 0.0
    lever_v = 0.0
    if tuning.steering:
        lever_v, lever = lever * x[2], lever * v_x
    for c in range(N_STATES):
        P[5, c] += lever_v * P[0, c] + lever * P[2, c]
        P[0, c] += T * P[1, c]
        p, q = P[3, c], P[4, c]
        P[3, c] = p - half * q
        P[4, c] = half * p + q
    for c in range(N_STATES):
        P[c, 5] += lever_v * P[c, 0] + lever * P[c, 2]
        P[c, 0] += T * P[c, 1]
        p, q = P[c, 3], P[c, 4]
        P[c, 3] = p - half * q
        P[c, 4] = half * p + q
    process_noise(P, v_x, omega, T, tuning, errata)
    for i in range(N_STATES):
        for j in range(i):
            # Rounding differs between the two passes; over hours it would tear the halves apart.
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])


@kernel
def measurement_model(
    x: Floats, q_V: Floats, q_A: Floats, clockwise: float, steering: bool, h: Floats, H: Floats, work: Floats
) -> None:
    """Write ``h`` of 001 eqs. 4.55-4.62 and its Jacobian, at ``a_A = 0``, into `h` (7,) and `H` (7, 9).

    With `steering` the third state is the curvature of 4.10.  `work` (12, 3) is scratch.

    Parameters
    ----------
    x : ndarray, shape (9,)
        The states.
    q_V : ndarray, shape (4,)
        Vehicle in T, (x, y, z, w).
    q_A : ndarray, shape (4,)
        Box in V, (x, y, z, w).
    clockwise : float
        1, or -1 for a course counted counter-clockwise.
    steering : bool
        Whether the third state is a curvature, 1/m.
    h : ndarray, shape (7,)
        Specific force, m/s², velocity, m/s, turn rate, rad/s; overwritten.
    H : ndarray, shape (7, 9)
        Overwritten.
    work : ndarray, shape (12, 3)
        Overwritten.
    """
    R_tv, R_va, J = work[:3], work[3:6], work[6:9]
    vector, turned, back = work[9], work[10], work[11]
    rotation_of(q_V, R_tv)
    rotation_of(q_A, R_va)
    a_V, v_x = x[3:6], x[0]
    omega = x[2] * v_x if steering else x[2]
    # Derivatives of the turn rate and of the centripetal acceleration with respect to v_x and the third state.
    rate_v, rate_w = (x[2], v_x) if steering else (0.0, 1.0)
    across_v, across_w = clockwise * (omega + v_x * rate_v), clockwise * v_x * rate_w
    H[:] = 0.0
    # Gravity reaction in the vehicle and its derivative; the transposed small rotation is that of -a.
    vector[0], vector[1], vector[2] = 0.0, 0.0, -GRAVITY
    back[0], back[1], back[2] = -a_V[0], -a_V[1], -a_V[2]
    small_rotation(back, vector, turned, J)
    b0 = R_tv[0, 0] * turned[0] + R_tv[1, 0] * turned[1] + R_tv[2, 0] * turned[2] + x[1]
    b1 = R_tv[0, 1] * turned[0] + R_tv[1, 1] * turned[1] + R_tv[2, 1] * turned[2] + clockwise * omega * v_x
    b2 = R_tv[0, 2] * turned[0] + R_tv[1, 2] * turned[1] + R_tv[2, 2] * turned[2]
    for i in range(3):
        x_a, y_a, z_a = R_va[0, i], R_va[1, i], R_va[2, i]
        h[i] = x_a * b0 + y_a * b1 + z_a * b2
        H[i, 0] = y_a * across_v
        H[i, 1] = x_a
        H[i, 2] = y_a * across_w
        for j in range(3):
            along = x_a * R_tv[j, 0] + y_a * R_tv[j, 1] + z_a * R_tv[j, 2]
            for c in range(3):
                H[i, 3 + c] -= along * J[j, c]
        H[i, 6] = y_a * b2 - z_a * b1
        H[i, 7] = z_a * b0 - x_a * b2
        H[i, 8] = x_a * b1 - y_a * b0
    for i in range(3):
        vector[i] = R_tv[i, 0]
    small_rotation(a_V, vector, turned, J)
    for i in range(3):
        h[3 + i] = v_x * turned[i]
        H[3 + i, 0] = turned[i]
        for c in range(3):
            H[3 + i, 3 + c] = v_x * J[i, c]
    h[6] = omega
    H[6, 0], H[6, 2] = rate_v, rate_w


@kernel
def assimilate(y: float, r: float, h: float, row: Floats, dx: Floats, P: Floats, spread: Floats) -> float:
    """Fold one scalar measurement into the correction `dx` and `P`; returns its squared normalised innovation.

    `h` and `row` belong to the prediction, so the innovation is what `dx` leaves of ``y - h``.

    Parameters
    ----------
    y : float
        Measured.
    r : float
        Variance of its noise.
    h : float
        Expected.
    row : ndarray, shape (9,)
        Derivative of `h` by the states.
    dx : ndarray, shape (9,)
        Overwritten.
    P : ndarray, shape (9, 9)
        Overwritten.
    spread : ndarray, shape (9,)
        Overwritten.

    Returns
    -------
    float
        Without unit.
    """
    innovation = y - h
    variance = r
    spread[:] = 0.0
    for j in range(N_STATES):
        if row[j] != 0.0:
            for i in range(N_STATES):
                spread[i] += P[j, i] * row[j]
            innovation -= row[j] * dx[j]
    for j in range(N_STATES):
        variance += row[j] * spread[j]
    scale = 1.0 / variance
    for i in range(N_STATES):
        gain = spread[i] * scale
        dx[i] += gain * innovation
        for j in range(N_STATES):
            P[i, j] -= gain * spread[j]
    return innovation * innovation * scale


@kernel
def update(
    x: Floats, P: Floats, y: Floats, r: Floats, used: Flags, h: Floats, H: Floats, errata: Errata, work: Floats
) -> float:
    """Update state and covariance with the measurements `used` (001 eqs. 4.18-4.23); returns their chi square.

    `work` (2, 9) is scratch.

    Parameters
    ----------
    x : ndarray, shape (9,)
        Overwritten.
    P : ndarray, shape (9, 9)
        Overwritten.
    y : ndarray, shape (7,)
        Specific force, m/s², velocity, m/s, turn rate, rad/s.
    r : ndarray, shape (7,)
        Variances of their noise.
    used : ndarray of bool, shape (7,)
        Which are measured.
    h : ndarray, shape (7,)
        Expected.
    H : ndarray, shape (7, 9)
        Derivative of `h`.
    errata : Errata
        Which corrections hold.
    work : ndarray, shape (2, 9)
        Overwritten.

    Returns
    -------
    float
        Without unit.
    """
    dx, spread = work[0], work[1]
    dx[:] = 0.0
    before = P if errata.covariance else P.copy()
    chi2 = 0.0
    for i in range(N_MEASUREMENTS):
        if used[i]:
            chi2 += assimilate(y[i], r[i], h[i], H[i], dx, P, spread)
    if not errata.covariance:
        # 4.23 to the letter; the residuals only fit between K and K' as a diagonal matrix.  K = P(k|k) H' R^-1.
        for i in range(N_MEASUREMENTS):
            if used[i]:
                gain = P @ H[i] / r[i]
                before += (y[i] - h[i]) * np.outer(gain, gain)
        P[:] = before
    for j in range(N_STATES):
        x[j] += dx[j]
    return chi2


@kernel
def restart_vehicle(x: Floats, P: Floats, q_V: Floats, velocity: Floats, speed: float) -> None:
    """Set the vehicle level, on its course and at its GPS speed, and forget what tied it to the mounting.

    Parameters
    ----------
    x : ndarray, shape (9,)
        All but the mounting's are overwritten.
    P : ndarray, shape (9, 9)
        Overwritten.
    q_V : ndarray, shape (4,)
        Vehicle in T; overwritten.
    velocity : ndarray, shape (3,)
        By GPS, m/s, T axes.
    speed : float
        By GPS, m/s.
    """
    half = 0.5 * np.arctan2(velocity[1], velocity[0])
    q_V[0], q_V[1], q_V[2], q_V[3] = 0.0, 0.0, np.sin(half), np.cos(half)
    for j in range(6):
        x[j] = 0.0
        for c in range(N_STATES):
            P[j, c] = 0.0
            P[c, j] = 0.0
        P[j, j] = VEHICLE_START[j]
    x[0] = speed


@kernel
def filter_drive(
    steps: Steps, x: Floats, P: Floats, q_V: Floats, q_A: Floats, tuning: Tuning, errata: Errata
) -> tuple[int, Floats, Floats, Floats, Floats, Floats, Floats]:
    """Run the filter over a drive; `x`, `P`, `q_V` and `q_A` are its start and are overwritten with its end.

    Parameters
    ----------
    steps : Steps
        n rows.
    x : ndarray, shape (9,)
        v_x (m/s), a_x (m/s²), omega_z (rad/s), a_V, a_A (rad).
    P : ndarray, shape (9, 9)
        Its covariance.
    q_V, q_A : ndarray, shape (4,)
        Vehicle in T, box in V, (x, y, z, w).
    tuning : Tuning
        Of table 5.1, in SI units.
    errata : Errata
        Which corrections hold.

    Returns
    -------
    tuple
        Steps done before a number stopped being finite, and the columns of `thesis.History`:
        q_A (n, 4), q_V (n, 4), motion (n, 3), mounting covariance (n, 3, 3), largest eigenvalue (n,), chi square (n,).
    """
    n = steps.t.size
    out_A, out_V, motion = np.full((n, 4), np.nan), np.full((n, 4), np.nan), np.full((n, 3), np.nan)
    covariance = np.full((n, 3, 3), np.nan)
    largest, chi2 = np.full(n, np.nan), np.full(n, np.nan)
    h, H = np.empty(N_MEASUREMENTS), np.zeros((N_MEASUREMENTS, N_STATES))
    triads, corrections = np.empty((12, 3)), np.empty((2, N_STATES))
    y, r, used = np.empty(N_MEASUREMENTS), np.empty(N_MEASUREMENTS), np.ones(N_MEASUREMENTS, dtype=np.bool_)
    r[:3], r[3:6], r[6] = tuning.accelerometer, tuning.speed, tuning.turn_rate
    clockwise = 1.0 if errata.course else -1.0
    eigenvalue, next_look = np.nan, steps.t[0]
    for k in range(n):
        speed, velocity = steps.speed[k], steps.velocity[k]
        if errata.start and steps.period[k] > tuning.longest_step:
            restart_vehicle(x, P, q_V, velocity, speed)
        else:
            predict(x, P, steps.period[k], tuning, errata)
        measurement_model(x, q_V, q_A, clockwise, tuning.steering, h, H, triads)
        y[:3], y[3:6], y[6] = steps.f[k], velocity, steps.turn_rate[k]
        used[6] = steps.turning[k]
        chi2[k] = update(x, P, y, r, used, h, H, errata, corrections)
        move_references(x, P, q_V, q_A, errata)
        if errata.forward and x[0] < 0.0:
            x[0] = 0.0
            if speed > MOVING:
                # Only a vehicle turned away from its course drives backwards: the way into the mirror solution.
                restart_vehicle(x, P, q_V, velocity, speed)
        trace = np.trace(P)
        if not np.isfinite(trace + q_A[0] + q_V[0] + x[0]):
            return k, out_A, out_V, motion, covariance, largest, chi2
        if steps.t[k] >= next_look:
            eigenvalue = N_STATES * np.linalg.eigvalsh(P)[-1] / trace
            next_look = steps.t[k] + EIGENVALUE_PERIOD
        for i in range(4):
            out_A[k, i], out_V[k, i] = q_A[i], q_V[i]
        motion[k, 0], motion[k, 1] = x[0], x[1]
        motion[k, 2] = x[0] * x[2] if tuning.steering else x[2]
        for i in range(3):
            for j in range(3):
                covariance[k, i, j] = P[6 + i, 6 + j]
        largest[k] = eigenvalue
    return n, out_A, out_V, motion, covariance, largest, chi2
