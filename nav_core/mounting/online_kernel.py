"""The online estimator's steps, compiled: one fix after another, one filter after another.

Analytic derivatives, transition rows with their few entries only, scalar measurements in turn.
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
    COURSE_LAG,
    COVERED,
    CURVE,
    ELAPSED,
    FORCE,
    FORCE_PER_SPEED,
    GPS_CHANGE,
    GPS_COURSE,
    GPS_HEIGHT,
    GPS_SPEED,
    GRAVITY,
    GYRO,
    GYRO_BIAS,
    GYRO_PER_SPEED,
    HEIGHT,
    HEIGHT_ERROR,
    LEVER,
    N_STATES,
    OF_CLIMB,
    OF_COURSE,
    OF_HEIGHT,
    OF_SIDE,
    OF_SPEED,
    PER_SPEED,
    PITCH_GAIN,
    ROLL_GAIN,
    SIDE,
    SLOPE,
    SPEED,
    SPEED_ERROR,
    SPEED_LAG,
    SQUARE_ACROSS,
    SQUARE_ALONG,
    SQUARE_TURN,
    STANDING,
    TRACK,
    TRACK_LOST,
    TURN,
    TURN_RATE,
    TURNED,
    UP,
    WAY,
    Filters,
    Tuning,
)
from nav_core.typing import Floats, Integers, kernel

FADE = 300.0
"""Memory of the innovation statistics, in fixes."""

CLIPPED = 25.0
"""A squared normalised innovation counts for no more than this."""

FOLLOW = 0.035
"""The reference mounting follows once the estimate has left it by this angle, rad: derivatives stay put between."""

COURSE_FLOOR = 1.0
"""Least divisor where course is in play, m/s."""

MOVING = 10
"""The first states move; the others are constants of the drive."""

JERK_TIME = 1.0
"""Acceleration and turn rate change by their own size in this time, s: the second order of a lag not yet known."""

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


@kernel
def assimilate(
    x: Floats, P: Floats, columns: Integers, h: Floats, nu: float, r: float, limit: float, note: Floats, spread: Floats
) -> float:
    """Fold in a scalar innovation whose row has the entries `h` at `columns`; returns its log likelihood.

    Beyond `limit` sigmas the innovation's variance grows with it (Huber's weight).  `note` is where the
    statistics of its kind are kept: misfit and count.

    Parameters
    ----------
    x : ndarray, shape (22,)
        Overwritten.
    P : ndarray, shape (22, 22)
        Overwritten.
    columns : ndarray of int, shape (k,)
        States that the measurement sees.
    h : ndarray, shape (k,)
        Its derivatives by them.
    nu : float
        Innovation.
    r : float
        Variance of the measurement's noise.
    limit : float
        Sigmas.
    note : ndarray, shape (2,)
        Overwritten.
    spread : ndarray, shape (22,)
        Overwritten.

    Returns
    -------
    float
        Natural logarithm, up to a constant.
    """
    count = columns.size
    for i in range(N_STATES):
        total = 0.0
        for k in range(count):
            total += P[columns[k], i] * h[k]
        spread[i] = total
    variance = r
    for k in range(count):
        variance += h[k] * spread[columns[k]]
    ratio = nu * nu / variance
    keep = 1.0 - 1.0 / FADE
    note[0] = keep * note[0] + min(ratio, CLIPPED)
    note[1] = keep * note[1] + 1.0
    likelihood = -0.5 * (min(ratio, CLIPPED) + np.log(variance))
    if ratio > limit * limit:
        variance *= np.sqrt(ratio) / limit
    gain = 1.0 / variance
    for i in range(N_STATES):
        x[i] += spread[i] * gain * nu
        for j in range(i + 1):
            P[i, j] -= spread[i] * spread[j] * gain
            P[j, i] = P[i, j]
    return likelihood


@kernel
def receive(x: Floats, P: Floats, row: Floats, tuning: Tuning, scale: Floats, notes: Floats, spread: Floats) -> float:
    """The receiver's speed, height and course, and that climb is speed times slope; returns the log likelihood.

    Parameters
    ----------
    x : ndarray, shape (22,)
        Overwritten.
    P : ndarray, shape (22, 22)
        Overwritten.
    row : ndarray, shape (30,)
        What is known at the fix.
    tuning : Tuning
        What to expect.
    scale : ndarray, shape (3,)
        Factors on the noise along, up and across.
    notes : ndarray, shape (5, 2)
        Innovation statistics by kind; overwritten.
    spread : ndarray, shape (22,)
        Overwritten.

    Returns
    -------
    float
        Natural logarithm, up to a constant.
    """
    v = row[GPS_SPEED]
    total = 0.0
    if row[STANDING] > 0.0:
        one, h = np.array([SPEED]), np.ones(1)
        total += assimilate(x, P, one, h, -x[SPEED], tuning.rest**2, tuning.limit, notes[OF_SPEED], spread)
    else:
        three, h = np.array([SPEED, SPEED_ERROR, SPEED_LAG]), np.array([1.0, 1.0, -row[ACCELERATION]])
        nu = v - x[SPEED] - x[SPEED_ERROR] + row[ACCELERATION] * x[SPEED_LAG]
        bend = (P[SPEED_LAG, SPEED_LAG] + x[SPEED_LAG] ** 2) * row[ACCELERATION] / JERK_TIME
        r = (tuning.speed_white * scale[ALONG]) ** 2 + 0.5 * bend * bend
        total += assimilate(x, P, three, h, nu, r, tuning.limit, notes[OF_SPEED], spread)
    if row[GPS_HEIGHT] == row[GPS_HEIGHT]:
        two, h = np.array([HEIGHT, HEIGHT_ERROR]), np.ones(2)
        nu = row[GPS_HEIGHT] - x[HEIGHT] - x[HEIGHT_ERROR]
        total += assimilate(x, P, two, h, nu, tuning.height_white**2, tuning.limit, notes[OF_HEIGHT], spread)
    two, h = np.array([CLIMB, SLOPE]), np.array([1.0, v])
    nu = -x[CLIMB] - v * x[SLOPE]
    total += assimilate(x, P, two, h, nu, (tuning.heave * scale[UP]) ** 2, tuning.limit, notes[OF_CLIMB], spread)
    if row[GPS_COURSE] == row[GPS_COURSE]:
        now = 1.0 / max(v, COURSE_FLOOR)
        w = row[TURN_RATE]
        three, h = np.array([TRACK, ACROSS_ERROR, COURSE_LAG]), np.array([1.0, now, -w])
        nu = row[GPS_COURSE] - x[TRACK] - now * x[ACROSS_ERROR] + w * x[COURSE_LAG]
        nu -= 2.0 * np.pi * np.round(nu / (2.0 * np.pi))
        bend = (P[COURSE_LAG, COURSE_LAG] + x[COURSE_LAG] ** 2) * w / JERK_TIME
        r = (tuning.across_white * scale[ACROSS] * now) ** 2 + 1e-6 + 0.5 * bend * bend
        total += assimilate(x, P, three, h, nu, r, tuning.limit, notes[OF_COURSE], spread)
    return total


@kernel
def compare_gyro(
    x: Floats, P: Floats, row: Floats, V: Floats, tuning: Tuning, scale: Floats, notes: Floats, spread: Floats
) -> float:
    """Turn by the side force against turn by the gyro; at rest, the gyro against nothing.

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
    notes : ndarray, shape (5, 2)
        Innovation statistics by kind; overwritten.
    spread : ndarray, shape (22,)
        Overwritten.

    Returns
    -------
    float
        Natural logarithm, up to a constant; 0 where nothing is compared.
    """
    p, w, change = V[1], V[2], V[3]
    elapsed, inverse = row[ELAPSED], row[PER_SPEED]
    if elapsed <= 0.0:
        return 0.0
    if row[STANDING] > 0.0:
        one, h = np.array([GYRO_BIAS]), np.array([elapsed])
        nu = w[2] - elapsed * x[GYRO_BIAS]
        return assimilate(x, P, one, h, nu, tuning.gyro**2 * elapsed, tuning.limit, notes[OF_SIDE], spread)
    if row[TRACK_LOST] > 0.0 or row[BROKEN] > 0.0 or row[COVERED] <= 0.0:
        return 0.0
    keep = 1.0 - tuning.roll_gain
    felt = keep * p[1] - tuning.lever * row[SIDE]
    columns = np.array([TURN, TURN + 1, TURN + 2, BIAS + 1, BANK, ROLL_GAIN, LEVER, GYRO_BIAS])
    h = np.array(
        [
            w[1] + keep * p[2],
            -w[0],
            -keep * p[0],
            inverse,
            GRAVITY * inverse,
            row[TURNED],
            change[2] + row[SIDE],
            -elapsed,
        ]
    )
    nu = felt - w[2] - tuning.lever * change[2]
    for k in range(columns.size):
        nu -= h[k] * x[columns[k]]
    r = tuning.force**2 * inverse**2 / row[COVERED] + (tuning.relative_turn * felt) ** 2
    r = scale[ACROSS] ** 2 * r + tuning.gyro**2 * elapsed
    return assimilate(x, P, columns, h, nu, r, tuning.limit, notes[OF_SIDE], spread)


@kernel
def move_reference(x: Floats, P: Floats, R: Floats) -> None:
    """Put the small rotation into the reference and turn the biases, which belong to the box, with the axes.

    Parameters
    ----------
    x : ndarray, shape (22,)
        Its turn becomes zero.
    P : ndarray, shape (22, 22)
        Overwritten.
    R : ndarray, shape (3, 3)
        From A to V; overwritten.
    """
    a, b, c = x[TURN], x[TURN + 1], x[TURN + 2]
    angle = np.sqrt(a * a + b * b + c * c)
    s = np.sin(angle) / angle
    q = (1.0 - np.cos(angle)) / (angle * angle)
    M = np.empty((3, 3))
    M[0, 0], M[0, 1], M[0, 2] = 1.0 - q * (b * b + c * c), q * a * b - s * c, q * a * c + s * b
    M[1, 0], M[1, 1], M[1, 2] = q * a * b + s * c, 1.0 - q * (a * a + c * c), q * b * c - s * a
    M[2, 0], M[2, 1], M[2, 2] = q * a * c - s * b, q * b * c + s * a, 1.0 - q * (a * a + b * b)
    R[:] = M @ R
    x[TURN : TURN + 3] = 0.0
    x[BIAS : BIAS + 3] = M @ x[BIAS : BIAS + 3]
    block = np.ascontiguousarray(P[BIAS : BIAS + 3])
    P[BIAS : BIAS + 3] = M @ block
    P[:, BIAS : BIAS + 3] = np.ascontiguousarray(P[BIAS : BIAS + 3]).T
    block = np.ascontiguousarray(P[BIAS : BIAS + 3, BIAS : BIAS + 3])
    P[BIAS : BIAS + 3, BIAS : BIAS + 3] = M @ block
    for i in range(3):
        for j in range(i):
            mean = 0.5 * (P[BIAS + i, BIAS + j] + P[BIAS + j, BIAS + i])
            P[BIAS + i, BIAS + j] = P[BIAS + j, BIAS + i] = mean


@kernel
def step(
    x: Floats,
    P: Floats,
    R: Floats,
    row: Floats,
    tuning: Tuning,
    scale: Floats,
    notes: Floats,
    F: Floats,
    V: Floats,
    spread: Floats,
) -> tuple[float, float]:
    """One fix: returns the log likelihood and the change of speed that the force told, m/s.

    Parameters
    ----------
    x : ndarray, shape (22,)
        Overwritten.
    P : ndarray, shape (22, 22)
        Overwritten.
    R : ndarray, shape (3, 3)
        From A to V; overwritten.
    row : ndarray, shape (30,)
        What is known at the fix.
    tuning : Tuning
        What to expect.
    scale : ndarray, shape (3,)
        Factors on the noise along, up and across.
    notes : ndarray, shape (5, 2)
        Innovation statistics by kind; overwritten.
    F : ndarray, shape (10, 22)
        Overwritten.
    V : ndarray, shape (4, 3)
        Overwritten.
    spread : ndarray, shape (22,)
        Overwritten.

    Returns
    -------
    tuple of float
        Log likelihood without unit, and m/s.
    """
    vectors(R, row, V)
    forward = predict(x, P, row, V, tuning, scale, F)
    likelihood = receive(x, P, row, tuning, scale, notes, spread)
    if V[2, 2] == V[2, 2]:
        likelihood += compare_gyro(x, P, row, V, tuning, scale, notes, spread)
    x[SPEED] = max(x[SPEED], 0.0)
    if x[TURN] ** 2 + x[TURN + 1] ** 2 + x[TURN + 2] ** 2 > FOLLOW**2:
        move_reference(x, P, R)
    return likelihood, forward


@kernel
def run(filters: Filters, rows: Floats, first: Integers, last: Integers, tuning: Tuning, trace: Floats) -> None:
    """Run filter `i` over ``rows[first[i]:last[i]]``; overwrites the filters.

    `trace` (steps of all filters one after the other, 4), or without rows if nobody wants to know, gets after each
    step the variances of the turn (3) and the change of speed that the force told.

    Parameters
    ----------
    filters : Filters
        m of them; overwritten.
    rows : ndarray, shape (n, 30)
        What is known at the fixes.
    first, last : ndarray of int, shape (m,)
        Range of each filter's rows; `last` is not included.
    tuning : Tuning
        What to expect.
    trace : ndarray, shape (k, 4)
        rad² and m/s; overwritten.
    """
    F, V, spread = np.zeros((MOVING, N_STATES)), np.empty((4, 3)), np.empty(N_STATES)
    done = 0
    for i in range(first.size):
        x, P, R, notes = filters.x[i], filters.P[i], filters.R_va[i], filters.notes[i]
        for k in range(first[i], last[i]):
            likelihood, forward = step(x, P, R, rows[k], tuning, filters.scale[i], notes, F, V, spread)
            filters.likelihood[i] += likelihood
            if trace.shape[0] > 0:
                for m in range(3):
                    trace[done, m] = P[TURN + m, TURN + m]
                trace[done, 3] = forward
                done += 1
