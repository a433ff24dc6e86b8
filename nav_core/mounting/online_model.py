"""The online estimator's state, what it is told at each fix, and how much it believes.

The model is that of the whole drive, run forward: specific force, turned by the present mounting,
drives speed, climb and track; the receiver says what became of them.  So acceleration and turn
rate need no states, GPS is never differentiated for its value, and every derivative that the
filter uses comes from what was measured, not from its own wavering states: fixes are worked off a
second late, when the receiver's speed and course on both sides are known.

Signs, for small road and body angles (V-frame; slope s uphill positive, climb downward positive)::

    f_x = v' + g s + kappa_x v' - l w²
    f_y = v chi' + g bank + kappa_y v w + l v' w / v
    f_z = -g + g s²/2 + climb' + v' s + f_y bank + (kappa_x v'² + kappa_y (v w)²) / g

`chi` is the direction of travel of the box, the receiver's course; `l` its place ahead of the
point that does not slip.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.mounting.model import GRAVITY, Noise
from nav_core.rotation import skew
from nav_core.typing import Flags, Floats

# The states.
SPEED, CLIMB, SLOPE, CURVE, HEIGHT, SPEED_ERROR, HEIGHT_ERROR, TRACK, BANK, ACROSS_ERROR = range(10)
TURN, BIAS = 10, 13
PITCH_GAIN, ROLL_GAIN, LEVER, SPEED_LAG, COURSE_LAG, GYRO_BIAS = range(16, 22)
N_STATES = 22

# What is known at a fix: the columns of a row.  Forces and turn rates are in the A-frame.
ELAPSED, COVERED, WAY, FORCE, SQUARE_ALONG, SQUARE_ACROSS, SQUARE_TURN = 0, 1, 2, 3, 6, 7, 8
GPS_SPEED, GPS_CHANGE, GPS_HEIGHT, GPS_COURSE, BROKEN, STANDING = range(9, 15)
ACCELERATION, TURN_RATE, TURNED, FORCE_PER_SPEED, PER_SPEED, SIDE = 15, 16, 17, 18, 21, 22
TRACK_LOST, GYRO, GYRO_PER_SPEED = 23, 24, 27
N_COLUMNS = 30
"""
ELAPSED, COVERED: s since the fix before, and those of it with accelerometer data.
WAY: m.  FORCE (3): integral of specific force, m/s.
SQUARE_ALONG, SQUARE_ACROSS: integrals of v'²/g and (v w)²/g, m/s.  SQUARE_TURN: of w², rad²/s.
GPS_SPEED, GPS_CHANGE: m/s, and since the fix before.  GPS_HEIGHT: m.  GPS_COURSE: rad.  NaN: unknown.
BROKEN, STANDING, TRACK_LOST: 0 or 1.
ACCELERATION, TURN_RATE: of the receiver, where they stand out of its noise, m/s², rad/s.
TURNED: rad, of the turn rate that stands out.
FORCE_PER_SPEED (3), PER_SPEED: integrals of f/v and 1/v between the moments of the courses.
SIDE: integral of v' w / v², rad/m.
GYRO (3): integral of the angular rate, rad.  GYRO_PER_SPEED (3): change of rate over speed, rad/m.  NaN: no gyro.
"""

ALONG, UP, ACROSS = range(3)

# Kinds of measurement in the innovation statistics.
OF_SPEED, OF_HEIGHT, OF_CLIMB, OF_COURSE, OF_SIDE = range(5)
N_KINDS = 5


_KNOWN = Noise()


class Tuning(NamedTuple):
    """What to expect of cars, roads, receivers and boxes; SI units, 1 sigma.

    What the whole-drive estimator's `Noise` knows as well is taken from there; only the lag's deviation is its own:
    the lags at which the rows stand move no faster than the filter learns them.
    """

    speed_white: float = _KNOWN.speed_white
    speed_slow: float = _KNOWN.speed_slow
    across_white: float = _KNOWN.across_white
    across_slow: float = _KNOWN.across_slow
    """m/s."""
    slow_time: float = _KNOWN.slow_time
    """s."""
    height_white: float = _KNOWN.height_white
    height_slow: float = _KNOWN.height_slow
    """m."""
    slope: float = _KNOWN.slope
    slope_length: float = _KNOWN.slope_length
    bank: float = _KNOWN.bank
    bank_length: float = _KNOWN.bank_length
    """rad and m."""
    force: float = _KNOWN.force
    """(m/s²)/√Hz."""
    relative: float = _KNOWN.relative
    relative_turn: float = _KNOWN.relative_turn
    heave: float = _KNOWN.heave
    """m/s."""
    gyro: float = 0.003
    """Of the integrated rate, with the body's own movement on its springs, rad/√s."""
    gyro_bias: float = 0.02
    gyro_drift: float = 1e-5
    """rad/s and (rad/s)/√s."""
    bias: float = _KNOWN.bias
    drift: float = _KNOWN.drift
    """m/s² and (m/s²)/√s."""
    pitch_gain: float = _KNOWN.pitch_gain[0]
    pitch_gain_sigma: float = _KNOWN.pitch_gain[1]
    roll_gain: float = _KNOWN.roll_gain[0]
    roll_gain_sigma: float = _KNOWN.roll_gain[1]
    """Body pitch and roll per g: expected value and deviation from it."""
    lever: float = _KNOWN.lever[0]
    lever_sigma: float = _KNOWN.lever[1]
    """m."""
    lag: float = _KNOWN.lag[0]
    lag_sigma: float = 0.3
    """s."""
    rest: float = 0.05
    """Speed of a vehicle that stands, m/s."""
    tilt: float = 0.12
    yaw: float = 0.45
    """Of the mounting at the start: after levelling, and about each hypothesis, rad."""
    limit: float = 3.0
    """Innovations beyond this many sigmas are weighted down."""


