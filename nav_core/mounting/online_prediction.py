"""The online estimator's way from fix to fix, compiled: transition, with its few entries only, and process noise.

`online_reference` says the same in matrices.
"""

from __future__ import annotations

import numpy as np

from nav_core.mounting.online_model import (
    ACCELERATION,
    ACROSS,
    ACROSS_ERROR,
    ALONG,
    BANK,
    BIAS,
    BROKEN,
    CLIMB,
    COVERED,
    CURVE,
    ELAPSED,
    FORCE,
    FORCE_PER_SPEED,
    GPS_CHANGE,
    GRAVITY,
    GYRO,
    GYRO_BIAS,
    GYRO_PER_SPEED,
    HEIGHT,
    HEIGHT_ERROR,
    LEVER,
    N_STATES,
    PER_SPEED,
    PITCH_GAIN,
    ROLL_GAIN,
    SIDE,
    SLOPE,
    SPEED,
    SPEED_ERROR,
    SQUARE_ACROSS,
    SQUARE_ALONG,
    SQUARE_TURN,
    TRACK,
    TRACK_LOST,
    TURN,
    TURNED,
    UP,
    WAY,
    Tuning,
)
from nav_core.typing import Floats, kernel

MOVING = 10
"""The first states move; the others are constants of the drive."""

LOST = 1e4
TRACK_ANEW = 100.0
"""Variance after missing data: (m/s)² and rad²."""


@kernel
def turned(R: Floats, row: Floats, first: int, out: Floats) -> None:
    """Write ``R`` times the three columns from `first` on into `out`.

    Parameters
    ----------
    R : ndarray, shape (3, 3)
        From A to V.
    row : ndarray, shape (30,)
        What is known at a fix.
    first : int
        Column.
    out : ndarray, shape (3,)
        V axes, in the unit of the columns; overwritten.
    """
    for i in range(3):
        out[i] = R[i, 0] * row[first] + R[i, 1] * row[first + 1] + R[i, 2] * row[first + 2]


@kernel
def vectors(R: Floats, row: Floats, V: Floats) -> None:
    """Write the row's vectors, turned into the present V axes: force, force over speed, gyro, gyro over speed.

    Parameters
    ----------
    R : ndarray, shape (3, 3)
        From A to V.
    row : ndarray, shape (30,)
        What is known at a fix, A-frame.
    V : ndarray, shape (4, 3)
        m/s, rad (both over the step), rad and rad/m; overwritten.
    """
    turned(R, row, FORCE, V[0])
    turned(R, row, FORCE_PER_SPEED, V[1])
    turned(R, row, GYRO, V[2])
    turned(R, row, GYRO_PER_SPEED, V[3])


