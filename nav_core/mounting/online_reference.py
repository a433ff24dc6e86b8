"""One step of the online estimator in matrices: what `online_kernel` is tested against.

The transition is a full matrix written block by block, process noise of the slope comes out of its
stationarity, updates are in Joseph's form, rotations are scipy's; the kernel has none of these.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from nav_core.mounting import online_model as m
from nav_core.mounting.online_kernel import FOLLOW
from nav_core.mounting.online_measurements import CLIPPED, COURSE_FLOOR, FADE, JERK_TIME
from nav_core.mounting.online_model import GRAVITY, Filters, Tuning
from nav_core.mounting.online_prediction import LOST, TRACK_ANEW
from nav_core.rotation import skew, wrap
from nav_core.typing import Floats

AXES = slice(m.TURN, m.TURN + 3)
BIASES = slice(m.BIAS, m.BIAS + 3)
ROAD = slice(m.SLOPE, m.CURVE + 1)


def _three(row: Floats, first: int, R_va: Floats) -> Floats:
    return R_va @ row[first : first + 3]


def _has_gyro(row: Floats) -> bool:
    return bool(np.isfinite(row[m.GYRO]))


def transition(x: Floats, row: Floats, R_va: Floats, tuning: Tuning) -> tuple[Floats, Floats, Floats]:
    """``x = F x + u`` with the Jacobian of the whole, whose slope enters squared: F, u, Jacobian.

    Parameters
    ----------
    x : ndarray, shape (22,)
        The states.
    row : ndarray, shape (30,)
        What is known at the fix.
    R_va : ndarray, shape (3, 3)
        From A to V.
    tuning : Tuning
        What to expect.

    Returns
    -------
    F : ndarray, shape (22, 22)
        Without the square of the slope.
    u : ndarray, shape (22,)
        What the row alone adds.
    jacobian : ndarray, shape (22, 22)
        With it.
    """
    f, p = _three(row, m.FORCE, R_va), _three(row, m.FORCE_PER_SPEED, R_va)
    dt, d = row[m.COVERED], row[m.WAY]
    keep_x, keep_y = 1.0 - tuning.pitch_gain, 1.0 - tuning.roll_gain
    length = tuning.slope_length
    z = max(d / length, 1e-3)
    means = np.array([(2.0 - (2.0 + z) * np.exp(-z)) / z, d * (1.0 - (1.0 + z) * np.exp(-z)) / z**2])
    F, u = np.eye(m.N_STATES), np.zeros(m.N_STATES)
    F[m.SPEED, ROAD] = -GRAVITY * dt * means
    F[m.SPEED, AXES] = keep_x * -skew(f)[0]
    F[m.SPEED, [m.BIAS, m.PITCH_GAIN, m.LEVER]] = -dt, -row[m.ACCELERATION] * dt, row[m.SQUARE_TURN]
    u[m.SPEED] = keep_x * f[0] + tuning.lever * row[m.SQUARE_TURN]
    F[m.CLIMB, [m.SLOPE, m.BANK, m.BIAS + 2]] = -row[m.GPS_CHANGE], -f[1], -dt
    F[m.CLIMB, AXES] = -skew(f)[2]
    F[m.CLIMB, [m.PITCH_GAIN, m.ROLL_GAIN]] = -row[[m.SQUARE_ALONG, m.SQUARE_ACROSS]]
    u[m.CLIMB] = f[2] + GRAVITY * dt - 0.5 * GRAVITY * x[m.SLOPE] ** 2 * dt
    u[m.CLIMB] -= row[[m.SQUARE_ALONG, m.SQUARE_ACROSS]] @ [tuning.pitch_gain, tuning.roll_gain]
    generator = np.array([[1.0, length], [-1.0 / length, -1.0]]) * (d / length)
    F[ROAD, ROAD] = np.exp(-d / length) * (np.eye(2) + generator)
    F[m.HEIGHT, ROAD] = d * means
    F[m.BANK, m.BANK] = np.exp(-d / tuning.bank_length)
    for slow in (m.SPEED_ERROR, m.HEIGHT_ERROR, m.ACROSS_ERROR):
        F[slow, slow] = np.exp(-row[m.ELAPSED] / tuning.slow_time)
    if _has_gyro(row):
        w, change = _three(row, m.GYRO, R_va), _three(row, m.GYRO_PER_SPEED, R_va)
        F[m.TRACK, AXES] = -skew(w)[2]
        F[m.TRACK, [m.GYRO_BIAS, m.LEVER]] = -row[m.ELAPSED], change[2]
        u[m.TRACK] = w[2] + tuning.lever * change[2]
    else:
        F[m.TRACK, AXES] = keep_y * -skew(p)[1]
        F[m.TRACK, [m.BANK, m.BIAS + 1]] = -GRAVITY * row[m.PER_SPEED], -row[m.PER_SPEED]
        F[m.TRACK, [m.ROLL_GAIN, m.LEVER]] = -row[[m.TURNED, m.SIDE]]
        u[m.TRACK] = keep_y * p[1] - tuning.lever * row[m.SIDE]
    jacobian = F.copy()
    jacobian[m.CLIMB, m.SLOPE] -= GRAVITY * x[m.SLOPE] * dt
    return F, u, jacobian


def process_noise(row: Floats, F: Floats, u: Floats, f_along: float, tuning: Tuning, scale: Floats) -> Floats:
    """Q of a step: white noise of the force, what the model may miss, what keeps stationary processes so.

    Parameters
    ----------
    row : ndarray, shape (30,)
        What is known at the fix.
    F : ndarray, shape (22, 22)
        Of `transition`.
    u : ndarray, shape (22,)
        Of `transition`.
    f_along : float
        Integral of longitudinal specific force over the step, m/s.
    tuning : Tuning
        What to expect.
    scale : ndarray, shape (3,)
        Factors on the noise along, up and across.

    Returns
    -------
    ndarray, shape (22, 22)
        Covariance.
    """
    dt, elapsed = row[m.COVERED], row[m.ELAPSED]
    along, up, across = scale**2
    rest = np.zeros((m.N_STATES, m.N_STATES))
    rest[ROAD, ROAD] = along * np.diag([tuning.slope**2, (tuning.slope / tuning.slope_length) ** 2])
    rest[m.BANK, m.BANK] = across * tuning.bank**2
    for slow, variance in (
        (m.SPEED_ERROR, along * tuning.speed_slow**2),
        (m.HEIGHT_ERROR, tuning.height_slow**2),
        (m.ACROSS_ERROR, across * tuning.across_slow**2),
    ):
        rest[slow, slow] = variance
    keep = np.array([m.SLOPE, m.CURVE, m.BANK, m.SPEED_ERROR, m.HEIGHT_ERROR, m.ACROSS_ERROR])
    Q = np.zeros_like(rest)
    block = np.ix_(keep, keep)
    Q[block] = rest[block] - F[block] @ rest[block] @ F[block].T
    white = tuning.force**2 * dt
    diagonal = np.zeros(m.N_STATES)
    diagonal[m.SPEED] = along * (white + (tuning.relative * f_along) ** 2) + LOST * row[m.BROKEN]
    diagonal[m.CLIMB] = up * white + LOST * row[m.BROKEN]
    diagonal[m.HEIGHT] = (0.02 * row[m.WAY]) ** 2 * row[m.BROKEN]
    turning = tuning.gyro**2 * elapsed
    if not _has_gyro(row):
        turning = across * white * (row[m.PER_SPEED] / dt) ** 2 if dt > 0.0 else 0.0
    missed = across * (tuning.relative_turn * u[m.TRACK]) ** 2
    diagonal[m.TRACK] = missed + turning + TRACK_ANEW * row[m.TRACK_LOST]
    diagonal[BIASES] = tuning.drift**2 * elapsed
    diagonal[m.GYRO_BIAS] = tuning.gyro_drift**2 * elapsed
    return Q + np.diag(diagonal)


def second_order(x: Floats, P: Floats, lag: int, rate: float) -> float:
    """Variance of what is quadratic in a lag, as far as it is still unknown or not yet in the reference.

    Parameters
    ----------
    x : ndarray, shape (22,)
        The states.
    P : ndarray, shape (22, 22)
        Their covariance.
    lag : int
        Which state the lag is.
    rate : float
        Of what lags: m/s² or rad/s.

    Returns
    -------
    float
        m²/s² or rad².
    """
    return 0.5 * float((P[lag, lag] + x[lag] ** 2) * rate / JERK_TIME) ** 2


def measurements(row: Floats, R_va: Floats, tuning: Tuning, scale: Floats) -> list[tuple[int, Floats, float, float]]:
    """What a row says, in order: kind, row of H, measured less constant, variance.

    Parameters
    ----------
    row : ndarray, shape (30,)
        What is known at the fix.
    R_va : ndarray, shape (3, 3)
        From A to V.
    tuning : Tuning
        What to expect.
    scale : ndarray, shape (3,)
        Factors on the noise along, up and across.

    Returns
    -------
    list of tuple[int, ndarray, float, float]
        Rows of H have shape (22,).
    """
    out: list[tuple[int, Floats, float, float]] = []

    def add(kind: int, entries: dict[int, float], y: float, r: float) -> None:
        H = np.zeros(m.N_STATES)
        H[list(entries)] = list(entries.values())
        out.append((kind, H, y, r))

    v, standing = float(row[m.GPS_SPEED]), bool(row[m.STANDING])
    if standing:
        add(m.OF_SPEED, {m.SPEED: 1.0}, 0.0, tuning.rest**2)
    else:
        entries = {m.SPEED: 1.0, m.SPEED_ERROR: 1.0, m.SPEED_LAG: -float(row[m.ACCELERATION])}
        add(m.OF_SPEED, entries, v, (scale[m.ALONG] * tuning.speed_white) ** 2)
    if np.isfinite(row[m.GPS_HEIGHT]):
        add(m.OF_HEIGHT, {m.HEIGHT: 1.0, m.HEIGHT_ERROR: 1.0}, float(row[m.GPS_HEIGHT]), tuning.height_white**2)
    add(m.OF_CLIMB, {m.CLIMB: 1.0, m.SLOPE: v}, 0.0, (scale[m.UP] * tuning.heave) ** 2)
    if np.isfinite(row[m.GPS_COURSE]):
        now = 1.0 / max(v, COURSE_FLOOR)
        entries = {m.TRACK: 1.0, m.ACROSS_ERROR: now, m.COURSE_LAG: -float(row[m.TURN_RATE])}
        add(m.OF_COURSE, entries, float(row[m.GPS_COURSE]), (scale[m.ACROSS] * tuning.across_white * now) ** 2 + 1e-6)
    if _has_gyro(row):
        w, change = _three(row, m.GYRO, R_va), _three(row, m.GYRO_PER_SPEED, R_va)
        p, elapsed = _three(row, m.FORCE_PER_SPEED, R_va), float(row[m.ELAPSED])
        if elapsed <= 0.0:
            return out
        if standing:
            add(m.OF_SIDE, {m.GYRO_BIAS: elapsed}, float(w[2]), tuning.gyro**2 * elapsed)
        elif not row[m.TRACK_LOST] and not row[m.BROKEN] and row[m.COVERED] > 0.0:
            keep, inverse = 1.0 - tuning.roll_gain, float(row[m.PER_SPEED])
            felt = float(keep * p[1] - tuning.lever * row[m.SIDE])
            H = np.zeros(m.N_STATES)
            H[AXES] = -skew(w)[2] + keep * skew(p)[1]
            H[[m.BIAS + 1, m.BANK, m.ROLL_GAIN]] = inverse, GRAVITY * inverse, row[m.TURNED]
            H[[m.LEVER, m.GYRO_BIAS]] = change[2] + row[m.SIDE], -elapsed
            r = tuning.force**2 * inverse**2 / row[m.COVERED] + (tuning.relative_turn * felt) ** 2
            y = felt - float(w[2]) - tuning.lever * float(change[2])
            out.append((m.OF_SIDE, H, y, scale[m.ACROSS] ** 2 * float(r) + tuning.gyro**2 * elapsed))
    return out


def step(filters: Filters, row: Floats, tuning: Tuning) -> Filters:
    """One filter after one row; `filters` holds one filter and stays as it is.

    Parameters
    ----------
    filters : Filters
        One filter.
    row : ndarray, shape (30,)
        What is known at the fix.
    tuning : Tuning
        What to expect.

    Returns
    -------
    Filters
        The filter afterwards.
    """
    x, cov, R_va = filters.x[0].copy(), filters.P[0], filters.R_va[0]
    notes, likelihood = filters.notes[0].copy(), float(filters.likelihood[0])
    F, u, jacobian = transition(x, row, R_va, tuning)
    Q = process_noise(row, F, u, float(_three(row, m.FORCE, R_va)[0]), tuning, filters.scale[0])
    x, cov = F @ x + u, jacobian @ cov @ jacobian.T + Q
    for kind, H, y, given in measurements(row, R_va, tuning, filters.scale[0]):
        r = given
        if kind == m.OF_SPEED and not row[m.STANDING]:
            r += second_order(x, cov, m.SPEED_LAG, float(row[m.ACCELERATION]))
        if kind == m.OF_COURSE:
            r += second_order(x, cov, m.COURSE_LAG, float(row[m.TURN_RATE]))
        nu = y - H @ x
        nu = float(wrap(np.array(nu))) if kind == m.OF_COURSE else float(nu)
        S = float(H @ cov @ H) + r
        ratio = nu**2 / S
        notes[kind] = (1.0 - 1.0 / FADE) * notes[kind] + [min(ratio, CLIPPED), 1.0]
        likelihood -= 0.5 * (min(ratio, CLIPPED) + float(np.log(S)))
        widened = S * max(np.sqrt(ratio) / tuning.limit, 1.0)
        K = cov @ H / widened
        x = x + K * nu
        left = np.eye(m.N_STATES) - np.outer(K, H)
        cov = left @ cov @ left.T + np.outer(K, K) * (widened - (S - r))
    x[m.SPEED] = max(x[m.SPEED], 0.0)
    if np.linalg.norm(x[AXES]) > FOLLOW:
        turn = Rotation.from_rotvec(x[AXES]).as_matrix()
        R_va = turn @ R_va
        T = np.eye(m.N_STATES)
        T[BIASES, BIASES] = turn
        x, cov = T @ x, T @ cov @ T.T
        x[AXES] = 0.0
    return Filters(x[None], cov[None], R_va[None], np.array([likelihood]), filters.scale, notes[None])
