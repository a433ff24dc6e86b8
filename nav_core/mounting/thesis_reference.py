"""One step of the thesis' filter in matrices, as 001 writes it: what `thesis_kernel` is tested against.

The update is the joint one of 4.20-4.22 with an inverse, and Joseph's form, where the kernel goes measurement by
measurement; rotations are matrices from skew-symmetric ones, where the kernel writes components.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from nav_core.mounting.thesis_model import GRAVITY, MOVING, THESIS_PERIOD, VEHICLE_START, Errata, Steps, Tuning
from nav_core.rotation import skew
from nav_core.typing import Flags, Floats

FORWARD, RIGHT, DOWN = np.eye(3)


def small_matrix(a: Floats) -> Floats:
    """``R(dq(a))`` of 001 eq. 4.26, shape (3, 3).

    Parameters
    ----------
    a : ndarray, shape (3,)
        Rodrigues vector ``2 tan(angle/2)``, rad for small angles.

    Returns
    -------
    ndarray, shape (3, 3)
        A rotation.
    """
    return Rotation.from_quat([*a, 2.0]).as_matrix()


def small_derivative(a: Floats, v: Floats) -> Floats:
    """Derivative of ``R(dq(a)) v`` with respect to `a`, shape (3, 3).

    Parameters
    ----------
    a : ndarray, shape (3,)
        Rodrigues vector, rad.
    v : ndarray, shape (3,)
        In any unit.

    Returns
    -------
    ndarray, shape (3, 3)
        In that unit.
    """
    s = 4.0 / (4.0 + a @ a)
    turned = np.cross(a, v) + 0.5 * np.cross(a, np.cross(a, v))
    bend = 0.5 * ((a @ v) * np.eye(3) + np.outer(a, v) - 2.0 * np.outer(v, a))
    return s * (bend - skew(v)) - 0.5 * s**2 * np.outer(turned, a)


def predicted(x: Floats, P: Floats, T: float, tuning: Tuning, errata: Errata) -> tuple[Floats, Floats]:
    """State and covariance over `T` (001 eqs. 4.14-4.17, 4.46-4.51, 4.63-4.70).

    Parameters
    ----------
    x : ndarray, shape (9,)
        The states.
    P : ndarray, shape (9, 9)
        Their covariance.
    T : float
        s.
    tuning : Tuning
        Of table 5.1, in SI units.
    errata : Errata
        Which corrections hold.

    Returns
    -------
    x : ndarray, shape (9,)
        After `T`.
    P : ndarray, shape (9, 9)
        After `T`.
    """
    sense = 1.0 if errata.course else -1.0
    v_x = x[0]
    omega = v_x * x[2] if tuning.steering else x[2]
    half = 0.5 * omega * T * (sense if errata.jacobian else 1.0)
    F = np.eye(9)
    F[0, 1] = T
    F[3:5, 3:5] = [[1.0, -half], [half, 1.0]]
    L = np.zeros(9)
    L[5] = sense * omega * T
    following = F @ x + L
    if errata.jacobian:
        F[5, 2] = sense * T
        if tuning.steering:
            F[5, [0, 2]] = sense * T * x[2], sense * T * v_x
    floors = (tuning.floor_speed, tuning.floor_attitude, tuning.floor_mounting) if errata.floor else (0.0, 0.0, 0.0)
    g_turn, g_V, g_A = (max(abs(g), floor) for g, floor in zip((v_x, omega, omega), floors, strict=True))
    if tuning.steering:
        g_turn = 1.0
    share = T / THESIS_PERIOD
    Q = np.diag([0.0, 0.0, share * tuning.turn, *[share * tuning.attitude] * 3, *[share * tuning.mounting] * 3])
    Q[:2, :2] = tuning.acceleration * np.array([[T**3 / 3.0, T**2 / 2.0], [T**2 / 2.0, T]])
    G = np.diag([1.0, 1.0, g_turn, *[g_V] * 3, *[g_A] * 3])
    return following, F @ P @ F.T + G @ Q @ G.T


def measured(x: Floats, R_tv: Floats, R_va: Floats, errata: Errata, *, steering: bool) -> tuple[Floats, Floats]:
    """``h`` (7,) of 001 eqs. 4.55-4.62 at ``a_A = 0`` and its Jacobian (7, 9); with `steering`, that of 4.10.

    Parameters
    ----------
    x : ndarray, shape (9,)
        The states.
    R_tv, R_va : ndarray, shape (3, 3)
        The references.
    errata : Errata
        Which corrections hold.
    steering : bool
        Whether the third state is a curvature, 1/m.

    Returns
    -------
    h : ndarray, shape (7,)
        Specific force, m/s², velocity, m/s, turn rate, rad/s.
    H : ndarray, shape (7, 9)
        Its Jacobian.
    """
    if steering:
        # The chain rule through omega_z = v_x x_steer.
        inner = np.eye(9)
        inner[2, [0, 2]] = x[2], x[0]
        turning = x.copy()
        turning[2] = x[0] * x[2]
        inside = measured(turning, R_tv, R_va, errata, steering=False)
        return inside[0], inside[1] @ inner
    sense = 1.0 if errata.course else -1.0
    v_x, a_x, omega, a_V = x[0], x[1], x[2], x[3:6]
    gravity = -GRAVITY * DOWN
    felt = R_tv.T @ small_matrix(a_V).T @ gravity + a_x * FORWARD + sense * omega * v_x * RIGHT
    ahead = R_tv @ FORWARD
    h = np.concatenate([R_va.T @ felt, small_matrix(a_V) @ ahead * v_x, [omega]])
    H = np.zeros((7, 9))
    H[:3, 0] = R_va.T @ RIGHT * sense * omega
    H[:3, 1] = R_va.T @ FORWARD
    H[:3, 2] = R_va.T @ RIGHT * sense * v_x
    H[:3, 3:6] = -R_va.T @ R_tv.T @ small_derivative(-a_V, gravity)
    H[:3, 6:9] = R_va.T @ skew(felt)
    H[3:6, 0] = small_matrix(a_V) @ ahead
    H[3:6, 3:6] = v_x * small_derivative(a_V, ahead)
    H[6, 2] = 1.0
    return h, H


def updated(x: Floats, P: Floats, e: Floats, H: Floats, r: Floats, errata: Errata) -> tuple[Floats, Floats, float]:
    """Joint update of 001 eqs. 4.20-4.23 with the residuals `e`; also their chi square.

    Parameters
    ----------
    x : ndarray, shape (9,)
        Predicted.
    P : ndarray, shape (9, 9)
        Its covariance.
    e : ndarray, shape (m,)
        Measured less expected.
    H : ndarray, shape (m, 9)
        Measurement matrix.
    r : ndarray, shape (m,)
        Variances of the noise.
    errata : Errata
        Which corrections hold.

    Returns
    -------
    x : ndarray, shape (9,)
        Updated.
    P : ndarray, shape (9, 9)
        Updated.
    chi2 : float
        Without unit.
    """
    S = H @ P @ H.T + np.diag(r)
    K = np.linalg.solve(S, H @ P).T
    if errata.covariance:
        keep = np.eye(9) - K @ H
        after = keep @ P @ keep.T + K @ np.diag(r) @ K.T
    else:
        after = P + K @ np.diag(e) @ K.T
    return x + K @ e, after, float(e @ np.linalg.solve(S, e))


def reset_matrix(a: Floats) -> Floats:
    """Derivative, at ``a``, of the small rotation left over when the reference has been moved by `a`.

    Parameters
    ----------
    a : ndarray, shape (3,)
        Rodrigues vector, rad.

    Returns
    -------
    ndarray, shape (3, 3)
        ``s (I + [a]x / 2)``.
    """
    return 4.0 / (4.0 + a @ a) * (np.eye(3) + 0.5 * skew(a))


def filter_reference(
    steps: Steps, x: Floats, P: Floats, q_V: Floats, q_A: Floats, tuning: Tuning, errata: Errata
) -> tuple[Floats, Floats, Floats, Floats]:
    """`thesis_kernel.filter_drive` in plain numpy.

    Parameters
    ----------
    steps : Steps
        n rows.
    x : ndarray, shape (9,)
        States at the start.
    P : ndarray, shape (9, 9)
        Their covariance.
    q_V, q_A : ndarray, shape (4,)
        Vehicle in T, box in V, (x, y, z, w), at the start.
    tuning : Tuning
        Of table 5.1, in SI units.
    errata : Errata
        Which corrections hold.

    Returns
    -------
    tuple of ndarray
        q_A (n, 4) with arbitrary signs, motion (n, 3), mounting covariance (n, 3, 3), chi square (n,).
    """
    R_tv, R_va, cov = Rotation.from_quat(q_V).as_matrix(), Rotation.from_quat(q_A).as_matrix(), P
    r = np.array([tuning.accelerometer] * 3 + [tuning.speed] * 3 + [tuning.turn_rate])
    turns: list[Floats] = []
    motion, mounting, chi2 = np.empty((steps.t.size, 3)), np.empty((steps.t.size, 3, 3)), np.empty(steps.t.size)
    for k in range(steps.t.size):
        velocity, speed = steps.velocity[k], float(steps.speed[k])
        if errata.start and steps.period[k] > tuning.longest_step:
            x, cov, R_tv = restarted(cov, velocity, speed)
        else:
            x, cov = predicted(x, cov, float(steps.period[k]), tuning, errata)
        h, H = measured(x, R_tv, R_va, errata, steering=tuning.steering)
        used: Flags = np.append(np.ones(6, dtype=np.bool_), steps.turning[k])
        e = np.concatenate([steps.f[k], velocity, steps.turn_rate[k : k + 1]]) - h
        x, cov, chi2[k] = updated(x, cov, e[used], H[used], r[used], errata)
        R_tv, R_va = small_matrix(x[3:6]) @ R_tv, small_matrix(x[6:9]) @ R_va
        if errata.reset:
            M = np.eye(9)
            M[3:6, 3:6], M[6:, 6:] = reset_matrix(x[3:6]), reset_matrix(x[6:9])
            cov = M @ cov @ M.T
        x = np.append(x[:3], np.zeros(6))
        if errata.forward and x[0] < 0.0:
            x[0] = 0.0
            if speed > MOVING:
                x, cov, R_tv = restarted(cov, velocity, speed)
        turns.append(R_va)
        motion[k], mounting[k] = x[:3], cov[6:, 6:]
        if tuning.steering:
            motion[k, 2] *= x[0]
    return Rotation.from_matrix(np.array(turns)).as_quat(), motion, mounting, chi2


def restarted(P: Floats, velocity: Floats, speed: float) -> tuple[Floats, Floats, Floats]:
    """State, covariance and ``R_tv`` of a vehicle set level on its course.

    Parameters
    ----------
    P : ndarray, shape (9, 9)
        Before.
    velocity : ndarray, shape (3,)
        By GPS, m/s, T axes.
    speed : float
        By GPS, m/s.

    Returns
    -------
    x : ndarray, shape (9,)
        With nothing but the speed.
    P : ndarray, shape (9, 9)
        The mounting's block as before, alone.
    R_tv : ndarray, shape (3, 3)
        Level.
    """
    after = np.diag([*VEHICLE_START, 0.0, 0.0, 0.0])
    after[6:, 6:] = P[6:, 6:]
    heading = float(np.arctan2(velocity[1], velocity[0]))
    return np.append(speed, np.zeros(8)), after, Rotation.from_rotvec(heading * DOWN).as_matrix()
