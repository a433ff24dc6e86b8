"""Bias against temperature (002 section 6.6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.errors import RangeError, ShapeError, TooLittleDataError
from nav_core.sensors.calibration import check_readings
from nav_core.sensors.error_model import REFERENCE_TEMPERATURE
from nav_core.typing import Floats

LEAST_SPAN = 1.0
"""K; over less than this the slope says nothing about the sensor's range."""


@dataclass(frozen=True, slots=True)
class TemperatureFit:
    """Straight lines ``bias = offset + slope (T - 25 °C)`` of three axes.

    Attributes
    ----------
    slope : ndarray, shape (3,)
        Unit of the readings per K: p1 of 002 eq. 6.24.
    offset : ndarray, shape (3,)
        Bias at 25 °C.
    covariance : ndarray, shape (3, 2, 2)
        Of (offset, slope), axis by axis.
    residuals : ndarray, shape (n, 3)
    span : tuple of float
        Lowest and highest temperature, °C; the line is not known beyond.
    """

    slope: Floats
    offset: Floats
    covariance: Floats
    residuals: Floats
    span: tuple[float, float]

    @property
    def intercept(self) -> Floats:
        """Bias at 0 °C, p2 of 002 eq. 6.24, shape (3,)."""
        return self.offset - REFERENCE_TEMPERATURE * self.slope

    def interval(self, level: float = 0.95) -> Floats:
        """Intervals of the slopes, shape (3, 2).

        Parameters
        ----------
        level : float
            Probability, between 0 and 1.

        Returns
        -------
        ndarray, shape (3, 2)
            Sensor's unit per °C.
        """
        from scipy.special import stdtrit

        reach = stdtrit(len(self.residuals) - 2, 0.5 + 0.5 * level) * np.sqrt(self.covariance[:, 1, 1])
        return np.stack((self.slope - reach, self.slope + reach), axis=1)

    def bias(self, temp: Floats | float) -> Floats:
        """Bias at these temperatures, °C, shape (..., 3).

        Parameters
        ----------
        temp : ndarray or float, shape (...)
            °C.

        Returns
        -------
        ndarray, shape (..., 3)
            In the sensor's unit.
        """
        return self.offset + (np.asarray(temp, dtype=np.float64)[..., None] - REFERENCE_TEMPERATURE) * self.slope


def fit_temperature(temp: Floats, readings: Floats) -> TemperatureFit:
    """Line of each axis through readings at rest and their temperatures.

    Parameters
    ----------
    temp : ndarray, shape (n,)
        °C.
    readings : ndarray, shape (n, 3)
        At rest, n >= 3.

    Returns
    -------
    TemperatureFit

    Raises
    ------
    ShapeError, NotFiniteError, TooLittleDataError
    RangeError
        The temperature spans less than 1 K.

    Notes
    -----
    002 eq. 6.24, centred at 25 °C (000 section 7.3.1), where offset and slope are asked for.  The covariance
    takes the errors of the readings as independent; bias wandering within the test is not in it.
    """
    y, T = check_readings("readings", readings), np.asarray(temp, dtype=np.float64)
    if T.shape != (len(y),):
        raise ShapeError("temp", T.shape, f"({len(y)},)")
    if T.size < 3:
        raise TooLittleDataError("temp", int(T.size), 3)
    low, high = float(T.min()), float(T.max())
    if not high - low >= LEAST_SPAN:
        raise RangeError("span of the temperature", high - low, f">= {LEAST_SPAN:g} K")
    middle = T.mean()
    above = T - middle
    weight = float(above @ above)
    slope = above @ (y - y.mean(axis=0)) / weight
    left = y - y.mean(axis=0) - np.outer(above, slope)
    variance = np.sum(left**2, axis=0) / (T.size - 2)
    lever = REFERENCE_TEMPERATURE - middle
    unit = np.array([[1.0 / T.size + lever**2 / weight, lever / weight], [lever / weight, 1.0 / weight]])
    return TemperatureFit(slope, y.mean(axis=0) + lever * slope, variance[:, None, None] * unit, left, (low, high))
