"""What a fix says to the online estimator, compiled: scalar measurements in turn, with analytic derivatives.

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
    ELAPSED,
    GPS_COURSE,
    GPS_HEIGHT,
    GPS_SPEED,
    GRAVITY,
    GYRO_BIAS,
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
    ROLL_GAIN,
    SIDE,
    SLOPE,
    SPEED,
    SPEED_ERROR,
    SPEED_LAG,
    STANDING,
    TRACK,
    TRACK_LOST,
    TURN,
    TURN_RATE,
    TURNED,
    UP,
    Tuning,
)
from nav_core.typing import Floats, Integers, kernel

FADE = 300.0
"""Memory of the innovation statistics, in fixes."""

CLIPPED = 25.0
"""A squared normalised innovation counts for no more than this."""

COURSE_FLOOR = 1.0
"""Least divisor where course is in play, m/s."""

JERK_TIME = 1.0
"""Acceleration and turn rate change by their own size in this time, s: the second order of a lag not yet known."""


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
