"""Overlapping Allan deviation (002 section 5.2; IEEE Std 647, annex C)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.errors import NotFiniteError, RangeError, ShapeError, TooLittleDataError
from nav_core.typing import Floats, Integers, kernel


@dataclass(frozen=True, slots=True)
class AllanDeviation:
    """Allan deviation of one recording at several cluster times.

    Attributes
    ----------
    rate : float
        Of the samples, Hz.
    samples : int
        Their number.
    factor : ndarray of int64, shape (k,)
        Samples in a cluster.
    sigma : ndarray, shape (k,)
        Allan deviation, in the unit of the samples.
    """

    rate: float
    samples: int
    factor: Integers
    sigma: Floats

    @property
    def tau(self) -> Floats:
        """Cluster time, s, shape (k,)."""
        return self.factor / self.rate

    @property
    def count(self) -> Integers:
        """Pairs of clusters behind each value, overlapping ones included, shape (k,)."""
        return self.samples + 1 - 2 * self.factor


def cluster_factors(samples: int, *, per_octave: int = 4, pairs: int = 2) -> Integers:
    """Cluster lengths spread evenly over the logarithm, the powers of two among them.

    Parameters
    ----------
    samples : int
    per_octave : int
        How many to each doubling; short clusters have fewer, being whole numbers.
    pairs : int
        The longest cluster still fits this often into the recording.

    Returns
    -------
    ndarray of int64, shape (k,), strictly increasing
    """
    longest = max(samples // pairs, 1)
    steps = np.arange(int(np.floor(per_octave * np.log2(longest))) + 1)
    return np.unique(np.round(2.0 ** (steps / per_octave)).astype(np.int64))


def allan_deviation(x: Floats, rate: float, *, factors: Integers | None = None) -> AllanDeviation:
    """Overlapping Allan deviation of regular samples.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Samples of rate, specific force or field, in any unit: means over their period, not their integral.
    rate : float
        Hz.
    factors : ndarray of int64, shape (k,), optional
        Samples in a cluster, each from 1 to n // 2; by default `cluster_factors`.

    Returns
    -------
    AllanDeviation

    Raises
    ------
    ShapeError, NotFiniteError, RangeError, TooLittleDataError
        `x` is not a column, has gaps, or fewer than 3 samples; `rate` is not positive; a factor does not fit.

    Notes
    -----
    002 eq. 5.7 over all pairs of adjoining clusters, not only those that begin at multiples of the cluster:
    ``sigma² = mean((theta(k + 2m) - 2 theta(k + m) + theta(k))²) / (2 m²)`` with `theta` the running sum.
    """
    x = np.ascontiguousarray(x, dtype=np.float64)
    if x.ndim != 1:
        raise ShapeError("x", x.shape, "(n,)")
    if x.size < 3:
        raise TooLittleDataError("x", x.size, 3)
    if not np.isfinite(x).all():
        raise NotFiniteError("x", int(np.argmin(np.isfinite(x))))
    if not rate > 0.0:
        raise RangeError("rate", rate, "> 0")
    m = cluster_factors(x.size) if factors is None else np.asarray(factors, dtype=np.int64)
    for factor in m[(m < 1) | (m > x.size // 2)]:
        raise RangeError("factors", float(factor), f"1..{x.size // 2}")
    # The mean drops out of the second differences, and without it the running sum keeps its digits.
    theta = np.concatenate(([0.0], np.cumsum(x - x.mean())))
    mean_square = np.array([_square_sum(theta, int(factor)) for factor in m]) / (x.size + 1 - 2 * m)
    return AllanDeviation(float(rate), int(x.size), m, np.sqrt(0.5 * mean_square) / m)


@kernel
def _square_sum(theta: Floats, m: int) -> float:
    # Slice by slice the compiler uses vector registers and nothing leaves the cache: five times as fast as one loop.
    width = 1024
    sums = np.zeros(width)
    count = theta.size - 2 * m
    whole = count - count % width
    for start in range(0, whole, width):
        left = theta[start : start + width]
        middle = theta[start + m : start + m + width]
        right = theta[start + 2 * m : start + 2 * m + width]
        sums += (right - 2.0 * middle + left) ** 2
    total = sums.sum()
    for i in range(whole, count):
        total += (theta[i + 2 * m] - 2.0 * theta[i + m] + theta[i]) ** 2
    return total


def square_sum_reference(theta: Floats, m: int) -> float:
    """What the kernel sums, in plain array code.

    Parameters
    ----------
    theta : ndarray, shape (n,)
        Integrated readings, in any unit.
    m : int
        Samples per cluster.

    Returns
    -------
    float
        In the square of that unit.
    """
    return float(np.sum((theta[2 * m :] - 2.0 * theta[m:-m] + theta[: -2 * m]) ** 2))
