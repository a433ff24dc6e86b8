"""What a car, a road, a receiver and a box do: the linear model behind the whole-drive estimate.

Two systems share the unknowns.  The *pitch plane* holds speed, climb, slope and height, driven by
the longitudinal and vertical specific force; the *yaw plane* holds course and bank, driven by the
lateral one.  Specific force is integrated and compared with what the receiver says, so GPS is
never differentiated, its noise stays in its place, and slow fixes lose nothing.

Signs, for small road and body angles (V-frame; slope s uphill positive, climb downward positive)::

    f_x = v' + g s + kappa_x v' - l_x w²
    f_y = v w + g bank + kappa_y v w + l_x w'
    f_z = -g + g s²/2 + climb' + v' s + f_y bank + (kappa_x v'² + kappa_y f_y²) / g
    course = heading + l_x w / v

`v` is the speed of the box; ``l_x`` its place ahead of the point that does not slip.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from nav_core.mounting.stretch import (
    Fixes,
    Record,
    Steps,
    at,
    clear_rate,
    gps_rate,
    integrate,
    rough_share,
    smoothed,
    steps_of,
    unrolled,
)
from nav_core.mounting.whitening import Channel
from nav_core.typing import Flags, Floats

GRAVITY = 9.80665
MILLI_G = 1e-3 * GRAVITY

# Places of the unknowns in p.
TURN = slice(0, 3)
BIAS = slice(3, 6)
PITCH_GAIN, ROLL_GAIN, LEVER_X, ANTENNA_X, ANTENNA_Y, SPEED_LAG, COURSE_LAG = range(6, 13)
UNKNOWNS = 13
PITCH_UNKNOWNS = np.array([0, 1, 2, 3, 5, PITCH_GAIN, ROLL_GAIN, LEVER_X, ANTENNA_Y, SPEED_LAG])
YAW_UNKNOWNS = np.array([0, 2, 4, ROLL_GAIN, LEVER_X, ANTENNA_X, COURSE_LAG])


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """How much of what to expect; the prior knowledge of the estimator, SI units.

    The figures are those of ordinary cars, roads and receivers and are meant to be generous rather
    than tuned; the innovation statistics widen the result where a drive is worse.
    """

    speed_white: float = 0.06
    speed_slow: float = 0.06
    """Errors of GPS velocity along the travel, m/s: per fix, and slowly varying."""
    across_white: float = 0.06
    across_slow: float = 0.06
    """The same across the travel: course times speed, m/s."""
    slow_time: float = 4.0
    """Correlation time of the slow errors of speed, course and height, s."""
    height_white: float = 0.5
    height_slow: float = 3.0
    """m."""
    slope: float = 0.03
    slope_length: float = 110.0
    """Deviation (rad) and correlation length (m) of the slope, a smooth (second-order) process."""
    bank: float = np.radians(0.8)
    bank_length: float = 80.0
    """Deviation (rad) and correlation length (m) of the bank, a rough (first-order) process."""
    force: float = 0.012
    """White noise of specific force: sensor, vibration left over, (m/s²)/√Hz."""
    relative: float = 0.005
    relative_turn: float = 0.005
    """Share of a change of speed, and of course, that the model may miss."""
    heave: float = 0.03
    """Vertical velocity of the body on its springs, m/s."""
    crown: float = np.radians(0.7)
    """Mean sideways tilt of the roads of a drive; part of the mounting for all the data can tell, rad.
    Roads fall by one to two percent to one side: not a bell curve.  The figure is such that 1.96 of it
    is the 95 % limit, which is what an interval is made of."""
    crown_mean: float = 0.0
    """What is expected of it, right side down positive; see `roads_of`, rad."""
    bias: float = 5.0 * MILLI_G
    """Accelerometer bias before the drive has spoken, per axis, m/s²."""
    drift: float = 1.0 * MILLI_G / np.sqrt(300.0)
    """Random walk of the bias (temperature), (m/s²)/√s."""
    pitch_gain: tuple[float, float] = (0.04, 0.02)
    roll_gain: tuple[float, float] = (0.07, 0.03)
    """Body pitch and roll per g, as a share of specific force: mean and deviation."""
    lever: tuple[float, float] = (1.0, 0.8)
    """How far the box sits ahead of the point that does not slip: mean and deviation, m."""
    antenna: float = 0.3
    """Deviation of the antenna from the box, ahead and to the right, m."""
    lag: tuple[float, float] = (0.3, 0.5)
    """Of the receiver: mean and deviation, s."""


TrafficSide = Literal["left", "right"]


def roads_of(traffic_side: TrafficSide | None) -> Noise:
    """Prior knowledge where the side of the traffic is known: roads fall towards their edge.

    Parameters
    ----------
    traffic_side : {"left", "right"}, optional

    Returns
    -------
    Noise
        Expecting 0.75° of mean bank, give or take 0.4°: one to two percent, and now and then a road that
        falls to the other side.
    """
    if traffic_side is None:
        return Noise()
    side = 1.0 if traffic_side == "right" else -1.0
    return Noise(crown=np.radians(0.4), crown_mean=side * np.radians(0.75))


def less_crown(R_va: Floats, noise: Noise) -> Floats:
    """A mounting without the expected mean bank of the roads, which a drive cannot tell from it, shape (3, 3).

    Parameters
    ----------
    R_va : ndarray, shape (3, 3)
        From A to V.
    noise : Noise
        Says what bank is expected.

    Returns
    -------
    ndarray, shape (3, 3)
        Turned about V's x by it.
    """
    c, s = np.cos(noise.crown_mean), np.sin(noise.crown_mean)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]]) @ R_va


LONGEST_STEP = 3.0
"""Between fixes further apart the course is not followed, s."""

FLOOR_SPEED = 1.0
"""Divisor's floor where course is integrated, m/s."""


