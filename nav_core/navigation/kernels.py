"""The error-state filter over a record, compiled: 15 states of the vehicle and 5 of the receiver.

States are truth minus estimate: position and velocity in T axes (m, m/s), the rotation vector of the attitude about the
T axes (rad; ``R_true = exp([psi]x) R``), biases of accelerometer and gyro in V axes (m/s², rad/s), and what
the receiver's fixes err by in common with their neighbours: north, east, down, along and across the track, each in
units of its sigma.  Biases and receiver's errors together are the array `slow` (11,).  Corrections go back into the
estimates at once, so that the error states are zero between epochs.
"""

from __future__ import annotations

import numpy as np

from nav_core.attitude.kernels import Vector, turn
from nav_core.kalman.kernels import Pattern, Room, pattern_of, propagate_into, room_for, update_sequential
from nav_core.navigation.gates import speeds_up, strike, strike_fix
from nav_core.navigation.rows import fix_rows, rest_rows, slip_rows
from nav_core.navigation.states import ROWS, SLOW, STATES, VEHICLE, Weights
from nav_core.strapdown.kernels import curvatures, step_local
from nav_core.typing import Floats, Integers, kernel


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
def errors_pattern() -> Pattern:
    """Where `transition_of` can write off the diagonal.

    Returns
    -------
    Pattern
    """
    written = np.zeros((STATES, STATES))
    for i in range(3):
        written[i, 3 + i] = 1.0
        written[i, 6:12] = 1.0
        written[3 + i, 6:VEHICLE] = 1.0
        written[6 + i, 12:VEHICLE] = 1.0
    return pattern_of(written)


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
    pattern: Pattern,
    room: Room,
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
    pattern : Pattern
        Of `errors_pattern`.
    room : Room
        Of `kalman.kernels.room_for`; overwritten.

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
    propagate_into(P, Phi, half, P, pattern, room)
    return force, (wx / T, wy / T, wz / T)


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
        See `rows.fix_rows`.
    still : ndarray, shape (m,)
        1 where the vehicle seems to stand; becomes 0 where it speeds up or brakes nevertheless.
    density : ndarray, shape (m, 2)
        Of the interval before each epoch; see `advance`.
    arm : ndarray, shape (3,)
        See `rows.slip_rows`.
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
    left_out, since, pattern, room = 0, np.inf, errors_pattern(), room_for(STATES)
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
                pattern,
                room,
            )
            if still[j] > 0.0 and speeds_up(force, Phis[j], P, float(t[b] - t[a]), density[j, 0], weights):
                still[j] = 0.0
            if still[j] > 0.0:
                rest_rows(v, spin, float(t[b] - t[a]), density[j, 1], weights, e, H, s, r)
            else:
                slip_rows(v, C, spin, arm, weights, e, H, s, r)
        P_prior[j] = P
        fix_rows(place, v, slow, z[j], late[j], noise[j], e, H, s, r)
        strike(P, e[5:], H[5:], s[5:], weights.gate, room)
        now = float(t[sample[j]])
        if not np.isnan(e[0]):
            if strike_fix(P, e[:5], H[:5], s[:5], weights, now - since, room):
                left_out += 1
                since = min(since, now)
            else:
                since = np.inf
        else:
            strike(P, e[:5], H[:5], s[:5], weights.gate, room)
        update_sequential(corrections[j], P, e, H, r, np.inf, chi2, room)
        apply(place, v, C, slow, corrections[j])
        places[j], speeds[j], attitudes[j], slows[j], P_after[j] = place, v, C, slow, P
    return places, speeds, attitudes, slows, P_prior, P_after, Phis, corrections, left_out
