"""Single-point position from pseudoranges by weighted least squares, and the dilutions of precision (000 §5.3-5.5)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nav_core.earth import RATE, ecef_to_geodetic, tangent_axes
from nav_core.errors import ConvergenceError, GeometryError, RangeError, ShapeError, TooLittleDataError
from nav_core.typing import Floats, trailing

LIGHT = 299_792_458.0
"""Speed of light, m/s."""

CONVERGED = 1e-4
"""Size of the last step, m."""

MOST_ROUNDS = 20

WORST_CONDITION = 1e13
"""Condition number of a scaled normal matrix beyond which its inverse is noise."""


@dataclass(frozen=True, slots=True)
class Dilution:
    """How the geometry of the satellites enlarges the error of the ranges."""

    gdop: float
    """Position and clock."""
    pdop: float
    """Position."""
    hdop: float
    """North and east."""
    vdop: float
    """Height."""
    tdop: float
    """Clock, as a distance."""


@dataclass(frozen=True, slots=True)
class PointFix:
    """Position of a receiver.

    Attributes
    ----------
    r_e : ndarray, shape (3,)
        e frame, m.
    clock : float
        Receiver clock less satellite clocks, as a distance, m.
    covariance : ndarray, shape (4, 4)
        North, east, down, clock, m²; as the stated range errors have it.
    residuals : ndarray, shape (n,)
        Measured less expected ranges, m.
    chi2 : float
        Sum of the squared residuals over their variances; n - 4 degrees of freedom.
    dilution : Dilution
    """

    r_e: Floats
    clock: float
    covariance: Floats
    residuals: Floats
    chi2: float
    dilution: Dilution


def sight(satellites: Floats, receiver: Floats) -> tuple[Floats, Floats]:
    """Distances and unit vectors from a receiver to satellites (000 eqs. 5.3.6, 5.3.7, 5.5.3).

    Parameters
    ----------
    satellites : ndarray, shape (..., 3)
        e frame, m.
    receiver : ndarray, shape (3,)
        e frame, m.

    Returns
    -------
    ranges : ndarray, shape (...)
        m.
    units : ndarray, shape (..., 3)

    Raises
    ------
    ShapeError
    """
    away = trailing("satellites", satellites, 3) - receiver
    ranges = np.sqrt(np.sum(away**2, axis=-1))
    return ranges, away / ranges[..., None]


def elevation_azimuth(satellites: Floats, receiver: Floats) -> tuple[Floats, Floats]:
    """Where satellites stand in the sky.

    Parameters
    ----------
    satellites : ndarray, shape (..., 3)
        e frame, m.
    receiver : ndarray, shape (3,)
        e frame, m.

    Returns
    -------
    elevation, azimuth : ndarray, shape (...)
        Above the horizon; clockwise from north, rad.

    Raises
    ------
    ShapeError, RangeError
    """
    _, units = sight(satellites, receiver)
    local = units @ local_axes(receiver)
    return np.arcsin(-local[..., 2]), np.arctan2(local[..., 1], local[..., 0])


def local_axes(r_e: Floats) -> Floats:
    """``R_et`` at a position: columns north, east, down, shape (3, 3).

    Parameters
    ----------
    r_e : ndarray, shape (3,)
        m.

    Returns
    -------
    ndarray, shape (3, 3)
        From T to e.
    """
    lat, lon, _ = ecef_to_geodetic(r_e)
    return tangent_axes(lat, lon)


def at_reception(satellites: Floats, pseudoranges: Floats) -> Floats:
    """Satellites where they were when they sent, in the axes the Earth has when the signal arrives.

    Parameters
    ----------
    satellites : ndarray, shape (n, 3)
        At emission, in the e frame of that moment, m.
    pseudoranges : ndarray, shape (n,)
        m.

    Returns
    -------
    ndarray, shape (n, 3)
        m.  Left out (as 000 does), the Earth's turning moves a position by up to some 40 m to the east.

    Raises
    ------
    ShapeError
    """
    r = trailing("satellites", satellites, 3)
    turn = RATE * pseudoranges / LIGHT
    cosine, sine = np.cos(turn), np.sin(turn)
    return np.stack((cosine * r[:, 0] + sine * r[:, 1], -sine * r[:, 0] + cosine * r[:, 1], r[:, 2]), axis=-1)


def design(satellites: Floats, receiver: Floats) -> tuple[Floats, Floats]:
    """Expected ranges without clock, and the design matrix of 000 eq. 5.5.10 in local axes.

    Parameters
    ----------
    satellites : ndarray, shape (n, 3)
        e axes, m.
    receiver : ndarray, shape (3,)
        e axes, m.

    Returns
    -------
    ranges : ndarray, shape (n,)
    H : ndarray, shape (n, 4)
        Derivative of each range by north, east, down and clock, for a receiver at `receiver`.
    """
    ranges, units = sight(satellites, receiver)
    return ranges, np.column_stack([-units @ local_axes(receiver), np.ones(ranges.size)])


def inverse(normal: Floats) -> Floats:
    """Inverse of a normal matrix (n, n).

    Parameters
    ----------
    normal : ndarray, shape (n, n)
        Symmetric.

    Returns
    -------
    ndarray, shape (n, n)
        In one over its units.

    Raises
    ------
    GeometryError
    """
    # Ambiguities, clocks and metres differ by orders of magnitude; with a unit diagonal the condition means geometry.
    scale = np.sqrt(np.diag(normal))
    if not scale.min() > 0.0:
        raise GeometryError(np.inf)
    scales = np.outer(scale, scale)
    condition = float(np.linalg.cond(normal / scales))
    if not condition < WORST_CONDITION:
        raise GeometryError(condition)
    return np.asarray(np.linalg.inv(normal / scales) / scales, dtype=np.float64)


def iterated(x: Floats, rows_and_residuals: Callable[[Floats], tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
    """Nonlinear least squares by Gauss-Newton, for measurements with unit, independent noise.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Unknowns to begin with; the first three are a position, m.
    rows_and_residuals : callable
        Derivative of the measurements by `x`, (m, n), and measured less expected, (m,), at an `x`.

    Returns
    -------
    x : ndarray, shape (n,)
    spread : ndarray, shape (n, n)
        Its covariance.

    Raises
    ------
    GeometryError, ConvergenceError
    """
    step = np.inf
    for _ in range(MOST_ROUNDS):
        rows, residuals = rows_and_residuals(x)
        spread = inverse(rows.T @ rows)
        change = spread @ (rows.T @ residuals)
        x, step = x + change, float(np.linalg.norm(change[:3]))
        if step < CONVERGED:
            return x, spread
    raise ConvergenceError(MOST_ROUNDS, step)


def dilution(satellites: Floats, receiver: Floats) -> Dilution:
    """Dilutions of precision of a geometry (000 eqs. 5.5.15-5.5.18).

    Parameters
    ----------
    satellites : ndarray, shape (n, 3)
        e frame, m.
    receiver : ndarray, shape (3,)
        e frame, m.

    Returns
    -------
    Dilution

    Raises
    ------
    ShapeError, TooLittleDataError, GeometryError

    Notes
    -----
    5.5.16 names the unknowns east, north and up, but 5.5.3 derives them in the e axes; the design matrix is turned
    into the local axes first, or HDOP and VDOP mean nothing.
    """
    _four(satellites)
    return _dilution(design(satellites, receiver)[1])


def _dilution(H: Floats) -> Dilution:
    n, e, d, t = np.diag(inverse(H.T @ H))
    roots = (float(np.sqrt(total)) for total in (n + e + d + t, n + e + d, n + e, d, t))
    return Dilution(*roots)


def _four(satellites: Floats) -> None:
    count = trailing("satellites", satellites, 3).shape[0]
    if satellites.ndim != 2:
        raise ShapeError("satellites", satellites.shape, "(n, 3)")
    if count < 4:
        raise TooLittleDataError("satellites", count, 4)


def single_point(satellites: Floats, pseudoranges: Floats, sigma: Floats, *, start: Floats | None = None) -> PointFix:
    """Position and clock from pseudoranges (000 eqs. 5.4.1, 5.5.1-5.5.12).

    Parameters
    ----------
    satellites : ndarray, shape (n, 3)
        e frame at reception (`at_reception`), m; n >= 4.
    pseudoranges : ndarray, shape (n,)
        m, satellite clocks and atmosphere taken off.
    sigma : ndarray, shape (n,)
        1-sigma of each, m.
    start : ndarray, shape (3,), optional
        e frame, m; by default under the middle of the satellites.

    Returns
    -------
    PointFix

    Raises
    ------
    ShapeError, RangeError, TooLittleDataError, GeometryError, ConvergenceError
    """
    _four(satellites)
    n = satellites.shape[0]
    for name, values in (("pseudoranges", pseudoranges), ("sigma", sigma)):
        if values.shape != (n,):
            raise ShapeError(name, values.shape, f"({n},)")
    if not sigma.min() > 0.0:
        raise RangeError("sigma", float(sigma.min()), "more than 0")

    def whitened(x: Floats) -> tuple[Floats, Floats]:
        # In e axes: local ones would turn along with a far start.
        ranges, units = sight(satellites, x[:3])
        rows = np.column_stack([-units, np.ones(n)])
        return rows / sigma[:, None], (pseudoranges - ranges - x[3]) / sigma

    middle = satellites.mean(axis=0)
    x, _ = iterated(np.append(middle * (6.37e6 / np.linalg.norm(middle)) if start is None else start, 0.0), whitened)
    ranges, H = design(satellites, x[:3])
    residuals = pseudoranges - ranges - x[3]
    rows = H / sigma[:, None]
    chi2 = float(np.sum((residuals / sigma) ** 2))
    return PointFix(x[:3], float(x[3]), inverse(rows.T @ rows), residuals, chi2, _dilution(H))