def _difference(values: Floats, broken: Flags) -> Floats:
    out = np.diff(values, axis=0, prepend=values[:1])
    out[broken] = 0.0
    return out


def _slow(elapsed: Floats, time: float) -> tuple[Floats, Floats]:
    """Decay and fresh variance (share) of a first-order process over each step."""
    decay = np.exp(-np.maximum(elapsed, 0.0) / time)
    return decay, 1.0 - decay**2


class Frame(NamedTuple):
    """Specific force turned by the present estimate, and what follows from it, at the ticks."""

    f: Floats
    """V axes of the present estimate, m/s², shape (m, 3)."""
    w: Floats
    """Turn rate, rad/s, shape (m,)."""
    lateral: Floats
    """Speed times turn rate, m/s², shape (m,)."""
    inverse_speed: Floats
    """s/m, shape (m,)."""


TURN_SPAN = 4.0
"""Half width of the means that divide the turn rate between receiver and accelerometer, s."""


def turned(record: Record, R_va: Floats, lag: float) -> Frame:
    """The ticks in the V axes of the present estimate.

    Turn rate is lateral force over speed where it is quick, and the receiver's where it is slow:
    the force also feels bank and bias, the receiver is late and coarse.

    Parameters
    ----------
    record : Record
        Ticks, A-frame, m/s², and fixes.
    R_va : ndarray, shape (3, 3)
        From A to V.
    lag : float
        Of the receiver, s.

    Returns
    -------
    Frame
        m/s² and rad/s, V axes, at the m ticks.
    """
    fixes = record.fixes
    f = record.f @ R_va.T
    speed = np.interp(record.t + lag, fixes.t, fixes.speed)
    inverse = 1.0 / np.maximum(speed, FLOOR_SPEED)
    rolling = speed > FLOOR_SPEED
    felt = np.where(rolling, f[:, 1] * inverse, 0.0)
    seen = np.where(rolling, np.interp(record.t + lag, fixes.t, gps_rate(fixes.t, unrolled(fixes.course))), 0.0)
    w = felt + smoothed(record, seen - felt, TURN_SPAN)
    return Frame(f, w, w * speed, inverse)


# States of the pitch plane.
V, CLIMB, SLOPE, CURVE, HEIGHT, SPEED_ERROR, HEIGHT_ERROR, TILT, DRIFT_X, DRIFT_Z = range(10)


