"""The error-state filter over a record, compiled: 15 states of the vehicle and 5 of the receiver.

States are truth minus estimate: position and velocity in T axes (m, m/s), the rotation vector of the attitude about the
T axes (rad; ``R_true = exp([psi]x) R``), biases of accelerometer and gyro in V axes (m/s², rad/s), and what
the receiver's fixes err by in common with their neighbours: north, east, down, along and across the track, each in
units of its sigma.  Biases and receiver's errors together are the array `slow` (11,).  Corrections go back into the
estimates at once, so that the error states are zero between epochs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.attitude.kernels import Vector, cross, turn
from nav_core.kalman.kernels import projected, propagate_covariance, update_sequential
from nav_core.strapdown.kernels import curvatures, step_local
from nav_core.typing import Floats, Integers, kernel

STATES = 20
VEHICLE = 15
"""Of them those of the vehicle, which come first."""
SLOW = STATES - 9
"""Those that keep their value, or forget it slowly, while the vehicle moves."""
ROWS = 13
"""Position north, east, down; speed; course; sideways and down velocity; velocity and rate at rest, three each."""

SLOWEST = 1.0
"""Below this speed GPS course and the direction of the speed say nothing, m/s."""


class Weights(NamedTuple):
    """What the kernel needs to know of the noise; variances are inflated for correlation where they enter the filter.

    Attributes
    ----------
    accel_walk, gyro_walk : float
        Random walk of the biases, (m/s²)²/s and (rad/s)²/s.
    correlation : float
        Of the receiver's errors, s.
    sideways, downwards : float
        1 sigma of the velocity of the slip-free point across and normal to the vehicle, m/s.
    slip_repeat : float
        By how much the variance of these grows because neighbouring epochs share their error.
    arm_sigma : float
        1 sigma of the slip-free point's place, m.
    mount : float
        1 sigma of the mounting, rad.
    mount_repeat : float
        As `slip_repeat`, for the mounting.
    rest, rest_repeat : float
        Velocity at rest, m/s, 1 sigma, and its repetition.
    rest_rate : float
        Turning at rest, rad/s, 1 sigma.
    rest_push : float
        Mean acceleration over an epoch at rest, m/s², 1 sigma: people and suspension.
    gate : float
        Squared normalised innovation beyond which a measurement is left out.
    relent : float
        After this time of nothing but fixes left out they are taken as they are, s.
    """

    accel_walk: float
    gyro_walk: float
    correlation: float
    sideways: float
    downwards: float
    slip_repeat: float
    arm_sigma: float
    mount: float
    mount_repeat: float
    rest: float
    rest_repeat: float
    rest_rate: float
    rest_push: float
    gate: float
    relent: float


@kernel
def transition_of(force: Vector, C: Floats, T: float, keep: float, Phi: Floats) -> None:
    """Write ``I + F T + F² T²/2`` of the error states into `Phi` (20, 20).

    `force` is the mean specific force in T axes, `C` (3, 3) the mean attitude, `keep` what is left of the receiver's
    errors after `T` s.  Terms of Earth rate, transport and the gravity gradient are left out: over the seconds between
    fixes they are a thousand times below the biases.

    Parameters
    ----------
    force : tuple of 3 floats
        m/s².
    C : ndarray, shape (3, 3)
        From V to T.
    T : float
        s.
    keep : float
        0 to 1.
    Phi : ndarray, shape (20, 20)
        Overwritten.
    """
    Phi[:] = 0.0
    for i in range(STATES):
        Phi[i, i] = 1.0 if i < VEHICLE else keep
    for i in range(3):
        Phi[i, 3 + i] = T
        for j in range(3):
            Phi[3 + i, 9 + j] = -C[i, j] * T
            Phi[i, 9 + j] = -C[i, j] * 0.5 * T * T
            Phi[6 + i, 12 + j] = -C[i, j] * T
    x, y, z = force
    # -[f]x: a platform that leans sees gravity sideways.
    Phi[3, 7], Phi[3, 8], Phi[4, 6] = z * T, -y * T, -z * T
    Phi[4, 8], Phi[5, 6], Phi[5, 7] = x * T, y * T, -x * T
    for i in range(3):
        for j in range(3):
            Phi[i, 6 + j] = 0.5 * T * Phi[3 + i, 6 + j]
            for k in range(3):
                Phi[3 + i, 12 + j] += 0.5 * Phi[3 + i, 6 + k] * Phi[6 + k, 12 + j]


@kernel
def rotate_back(C: Floats, v: Vector) -> Vector:
    """``C' v``.

    Parameters
    ----------
    C : ndarray, shape (3, 3)
        From V to T.
    v : tuple of 3 floats
        T axes.

    Returns
    -------
    tuple of 3 floats
        V axes, in the unit of `v`.
    """
    return (
        C[0, 0] * v[0] + C[1, 0] * v[1] + C[2, 0] * v[2],
        C[0, 1] * v[0] + C[1, 1] * v[1] + C[2, 1] * v[2],
        C[0, 2] * v[0] + C[1, 2] * v[1] + C[2, 2] * v[2],
    )


@kernel
def fix_rows(
    place: Floats,
    v: Floats,
    slow: Floats,
    z: Floats,
    late: Floats,
    noise: Floats,
    e: Floats,
    H: Floats,
    s: Floats,
    r: Floats,
) -> None:
    """Rows 0-4: position, speed and course of a fix `z` (lat, lon, height, speed, course; NaN where not measured).

    `late` (2,) is by how much position and speed, and course, are younger than the epoch, s; `noise` (5, 2) their
    variances, as a whole and of the white part.  Course counts as metres per second across the track.  The gate
    judges by the whole: another satellite may begin a new common error at any fix.

    Parameters
    ----------
    place : ndarray, shape (3,)
        Latitude, longitude, rad, and height, m.
    v : ndarray, shape (3,)
        T axes, m/s.
    slow : ndarray, shape (11,)
        Biases and the receiver's errors.
    z : ndarray, shape (5,)
        rad, rad, m, m/s, rad.
    late : ndarray, shape (2,)
        s.
    noise : ndarray, shape (5, 2)
        m² and (m/s)².
    e : ndarray, shape (13,)
        Measured less expected, m and m/s; overwritten.
    H : ndarray, shape (13, 20)
        Overwritten.
    s : ndarray, shape (13,)
        Variances for the gate; overwritten.
    r : ndarray, shape (13,)
        Variances for the update; overwritten.
    """
    along, across = curvatures(np.sin(place[0]), place[2])
    e[0] = (z[0] - place[0]) / along - v[0] * late[0]
    e[1] = (z[1] - place[1]) * np.cos(place[0]) / across - v[1] * late[0]
    e[2] = place[2] - z[2] - v[2] * late[0]
    for i in range(3):
        H[i, i] = 1.0
    speed = np.hypot(v[0], v[1])
    if speed >= SLOWEST:
        north, east = v[0] / speed, v[1] / speed
        e[3] = z[3] - speed
        H[3, 3], H[3, 4] = north, east
        off = z[4] - np.arctan2(v[1], v[0])
        e[4] = speed * np.arctan2(np.sin(off), np.cos(off))
        H[4, 3], H[4, 4] = -east, north
    for i in range(5):
        s[i], r[i] = noise[i, 0], noise[i, 1]
        H[i, VEHICLE + i] = np.sqrt(noise[i, 0] - noise[i, 1])
        e[i] -= H[i, VEHICLE + i] * slow[6 + i]


@kernel
def slip_rows(
    v: Floats, C: Floats, spin: Vector, arm: Floats, weights: Weights, e: Floats, H: Floats, s: Floats, r: Floats
) -> None:
    """Rows 5-6: a wheeled vehicle moves neither sideways nor up at its slip-free point, `arm` (3,) m from the box.

    Parameters
    ----------
    v : ndarray, shape (3,)
        T axes, m/s.
    C : ndarray, shape (3, 3)
        From V to T.
    spin : tuple of 3 floats
        Angular rate, V axes, rad/s.
    arm : ndarray, shape (3,)
        V axes, m.
    weights : Weights
        Of `Vehicle.weights`.
    e : ndarray, shape (13,)
        m/s; overwritten.
    H : ndarray, shape (13, 20)
        Overwritten.
    s : ndarray, shape (13,)
        Variances for the gate; overwritten.
    r : ndarray, shape (13,)
        Variances for the update; overwritten.
    """
    now = (v[0], v[1], v[2])
    body = rotate_back(C, now)
    swing = cross(spin, (arm[0], arm[1], arm[2]))
    swung = weights.arm_sigma**2 * (spin[0] ** 2 + spin[1] ** 2 + spin[2] ** 2)
    tilted = (weights.mount * body[0]) ** 2
    for i in range(1, 3):
        row = 4 + i
        e[row] = -body[i] - swing[i]
        lever = cross((C[0, i], C[1, i], C[2, i]), now)
        for j in range(3):
            H[row, 3 + j] = C[j, i]
            H[row, 6 + j] = lever[j]
        slip = (weights.sideways if i == 1 else weights.downwards) ** 2 + swung
        s[row] = slip + tilted
        r[row] = slip * weights.slip_repeat + tilted * weights.mount_repeat


@kernel
def rest_rows(
    v: Floats,
    spin: Vector,
    T: float,
    gyro_noise: float,
    weights: Weights,
    e: Floats,
    H: Floats,
    s: Floats,
    r: Floats,
) -> None:
    """Rows 7-12: at rest the velocity is zero, and what the gyro says beyond the Earth's turning is its bias.

    Parameters
    ----------
    v : ndarray, shape (3,)
        T axes, m/s.
    spin : tuple of 3 floats
        Angular rate less the estimated bias, V axes, rad/s.
    T : float
        s.
    gyro_noise : float
        (rad/s)²s.
    weights : Weights
        Of `Vehicle.weights`.
    e : ndarray, shape (13,)
        m/s and rad/s; overwritten.
    H : ndarray, shape (13, 20)
        Overwritten.
    s : ndarray, shape (13,)
        Variances for the gate; overwritten.
    r : ndarray, shape (13,)
        Variances for the update; overwritten.
    """
    for i in range(3):
        e[7 + i] = -v[i]
        H[7 + i, 3 + i] = 1.0
        s[7 + i], r[7 + i] = weights.rest**2, weights.rest**2 * weights.rest_repeat
        e[10 + i] = spin[i]
        H[10 + i, 12 + i] = 1.0
        s[10 + i] = r[10 + i] = gyro_noise / T + weights.rest_rate**2


@kernel
def apply(place: Floats, v: Floats, C: Floats, slow: Floats, dx: Floats) -> None:
    """Put an error estimate into position, velocity, attitude, biases and receiver's errors.

    Parameters
    ----------
    place : ndarray, shape (3,)
        Latitude, longitude, rad, and height, m; overwritten.
    v : ndarray, shape (3,)
        T axes, m/s; overwritten.
    C : ndarray, shape (3, 3)
        From V to T; overwritten.
    slow : ndarray, shape (11,)
        Biases and the receiver's errors; overwritten.
    dx : ndarray, shape (20,)
        Position, m, velocity, m/s, attitude, rad (T axes), biases and the receiver's errors.
    """
    along, across = curvatures(np.sin(place[0]), place[2])
    place[1] += dx[1] * across / np.cos(place[0])
    place[0] += dx[0] * along
    place[2] -= dx[2]
    for i in range(3):
        v[i] += dx[3 + i]
    turn(C, (-dx[6], -dx[7], -dx[8]), (0.0, 0.0, 0.0))
    for i in range(SLOW):
        slow[i] += dx[9 + i]


@kernel
def advance(
    place: Floats,
    v: Floats,
    C: Floats,
    slow: Floats,
    P: Floats,
    rotation: Floats,
    velocity: Floats,
    periods: Floats,
    density: Floats,
    weights: Weights,
    Phi: Floats,
    half: Floats,
) -> tuple[Vector, Vector]:
    """Navigate over the samples between two epochs and predict.

    Returns the mean specific force, T axes, m/s², and the mean angular rate, V axes, rad/s.

    `density` (2,) holds the white noise of specific force and rate, (m/s²)²s and (rad/s)²s; `half` (20, 20) is zero
    off its diagonal.  Half of the noise enters at the start and half at the end: third order in the period.

    Parameters
    ----------
    place : ndarray, shape (3,)
        Latitude, longitude, rad, and height, m; overwritten.
    v : ndarray, shape (3,)
        T axes, m/s; overwritten.
    C : ndarray, shape (3, 3)
        From V to T; overwritten.
    slow : ndarray, shape (11,)
        Biases and the receiver's errors; the latter fade.
    P : ndarray, shape (20, 20)
        Overwritten.
    rotation, velocity : ndarray, shape (k, 3)
        Increments of the steps, V axes, rad and m/s.
    periods : ndarray, shape (k,)
        Of the steps, s.
    density : ndarray, shape (2,)
        Of specific force and rate.
    weights : Weights
        Of `Vehicle.weights`.
    Phi : ndarray, shape (20, 20)
        Overwritten.
    half : ndarray, shape (20, 20)
        Overwritten on its diagonal.

    Returns
    -------
    force : tuple of 3 floats
        T axes, m/s².
    rate : tuple of 3 floats
        V axes, rad/s.
    """
    turned, pushed = np.empty(3), np.empty(3)
    fx, fy, fz, wx, wy, wz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    T = float(periods.sum())
    middle = 0.5 * C
    for k in range(periods.size):
        dt = periods[k]
        for i in range(3):
            turned[i] = rotation[k, i] - dt * slow[3 + i]
            pushed[i] = velocity[k, i] - dt * slow[i]
        fx += C[0, 0] * pushed[0] + C[0, 1] * pushed[1] + C[0, 2] * pushed[2]
        fy += C[1, 0] * pushed[0] + C[1, 1] * pushed[1] + C[1, 2] * pushed[2]
        fz += C[2, 0] * pushed[0] + C[2, 1] * pushed[1] + C[2, 2] * pushed[2]
        wx, wy, wz = wx + turned[0], wy + turned[1], wz + turned[2]
        step_local(place, v, C, turned, pushed, dt, False)
    middle += 0.5 * C
    keep = np.exp(-T / weights.correlation)
    force = (fx / T, fy / T, fz / T)
    transition_of(force, middle, T, keep, Phi)
    for i in range(VEHICLE, STATES):
        slow[i - 9] *= keep
        half[i, i] = (1.0 - keep * keep) / (1.0 + keep * keep)
    for i in range(3):
        half[3 + i, 3 + i], half[6 + i, 6 + i] = 0.5 * T * density[0], 0.5 * T * density[1]
        half[9 + i, 9 + i], half[12 + i, 12 + i] = 0.5 * T * weights.accel_walk, 0.5 * T * weights.gyro_walk
    for i in range(STATES):
        P[i, i] += half[i, i]
    propagate_covariance(P, Phi, half)
    return force, (wx / T, wy / T, wz / T)


@kernel
def speeds_up(force: Vector, Phi: Floats, P: Floats, T: float, noise: float, weights: Weights) -> bool:
    """Whether the horizontal specific force is more than tilt, biases and rest explain: the vehicle is not at rest.

    Calm sensors alone do not tell rest from smooth braking at walking pace.  `noise` is the density of the force.

    Parameters
    ----------
    force : tuple of 3 floats
        Mean specific force, T axes, m/s².
    Phi : ndarray, shape (20, 20)
        Of the time between the epochs.
    P : ndarray, shape (20, 20)
        Covariance of the errors.
    T : float
        s.
    noise : float
        (m/s²)²s.
    weights : Weights
        Of `Vehicle.weights`.

    Returns
    -------
    bool
        Whether it is on either axis.
    """
    for i in range(2):
        variance = noise / T + weights.rest_push**2
        for j in range(6, VEHICLE):
            for k in range(6, VEHICLE):
                variance += Phi[3 + i, j] * P[j, k] * Phi[3 + i, k] / (T * T)
        if force[i] * force[i] > weights.gate * variance:
            return True
    return False


@kernel
def strike(P: Floats, e: Floats, H: Floats, s: Floats, gate: float) -> None:
    """Strike out residuals beyond the gate, each judged alone and before any update.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance of the errors.
    e : ndarray, shape (m,)
        NaN where not measured; what is struck out becomes NaN.
    H : ndarray, shape (m, n)
        Measurement rows.
    s : ndarray, shape (m,)
        Variances of the noise.
    gate : float
        On the squared normalised residual.
    """
    for i in range(e.size):
        if np.isnan(e[i]):
            continue
        variance = s[i] + H[i] @ projected(P, H[i])
        if e[i] * e[i] > gate * variance:
            e[i] = np.nan


@kernel
def strike_fix(P: Floats, e: Floats, H: Floats, s: Floats, weights: Weights, since: float) -> bool:
    """Gate a fix, `since` s after the first of those left out without a break; returns whether it was left out.

    A position with one bad coordinate is bad as a whole.  When nothing else came for long, it is the filter that has
    lost its way: then the position counts, and `P` grows by what it says.

    Parameters
    ----------
    P : ndarray, shape (20, 20)
        Overwritten where the filter relents.
    e : ndarray, shape (5,)
        m and m/s; what is struck out becomes NaN.
    H : ndarray, shape (5, 20)
        Measurement rows.
    s : ndarray, shape (5,)
        Variances for the gate.
    weights : Weights
        Of `Vehicle.weights`.
    since : float
        s.

    Returns
    -------
    bool
        Whether the position was out of the gate.
    """
    seen = (e[0], e[1], e[2])
    strike(P, e, H, s, weights.gate)
    bad = False
    for i in range(3):
        bad = bad or (np.isnan(e[i]) and not np.isnan(seen[i]))
    if not bad:
        return False
    for i in range(3):
        e[i] = np.nan
        if since > weights.relent:
            e[i] = seen[i]
            P[i, i] += 0.0 if np.isnan(seen[i]) else seen[i] ** 2
    return True


@kernel
def run(
    t: Floats,
    rotation: Floats,
    velocity: Floats,
    sample: Integers,
    z: Floats,
    late: Floats,
    noise: Floats,
    still: Floats,
    density: Floats,
    arm: Floats,
    weights: Weights,
    place: Floats,
    v: Floats,
    C: Floats,
    P: Floats,
) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats, Floats, Floats, int]:
    """Filter over a record of m epochs; `place`, `v`, `C`, `P` are the start and become the end.

    Parameters
    ----------
    t : ndarray, shape (n + 1,)
        Samples, s.
    rotation, velocity : ndarray, shape (n, 3)
        Increments between them (`nav_core.strapdown.increments`).
    sample : ndarray of int64, shape (m,)
        Sample of each epoch, increasing, the first 0.
    z, late, noise : ndarray, shape (m, 5), (m, 2), (m, 5, 2)
        See `fix_rows`.
    still : ndarray, shape (m,)
        1 where the vehicle seems to stand; becomes 0 where it speeds up or brakes nevertheless.
    density : ndarray, shape (m, 2)
        Of the interval before each epoch; see `advance`.
    arm : ndarray, shape (3,)
        See `slip_rows`.
    weights : Weights
        See there.
    place, v : ndarray, shape (3,)
        Latitude, longitude, rad, and height, m; T axes, m/s.
    C : ndarray, shape (3, 3)
        From V to T.
    P : ndarray, shape (20, 20)
        Covariance of the errors.

    Returns
    -------
    tuple
        Places (m, 3), velocities (m, 3), attitudes (m, 3, 3), slow states (m, 11), covariances before and after the
        update (m, 20, 20), transitions into each epoch (m, 20, 20), corrections (m, 20), fixes left out.
    """
    m = sample.size
    places, speeds, attitudes, slows = np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 3, 3)), np.empty((m, SLOW))
    P_prior, P_after, Phis = (
        np.empty((m, STATES, STATES)),
        np.empty((m, STATES, STATES)),
        np.empty((m, STATES, STATES)),
    )
    corrections, slow, half = np.zeros((m, STATES)), np.zeros(SLOW), np.zeros((STATES, STATES))
    e, H, s, r, chi2 = np.empty(ROWS), np.zeros((ROWS, STATES)), np.empty(ROWS), np.empty(ROWS), np.empty(ROWS)
    left_out, since = 0, np.inf
    Phis[0] = np.eye(STATES)
    for j in range(m):
        e[:], H[:], s[:], r[:] = np.nan, 0.0, 1.0, 1.0
        if j > 0:
            a, b = sample[j - 1], sample[j]
            force, spin = advance(
                place,
                v,
                C,
                slow,
                P,
                rotation[a:b],
                velocity[a:b],
                np.diff(t[a : b + 1]),
                density[j],
                weights,
                Phis[j],
                half,
            )
            if still[j] > 0.0 and speeds_up(force, Phis[j], P, float(t[b] - t[a]), density[j, 0], weights):
                still[j] = 0.0
            if still[j] > 0.0:
                rest_rows(v, spin, float(t[b] - t[a]), density[j, 1], weights, e, H, s, r)
            else:
                slip_rows(v, C, spin, arm, weights, e, H, s, r)
        P_prior[j] = P
        fix_rows(place, v, slow, z[j], late[j], noise[j], e, H, s, r)
        strike(P, e[5:], H[5:], s[5:], weights.gate)
        now = float(t[sample[j]])
        if not np.isnan(e[0]):
            if strike_fix(P, e[:5], H[:5], s[:5], weights, now - since):
                left_out += 1
                since = min(since, now)
            else:
                since = np.inf
        else:
            strike(P, e[:5], H[:5], s[:5], weights.gate)
        update_sequential(corrections[j], P, e, H, r, np.inf, chi2)
        apply(place, v, C, slow, corrections[j])
        places[j], speeds[j], attitudes[j], slows[j], P_after[j] = place, v, C, slow, P
    return places, speeds, attitudes, slows, P_prior, P_after, Phis, corrections, left_out
