"""What 002 chapter 9 studies on its platform, accuracy against frequency and the magnetometer's weight; 000's drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from nav_core.alignment import tilt
from nav_core.attitude.error_state import Direction, Estimates, GyroNoise, Start, StarTracker, estimate, mean_rates
from nav_core.attitude.propagation import propagate_closed
from nav_core.attitude.quaternion_ekf import QuaternionState, correct, propagate
from nav_core.rotation import conjugate, euler_to_quaternion, product, quaternion_to_euler, quaternion_to_matrix, wrap
from nav_core.sensors.noise import NoiseCoefficients
from nav_core.simulate.platform import (
    ENCODER_SIGMA,
    GRAVITY_REACTION,
    PADUA_FIELD,
    Instruments,
    Readings,
    Turning,
    by_hand,
    measure,
    thrusters,
)
from nav_core.typing import Floats

SETTLING = 50.0
"""s at the start that 002 leaves out of its errors."""

MAGNETOMETER_LEFT = np.array([2.189, 1.303, 0.927])
"""rms of what calibration leaves of the magnetometer's errors, b axes, µT (002 table 6.4)."""


@dataclass(frozen=True, slots=True)
class Weights:
    """Errors against the factor on the magnetometer's sigma.

    Attributes
    ----------
    factors : ndarray, shape (k,)
    rms : ndarray, shape (k, 3)
        Of the quaternion error's vector part, x, y, z (002 figure 9.13); its sum over the axes is figure 9.12.
    """

    factors: Floats
    rms: Floats

    @property
    def total(self) -> Floats:
        """Sum over the axes, shape (k,)."""
        return self.rms.sum(axis=1)


def common(axes: Sequence[NoiseCoefficients]) -> GyroNoise:
    """Root mean square over the axes of N and K: the filter of 002 has one for all (7.18).

    Parameters
    ----------
    axes : sequence of NoiseCoefficients
        Of the gyro, rad/s.

    Returns
    -------
    GyroNoise
        rad/s based.
    """
    return GyroNoise(*(float(np.sqrt(np.mean([getattr(axis, name) ** 2 for axis in axes]))) for name in ("N", "K")))


def white_sigma(axes: Sequence[NoiseCoefficients], rate: float) -> float:
    """Root mean square over the axes of the 1-sigma of a sample's white noise at `rate`, Hz (002 eq. 5.10).

    Parameters
    ----------
    axes : sequence of NoiseCoefficients
        Of one sensor, in any unit.
    rate : float
        Hz.

    Returns
    -------
    float
        In that unit.
    """
    return common(axes).N * float(np.sqrt(rate))


def quaternion_errors(truth: Floats, estimated: Floats) -> Floats:
    """Vector part of ``conj(truth) estimated`` with its scalar positive, shape (n, 3): half the error about b.

    Parameters
    ----------
    truth, estimated : ndarray, shape (n, 4)
        From b to n.

    Returns
    -------
    ndarray, shape (n, 3)
        rad, halved, b axes.
    """
    error = product(conjugate(truth), estimated)
    return error[..., :3] * np.where(error[..., 3:] < 0.0, -1.0, 1.0)


def euler_errors(truth: Floats, estimated: Floats) -> Floats:
    """Errors of roll, pitch and yaw of quaternions, shape (n, 3), rad.

    Parameters
    ----------
    truth, estimated : ndarray, shape (n, 4)
        From b to n.

    Returns
    -------
    ndarray, shape (n, 3)
        rad.
    """
    return wrap(quaternion_to_euler(estimated) - quaternion_to_euler(truth))


def rms(errors: Floats, rate: float, *, after: float = SETTLING) -> Floats:
    """Root mean square of each column, without the first `after` s.

    Parameters
    ----------
    errors : ndarray, shape (n, k)
        In any unit.
    rate : float
        Hz.
    after : float
        s.

    Returns
    -------
    ndarray, shape (k,)
        In that unit.
    """
    return np.sqrt(np.mean(errors[round(after * rate) :] ** 2, axis=0))


