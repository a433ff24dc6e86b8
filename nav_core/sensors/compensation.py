"""Compensation of a triad at work: calibration, temperature, the bias that a filter feeds back (000 section 7.3)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from nav_core.errors import RangeError, ShapeError
from nav_core.sensors.error_model import REFERENCE_TEMPERATURE
from nav_core.typing import Floats, trailing


@dataclass(frozen=True, slots=True)
class Compensation:
    """What is taken off the readings of a triad.

    Attributes
    ----------
    gain : ndarray, shape (3, 3)
        Of the calibration: ``reading = gain @ truth + bias``.
    bias : ndarray, shape (3,)
        At 25 °C, in the unit of the readings.
    slope : ndarray, shape (3,)
        Change of the bias, per K.
    feedback : ndarray, shape (3,)
        Bias that the filter has found on top, in the unit of the truth: the sum of its corrections.
    hold : float
        s after a reset of the attitude during which corrections are held back (T_KF).
    held_until : float
        Time before which the filter's corrections are not taken, s.
    """

    gain: Floats = field(default_factory=lambda: np.eye(3))
    bias: Floats = field(default_factory=lambda: np.zeros(3))
    slope: Floats = field(default_factory=lambda: np.zeros(3))
    feedback: Floats = field(default_factory=lambda: np.zeros(3))
    hold: float = 5.0
    held_until: float = -np.inf

    def __post_init__(self) -> None:
        for name, shape in (("gain", (3, 3)), ("bias", (3,)), ("slope", (3,)), ("feedback", (3,))):
            if np.shape(getattr(self, name)) != shape:
                raise ShapeError(name, np.shape(getattr(self, name)), str(shape))
        if not self.hold >= 0.0:
            raise RangeError("hold", self.hold, ">= 0")

    def apply(self, readings: Floats, *, temp: Floats | float = REFERENCE_TEMPERATURE) -> Floats:
        """Compensated readings.

        Parameters
        ----------
        readings : ndarray, shape (..., 3)
        temp : float or ndarray, shape (...)
            °C.

        Returns
        -------
        ndarray, shape (..., 3)
            ``gain^-1 (reading - bias - slope (T - 25)) - feedback``.

        Raises
        ------
        ShapeError
        """
        warmer = np.asarray(temp, dtype=np.float64)[..., None] - REFERENCE_TEMPERATURE
        centred = trailing("readings", readings, 3) - self.bias - warmer * self.slope
        return centred @ np.linalg.inv(self.gain).T - self.feedback

    def corrected(self, t: float, bias_error: Floats) -> Compensation:
        """After the filter found a bias at time `t`, s, shape (3,): added to the feedback unless it is held back.

        The thesis adds the filter's state, whose sign is opposite to the sensor's bias (docs/equations.md); here the
        bias itself is given, and taken off.

        Parameters
        ----------
        t : float
            s.
        bias_error : ndarray, shape (3,)
            Sensor's bias that is left, body axes, in the sensor's unit.

        Returns
        -------
        Compensation
            `self` while feedback is held back.

        Raises
        ------
        ShapeError
        """
        if t < self.held_until:
            return self
        return replace(self, feedback=self.feedback + trailing("bias_error", bias_error, 3))

    def reset(self, t: float) -> Compensation:
        """After the attitude was reset at time `t`, s: its jump would be taken for a bias, so feedback waits.

        Parameters
        ----------
        t : float
            s.

        Returns
        -------
        Compensation
            Without feedback until `t` plus `hold`.
        """
        return replace(self, held_until=t + self.hold)