def pitch_system(
    record: Record, steps: Steps, noise: Noise, change: Floats, swing: Floats, grain: Floats
) -> tuple[Floats, ...]:
    """Start, transition, noise and measurement rows of the pitch plane.

    `change` and `swing` are the longitudinal and lateral specific force integrated over each step,
    `grain` the density of its noise.
    The body stands on the slope and on the bank: of the acceleration along the road none shows on
    its vertical axis, of the lateral one the share of the bank does.

    Parameters
    ----------
    record : Record
        Ticks and fixes, n of them.
    steps : Steps
        From fix to fix.
    noise : Noise
        What to expect.
    change, swing : ndarray, shape (n,)
        V axes, m/s.
    grain : ndarray, shape (n,)
        (m/s²)²/Hz.

    Returns
    -------
    P0 : ndarray, shape (10, 10)
        Covariance of the states at the first fix: V, CLIMB, SLOPE, ... as numbered above.
    Phi : ndarray, shape (n, 10, 10)
        Transition over each step.
    Q : ndarray, shape (n, 10, 10)
        Its noise.
    H : ndarray, shape (n, 3, 10)
        Of speed, height, and climb by slope.
    r : ndarray, shape (n, 3)
        Variances; NaN where not measured.
    """
    fixes = record.fixes
    count = fixes.t.size
    elapsed = np.diff(steps.when, prepend=steps.when[:1])
    Phi, Q = np.zeros((count, 10, 10)), np.zeros((count, 10, 10))
    steady = (V, CLIMB, HEIGHT, DRIFT_X, DRIFT_Z)
    Phi[:, steady, steady] = 1.0
    Phi[:, V, DRIFT_X] = Phi[:, CLIMB, DRIFT_Z] = -steps.dt
    Q[:, DRIFT_X, DRIFT_X] = Q[:, DRIFT_Z, DRIFT_Z] = noise.drift**2 * elapsed
    Phi[1:, CLIMB, SLOPE] = -np.diff(fixes.speed)
    Phi[:, CLIMB, TILT] = -swing
    # Critically damped second-order Gauss-Markov process along the distance.
    beta = 1.0 / noise.slope_length
    d = steps.distance
    decay = np.exp(-beta * d)
    # Means of the slope over the step, per slope and per curvature at its begin: at 30 m/s and one
    # fix a second the slope at either end would lead or lag by half a step.
    z = np.maximum(beta * d, 1e-3)
    of_slope = (2.0 - (2.0 + z) * np.exp(-z)) / z
    of_curve = d * (1.0 - (1.0 + z) * np.exp(-z)) / z**2
    Phi[:, V, SLOPE], Phi[:, V, CURVE] = -GRAVITY * steps.dt * of_slope, -GRAVITY * steps.dt * of_curve
    Phi[:, HEIGHT, SLOPE], Phi[:, HEIGHT, CURVE] = d * of_slope, d * of_curve
    Phi[:, SLOPE, SLOPE], Phi[:, SLOPE, CURVE] = decay * (1.0 + beta * d), decay * d
    Phi[:, CURVE, SLOPE], Phi[:, CURVE, CURVE] = -(beta**2) * d * decay, decay * (1.0 - beta * d)
    rest = np.diag([noise.slope**2, (beta * noise.slope) ** 2])
    block = Phi[:, SLOPE : CURVE + 1, SLOPE : CURVE + 1]
    Q[:, SLOPE : CURVE + 1, SLOPE : CURVE + 1] = rest - block @ rest @ np.swapaxes(block, 1, 2)
    along = np.exp(-d / noise.bank_length)
    Phi[:, TILT, TILT], Q[:, TILT, TILT] = along, (1.0 - along**2) * noise.bank**2
    decay, fresh = _slow(elapsed, noise.slow_time)
    Phi[:, SPEED_ERROR, SPEED_ERROR], Q[:, SPEED_ERROR, SPEED_ERROR] = decay, fresh * noise.speed_slow**2
    Phi[:, HEIGHT_ERROR, HEIGHT_ERROR], Q[:, HEIGHT_ERROR, HEIGHT_ERROR] = decay, fresh * noise.height_slow**2
    lost = np.where(steps.broken, 1e4, 0.0)
    shaken = noise.force**2 * steps.dt + grain
    Q[:, V, V] = shaken + (noise.relative * change) ** 2 + lost
    Q[:, CLIMB, CLIMB] = shaken + lost
    # Over a long gap the vehicle may have got anywhere, by a ramp, a train, or a reset of the receiver.
    Q[:, HEIGHT, HEIGHT] = (0.02 * steps.distance) ** 2 * steps.broken + np.where(elapsed > LONGEST_STEP, 1e4, 0.0)
    H = np.zeros((count, 3, 10))
    H[:, 0, V] = H[:, 0, SPEED_ERROR] = 1.0
    H[:, 1, HEIGHT] = H[:, 1, HEIGHT_ERROR] = 1.0
    H[:, 2, CLIMB], H[:, 2, SLOPE] = 1.0, fixes.speed
    r = np.empty((count, 3))
    r[:, 0] = noise.speed_white**2
    r[:, 1] = np.where(np.isfinite(fixes.alt), noise.height_white**2, np.nan)
    r[:, 2] = noise.heave**2
    deviations = [
        1e2,
        1e2,
        noise.slope,
        beta * noise.slope,
        1e2,
        noise.speed_slow,
        noise.height_slow,
        noise.bank,
        0.0,
        0.0,
    ]
    P0 = np.diag(np.square(deviations))
    return P0, Phi, Q, H, r