class Filters(NamedTuple):
    """Any number of filters side by side: the yaw hypotheses of one box, or the boxes of a fleet.

    Attributes
    ----------
    x : ndarray, shape (b, 22)
    P : ndarray, shape (b, 22, 22)
    R_va : ndarray, shape (b, 3, 3)
        Reference mountings; the states `TURN` are the small rotation about its V axes.  A mirrored hypothesis
        has a mirrored matrix: that of a box with left-handed axes or an inverted sign.
    likelihood : ndarray, shape (b,)
        Logarithm, of all measurements so far.
    scale : ndarray, shape (b, 3)
        How many times noisier than the tuning the drive is, along, up and across.
    notes : ndarray, shape (b, 5, 2)
        Squared normalised innovations and their number, fading, by kind.
    """

    x: Floats
    P: Floats
    R_va: Floats
    likelihood: Floats
    scale: Floats
    notes: Floats

    @property
    def mirrored(self) -> Flags:
        """Which hypotheses say that the box's data are mirrored, shape (b,)."""
        x, y, z = self.R_va[:, 0], self.R_va[:, 1], self.R_va[:, 2]
        handed = x[:, 0] * (y[:, 1] * z[:, 2] - y[:, 2] * z[:, 1]) - x[:, 1] * (y[:, 0] * z[:, 2] - y[:, 2] * z[:, 0])
        return handed + x[:, 2] * (y[:, 0] * z[:, 1] - y[:, 1] * z[:, 0]) < 0.0

    @property
    def best(self) -> int:
        """The likeliest filter; a mirrored one must be so beyond doubt."""
        if self.likelihood.size == 1:
            return 0
        return int(np.argmax(self.likelihood - BEYOND_DOUBT * self.mirrored))


UNLIKELY = 12.0
BEYOND_DOUBT = 40.0
"""A hypothesis whose log likelihood is this far below the best's of its kind is dropped; one kind, mirrored or not,
in favour of the other only beyond doubt: the first bends of a road may by chance bank either way."""

HYPOTHESES = 8
"""Yaws at which the filter is started, twice: see `Filters.R_va`."""


