"""Whether a filter is as good as it says: normalised errors against their chi square (Bar-Shalom 2001 §5.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.errors import RangeError, ShapeError
from nav_core.typing import Floats


@dataclass(frozen=True, slots=True)
class Consistency:
    """Mean of chi squares over runs, against the band where it should lie.

    Attributes
    ----------
    mean : ndarray, shape (k,)
        Mean over the runs at each epoch.
    lower, upper : float
        Two-sided band for such a mean.
    inside : float
        Share of the epochs whose mean lies within the band; near the confidence if all is as modelled.
    """

    mean: Floats
    lower: float
    upper: float
    inside: float


def normalised(error: Floats, P: Floats) -> Floats:
    """Error squared, normalised by its covariance: NEES of a state error, NIS of an innovation.

    Parameters
    ----------
    error : ndarray, shape (..., n)
    P : ndarray, shape (..., n, n)

    Returns
    -------
    ndarray, shape (...)
        ``e' P^-1 e``, chi square with n degrees of freedom if `P` is the covariance of `error`.

    Raises
    ------
    ShapeError
    """
    n = error.shape[-1]
    if P.shape[-2:] != (n, n):
        raise ShapeError("P", P.shape, f"(..., {n}, {n})")
    return np.sum(error * np.linalg.solve(P, error[..., None])[..., 0], axis=-1)


def gate(freedom: int, probability: float = 0.999) -> float:
    """Threshold that a chi square with `freedom` degrees of freedom stays under with `probability`.

    Parameters
    ----------
    freedom : int
        1 or more.
    probability : float
        Between 0 and 1.

    Returns
    -------
    float
        Without unit.

    Raises
    ------
    RangeError
    """
    return _quantile(_probability(probability), _freedom(freedom))


def mean_band(freedom: int, runs: int, confidence: float = 0.95) -> tuple[float, float]:
    """Two-sided band for the mean of `runs` independent chi squares.

    Parameters
    ----------
    freedom : int
        Degrees of freedom of each.
    runs : int
    confidence : float

    Returns
    -------
    lower, upper : float

    Raises
    ------
    RangeError
    """
    tail = 0.5 * (1.0 - _probability(confidence))
    total = _freedom(freedom) * _freedom(runs)
    return _quantile(tail, total) / runs, _quantile(1.0 - tail, total) / runs


def consistency(squares: Floats, freedom: int, confidence: float = 0.95) -> Consistency:
    """NEES or NIS of many independent runs against their band.

    Parameters
    ----------
    squares : ndarray, shape (runs, k)
    freedom : int
        Degrees of freedom of each.
    confidence : float

    Returns
    -------
    Consistency

    Raises
    ------
    ShapeError, RangeError
    """
    if squares.ndim != 2:
        raise ShapeError("squares", squares.shape, "(runs, k)")
    mean = squares.mean(axis=0)
    lower, upper = mean_band(freedom, squares.shape[0], confidence)
    return Consistency(mean, lower, upper, float(np.mean((mean >= lower) & (mean <= upper))))


def _quantile(probability: float, freedom: int) -> float:
    # scipy.stats takes seconds to import.
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(0.5 * freedom, probability))


def _probability(value: float) -> float:
    if not 0.0 < value < 1.0:
        raise RangeError("probability", value, "between 0 and 1")
    return value


def _freedom(value: int) -> int:
    if value < 1:
        raise RangeError("degrees of freedom, runs", value, "1 or more")
    return value