def road_slope(record: Record, felt: Floats, *, fine: float = 2.0, coarse: float = 60.0) -> Floats:
    """Slope at the ticks, good enough for its square.

    Parameters
    ----------
    record : Record
    felt : ndarray, shape (m,)
        Longitudinal specific force less acceleration, over gravity.
    fine, coarse : float
        Half widths of the means, s: the force gives the waves between them, height the rest, because
        a bias of the force times the slope would pass for pitch.

    Returns
    -------
    ndarray, shape (m,)
        rad, uphill positive.
    """
    fixes = record.fixes
    waves = smoothed(record, felt, fine)
    way = np.cumsum(fixes.speed * np.diff(fixes.t, prepend=fixes.t[0]))
    pace = gps_rate(fixes.t, way, coarse)
    rise = np.where(pace > 2.0, gps_rate(fixes.t, fixes.alt, coarse) / np.maximum(pace, 2.0), 0.0)
    return waves - smoothed(record, waves, coarse) + np.interp(record.t, fixes.t, rise)


def pitch_plane(record: Record, R_va: Floats, lag: float, noise: Noise) -> Channel:
    """Speed, climb and height against longitudinal and vertical specific force.

    Parameters
    ----------
    record : Record
    R_va : ndarray, shape (3, 3)
        Present estimate; the unknown turn is a small rotation about its V axes.
    lag : float
        Present estimate of the lag of GPS speed, s.
    noise : Noise

    Returns
    -------
    Channel
        Measurements: GPS speed, GPS height, and "climb is speed times slope".
    """
    steps = steps_of(record, lag)
    frame = turned(record, R_va, lag)
    c = 1 + UNKNOWNS
    fixes = record.fixes
    acceleration = gps_rate(fixes.t, fixes.speed)
    pushed = np.interp(record.t + lag, fixes.t, acceleration)
    quadratic = np.column_stack([pushed**2, frame.lateral**2]) / GRAVITY
    slope = road_slope(record, (frame.f[:, 0] - pushed) / GRAVITY)
    felt = np.column_stack([frame.f, quadratic, frame.w**2, 0.5 * GRAVITY * slope**2, record.density])
    total = _difference(at(record, steps.when, integrate(record, felt)), steps.broken)
    U = np.zeros((steps.when.size, 2, c))
    keep = 1.0 - noise.pitch_gain[0]
    U[:, 0, 0] = keep * total[:, 0] + noise.lever[0] * total[:, 5]
    U[:, 0, 1 + 1], U[:, 0, 1 + 2] = keep * total[:, 2], -keep * total[:, 1]
    U[:, 0, 1 + 3] = -steps.dt
    change = clear_rate(fixes.t, fixes.speed, noise.speed_white)
    U[:, 0, 1 + PITCH_GAIN] = -change * steps.dt
    U[:, 0, 1 + LEVER_X] = total[:, 5]
    U[:, 1, 0] = (
        total[:, 2]
        + GRAVITY * steps.dt
        - noise.pitch_gain[0] * total[:, 3]
        - noise.roll_gain[0] * total[:, 4]
        - total[:, 6]
    )
    U[:, 1, 1 + 0], U[:, 1, 1 + 1] = total[:, 1], -total[:, 0]
    U[:, 1, 1 + 5] = -steps.dt
    U[:, 1, 1 + PITCH_GAIN], U[:, 1, 1 + ROLL_GAIN] = -total[:, 3], -total[:, 4]
    P0, Phi, Q, H, r = pitch_system(record, steps, noise, total[:, 0], total[:, 1], total[:, 7])
    Y = np.zeros((steps.when.size, 3, c))
    Y[:, 0, 0], Y[:, 1, 0] = fixes.speed, np.nan_to_num(fixes.alt)
    Y[:, 0, 1 + SPEED_LAG] = change
    Y[:, 0, 1 + ANTENNA_Y] = at(record, steps.when, frame.w)
    x0 = np.zeros(10)
    x0[V] = fixes.speed[0]
    x0[HEIGHT] = Y[0, 1, 0]
    columns = np.concatenate([[0], 1 + PITCH_UNKNOWNS])
    grain = np.repeat((total[:, 7] * rough_share(steps.dt))[:, None], 2, axis=1)
    inputs, values = U[:, :, columns], Y[:, :, columns]
    return Channel(x0, P0, Phi, Q, np.array([V, CLIMB]), inputs, grain, H, values, r, np.zeros(3), PITCH_UNKNOWNS)