def hypotheses(force: Floats, level: Floats, driven: tuple[float, float]) -> Floats:
    """Mountings at yaws all around that are level for what the vehicle did meanwhile.

    Parameters
    ----------
    force : ndarray, shape (3,)
        Mean specific force of the first seconds, A-frame, m/s².
    level : ndarray, shape (3, 3)
        Rotation from the A-frame to a frame that `force` is vertical in.
    driven : tuple of float
        Mean acceleration along and across in those seconds, by the receiver, m/s².

    Returns
    -------
    ndarray, shape (16, 3, 3)
        Eight for the data as they are and eight for mirrored data.
    """
    expected = np.array([driven[0], driven[1], -GRAVITY])
    up, expected = level @ force, expected / np.linalg.norm(expected)
    up /= np.linalg.norm(up)
    axis = np.cross(up, expected)
    # From the vertical to what is felt when driving so: the shortest turn.
    K = skew(axis)
    tilt = np.eye(3) + K + K @ K / (1.0 + float(up @ expected))
    yaw = 2.0 * np.pi / HYPOTHESES * np.arange(HYPOTHESES)
    c, s, zero = np.cos(yaw), np.sin(yaw), np.zeros(HYPOTHESES)
    turns = np.stack([c, s, zero, -s, c, zero, zero, zero, zero + 1.0], axis=1).reshape(-1, 3, 3)
    # Mirroring the vehicle's left and right leaves the vertical and what was driven along alone.
    mirror = np.diag([1.0, -1.0, 1.0])
    upright = tilt @ turns @ level
    mirrored = tilt @ mirror @ turns @ level
    return np.concatenate([upright, mirrored])


def prior_sigma(tuning: Tuning) -> Floats:
    """Standard deviations of the states at the first fix, shape (22,).

    Parameters
    ----------
    tuning : Tuning
        What to expect.

    Returns
    -------
    ndarray, shape (22,)
        SI units, in the order of the states.
    """
    sigma = np.zeros(N_STATES)
    sigma[[SPEED, CLIMB, SLOPE, CURVE]] = 0.2, 0.5, tuning.slope, tuning.slope / tuning.slope_length
    sigma[[HEIGHT, SPEED_ERROR, HEIGHT_ERROR]] = 5.0, tuning.speed_slow, tuning.height_slow
    sigma[[TRACK, BANK, ACROSS_ERROR]] = 10.0, tuning.bank, tuning.across_slow
    sigma[TURN : TURN + 3] = tuning.tilt, tuning.tilt, tuning.yaw
    sigma[BIAS : BIAS + 3] = tuning.bias
    sigma[[PITCH_GAIN, ROLL_GAIN, LEVER]] = tuning.pitch_gain_sigma, tuning.roll_gain_sigma, tuning.lever_sigma
    sigma[[SPEED_LAG, COURSE_LAG, GYRO_BIAS]] = tuning.lag_sigma, tuning.lag_sigma, tuning.gyro_bias
    return sigma


def initial_filters(row: Floats, R_va: Floats, lags: tuple[float, float], tuning: Tuning) -> Filters:
    """Filters at the first fix, one for each yaw hypothesis.

    Parameters
    ----------
    row : ndarray, shape (30,)
        Of the first fix.
    R_va : ndarray, shape (k, 3, 3)
        See `hypotheses`.
    lags : tuple of float
        Lags of speed and course at which the rows stand, s.
    tuning : Tuning

    Returns
    -------
    Filters
    """
    x, sigma = np.zeros(N_STATES), prior_sigma(tuning)
    course = row[GPS_COURSE]
    known = bool(np.isfinite(course))
    x[SPEED], x[HEIGHT] = row[GPS_SPEED], np.nan_to_num(row[GPS_HEIGHT])
    x[TRACK] = course if known else 0.0
    x[[SPEED_LAG, COURSE_LAG]] = tuning.lag - lags[0], tuning.lag - lags[1]
    count = R_va.shape[0]
    return Filters(
        x=np.tile(x, (count, 1)),
        P=np.tile(np.diag(sigma**2), (count, 1, 1)),
        R_va=R_va.copy(),
        likelihood=np.zeros(count),
        scale=np.ones((count, 3)),
        notes=np.zeros((count, N_KINDS, 2)),
    )
