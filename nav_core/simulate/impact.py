"""Impacts: pulses of exact delta-V, and the friction that brings the vehicle to rest after them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.simulate.scenario import PulseShape
from nav_core.typing import Floats

SLIDE_DECELERATION = 6.0
"""Strongest deceleration while the vehicle comes to rest after an impact, m/s²."""

_SHORTEST_SLIDE = 0.8


@dataclass(frozen=True, slots=True)
class Shock:
    """An impact on its way to rest: unit step through a pulse, then a smooth return to zero.

    Attributes
    ----------
    t0, duration : float
        Start and length of the pulse, s.
    shape : {"haversine", "half_sine", "triangle"}
    slide : float
        Time from the end of the pulse to rest, s.
    forward, sideways : float
        Delta-V along V x and y, m/s.
    across : ndarray, shape (3,)
        The V y axis at `t0` in T.
    turn_rate : float
        Change of turn rate, rad/s.
    """

    t0: float
    duration: float
    shape: PulseShape
    slide: float
    forward: float
    sideways: float
    across: Floats
    turn_rate: float

    def jet(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Integral, value and rate of the unit motion: 0 before, 1 at the end of the pulse, 0 at rest.

        Parameters
        ----------
        t : ndarray, shape (n,)
            s.

        Returns
        -------
        travel, value, rate : ndarray, shape (n,)
            s, 1, 1/s.
        """
        travel, value, rate = pulse(self.shape, np.clip((t - self.t0) / self.duration, 0.0, 1.0))
        after, left, braking = self.friction(t)
        inside = t < self.t0 + self.duration
        return (
            self.duration * travel + after,
            np.where(inside, value, left),
            np.where(inside, rate / self.duration, braking),
        )

    def friction(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Integral, value and rate of what friction leaves of a speed: 1 until the pulse ends, then down to 0.

        The integral counts from the end of the pulse, s.

        Parameters
        ----------
        t : ndarray, shape (n,)
            Box clock, s.

        Returns
        -------
        travel : ndarray, shape (n,)
            s.
        value : ndarray, shape (n,)
            0 to 1.
        rate : ndarray, shape (n,)
            1/s.
        """
        x = np.clip((t - self.t0 - self.duration) / self.slide, 0.0, 1.0)
        travel = self.slide * (0.5 * x + np.sin(np.pi * x) / (2.0 * np.pi))
        rate = -0.5 * np.pi * np.sin(np.pi * x) / self.slide
        return travel, 0.5 * (1.0 + np.cos(np.pi * x)), rate


def slide_time(speed: float) -> float:
    """Time in which friction brings a vehicle of this speed, m/s, to rest, s.

    Parameters
    ----------
    speed : float
        m/s.

    Returns
    -------
    float
        s; never 0.
    """
    return max(_SHORTEST_SLIDE, 0.5 * np.pi * speed / SLIDE_DECELERATION)


def pulse(shape: PulseShape, x: Floats) -> tuple[Floats, Floats, Floats]:
    """Unit pulse on 0..1: integral, value and rate of the step it makes.

    Parameters
    ----------
    shape : {"haversine", "half_sine", "triangle"}
    x : ndarray, shape (n,)
        Share of the duration that has passed, 0..1.

    Returns
    -------
    travel, step, rate : ndarray, shape (n,)
        ``step`` goes from 0 to 1 and ``rate`` is its derivative; ``travel`` is its integral.
    """
    match shape:
        case "haversine":
            turn = 2.0 * np.pi * x
            travel = 0.5 * x**2 + (np.cos(turn) - 1.0) / (4.0 * np.pi**2)
            return travel, x - np.sin(turn) / (2.0 * np.pi), 1.0 - np.cos(turn)
        case "half_sine":
            half = np.pi * x
            return 0.5 * x - np.sin(half) / (2.0 * np.pi), 0.5 * (1.0 - np.cos(half)), 0.5 * np.pi * np.sin(half)
        case "triangle":
            y = 1.0 - x
            rising = x < 0.5
            travel = np.where(rising, 2.0 * x**3 / 3.0, x - 0.5 + 2.0 * y**3 / 3.0)
            return travel, np.where(rising, 2.0 * x**2, 1.0 - 2.0 * y**2), 4.0 * np.minimum(x, y)