@kernel
def transition(x: Floats, row: Floats, V: Floats, tuning: Tuning, F: Floats) -> None:
    """Write the ten moving rows of the transition into `F` (10, 22); the other rows are the identity's.

    Parameters
    ----------
    x : ndarray, shape (22,)
        The states.
    row : ndarray, shape (30,)
        What is known at the fix.
    V : ndarray, shape (4, 3)
        Of `vectors`.
    tuning : Tuning
        What to expect.
    F : ndarray, shape (10, 22)
        Overwritten.
    """
    f, p, w, change = V[0], V[1], V[2], V[3]
    dt, d = row[COVERED], row[WAY]
    keep_x, keep_y = 1.0 - tuning.pitch_gain, 1.0 - tuning.roll_gain
    # The slope is a critically damped second-order process along the way; speed and height feel its mean.
    beta = 1.0 / tuning.slope_length
    decay = np.exp(-beta * d)
    z = max(beta * d, 1e-3)
    e = np.exp(-z)
    of_slope = (2.0 - (2.0 + z) * e) / z
    of_curve = d * (1.0 - (1.0 + z) * e) / (z * z)
    F[:] = 0.0
    F[SPEED, SPEED] = F[CLIMB, CLIMB] = F[HEIGHT, HEIGHT] = F[TRACK, TRACK] = 1.0
    F[SPEED, SLOPE], F[SPEED, CURVE] = -GRAVITY * dt * of_slope, -GRAVITY * dt * of_curve
    F[SPEED, TURN + 1], F[SPEED, TURN + 2] = keep_x * f[2], -keep_x * f[1]
    F[SPEED, BIAS], F[SPEED, PITCH_GAIN], F[SPEED, LEVER] = -dt, -row[ACCELERATION] * dt, row[SQUARE_TURN]
    F[CLIMB, SLOPE], F[CLIMB, BANK] = -row[GPS_CHANGE] - GRAVITY * x[SLOPE] * dt, -f[1]
    F[CLIMB, TURN], F[CLIMB, TURN + 1], F[CLIMB, BIAS + 2] = f[1], -f[0], -dt
    F[CLIMB, PITCH_GAIN], F[CLIMB, ROLL_GAIN] = -row[SQUARE_ALONG], -row[SQUARE_ACROSS]
    F[SLOPE, SLOPE], F[SLOPE, CURVE] = decay * (1.0 + beta * d), decay * d
    F[CURVE, SLOPE], F[CURVE, CURVE] = -beta * beta * d * decay, decay * (1.0 - beta * d)
    F[HEIGHT, SLOPE], F[HEIGHT, CURVE] = d * of_slope, d * of_curve
    F[BANK, BANK] = np.exp(-d / tuning.bank_length)
    slow = np.exp(-row[ELAPSED] / tuning.slow_time)
    F[SPEED_ERROR, SPEED_ERROR] = F[HEIGHT_ERROR, HEIGHT_ERROR] = F[ACROSS_ERROR, ACROSS_ERROR] = slow
    if w[2] == w[2]:
        F[TRACK, TURN], F[TRACK, TURN + 1], F[TRACK, GYRO_BIAS] = w[1], -w[0], -row[ELAPSED]
        F[TRACK, LEVER] = change[2]
    else:
        F[TRACK, BANK], F[TRACK, BIAS + 1] = -GRAVITY * row[PER_SPEED], -row[PER_SPEED]
        F[TRACK, TURN], F[TRACK, TURN + 2] = -keep_y * p[2], keep_y * p[0]
        F[TRACK, ROLL_GAIN], F[TRACK, LEVER] = -row[TURNED], -row[SIDE]


@kernel
def track_turn(row: Floats, V: Floats, tuning: Tuning) -> float:
    """Turn of the track over the step with all unknowns at their expected values, rad.

    Parameters
    ----------
    row : ndarray, shape (30,)
        What is known at a fix.
    V : ndarray, shape (4, 3)
        Of `vectors`.
    tuning : Tuning
        What to expect.

    Returns
    -------
    float
        rad, clockwise; by the gyro where there is one.
    """
    if V[2, 2] == V[2, 2]:
        return V[2, 2] + tuning.lever * V[3, 2]
    return (1.0 - tuning.roll_gain) * V[1, 1] - tuning.lever * row[SIDE]


@kernel
def predict(x: Floats, P: Floats, row: Floats, V: Floats, tuning: Tuning, scale: Floats, F: Floats) -> float:
    """State and covariance over one step; returns the change of speed that the force tells, m/s.

    Parameters
    ----------
    x : ndarray, shape (22,)
        Overwritten.
    P : ndarray, shape (22, 22)
        Overwritten.
    row : ndarray, shape (30,)
        What is known at the fix.
    V : ndarray, shape (4, 3)
        Of `vectors`.
    tuning : Tuning
        What to expect.
    scale : ndarray, shape (3,)
        Factors on the noise along, up and across.
    F : ndarray, shape (10, 22)
        Overwritten.

    Returns
    -------
    float
        m/s.
    """
    transition(x, row, V, tuning, F)
    dt, slope = row[COVERED], x[SLOPE]
    lift = V[0, 2] + GRAVITY * dt + 0.5 * GRAVITY * slope * slope * dt
    lift -= tuning.pitch_gain * row[SQUARE_ALONG] + tuning.roll_gain * row[SQUARE_ACROSS]
    moved = np.empty(MOVING)
    for i in range(MOVING):
        total = 0.0
        for j in range(N_STATES):
            total += F[i, j] * x[j]
        moved[i] = total
    moved[SPEED] += (1.0 - tuning.pitch_gain) * V[0, 0] + tuning.lever * row[SQUARE_TURN]
    # F holds the slope's square linearised: twice what it is, and half of that comes back here.
    moved[CLIMB] += lift
    moved[TRACK] += track_turn(row, V, tuning)
    forward = moved[SPEED] - x[SPEED]
    for i in range(MOVING):
        x[i] = moved[i]
    carry(P, F)
    disturb(P, row, V, tuning, scale, F)
    return forward


