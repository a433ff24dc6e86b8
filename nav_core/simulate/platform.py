"""A platform that only turns, and what gyro, accelerometer, magnetometer and star tracker make of it (002 ch. 9).

Frame b is the platform's, n is north, east, down.  The motion is exact: rates are derivatives of the attitude.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nav_core.attitude.euler_rates import body_rate
from nav_core.earth import STANDARD_GRAVITY
from nav_core.errors import RangeError
from nav_core.rotation import (
    euler_to_quaternion,
    product,
    quaternion_to_euler,
    quaternion_to_matrix,
    rotvec_to_quaternion,
)
from nav_core.sensors.noise import HMC5883L, MPU6050_ACCELEROMETER, MPU6050_GYRO, NoiseCoefficients, simulate_noise
from nav_core.typing import Floats

PADUA_FIELD = np.array([22.5, 0.0, 41.8])
"""Magnetic field in n, µT, of 002 section 6.5."""

GRAVITY_REACTION = np.array([0.0, 0.0, -STANDARD_GRAVITY])
"""Specific force of a platform at rest, n, m/s²."""

THRUST = 0.1551
"""Angular acceleration about z of the thrusters, rad/s² (002 eq. 9.2)."""

ENCODER_STEP = float(np.radians(0.09))
"""Resolution of the encoders, which stand for the star tracker and for the truth in 002 section 9.2, rad."""

ENCODER_SIGMA = ENCODER_STEP / float(np.sqrt(12.0))
"""1-sigma of their angles, rad (002 eq. 8.8)."""


@dataclass(frozen=True, slots=True)
class Turning:
    """A motion, at the start and after each of n steps.

    Attributes
    ----------
    t : ndarray, shape (n + 1,)
        s.
    q_nb : ndarray, shape (n + 1, 4)
        From b to n.
    w : ndarray, shape (n + 1, 3)
        Rate of b against n, b axes, rad/s.
    """

    t: Floats
    q_nb: Floats
    w: Floats


@dataclass(frozen=True, slots=True)
class Instruments:
    """Noise of the sensors of a platform, axis by axis; calibrated but for `soft_iron` and `hard_iron`.

    Attributes
    ----------
    gyro, accelerometer, magnetometer : sequence of NoiseCoefficients
        In rad/s, m/s², µT.
    turn_on : float
        1-sigma of the gyro's bias at the start, rad/s.
    tracker_sigma : float
        About each axis, white, rad; without influence with `encoders`.
    encoders : bool
        The tracker is made of encoders (002 section 8.2.5): the true angles, rounded.
    tracker_period : float
        s (0.33 Hz of 002).
    soft_iron : ndarray, shape (3, 3)
        What calibration left: added to the identity.
    hard_iron : ndarray, shape (3,)
        The same, µT.
    """

    gyro: Sequence[NoiseCoefficients] = MPU6050_GYRO
    accelerometer: Sequence[NoiseCoefficients] = MPU6050_ACCELEROMETER
    magnetometer: Sequence[NoiseCoefficients] = HMC5883L
    turn_on: float = 0.0
    tracker_sigma: float = ENCODER_SIGMA
    encoders: bool = False
    tracker_period: float = 3.0
    soft_iron: Floats | None = None
    hard_iron: Floats | None = None


@dataclass(frozen=True, slots=True)
class Readings:
    """What the sensors of a platform say.

    Attributes
    ----------
    w : ndarray, shape (n + 1, 3)
        rad/s, at the moments of `Turning.t`.
    bias : ndarray, shape (n + 1, 3)
        The truth of what wanders in `w`, its 1/f part excluded, rad/s.
    f, m : ndarray, shape (n, 3)
        m/s² and µT at the end of each step.
    star : ndarray, shape (n, 4)
        Quaternions at the end of each step, NaN where none is due.
    """

    w: Floats
    bias: Floats
    f: Floats
    m: Floats
    star: Floats


def thrusters(rate: float, *, rest: float = 50.0, after: float = 5.0) -> Turning:
    """The profile of 002 figure 9.1: rest, then full thrust about z for 2.5 s and against it for 2.5 s.

    Parameters
    ----------
    rate : float
        Samples a second.
    rest, after : float
        s before and after.

    Returns
    -------
    Turning
    """
    t = np.arange(round((rest + 5.0 + after) * rate) + 1) / rate
    since = np.clip(t - rest, 0.0, 5.0)
    up, down = np.minimum(since, 2.5), np.maximum(since - 2.5, 0.0)
    w = np.zeros((t.size, 3))
    w[:, 2] = THRUST * (up - down)
    yaw = THRUST * (0.5 * up**2 + 2.5 * down - 0.5 * down**2)
    return Turning(t, euler_to_quaternion(0.0, 0.0, yaw), w)


def by_hand(
    duration: float, rate: float, rms: Floats, rng: np.random.Generator, *, moving: float | None = None
) -> Turning:
    """A platform moved by hand: slow random oscillations of roll, pitch and yaw (002 table 9.1).

    Parameters
    ----------
    duration : float
        s.
    rate : float
        Samples a second.
    rms : ndarray, shape (3,)
        Of the rate about x, y, z over the whole duration, rad/s; met within a per cent.
    rng : numpy.random.Generator
    moving : float, optional
        s after which it comes to rest.

    Returns
    -------
    Turning

    Raises
    ------
    RangeError
        Pitch would come within 10° of the vertical.
    """
    t = np.arange(round(duration * rate) + 1) / rate
    # Eight lines between 0.04 and 0.25 Hz for each angle.
    f = 2.0 * np.pi * rng.uniform(0.04, 0.25, (3, 8, 1))
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, 8, 1))
    size = rng.uniform(0.5, 1.0, (3, 8, 1)) / f
    angles = np.sum(size * np.sin(f * t + phase), axis=1).T
    rates = np.sum(size * f * np.cos(f * t + phase), axis=1).T
    rest = np.zeros(3)
    if moving is not None:
        # Anywhere between two marks of an encoder.
        rest = np.radians(rng.uniform(-10.0, 10.0, 3))
        fade = np.clip((t - moving + 10.0) / 10.0, 0.0, 1.0)[:, None]
        level = 0.5 + 0.5 * np.cos(np.pi * fade)
        slope = np.where((fade > 0.0) & (fade < 1.0), -0.05 * np.pi * np.sin(np.pi * fade), 0.0)
        angles, rates = angles * level, rates * level + angles * slope
    scale = np.ones(3)
    for _ in range(12):
        w = body_rate(scale * angles + rest, scale * rates)
        scale *= rms / np.sqrt(np.mean(w**2, axis=0))
    angles, rates = scale * angles + rest, scale * rates
    steepest = float(np.max(np.abs(angles[:, 1])))
    if steepest > np.radians(80.0):
        raise RangeError("pitch", steepest, "within 80°")
    return Turning(t, euler_to_quaternion(*angles.T), body_rate(angles, rates))


def measure(truth: Turning, instruments: Instruments, rng: np.random.Generator) -> Readings:
    """Readings of the motion (002 section 5.4).

    Parameters
    ----------
    truth : Turning
    instruments : Instruments
    rng : numpy.random.Generator

    Returns
    -------
    Readings
    """
    count = truth.t.size
    rate = (count - 1) / float(truth.t[-1] - truth.t[0])
    bias = instruments.turn_on * rng.standard_normal(3) + np.column_stack(
        [simulate_noise(NoiseCoefficients(K=axis.K), count, rate, rng) for axis in instruments.gyro]
    )
    fast = [simulate_noise(axis._replace(K=0.0), count, rate, rng) for axis in instruments.gyro]
    R_bn = np.swapaxes(quaternion_to_matrix(truth.q_nb[1:]), -1, -2)
    f = R_bn @ GRAVITY_REACTION + _noise(instruments.accelerometer, count - 1, rate, rng)
    m = R_bn @ PADUA_FIELD
    if instruments.soft_iron is not None:
        m = m + m @ instruments.soft_iron.T
    if instruments.hard_iron is not None:
        m = m + instruments.hard_iron
    m = m + _noise(instruments.magnetometer, count - 1, rate, rng)
    star = np.full((count - 1, 4), np.nan)
    every = round(instruments.tracker_period * rate)
    due = truth.q_nb[every::every]
    errors = instruments.tracker_sigma * rng.standard_normal((len(due), 3))
    star[every - 1 :: every] = (
        encoder_attitude(due) if instruments.encoders else product(due, rotvec_to_quaternion(errors))
    )
    return Readings(truth.w + bias + np.column_stack(fast), bias, f, m, star)


def encoder_attitude(q_nb: Floats) -> Floats:
    """Attitude by encoders of roll, pitch and yaw: the angles rounded to `ENCODER_STEP`, shape (..., 4).

    Parameters
    ----------
    q_nb : ndarray, shape (..., 4)
        From b to n, order (x, y, z, w).

    Returns
    -------
    ndarray, shape (..., 4)
        From b to n.
    """
    angles = ENCODER_STEP * np.round(quaternion_to_euler(q_nb) / ENCODER_STEP)
    return euler_to_quaternion(*np.moveaxis(angles, -1, 0))


def _noise(axes: Sequence[NoiseCoefficients], count: int, rate: float, rng: np.random.Generator) -> Floats:
    return np.column_stack([simulate_noise(axis, count, rate, rng) for axis in axes])