def space(readings: Readings) -> StarTracker:
    """The star tracker's readings as the filter takes them.

    Parameters
    ----------
    readings : Readings
        Of a simulated test.

    Returns
    -------
    StarTracker
        With the sigma of the encoders, rad.
    """
    return StarTracker(readings.star, ENCODER_SIGMA)


def terrestrial(readings: Readings, instruments: Instruments, rate: float, *, weight: float = 1.0) -> list[Direction]:
    """Accelerometer and magnetometer as the filter takes them; `weight` is the factor k on the latter's sigma.

    Parameters
    ----------
    readings : Readings
        Of a simulated test.
    instruments : Instruments
        Say the noise.
    rate : float
        Of the filter, Hz.
    weight : float
        k of 002 §9.2.2.

    Returns
    -------
    list of Direction
        Gravity's reaction and the field, n axes, with their 1-sigma.
    """
    return [
        Direction(GRAVITY_REACTION, readings.f, white_sigma(instruments.accelerometer, rate)),
        Direction(PADUA_FIELD, readings.m, weight * white_sigma(instruments.magnetometer, rate)),
    ]


def accuracy_against_rate(
    rates: Sequence[float], scenario: str, rng: np.random.Generator, *, runs: int = 10, sample: str = "end"
) -> Floats:
    """Error of q3 in the thrusters' profile (002 figures 9.4, 9.6).

    Parameters
    ----------
    rates : sequence of float
        Hz.
    scenario : {"space", "terrestrial"}
    rng : numpy.random.Generator
    runs : int
    sample : {"end", "mean"}
        The gyro's sample at the end of each step (002 eq. 7.45), or the mean of those at its ends.

    Returns
    -------
    ndarray, shape (k, 2)
        rms after `SETTLING` over the runs, with exact (v1) and approximate (v2) discretisation.
    """
    instruments = Instruments()
    out = np.zeros((len(rates), 2))
    for i, rate in enumerate(rates):
        truth = thrusters(rate)
        for _ in range(runs):
            readings = measure(truth, instruments, rng)
            w = readings.w[1:] if sample == "end" else mean_rates(readings.w)
            start = Start.of(truth.q_nb[0], np.zeros(3), ENCODER_SIGMA, 1e-4)
            seen = () if scenario == "space" else terrestrial(readings, instruments, rate)
            tracker = space(readings) if scenario == "space" else None
            noise = common(instruments.gyro)
            for j, how in enumerate(("exact", "approximate")):
                found = estimate(start, w, 1.0 / rate, noise, tracker=tracker, directions=seen, discretisation=how)
                out[i, j] += rms(quaternion_errors(truth.q_nb[1:], found.q_nb), rate)[2] ** 2
    return np.sqrt(out / runs)


def magnetometer_weight(
    factors: Sequence[float],
    rng: np.random.Generator,
    *,
    runs: int = 8,
    duration: float = 180.0,
    rate: float = 100.0,
    left: Floats = MAGNETOMETER_LEFT,
) -> Weights:
    """Monte Carlo for the magnetometer's weight (002 section 9.2.2).

    Parameters
    ----------
    factors : sequence of float
        k, on the sigma of the magnetometer's white noise.
    rng : numpy.random.Generator
    runs : int
        Each with a motion, noises and an imperfect calibration of its own.
    duration : float
        s.
    rate : float
        Hz.
    left : ndarray, shape (3,)
        rms of what calibration leaves on each axis, µT.

    Returns
    -------
    Weights

    Notes
    -----
    With nothing left but white noise the optimal factor is 1; it is the errors of calibration, the same in every
    sample, that a filter takes for information when it trusts the magnetometer's noise.
    """
    square = np.zeros((len(factors), 3))
    for _ in range(runs):
        iron = left[:, None] / float(np.linalg.norm(PADUA_FIELD)) * rng.standard_normal((3, 3))
        instruments = replace(Instruments(), soft_iron=iron)
        truth = by_hand(duration, rate, np.radians([5.0, 7.0, 10.0]), rng)
        readings = measure(truth, instruments, rng)
        start = Start.of(truth.q_nb[0], np.zeros(3), np.radians(3.0), np.radians(0.02))
        for i, factor in enumerate(factors):
            found = run_terrestrial(start, readings, instruments, rate, weight=factor)
            square[i] += rms(quaternion_errors(truth.q_nb[1:], found.q_nb), rate) ** 2
    return Weights(np.array(factors), np.sqrt(square / runs))