@kernel
def disturb(P: Floats, row: Floats, V: Floats, tuning: Tuning, scale: Floats, F: Floats) -> None:
    """Add the process noise of a step to `P`; to stationary processes, what the decay has lost.

    Parameters
    ----------
    P : ndarray, shape (22, 22)
        Overwritten.
    row : ndarray, shape (30,)
        What is known at the fix.
    V : ndarray, shape (4, 3)
        Of `vectors`.
    tuning : Tuning
        What to expect.
    scale : ndarray, shape (3,)
        Factors on the noise along, up and across.
    F : ndarray, shape (10, 22)
        Of `transition`.
    """
    dt, elapsed, d = row[COVERED], row[ELAPSED], row[WAY]
    along, up, across = scale[ALONG] ** 2, scale[UP] ** 2, scale[ACROSS] ** 2
    white = tuning.force**2 * dt
    P[SPEED, SPEED] += along * (white + (tuning.relative * V[0, 0]) ** 2)
    P[CLIMB, CLIMB] += up * white
    if row[BROKEN] > 0.0:
        P[SPEED, SPEED] += LOST
        P[CLIMB, CLIMB] += LOST
        P[HEIGHT, HEIGHT] += (0.02 * d) ** 2
    s2 = along * tuning.slope**2
    c2 = s2 / tuning.slope_length**2
    a, b, c, g = F[SLOPE, SLOPE], F[SLOPE, CURVE], F[CURVE, SLOPE], F[CURVE, CURVE]
    P[SLOPE, SLOPE] += s2 - a * a * s2 - b * b * c2
    P[CURVE, CURVE] += c2 - c * c * s2 - g * g * c2
    P[SLOPE, CURVE] -= a * c * s2 + b * g * c2
    P[CURVE, SLOPE] -= a * c * s2 + b * g * c2
    P[BANK, BANK] += across * (1.0 - F[BANK, BANK] ** 2) * tuning.bank**2
    fresh = 1.0 - F[SPEED_ERROR, SPEED_ERROR] ** 2
    P[SPEED_ERROR, SPEED_ERROR] += along * fresh * tuning.speed_slow**2
    P[HEIGHT_ERROR, HEIGHT_ERROR] += fresh * tuning.height_slow**2
    P[ACROSS_ERROR, ACROSS_ERROR] += across * fresh * tuning.across_slow**2
    P[TRACK, TRACK] += across * (tuning.relative_turn * track_turn(row, V, tuning)) ** 2
    if V[2, 2] == V[2, 2]:
        P[TRACK, TRACK] += tuning.gyro**2 * elapsed
    elif dt > 0.0:
        P[TRACK, TRACK] += across * white * (row[PER_SPEED] / dt) ** 2
    if row[TRACK_LOST] > 0.0:
        P[TRACK, TRACK] += TRACK_ANEW
    for i in range(3):
        P[BIAS + i, BIAS + i] += tuning.drift**2 * elapsed
    P[GYRO_BIAS, GYRO_BIAS] += tuning.gyro_drift**2 * elapsed


@kernel
def carry(P: Floats, F: Floats) -> None:
    """``P = F P F'``, using that the rows of `F` have few entries.

    Parameters
    ----------
    P : ndarray, shape (22, 22)
        Overwritten.
    F : ndarray, shape (10, 22)
        Of `transition`.
    """
    columns, values = np.empty((MOVING, N_STATES), dtype=np.int64), np.empty((MOVING, N_STATES))
    count = np.zeros(MOVING, dtype=np.int64)
    block = np.zeros((MOVING, N_STATES))
    for i in range(MOVING):
        for j in range(N_STATES):
            if F[i, j] != 0.0:
                columns[i, count[i]], values[i, count[i]] = j, F[i, j]
                count[i] += 1
        for k in range(count[i]):
            for c in range(N_STATES):
                block[i, c] += values[i, k] * P[columns[i, k], c]
    for i in range(MOVING):
        for r in range(i, MOVING):
            total = 0.0
            for k in range(count[i]):
                total += values[i, k] * block[r, columns[i, k]]
            P[r, i] = P[i, r] = total
        for c in range(MOVING, N_STATES):
            P[i, c] = P[c, i] = block[i, c]
