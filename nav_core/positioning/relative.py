"""Relative position of two receivers: code differences, carrier-phase differences, cycle slips (000 §5.6, 5.7).

Receiver 1 is the base with a known position, receiver 2 the rover.  A single difference is rover less base, a double
difference a satellite's single difference less the reference satellite's, a triple difference an epoch's double
difference less that of the epoch before.  Phases are distances, m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.errors import RangeError, ShapeError, TooLittleDataError
from nav_core.positioning.single import PointFix, iterated, sight, single_point
from nav_core.typing import Flags, Floats, Integers


def single_difference(base: Floats, rover: Floats) -> Floats:
    """Rover less base, any equal shapes: free of the satellite's clock and initial phase (5.6.2, 5.7.10).

    Parameters
    ----------
    base, rover : ndarray, shape (...)
        Ranges or phases of the same satellites and epochs, m or cycles.

    Returns
    -------
    ndarray, shape (...)
        In that unit.
    """
    return rover - base


def double_difference(single: Floats, reference: int) -> Floats:
    """Single differences of satellites less that of a reference satellite: free of the receivers' clocks (5.7.12).

    Parameters
    ----------
    single : ndarray, shape (..., n)
    reference : int
        Index of the reference satellite, best one that stands high and long.

    Returns
    -------
    ndarray, shape (..., n - 1)
        Without the reference itself.

    Raises
    ------
    RangeError
    """
    if not 0 <= reference < single.shape[-1]:
        raise RangeError("reference", reference, f"0 to {single.shape[-1] - 1}")
    return np.delete(single, reference, axis=-1) - single[..., reference : reference + 1]


def triple_difference(double: Floats) -> Floats:
    """Changes of double differences (k, m) from epoch to epoch: free of ambiguities (5.7.14), shape (k - 1, m).

    Parameters
    ----------
    double : ndarray, shape (k, m)
        m or cycles.

    Returns
    -------
    ndarray, shape (k - 1, m)
        In that unit.
    """
    return np.diff(double, axis=0)


def double_difference_covariance(count: int, sigma: float) -> Floats:
    """Covariance of the double differences of one epoch.

    Parameters
    ----------
    count : int
        Double differences.
    sigma : float
        1-sigma of one undifferenced measurement, m.

    Returns
    -------
    ndarray, shape (count, count)
        ``2 sigma² (I + 1 1')``, m²: all share the reference satellite.
    """
    return 2.0 * sigma**2 * (np.eye(count) + 1.0)


def differential_code(
    base: Floats, satellites: Floats, base_ranges: Floats, rover_ranges: Floats, sigma: Floats
) -> PointFix:
    """Rover position from differenced pseudoranges (000 eq. 5.6.2).

    Parameters
    ----------
    base : ndarray, shape (3,)
        Known position, e frame, m.
    satellites : ndarray, shape (n, 3)
        e frame, m.
    base_ranges, rover_ranges : ndarray, shape (n,)
        Pseudoranges of the same moment, m.
    sigma : ndarray, shape (n,)
        1-sigma of a single difference, m: root two times that of a receiver.

    Returns
    -------
    PointFix
        Its clock is the rover's less the base's.

    Raises
    ------
    ShapeError, RangeError, TooLittleDataError, GeometryError, ConvergenceError

    Notes
    -----
    With the base's geometric ranges put back, a single difference is a pseudorange of the rover without the errors
    that both share: satellite clock and orbit, ionosphere and troposphere over short baselines.
    """
    ranges, _ = sight(satellites, base)
    return single_point(satellites, ranges + single_difference(base_ranges, rover_ranges), sigma, start=base)


def double_ranges(satellites: Floats, base: Floats, rover: Floats, reference: int) -> tuple[Floats, Floats]:
    """Geometric double differences, and their derivative by the rover's position.

    Parameters
    ----------
    satellites : ndarray, shape (..., n, 3)
        e frame, m.
    base, rover : ndarray, shape (3,)
        e frame, m.
    reference : int

    Returns
    -------
    ranges : ndarray, shape (..., n - 1)
        m (5.7.13 without its errors).
    H : ndarray, shape (..., n - 1, 3)

    Raises
    ------
    ShapeError, RangeError
    """
    from_base, _ = sight(satellites, base)
    from_rover, units = sight(satellites, rover)
    ranges = double_difference(single_difference(from_base, from_rover), reference)
    return ranges, np.moveaxis(double_difference(np.moveaxis(-units, -1, -2), reference), -2, -1)


@dataclass(frozen=True, slots=True)
class Slips:
    """Cycle slips.

    Attributes
    ----------
    epoch : ndarray of int, shape (s,)
        First epoch with the new ambiguity.
    pair : ndarray of int, shape (s,)
        Which double difference.  A slip of the reference satellite shows in all of them.
    cycles : ndarray of int, shape (s,)
        By how much.
    """

    epoch: Integers
    pair: Integers
    cycles: Integers


def find_slips(
    double: Floats,
    satellites: Floats,
    base: Floats,
    rover: Floats,
    *,
    reference: int,
    wavelength: float,
    threshold: float = 0.5,
) -> Slips:
    """Cycle slips, from the peaks of the triple differences (000 §5.7.4, fig. 5.4).

    Parameters
    ----------
    double : ndarray, shape (k, n - 1)
        Double differences of phase, m; NaN where not measured.
    satellites : ndarray, shape (k, n, 3)
        e frame, m.
    base, rover : ndarray, shape (3,)
        e frame, m; the rover's to a few metres (`differential_code`), for it only takes the satellites' motion off.
    reference : int
    wavelength : float
        m.
    threshold : float
        Cycles.

    Returns
    -------
    Slips

    Raises
    ------
    ShapeError, RangeError
    """
    expected, _ = double_ranges(satellites, base, rover, reference)
    if double.shape != expected.shape:
        raise ShapeError("double", double.shape, str(expected.shape))
    jumps = triple_difference(double - expected) / wavelength
    epoch, pair = np.nonzero(np.abs(np.nan_to_num(jumps)) > threshold)
    return Slips(epoch + 1, pair, np.rint(jumps[epoch, pair]).astype(np.int64))


def repaired(double: Floats, slips: Slips, wavelength: float) -> Floats:
    """Double differences (k, m) with the slips taken off from their epochs on.

    Parameters
    ----------
    double : ndarray, shape (k, m)
        m.
    slips : Slips
        Of `find_slips`.
    wavelength : float
        m.

    Returns
    -------
    ndarray, shape (k, m)
        m.
    """
    fixed = double.copy()
    for epoch, pair, cycles in zip(slips.epoch, slips.pair, slips.cycles, strict=True):
        fixed[epoch:, pair] -= cycles * wavelength
    return fixed


@dataclass(frozen=True, slots=True)
class Baseline:
    """Rover position from carrier phases.

    Attributes
    ----------
    rover : ndarray, shape (3,)
        e frame, m.
    covariance : ndarray, shape (3, 3)
        e axes, m².
    ambiguities : ndarray, shape (m,), optional
        Of the double differences, cycles; None from triple differences.
    ambiguity_sigma : ndarray, shape (m,), optional
        0 once fixed.
    fixed : bool
        Whether the ambiguities were taken as whole numbers.
    """

    rover: Floats
    covariance: Floats
    ambiguities: Floats | None
    ambiguity_sigma: Floats | None
    fixed: bool


def triple_baseline(
    double: Floats, satellites: Floats, base: Floats, start: Floats, *, reference: int, sigma: float, keep: Flags
) -> Baseline:
    """Static rover from triple differences: no ambiguities, first approximation (000 §5.7.4).

    Parameters
    ----------
    double : ndarray, shape (k, n - 1)
        m.
    satellites : ndarray, shape (k, n, 3)
        e frame, m.
    base, start : ndarray, shape (3,)
        Base, and rover to begin with, e frame, m.
    reference : int
    sigma : float
        1-sigma of one undifferenced phase, m.
    keep : ndarray of bool, shape (k - 1, n - 1)
        Which triple differences to use: not those across a slip.

    Returns
    -------
    Baseline
        Its covariance takes the triple differences for independent.

    Raises
    ------
    ShapeError, RangeError, GeometryError, ConvergenceError
    """
    measured = triple_difference(double)
    if keep.shape != measured.shape:
        raise ShapeError("keep", keep.shape, str(measured.shape))

    def changes(rover: Floats) -> tuple[Floats, Floats]:
        ranges, H = double_ranges(satellites, base, rover, reference)
        return np.diff(H, axis=0)[keep], (measured - triple_difference(ranges))[keep]

    rover, spread = iterated(start, changes)
    # Four measurements of variance sigma² make a double difference, two of those a triple.
    return Baseline(rover, 8.0 * sigma**2 * spread, None, None, fixed=False)


def double_baseline(
    double: Floats,
    satellites: Floats,
    base: Floats,
    start: Floats,
    *,
    reference: int,
    sigma: float,
    wavelength: float,
    fix_within: float = 0.1,
) -> Baseline:
    """Static rover and ambiguities from double differences; fixed to whole cycles where that is safe (000 §5.7.3).

    Parameters
    ----------
    double : ndarray, shape (k, n - 1)
        Without slips, m.
    satellites : ndarray, shape (k, n, 3)
        e frame, m.
    base, start : ndarray, shape (3,)
        e frame, m.
    reference : int
    sigma : float
        1-sigma of one undifferenced phase, m.
    wavelength : float
        m.
    fix_within : float
        Ambiguities are rounded only if all have at most this 1-sigma, and lie within three of them of a whole
        number, cycles.

    Returns
    -------
    Baseline

    Raises
    ------
    ShapeError, RangeError, TooLittleDataError, GeometryError, ConvergenceError

    Notes
    -----
    5.7.13.  Rounding ignores how ambiguities are correlated; a search with decorrelation (Teunissen 1995) would fix
    after shorter sessions.
    """
    if double.ndim != 2 or double.shape[0] < 2:
        raise TooLittleDataError("epochs", double.shape[0] if double.ndim else 0, 2)
    m = double.shape[1]
    x, spread = _adjust(double, satellites, base, start, reference, sigma, wavelength)
    cycles, sigmas = x[3:], np.sqrt(np.diag(spread)[3:])
    whole = np.rint(cycles)
    safe = sigmas.max() <= fix_within and (np.abs(cycles - whole) <= 3.0 * sigmas).all()
    if not safe:
        return Baseline(x[:3], spread[:3, :3], cycles, sigmas, fixed=False)
    # The ambiguities known exactly: the position's mean and covariance given them.
    gain = spread[:3, 3:] @ np.linalg.inv(spread[3:, 3:])
    rover = x[:3] + gain @ (whole - cycles)
    return Baseline(rover, spread[:3, :3] - gain @ spread[3:, :3], whole, np.zeros(m), fixed=True)


def _adjust(
    double: Floats, satellites: Floats, base: Floats, start: Floats, reference: int, sigma: float, wavelength: float
) -> tuple[Floats, Floats]:
    """Position and ambiguities (3 + m,) with their covariance, by iterated weighted least squares."""
    m = double.shape[1]
    white = np.linalg.inv(np.linalg.cholesky(double_difference_covariance(m, sigma)))

    def whitened(x: Floats) -> tuple[Floats, Floats]:
        ranges, H = double_ranges(satellites, base, x[:3], reference)
        if double.shape != ranges.shape:
            raise ShapeError("double", double.shape, str(ranges.shape))
        rows = np.concatenate([H, np.broadcast_to(wavelength * np.eye(m), (*ranges.shape, m))], axis=-1)
        left = (double - ranges - wavelength * x[3:]) @ white.T
        return (white @ rows).reshape(-1, 3 + m), left.ravel()

    return iterated(np.append(start, np.zeros(m)), whitened)
