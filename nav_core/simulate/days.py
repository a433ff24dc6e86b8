"""Days of driving at decimated rate: trips with pauses, a box that warms up, and perhaps a hand that turns it.

Hours of 200 Hz recording cost seconds each, and all that the estimators read of them is the ticks.  Here
the accelerometer runs at twice the tick rate, with the noise that decimation leaves of the faster one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from nav_core.records import Drive, Gnss, Inertial
from nav_core.simulate.drive import random_rotation, simulate
from nav_core.simulate.scenario import Move, Scenario
from nav_core.typing import Floats

DECIMATED = Scenario(accel_rate=20.0, accel_noise=0.025, accel_resolution=0.0, vibration=0.0, vibration_idle=0.0)
"""A box at decimated rate.  8 mg per sample at 200 Hz leave 2.5 mg in the mean of ten; the band of 8-25 Hz
is cut to a hundredth, the one of 1-3 Hz is there as ever."""

_MILLI_G = 9.80665e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Warmth:
    """Temperature of the box and what it does to the accelerometer.

    Attributes
    ----------
    parked : float
        1 sigma of the temperature from trip to trip, K.
    warming : float
        Rise during a trip, K, with the time constant `time`.
    time : float
        s.
    sensitivity : float
        1 sigma of each axis, (m/s²)/K: 0.5 mg/K is an ordinary consumer sensor.
    walk : float
        Random walk of the bias besides, (m/s²)/√s.
    """

    parked: float = 12.0
    warming: float = 18.0
    time: float = 900.0
    sensitivity: float = 0.5 * _MILLI_G
    walk: float = 2.0 * _MILLI_G / 60.0


@dataclass(frozen=True, slots=True)
class Day:
    """A recording of several trips and the mountings in force, each with the box time from which it was."""

    drive: Drive
    mountings: tuple[tuple[float, Floats], ...]


def day(trips: Sequence[Scenario], *, seed: int, pause: float = 600.0, warmth: Warmth | None = None) -> Day:
    """A day of trips by one box.

    Parameters
    ----------
    trips : sequence of Scenario
        In order.  Each begins with the mounting in which the one before ended, turned further by such
        of its `moves` as come before its start; `R_va` of the first one counts, drawn when None.
    seed : int
    pause : float
        Between trips, s.
    warmth : Warmth, optional
        Temperature; an ordinary day's by default.

    Returns
    -------
    Day
    """
    rng = np.random.default_rng((seed, 77))
    warmth = warmth or Warmth()
    R_va = random_rotation(rng) if trips[0].R_va is None else trips[0].R_va
    sensitivity = warmth.sensitivity * rng.standard_normal(3)
    bias = trips[0].accel_bias * rng.standard_normal(3)
    begin, height = 0.0, trips[0].start_alt
    inertial: list[Inertial] = []
    gnss: list[Gnss] = []
    mountings: list[tuple[float, Floats]] = []
    for number, trip in enumerate(trips):
        scenario = replace(trip, R_va=R_va, accel_bias=0.0, start_alt=height)
        drive, truth = simulate(scenario, seed=1000 * seed + number)
        mountings += [(begin + max(since, 0.0), R) for since, R in truth.mountings if number == 0 or since > -np.inf]
        R_va, height = truth.R_va, scenario.start_alt - float(truth.position[-1, 2])
        t = drive.inertial.t
        rise = warmth.parked * rng.standard_normal() + warmth.warming * (1.0 - np.exp(-t / warmth.time))
        steps = warmth.walk * np.sqrt(np.diff(t, prepend=t[0]))[:, None] * rng.standard_normal((t.size, 3))
        wander = bias + np.cumsum(steps, axis=0)
        bias = wander[-1]
        inertial.append(Inertial(t=t + begin, f=drive.inertial.f + wander + np.outer(rise, sensitivity)))
        gnss.append(replace(drive.gnss, t=drive.gnss.t + begin, utc=None))
        # Whole ticks, as the service does it.
        begin += np.ceil(scenario.duration + pause)
    return Day(Drive(_inertial(inertial), _gnss(gnss)), tuple(mountings))


def before_start(turn: Floats) -> Move:
    """A move made while the vehicle is parked before the trip that has it among its moves.

    Parameters
    ----------
    turn : ndarray, shape (3,)
        Rotation vector, rad, A-frame.

    Returns
    -------
    Move
        At a moment before the trip.
    """
    x, y, z = np.asarray(turn, dtype=np.float64).tolist()
    return Move(t=-1.0, turn=(x, y, z))


def _inertial(parts: list[Inertial]) -> Inertial:
    return Inertial(t=np.concatenate([p.t for p in parts]), f=np.concatenate([p.f for p in parts]))


def _gnss(parts: list[Gnss]) -> Gnss:
    columns = {n: np.concatenate([getattr(p, n) for p in parts]) for n in ("t", "lat", "lon", "alt", "speed", "course")}
    return Gnss(fix=np.concatenate([p.fix for p in parts]), **columns)