@dataclass(frozen=True, slots=True)
class RestDrift:
    """Position that an integration finds for a box at rest, north, east, down, m, each of shape (n, 3)."""

    unfiltered: Floats
    filtered: Floats


RESTING = Instruments(
    gyro=(NoiseCoefficients(N=float(np.radians(0.07)), K=float(np.radians(2e-4))),) * 3,
    accelerometer=(NoiseCoefficients(N=3e-3),) * 3,
)
"""An industrial triad of the class of 000's prototype."""

TURN_ON_000 = np.radians([0.3766, 0.1963, 0.6270])
"""Gyro biases of 000 table 6.2, rad/s."""


def drift_at_rest(
    rng: np.random.Generator, *, duration: float = 100.0, rate: float = 40.0, level_over: float = 10.0
) -> RestDrift:
    """Drift of a box at rest with raw and with filtered rates (000 chapter 9, figures 9.22-9.27).

    Parameters
    ----------
    rng : numpy.random.Generator
    duration : float
        s.
    rate : float
        Hz.
    level_over : float
        s at the start whose mean specific force gives the tilt and stands for gravity: no bias of the accelerometer is
        left along it.

    Returns
    -------
    RestDrift

    Notes
    -----
    Filtered: once a second `quaternion_ekf` is told that the attitude is the one it started with, as rest is known.
    """
    count = round(duration * rate) + 1
    truth = Turning(np.arange(count) / rate, np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)), np.zeros((count, 3)))
    readings = measure(truth, RESTING, rng)
    w = readings.w[1:] + TURN_ON_000
    mean = readings.f[: round(level_over * rate)].mean(axis=0)
    roll, pitch = tilt(mean)
    start = euler_to_quaternion(roll, pitch, 0.0)
    raw = propagate_closed(start, w / rate)[1:]
    density = common(RESTING.gyro)
    state = QuaternionState(start, np.zeros(3), np.diag([1e-8] * 4 + [1e-3] * 3))
    followed = np.empty((count - 1, 4))
    each = round(rate)
    for first in range(0, count - 1, each):
        rows = slice(first, first + each)
        state, followed[rows] = propagate(state, w[rows], 1.0 / rate, density.N**2, density.K**2)
        state = correct(state, start, 1e-8).state
    gravity = np.array([0.0, 0.0, float(np.linalg.norm(mean))])
    return RestDrift(*(_position(q, readings.f, gravity, rate) for q in (raw, followed)))


def _position(q: Floats, f: Floats, gravity: Floats, rate: float) -> Floats:
    a = np.einsum("nij,nj->ni", quaternion_to_matrix(q), f) + gravity
    return np.cumsum(np.cumsum(a, axis=0), axis=0) / rate**2


def run_terrestrial(
    start: Start, readings: Readings, instruments: Instruments, rate: float, *, weight: float = 1.0
) -> Estimates:
    """The terrestrial scenario: accelerometer and magnetometer at every step.

    Parameters
    ----------
    start : Start
        Of the filter.
    readings : Readings
        Of a simulated test.
    instruments : Instruments
        Say the noise.
    rate : float
        Of the filter, Hz.
    weight : float
        k of 002 §9.2.2.

    Returns
    -------
    Estimates
        One row per step.
    """
    seen = terrestrial(readings, instruments, rate, weight=weight)
    return estimate(start, mean_rates(readings.w), 1.0 / rate, common(instruments.gyro), directions=seen)


def run_space(start: Start, readings: Readings, instruments: Instruments, rate: float) -> Estimates:
    """The space scenario: a star tracker now and then.

    Parameters
    ----------
    start : Start
        Of the filter.
    readings : Readings
        Of a simulated test.
    instruments : Instruments
        Say the noise.
    rate : float
        Of the filter, Hz.

    Returns
    -------
    Estimates
        One row per step.
    """
    return estimate(start, mean_rates(readings.w), 1.0 / rate, common(instruments.gyro), tracker=space(readings))
