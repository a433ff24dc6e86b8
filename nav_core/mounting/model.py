"""What a car, a road, a receiver and a box do: the linear model behind the whole-drive estimate.

Two systems share the unknowns.  The *pitch plane* holds speed, climb, slope and height, driven by
the longitudinal and vertical specific force; the *yaw plane* holds course and bank, driven by the
lateral one.  Specific force is integrated and compared with what the receiver says, so GPS is
never differentiated, its noise stays in its place, and slow fixes lose nothing.

Signs, for small road and body angles (V-frame; slope s uphill positive, climb downward positive)::

    f_x = v' + g s + kappa_x v' + kappa_u |v'| - l_x w²
    f_y = v w + g bank + kappa_y v w + l_x w'
    f_z = -g + g s²/2 + climb' + v' s + f_y bank + (kappa_x v'² + kappa_u v' |v'| + kappa_y f_y²) / g
    course = heading + l_x w / v

`kappa_u` is what springs give more in accelerating, and less in braking, than in the mean of both.
`v` is the speed of the box; ``l_x`` its place ahead of the point that does not slip.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from nav_core.mounting.fixes import followed
from nav_core.mounting.stretch import Record, smoothed
from nav_core.typing import Flags, Floats, Integers

GRAVITY = 9.80665
MILLI_G = 1e-3 * GRAVITY

CROWN = np.radians(0.65)
"""Mean sideways tilt of the roads of a drive, 1 sigma; part of the mounting for all the data can tell, rad.  Roads fall
by 0.3 to 1.2° to one side: not a bell curve.  With a drive's doubt of 0.1 to 0.7° 1.96 of the sum hold 99 to 93 %."""

# Places of the unknowns in p.
TURN = slice(0, 3)
BIAS = slice(3, 6)
PITCH_GAIN, ROLL_GAIN, LEVER_X, ANTENNA_X, ANTENNA_Y, SPEED_LAG, COURSE_LAG, UNLIKE_GAIN = range(6, 14)
UNKNOWNS = 14
PITCH_UNKNOWNS = np.array([0, 1, 2, 3, 5, PITCH_GAIN, ROLL_GAIN, LEVER_X, ANTENNA_Y, SPEED_LAG, UNLIKE_GAIN])
YAW_UNKNOWNS = np.array([0, 2, 4, ROLL_GAIN, LEVER_X, ANTENNA_X, COURSE_LAG])


def columns_of(unknowns: Integers) -> list[int]:
    """Where each unknown stands among a channel's columns.

    Parameters
    ----------
    unknowns : ndarray of int, shape (c - 1,)
        Those of the channel.

    Returns
    -------
    list of int
        By unknown; -1 for those that do not act there.
    """
    column = np.full(UNKNOWNS, -1)
    column[unknowns] = 1 + np.arange(unknowns.size)
    return column.tolist()


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
    """Correlation time of the slow errors of speed and course, s."""
    height_white: float = 0.5
    height_slow: float = 3.0
    """m."""
    height_time: float = 4.0
    """Correlation time of the slow error of height, s; of many receivers it is a minute."""
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
    crown: float = CROWN
    crown_mean: float = 0.0
    """What is expected of it, right side down positive; see `roads_of`, rad."""
    bias: float = 5.0 * MILLI_G
    """Accelerometer bias before the drive has spoken, per axis, m/s²."""
    drift: float = 1.0 * MILLI_G / np.sqrt(300.0)
    """Random walk of the bias (temperature), (m/s²)/√s."""
    pitch_gain: tuple[float, float] = (0.04, 0.02)
    roll_gain: tuple[float, float] = (0.07, 0.03)
    """Body pitch and roll per g, as a share of specific force: mean and deviation."""
    unlike_gain: float = np.radians(0.5)
    """Deviation of the half difference of the pitch gains in accelerating and in braking: anti-squat and anti-dive of
    an axle are two different things; expected is none."""
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


def per_step(values: Floats, broken: Flags) -> Floats:
    """What running integrals gain over each step.

    Parameters
    ----------
    values : ndarray, shape (n, ...)
        Integrals up to the steps' ends, in any unit.
    broken : ndarray of bool, shape (n,)
        Steps that lack data.

    Returns
    -------
    ndarray, shape (n, ...)
        In that unit; 0 where broken.
    """
    out = np.diff(values, axis=0, prepend=values[:1])
    out[broken] = 0.0
    return out


def first_order(elapsed: Floats, time: float) -> tuple[Floats, Floats]:
    """Decay and fresh variance (share) of a first-order process over each step.

    Parameters
    ----------
    elapsed : ndarray, shape (n,)
        Since the step before, s.
    time : float
        Correlation time, s.

    Returns
    -------
    decay : ndarray, shape (n,)
        0 to 1.
    fresh : ndarray, shape (n,)
        Share of the variance that the decay has lost.
    """
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
    the force also feels bank and bias, the receiver is late and coarse.  Where the receiver gives no
    course, the force alone tells.

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
    seen = np.interp(record.t + lag, fixes.t, fixes.turn_rate)
    told = np.where(rolling & followed(fixes, record.t + lag, LONGEST_STEP), seen - felt, 0.0)
    w = felt + smoothed(record, told, TURN_SPAN)
    return Frame(f, w, w * speed, inverse)


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
    information : ndarray, shape (14,)
        One over the variances of `p`; 0 for the turn.
    mean : ndarray, shape (14,)
        Of `p`.
    """
    deviation = np.full(UNKNOWNS, np.inf)
    mean = np.zeros(UNKNOWNS)
    deviation[BIAS] = noise.bias
    deviation[[PITCH_GAIN, ROLL_GAIN]] = noise.pitch_gain[1], noise.roll_gain[1]
    deviation[UNLIKE_GAIN] = noise.unlike_gain
    deviation[[LEVER_X, ANTENNA_X, ANTENNA_Y]] = noise.lever[1], noise.antenna, noise.antenna
    deviation[[SPEED_LAG, COURSE_LAG]] = noise.lag[1]
    mean[[SPEED_LAG, COURSE_LAG]] = noise.lag[0] - lags[0], noise.lag[0] - lags[1]
    return 1.0 / deviation**2, mean
