"""Uniform cubic splines: the one way in which the simulator holds a smooth function.

Speed over time, curvature, slope and bank over distance, and vibration are control polygons of
a uniform cubic B-spline.  Such a function has two continuous derivatives and an exact integral,
stays within its polygon's range, and is evaluated at any set of moments, so the sampling of an
instrument may be as irregular as it likes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.errors import TooLittleDataError
from nav_core.typing import Floats, Integers

MARGIN = 1
"""Coefficient `k` is centred on ``start + (k - MARGIN) * step``."""


@dataclass(frozen=True, slots=True)
class Spline:
    """A uniform cubic B-spline.

    Attributes
    ----------
    start : float
        Left end of the first cell.
    step : float
        Width of a cell; there are ``coefficients.size - 3`` cells.
    coefficients : ndarray, shape (n,)
        Control polygon, n >= 4.
    """

    start: float
    step: float
    coefficients: Floats

    def __post_init__(self) -> None:
        if self.coefficients.size < 4:
            raise TooLittleDataError("coefficients", self.coefficients.size, 4)

    @property
    def centres(self) -> Floats:
        """Abscissae on which the coefficients are centred, shape (n,)."""
        return self.start + self.step * (np.arange(self.coefficients.size, dtype=np.float64) - MARGIN)

    def jet(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Value, first and second derivative at `x`, each of the shape of `x`.

        Parameters
        ----------
        x : ndarray, shape (n,)
            In the unit of `step`.

        Returns
        -------
        value : ndarray, shape (n,)
            In the unit of the coefficients.
        first : ndarray, shape (n,)
            Per unit of `x`.
        second : ndarray, shape (n,)
            Per unit of `x` squared.
        """
        cell, u = self._locate(x)
        c0, c1, c2, c3 = (self.coefficients[cell + k] for k in range(4))
        # Power basis of the cell: value = p0 + p1 u + p2 u² + p3 u³.
        p0 = (c0 + 4.0 * c1 + c2) / 6.0
        p1 = (c2 - c0) / 2.0
        p2 = (c0 - 2.0 * c1 + c2) / 2.0
        p3 = (c3 - c0 + 3.0 * (c1 - c2)) / 6.0
        value = p0 + u * (p1 + u * (p2 + u * p3))
        first = (p1 + u * (2.0 * p2 + 3.0 * u * p3)) / self.step
        second = (2.0 * p2 + 6.0 * u * p3) / self.step**2
        return value, first, second

    def value(self, x: Floats) -> Floats:
        """Value at `x`, of the shape of `x`.

        Parameters
        ----------
        x : ndarray, shape (n,)
            In the unit of `step`.

        Returns
        -------
        ndarray, shape (n,)
            In the unit of the coefficients.
        """
        return self.jet(x)[0]

    def integral(self, x: Floats) -> Floats:
        """Integral from `start` to `x`, of the shape of `x`.

        Parameters
        ----------
        x : ndarray, shape (n,)
            In the unit of `step`.

        Returns
        -------
        ndarray, shape (n,)
            Unit of the coefficients times that of `x`.
        """
        cell, u = self._locate(x)
        c = self.coefficients
        whole = (c[:-3] + 11.0 * (c[1:-2] + c[2:-1]) + c[3:]) / 24.0
        before = np.concatenate(([0.0], np.cumsum(whole)))
        u2 = u * u
        u4 = u2 * u2
        part = (
            c[cell] * (1.0 - (1.0 - u) ** 4) / 24.0
            + c[cell + 1] * (0.125 * u4 - u2 * u / 3.0 + u * (2.0 / 3.0))
            + c[cell + 2] * (-0.125 * u4 + u2 * u / 6.0 + 0.25 * u2 + u / 6.0)
            + c[cell + 3] * u4 / 24.0
        )
        return self.step * (before[cell] + part)

    def _locate(self, x: Floats) -> tuple[Integers, Floats]:
        u = (np.asarray(x, dtype=np.float64) - self.start) / self.step
        cell = np.clip(np.floor(u).astype(np.int64), 0, self.coefficients.size - 4)
        return cell, u - cell
