"""What every calibration returns, and the least squares that they share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from nav_core.errors import PosesError, RangeError, ShapeError
from nav_core.typing import Floats, finite

WORST_CONDITION = 200.0
"""Condition number beyond which poses are refused.  Poses all over the sphere reach 2 to 30, a hemisphere 20; tilts
up to 60° alone 140, up to 45° 500, and turning about one axis alone has no end."""

FLAT = 0.05
"""Least thickness of the cloud of readings over its width: a band of ±4° about a great circle."""

LEAST_REACH = 0.05
"""Least mean square of the corrected directions along any axis.  All over the sphere it is a third, in a band of ±23°
about a great circle this.  Noise alone would allow thinner bands, but a magnitude that is wrong by a share of itself,
as a field between houses is, makes the scale across the band wrong by that share over this number."""


@dataclass(frozen=True, slots=True)
class Poses:
    """Why the poses were enough: a calibration whose poses are not is refused with `PosesError`."""

    count: int
    """Poses, or samples, used."""
    needed: int
    """Least number for the method."""
    condition: float
    """Of the equations: how much worse the worst combination of parameters is known than the best."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """Result of a calibration: ``reading = gain @ truth + bias``.

    Attributes
    ----------
    names : tuple of str
        Of the parameters, as in the source of the method.
    values : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)
    gain : ndarray, shape (3, 3)
    bias : ndarray, shape (3,)
        In the unit of the readings.
    residuals : ndarray, shape (n,) or (n, 3)
        What is left of each equation after the calibration, in the unit of the truth.
    freedom : int, optional
        Redundancy of the residuals from which the covariance was scaled; None when the noise was given.
    poses : Poses
    iterations : int
        0 for a closed solution.
    """

    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    gain: Floats
    bias: Floats
    residuals: Floats
    freedom: int | None
    poses: Poses
    iterations: int = 0

    @property
    def sigma(self) -> Floats:
        """Standard deviations of the parameters, shape (k,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def rms(self) -> Floats:
        """Root mean square of the residuals, shape () or (3,)."""
        return np.sqrt(np.einsum("n...,n...->...", self.residuals, self.residuals) / len(self.residuals))

    def interval(self, level: float = 0.95) -> Floats:
        """Interval of each parameter, shape (k, 2): Student's t, or normal where the noise was given.

        Parameters
        ----------
        level : float
            Probability, between 0 and 1.

        Returns
        -------
        ndarray, shape (k, 2)
            In the units of `values`.
        """
        from scipy.special import ndtri, stdtrit

        tail = 0.5 + 0.5 * level
        reach = ndtri(tail) if self.freedom is None else stdtrit(self.freedom, tail)
        return np.stack((self.values - reach * self.sigma, self.values + reach * self.sigma), axis=1)

    def correct(self, readings: Floats) -> Floats:
        """Truth from readings, shape (..., 3): ``gain^-1 (reading - bias)`` (000 eq. 6.2.11, 002 eq. 6.7).

        Parameters
        ----------
        readings : ndarray, shape (..., 3)
            In the sensor's unit and axes.

        Returns
        -------
        ndarray, shape (..., 3)
            In the reference's unit, body axes.
        """
        return (np.asarray(readings, dtype=np.float64) - self.bias) @ np.linalg.inv(self.gain).T

    @property
    def matrix(self) -> Floats:
        """The calibration matrix ``[gain^-1, -gain^-1 bias]`` of 002 eq. 6.9, shape (3, 4)."""
        inverse: Floats = np.asarray(np.linalg.inv(self.gain), dtype=np.float64)
        return np.column_stack((inverse, -inverse @ self.bias))


class Minimum(NamedTuple):
    """Where `levenberg_marquardt` ended."""

    x: Floats
    residuals: Floats
    jacobian: Floats
    iterations: int


def levenberg_marquardt(model: Callable[[Floats], tuple[Floats, Floats]], x: Floats) -> Minimum:
    """Minimise a sum of squares by damped Gauss-Newton steps (001 section B.3).

    Parameters
    ----------
    model : callable
        From parameters, shape (k,), to residuals, shape (n,), and their derivative, shape (n, k).
    x : ndarray, shape (k,)
        Start.

    Returns
    -------
    Minimum
        The last accepted parameters; at most 100 steps.

    Notes
    -----
    Damping in proportion to the diagonal, tenfold up after a step that does not improve, tenfold down after one that
    does.  Ends when a step would change the residuals by less than 1e-8 of them.
    """
    r, slope = model(x)
    damping, cost = 1e-3, float(r @ r)
    for iteration in range(1, 101):
        H, gradient = slope.T @ slope, slope.T @ r
        scale = np.diag(np.maximum(np.diag(H), 1e-300))
        step = np.linalg.lstsq(H + damping * scale, -gradient, rcond=None)[0]
        trial, trial_slope = model(x + step)
        # Rounding may spoil the last step; without improvement there is nothing left to do either.
        small = float(np.linalg.norm(slope @ step)) <= 1e-8 * np.sqrt(cost) + 1e-14 * float(np.linalg.norm(slope * x))
        if float(trial @ trial) < cost:
            x, r, slope = x + step, trial, trial_slope
            cost, damping = float(r @ r), 0.1 * damping
        else:
            damping *= 10.0
        if small or damping > 1e12:
            return Minimum(x, r, slope, iteration)
    return Minimum(x, r, slope, 100)


def check_readings(name: str, readings: Floats) -> Floats:
    """Readings as floats, shape (n, 3), finite; else `ShapeError` or `NotFiniteError`.

    Parameters
    ----------
    name : str
        What they are, for the error.
    readings : ndarray, shape (n, 3)
        In any unit.

    Returns
    -------
    ndarray, shape (n, 3)
        The same numbers.

    Raises
    ------
    ShapeError, NotFiniteError
    """
    values = np.asarray(readings, dtype=np.float64)
    if values.ndim != 2 or values.shape[1] != 3:
        raise ShapeError(name, values.shape, "(n, 3)")
    return finite(name, values)


def check_spread(readings: Floats, needed: int) -> None:
    """Refuse readings that are too few, or that lie in a plane: the box was only turned about one axis.

    Parameters
    ----------
    readings : ndarray, shape (n, 3)
        One row per pose, in any unit.
    needed : int
        Least number of poses.

    Raises
    ------
    PosesError
    """
    if len(readings) < needed:
        raise PosesError(f"{needed} are needed", len(readings), np.inf)
    width = np.linalg.svd(readings - readings.mean(axis=0), compute_uv=False)
    if width[2] < FLAT * width[0]:
        raise PosesError(
            f"they are coplanar (thickness {width[2] / max(width[0], 1e-300):.2g} of the width); turn the box about "
            "a second axis as well",
            len(readings),
            np.inf,
        )


def check_reach(directions: Floats) -> None:
    """Refuse a solution whose directions keep to a band about a plane: what it says across the band is extrapolated.

    Parameters
    ----------
    directions : ndarray, shape (n, 3)
        Corrected readings of unit length, axes of the truth.

    Raises
    ------
    PosesError
    """
    squares, axes = np.linalg.eigh(directions.T @ directions / len(directions))
    if squares[0] < LEAST_REACH:
        across = axes[:, 0] * np.sign(axes[np.argmax(np.abs(axes[:, 0])), 0])
        raise PosesError(
            f"they are almost coplanar ({squares[0]:.2g} of the mean square lies across, {LEAST_REACH:g} is needed); "
            f"nothing reaches along the direction ({', '.join(f'{part:.2f}' for part in across)})",
            len(directions),
            np.inf,
        )


def solution_covariance(
    J: Floats, residuals: Floats, names: tuple[str, ...], noise: float | None, count: int
) -> tuple[Floats, int | None, float]:
    """Covariance, redundancy and condition number of a least squares solution.

    Parameters
    ----------
    J : ndarray, shape (n, k)
        Derivative of the residuals.
    residuals : ndarray, shape (n,)
    names : tuple of str
        Of the k parameters.
    noise : float, optional
        Standard deviation of the residuals, where known; else it is taken from them, with n - k redundant ones
        (the listing of 000 leaves out the division, which makes its variances n - k times too large).
    count : int
        Poses, for the message.

    Returns
    -------
    covariance : ndarray, shape (k, k)
    redundancy : int or None
        n - k; None where `noise` was given.
    condition : float
        Largest over smallest singular value of `J`.

    Raises
    ------
    PosesError
        The equations do not determine all parameters.
    RangeError
        `noise` is not positive.
    """
    _, sizes, axes = np.linalg.svd(J, full_matrices=False)
    condition = float(sizes[0] / sizes[-1]) if sizes[-1] > 0.0 else np.inf
    if condition > WORST_CONDITION:
        weak = ", ".join(name for name, part in zip(names, np.abs(axes[-1]), strict=True) if part > 0.3)
        raise PosesError(f"directions are missing that determine {weak}", count, condition)
    unit = (axes.T / sizes**2) @ axes
    if noise is not None:
        if not noise > 0.0:
            raise RangeError("noise", noise, "> 0")
        return noise**2 * unit, None, condition
    freedom = residuals.size - len(names)
    if freedom < 1:
        raise PosesError("none is left over to tell how exact the result is; give the noise or more", count, condition)
    return float(residuals @ residuals) / freedom * unit, freedom, condition