def yaw_plane(record: Record, R_va: Floats, lags: tuple[float, float], noise: Noise) -> Channel:
    """Course against lateral specific force; see `pitch_plane`.

    Parameters
    ----------
    record : Record
    R_va : ndarray, shape (3, 3)
    lags : tuple of float
        Present estimates of the lags of GPS speed and course, s.
    noise : Noise

    Returns
    -------
    Channel
        Measurement: GPS course.  States: course, bank, slow error of lateral velocity, drift of the bias.
    """
    steps = steps_of(record, lags[1])
    frame = turned(record, R_va, lags[0])
    c = 1 + UNKNOWNS
    inverse = frame.inverse_speed
    inputs = np.column_stack([frame.f * inverse[:, None], inverse, record.density * inverse**2])
    total = _difference(at(record, steps.when, integrate(record, inputs)), steps.broken)
    w = at(record, steps.when, frame.w)
    inverse_now = at(record, steps.when, inverse)
    spin = _difference(w, steps.broken) * inverse_now
    elapsed = np.diff(steps.when, prepend=steps.when[:1])
    keep = 1.0 - noise.roll_gain[0]
    U = np.zeros((steps.when.size, 1, c))
    U[:, 0, 0] = keep * total[:, 1] - noise.lever[0] * spin
    U[:, 0, 1 + 0], U[:, 0, 1 + 2] = -keep * total[:, 2], keep * total[:, 0]
    U[:, 0, 1 + 4] = -total[:, 3]
    course_noise = noise.across_white / np.maximum(record.fixes.speed, FLOOR_SPEED)
    turn_rate = clear_rate(record.fixes.t, unrolled(record.fixes.course), course_noise)
    U[:, 0, 1 + ROLL_GAIN] = -turn_rate * steps.dt
    U[:, 0, 1 + LEVER_X] = -spin
    lost = steps.broken | (elapsed > LONGEST_STEP)
    P0, Phi, Q, H, r = yaw_system(record.fixes, steps, noise, total[:, 1], total[:, 3], total[:, 4], lost)
    Y = np.zeros((steps.when.size, 1, c))
    # Ahead of the point that does not slip, the track points into the turn.
    Y[:, 0, 0] = np.nan_to_num(record.fixes.course) - noise.lever[0] * w * inverse_now
    Y[:, 0, 1 + COURSE_LAG] = w
    Y[:, 0, 1 + LEVER_X] = Y[:, 0, 1 + ANTENNA_X] = -w * inverse_now
    columns = np.concatenate([[0], 1 + YAW_UNKNOWNS])
    return Channel(
        np.zeros(4),
        P0,
        Phi,
        Q,
        np.array([0]),
        U[:, :, columns],
        (total[:, 4] * rough_share(steps.dt))[:, None],
        H,
        Y[:, :, columns],
        r,
        np.array([2.0 * np.pi]),
        YAW_UNKNOWNS,
    )


