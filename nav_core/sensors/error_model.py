"""What a triad of sensors makes of the truth (000 sections 1.5.2 and 1.5.6)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from nav_core.errors import RangeError, ShapeError
from nav_core.typing import Floats

REFERENCE_TEMPERATURE = 25.0
"""°C to which biases and gains refer (000 section 7.3.1)."""


def _zeros() -> Floats:
    return np.zeros(3)


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """Deterministic errors of three sensors; the default has none.

    The truth goes through, in this order: scale and misalignment ``(I + M)``, their change with temperature, asymmetry
    and nonlinearity of each axis, dead zone, bias with its change with temperature, noise, quantisation, clipping.

    Attributes
    ----------
    bias : ndarray, shape (3,)
        Reading at zero input at 25 °C, in the unit of the readings.
    M : ndarray, shape (3, 3)
        Deviations of scale on the diagonal, misalignments (rad) beside it (000 eq. 1.5.1).
    asymmetry : ndarray, shape (3,)
        The gain is ``1 + asymmetry`` for positive and ``1 - asymmetry`` for negative input.
    quadratic : ndarray, shape (3,)
        C2 of 000 section 1.5.6, per unit.
    bias_slope, scale_slope : ndarray, shape (3,)
        Change of bias, unit/K, and of scale, 1/K.
    dead_zone : float
        Input up to this size, in the unit of the readings, moves nothing, as static friction; beyond it the
        reading starts from zero.
    resolution : float
        Step of the readings; 0: none.
    full_scale : float
        Readings end at plus and minus this value.
    """

    bias: Floats = field(default_factory=_zeros)
    M: Floats = field(default_factory=lambda: np.zeros((3, 3)))
    asymmetry: Floats = field(default_factory=_zeros)
    quadratic: Floats = field(default_factory=_zeros)
    bias_slope: Floats = field(default_factory=_zeros)
    scale_slope: Floats = field(default_factory=_zeros)
    dead_zone: float = 0.0
    resolution: float = 0.0
    full_scale: float = np.inf

    def __post_init__(self) -> None:
        for name in ("bias", "asymmetry", "quadratic", "bias_slope", "scale_slope"):
            object.__setattr__(self, name, _fixed(name, getattr(self, name), (3,)))
        object.__setattr__(self, "M", _fixed("M", self.M, (3, 3)))
        if np.any(np.abs(self.asymmetry) >= 1.0):
            raise RangeError("asymmetry", float(np.max(np.abs(self.asymmetry))), "|asymmetry| < 1")
        for name in ("dead_zone", "resolution"):
            if getattr(self, name) < 0.0:
                raise RangeError(name, getattr(self, name), ">= 0")
        if not self.full_scale > 0.0:
            raise RangeError("full_scale", self.full_scale, "> 0")

    def measure(self, truth: Floats, *, noise: Floats | None = None, temp: Floats | float | None = None) -> Floats:
        """Readings of the truth.

        Parameters
        ----------
        truth : ndarray, shape (n, 3)
            Specific force, rate or field in the axes of the triad.
        noise : ndarray, shape (n, 3), optional
            Added before quantisation, e.g. from `simulate_noise`.
        temp : float or ndarray, shape (n,), optional
            °C; by default 25.

        Returns
        -------
        ndarray, shape (n, 3)

        Raises
        ------
        ShapeError
        """
        z = _rows("truth", truth) @ (np.eye(3) + self.M).T
        warmer = self._warmer(temp)
        z = z * (1.0 + warmer * self.scale_slope)
        y = z * (1.0 + self.asymmetry * np.sign(z)) + self.quadratic * z**2
        y = np.sign(y) * np.maximum(np.abs(y) - self.dead_zone, 0.0) + self.bias + warmer * self.bias_slope
        if noise is not None:
            y = y + noise
        if self.resolution > 0.0:
            y = self.resolution * np.round(y / self.resolution)
        return np.clip(y, -self.full_scale, self.full_scale)

    def correct(self, readings: Floats, *, temp: Floats | float | None = None) -> Floats:
        """Truth from readings: the exact inverse of all that can be inverted.

        Quantisation and clipping cannot, and what fell into the dead zone comes back as zero (000 section 1.5.2).

        Parameters
        ----------
        readings : ndarray, shape (n, 3)
        temp : float or ndarray, shape (n,), optional
            °C; by default 25.

        Returns
        -------
        ndarray, shape (n, 3)

        Raises
        ------
        ShapeError
        RangeError
            A reading lies where the quadratic term has turned the characteristic round.
        """
        warmer = self._warmer(temp)
        y = _rows("readings", readings) - self.bias - warmer * self.bias_slope
        y = np.where(y == 0.0, 0.0, y + np.sign(y) * self.dead_zone)
        gain = 1.0 + self.asymmetry * np.sign(y)
        root = gain**2 + 4.0 * self.quadratic * y
        if np.any(root < 0.0):
            raise RangeError("discriminant of the characteristic", float(root.min()), ">= 0")
        z = 2.0 * y / (gain + np.sqrt(root)) / (1.0 + warmer * self.scale_slope)
        return np.asarray(np.linalg.solve(np.eye(3) + self.M, z.T), dtype=np.float64).T

    def _warmer(self, temp: Floats | float | None) -> Floats:
        """Kelvin above the reference, shape (n, 1) or (1, 1)."""
        given = REFERENCE_TEMPERATURE if temp is None else temp
        return np.atleast_1d(np.asarray(given, dtype=np.float64))[:, None] - REFERENCE_TEMPERATURE


def _fixed(name: str, values: Floats, shape: tuple[int, ...]) -> Floats:
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise ShapeError(name, array.shape, str(shape))
    array.flags.writeable = False
    return array


def _rows(name: str, values: Floats) -> Floats:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ShapeError(name, array.shape, "(n, 3)")
    return array