def yaw_system(
    fixes: Fixes, steps: Steps, noise: Noise, change: Floats, inverse: Floats, grain: Floats, lost: Flags
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Start, transition, noise and measurement rows of the yaw plane.

    `change` is the turn that the lateral force makes in each step, `inverse` one over the speed,
    integrated, `grain` the noise of that turn in rad²; where the course is `lost`, or too slow to
    follow, the thread begins anew.

    Parameters
    ----------
    fixes : Fixes
        n of them.
    steps : Steps
        From fix to fix.
    noise : Noise
        What to expect.
    change : ndarray, shape (n,)
        rad.
    inverse : ndarray, shape (n,)
        s²/m.
    grain : ndarray, shape (n,)
        rad².
    lost : ndarray of bool, shape (n,)
        Where the thread begins anew.

    Returns
    -------
    P0 : ndarray, shape (4, 4)
        Covariance of course, bank, slow error of the course (m/s) and lateral bias drift (m/s²).
    Phi : ndarray, shape (n, 4, 4)
        Transition over each step.
    Q : ndarray, shape (n, 4, 4)
        Its noise.
    H : ndarray, shape (n, 1, 4)
        Of the course.
    r : ndarray, shape (n, 1)
        Variance, rad²; NaN where not measured.
    """
    count = fixes.t.size
    Phi, Q = np.zeros((count, 4, 4)), np.zeros((count, 4, 4))
    Phi[:, 0, 0] = Phi[:, 3, 3] = 1.0
    Phi[:, 0, 3] = -inverse
    z = np.maximum(steps.distance / noise.bank_length, 1e-6)
    along = np.exp(-z)
    Phi[:, 0, 1] = -GRAVITY * inverse * (1.0 - along) / z
    Phi[:, 1, 1], Q[:, 1, 1] = along, (1.0 - along**2) * noise.bank**2
    elapsed = np.diff(steps.when, prepend=steps.when[:1])
    Q[:, 3, 3] = noise.drift**2 * elapsed
    decay, fresh = _slow(elapsed, noise.slow_time)
    Phi[:, 2, 2], Q[:, 2, 2] = decay, fresh * noise.across_slow**2
    slack = np.where(steps.dt > 0.0, inverse**2 / np.maximum(steps.dt, 1e-3), 0.0)
    anew = np.where(lost | np.isnan(fixes.course), 100.0, 0.0)
    Q[:, 0, 0] = noise.force**2 * slack + grain + (noise.relative_turn * change) ** 2 + anew
    now = 1.0 / np.maximum(fixes.speed, FLOOR_SPEED)
    H = np.zeros((count, 1, 4))
    H[:, 0, 0], H[:, 0, 2] = 1.0, now
    r = np.where(np.isfinite(fixes.course), (noise.across_white * now) ** 2 + 1e-6, np.nan)[:, None]
    return np.diag([100.0, noise.bank**2, noise.across_slow**2, 0.0]), Phi, Q, H, r


def prior(noise: Noise, lags: tuple[float, float]) -> tuple[Floats, Floats]:
    """Information (diagonal) and mean of the unknowns before the drive; the turn has none.

    Parameters
    ----------
    noise : Noise
        What to expect.
    lags : tuple of float
        Of GPS speed and course, at which the system is built, s.

    Returns
    -------
    information : ndarray, shape (13,)
        One over the variances of `p`; 0 for the turn.
    mean : ndarray, shape (13,)
        Of `p`.
    """
    deviation = np.full(UNKNOWNS, np.inf)
    mean = np.zeros(UNKNOWNS)
    deviation[BIAS] = noise.bias
    deviation[[PITCH_GAIN, ROLL_GAIN]] = noise.pitch_gain[1], noise.roll_gain[1]
    deviation[[LEVER_X, ANTENNA_X, ANTENNA_Y]] = noise.lever[1], noise.antenna, noise.antenna
    deviation[[SPEED_LAG, COURSE_LAG]] = noise.lag[1]
    mean[[SPEED_LAG, COURSE_LAG]] = noise.lag[0] - lags[0], noise.lag[0] - lags[1]
    return 1.0 / deviation**2, mean
