"""Noise coefficients from an Allan deviation, each with an interval, and the confidence of the curve itself.

The overlapping Allan variance is a quadratic form of the samples.  For Gaussian noise of known composition the
covariance of its values at two cluster times follows from the covariance function of the second differences, so nothing
has to be assumed about independence: the clusters overlap, and the values at neighbouring times share their data.
The coefficients are the weighted least squares solution with that covariance, taken at the solution itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from nav_core.errors import ConstantError, RangeError, TooLittleDataError
from nav_core.sensors.allan import AllanDeviation, allan_deviation, cluster_factors
from nav_core.sensors.noise import NoiseCoefficients
from nav_core.typing import Floats, Integers

TERMS = NoiseCoefficients._fields

UNLIKELY = 1e-4
"""Probability below which a curve is not that of the model.  Values of few long clusters are far from Gaussian, so
this is far from the usual 5 %."""

LEAST_SAMPLES = 256
"""Fewer samples tell no coefficients."""

_GRAIN = 16
"""Lags to the shorter cluster at which the covariance function is taken about its bends."""


@dataclass(frozen=True, slots=True)
class NoiseFit:
    """Noise coefficients of a recording.

    Attributes
    ----------
    coefficients, low, high : NoiseCoefficients
        Estimate and ends of each coefficient's own interval; of a term that was not fitted zero and infinity.
        A lower end of zero: the recording does not show that there is any of it.
    level : float
        Confidence of the intervals.
    curve : AllanDeviation
        Four cluster times an octave.
    freedom : ndarray, shape (k,)
        Equivalent degrees of freedom of the curve's values, for noise of these coefficients.
    likelihood : float
        Probability of a curve at least this far from the fitted one, 0..1.  Below `UNLIKELY` the noise is not of these
        terms, as behind a low-pass filter that reaches into the sampled band, or the sensor was disturbed.  Then the
        model is allowed to err by the same share of itself at all cluster times, as large as the misfit demands: else
        the shortest, of which most is known, would decide alone.
    """

    coefficients: NoiseCoefficients
    low: NoiseCoefficients
    high: NoiseCoefficients
    level: float
    curve: AllanDeviation
    freedom: Floats
    likelihood: float

    def band(self) -> tuple[Floats, Floats]:
        """Interval of the curve at each cluster time, two arrays of shape (k,)."""
        return confidence(self.curve, self.freedom, self.level)


def identify(x: Floats, rate: float, *, terms: str = "NBK", level: float = 0.95, shortest: float = 0.0) -> NoiseFit:
    """Noise coefficients of a sensor at rest.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Regular samples at rest, any unit.
    rate : float
        Hz.
    terms : str
        Which of N, B, K, Q are fitted; the others are taken to be zero (002 section 5.2.1 leaves out Q).
    level : float
        Confidence of the intervals.
    shortest : float
        Cluster time from which the fit starts, s: beyond what a low-pass filter in the sensor smooths.

    Returns
    -------
    NoiseFit

    Raises
    ------
    RangeError
        Unknown terms, or a level outside 0..1.
    TooLittleDataError
        Fewer than `LEAST_SAMPLES`, or too few octaves beyond `shortest`.
    ConstantError
        Samples that never change, or repeat themselves exactly.
    ShapeError, NotFiniteError
        As `allan_deviation`.

    Notes
    -----
    The model is ``sigma²(tau) = N²/tau + (2 ln 2 / pi) B² + K² tau / 3 + 3 Q² / tau²`` (002 eqs. 5.8-5.12), linear in
    the squares, fitted to octaves of tau up to a quarter of the recording.  Reading the coefficients off the
    slopes, as 002 does, needs a stretch of the curve where one term is alone, which B rarely has.
    """
    from scipy.special import chdtrc

    if not terms or set(terms) - set(TERMS):
        raise RangeError("number of known terms", float(len(set(terms) & set(TERMS))), f"only {', '.join(TERMS)}")
    if not 0.0 < level < 1.0:
        raise RangeError("level", level, "0..1")
    x = np.asarray(x, dtype=np.float64)
    curve = allan_deviation(x, rate)
    if curve.samples < LEAST_SAMPLES:
        raise TooLittleDataError("x", curve.samples, LEAST_SAMPLES)
    chosen = "".join(name for name in TERMS if name in terms)
    factor = cluster_factors(curve.samples, per_octave=1, pairs=4)
    factor = factor[factor >= shortest * rate * (1.0 - 1e-9)]
    if factor.size <= len(chosen):
        name = f"octaves of cluster time from {shortest:g} s on" if shortest > 0.0 else "octaves of cluster time"
        raise TooLittleDataError(name, int(factor.size), len(chosen) + 1)
    variance = curve.sigma[np.searchsorted(curve.factor, factor)] ** 2
    if not variance.min() > 0.0:
        raise ConstantError("x", int(factor[np.argmin(variance)]))
    squares, spread, misfit = _least_squares(factor, curve.samples, variance, chosen)
    likelihood = float(chdtrc(factor.size - len(chosen), misfit))
    if likelihood < UNLIKELY:
        squares, spread = _inadequate(factor, curve.samples, variance, chosen)
    # From per-sample units, in which the covariance is tabulated, to seconds.
    unit = np.array([{"N": 1.0 / rate, "B": 1.0, "K": rate, "Q": 1.0 / rate**2}[name] for name in chosen])
    low, high = _interval(squares, spread, level)
    known = dict(zip(chosen, np.sqrt(np.stack((squares, low, high)) * unit).T.tolist(), strict=True))
    triples = [known.get(name, (0.0, 0.0, np.inf)) for name in TERMS]
    estimate, lower, upper = (NoiseCoefficients(*values) for values in zip(*triples, strict=True))
    return NoiseFit(estimate, lower, upper, level, curve, equivalent_freedom(curve, estimate), likelihood)


def equivalent_freedom(curve: AllanDeviation, coefficients: NoiseCoefficients) -> Floats:
    """Equivalent degrees of freedom of Allan variances.

    Parameters
    ----------
    curve : AllanDeviation
    coefficients : NoiseCoefficients
        Composition of the noise; only its proportions count.

    Returns
    -------
    ndarray, shape (k,)
        ``2 E(sigma²)² / var(sigma²)``: that of the chi-squared distribution with the same mean and variance.

    Raises
    ------
    RangeError
        All coefficients are zero.

    Notes
    -----
    The sum of Greenhall and Riley 2003, taken for the mixture instead of one power law, and for samples that are
    means of the rate over their period.  They smooth the phase over a period as well, which matters for clusters
    of a few samples of white noise.
    """
    # Scaled to the mixture at one second, so that coefficients of any unit stay clear of underflow.
    scale = float(np.sum(np.abs(coefficients)))
    if scale == 0.0:
        raise RangeError("coefficients", 0.0, "at least one > 0")
    rate = curve.rate
    squares = np.array(coefficients.scaled(1.0 / scale)) ** 2 * np.array([rate, 1.0, 1.0 / rate, rate**2])
    used = [name for name, square in zip(TERMS, squares, strict=True) if square > 0.0]
    weights = squares[squares > 0.0]
    freedom = np.empty(curve.factor.size)
    for i, m in enumerate(curve.factor.tolist()):
        mean = float(_design(np.array([m]), "".join(used))[0] @ weights)
        freedom[i] = 2.0 * mean**2 / (weights @ _pair(m, m, curve.samples, "".join(used)) @ weights)
    return freedom


def confidence(curve: AllanDeviation, freedom: Floats, level: float = 0.95) -> tuple[Floats, Floats]:
    """Interval of an Allan deviation at each cluster time.

    Parameters
    ----------
    curve : AllanDeviation
    freedom : ndarray, shape (k,)
        From `equivalent_freedom`.
    level : float

    Returns
    -------
    low, high : ndarray, shape (k,)
        In the unit of the curve; chi-squared, equal tails.
    """
    from scipy.special import chdtri

    tail = 0.5 * (1.0 - level)
    low = curve.sigma * np.sqrt(freedom / chdtri(freedom, tail))
    return low, curve.sigma * np.sqrt(freedom / chdtri(freedom, 1.0 - tail))


def _inadequate(factor: Integers, samples: int, variance: Floats, terms: str) -> tuple[Floats, Floats]:
    """Fit of a model that is not the truth: the share of itself by which it errs brings the misfit to its freedom."""
    freedom, low, high = factor.size - len(terms), 1e-3, 1.0
    for _ in range(20):
        share = np.sqrt(low * high)
        _, _, misfit = _least_squares(factor, samples, variance, terms, share)
        low, high = (share, high) if misfit > freedom else (low, share)
    return _least_squares(factor, samples, variance, terms, high)[:2]


def _least_squares(
    factor: Integers, samples: int, variance: Floats, terms: str, share: float = 0.0
) -> tuple[Floats, Floats, float]:
    """Squares of the coefficients in per-sample units, their standard deviations, and the weighted misfit.

    `share` of itself is what the model may err by at each cluster time, besides the noise of the curve.
    """
    A, table = _design(factor, terms), _covariances(tuple(factor.tolist()), samples, terms)
    whitened = np.column_stack((A / variance[:, None], np.ones(variance.size)))
    squares = _nonnegative(whitened[:, :-1], whitened[:, -1])
    for step in range(50):
        C = np.einsum("a,b,abij->ij", squares, squares, table)
        C[np.diag_indices_from(C)] *= 1.0 + 1e-9
        C[np.diag_indices_from(C)] += (share * (A @ squares)) ** 2
        whitened = np.linalg.solve(np.linalg.cholesky(C), np.column_stack((A, variance)))
        found = _nonnegative(whitened[:, :-1], whitened[:, -1])
        size = np.linalg.norm(whitened[:, :-1], axis=0)
        settled = bool(np.all(np.abs(found - squares) * size < 1e-3))
        # A term at the edge of zero can come and go for ever; halved steps settle it.
        squares = found if step < 10 else 0.5 * (found + squares)
        if settled:
            break
    weighted = whitened[:, :-1]
    left = whitened[:, -1] - weighted @ squares
    return squares, np.sqrt(np.diag(np.linalg.inv(weighted.T @ weighted))), float(left @ left)


def _nonnegative(A: Floats, y: Floats) -> Floats:
    from scipy.optimize import nnls

    size = np.linalg.norm(A, axis=0)
    return np.asarray(nnls(A / size, y)[0]) / size


def _interval(squares: Floats, spread: Floats, level: float) -> tuple[Floats, Floats]:
    """Ends for the squares: of the logarithm where they are well known, else the wider of both kinds."""
    from scipy.special import ndtri

    z = float(ndtri(0.5 + 0.5 * level))
    relative = spread / np.maximum(squares, 1e-300)
    known = relative < 0.5
    factor = np.exp(z * np.minimum(relative, 1.0))
    low = np.where(known, squares / factor, np.maximum(squares - z * spread, 0.0))
    high = np.where(known, squares * factor, np.maximum(squares + z * spread, squares * factor))
    return low, high


def _design(factor: Integers, terms: str) -> Floats:
    """Allan variance of each term with a square of one per sample, shape (k, terms) (002 eqs. 5.8-5.12)."""
    m = np.asarray(factor, dtype=np.float64)
    columns = {"N": 1.0 / m, "B": np.full(m.size, 2.0 * np.log(2.0) / np.pi), "K": m / 3.0, "Q": 3.0 / m**2}
    return np.stack([columns[name] for name in terms], axis=1)


def _covariances(factor: tuple[int, ...], samples: int, terms: str) -> Floats:
    """Bilinear tables of the covariance of Allan variances, shape (terms, terms, k, k)."""
    table = np.zeros((len(terms), len(terms), len(factor), len(factor)))
    for i, short in enumerate(factor):
        for j in range(i, len(factor)):
            table[:, :, i, j] = table[:, :, j, i] = _pair(short, factor[j], samples, terms)
    return table


@lru_cache(maxsize=4096)
def _pair(short: int, long: int, samples: int, terms: str) -> Floats:
    """Covariance of the Allan variances at two cluster lengths as a form in the squares, shape (terms, terms).

    Of Gaussian second differences `u`, `v`: ``cov(mean u², mean v²) = 2 sum_kl cov(u_k, v_l)² / (M_u M_v)``, and the
    covariance of a mixture is the sum of its terms'.  Remembered: the axes of one recording ask for the same.
    """
    lag = _lags(short, long)
    many, few = samples + 1 - 2 * short, samples + 1 - 2 * long
    overlap = np.maximum(np.minimum(many, few + lag) - np.maximum(lag, 0), 0).astype(np.float64)
    functions = np.stack([_second_difference_covariance(name, lag, short, long) for name in terms])
    share = 2.0 / (float(many) * few * 4.0 * short**2 * float(long) ** 2)
    smooth = share * (functions * overlap * np.gradient(lag.astype(np.float64))) @ functions.T
    # Quantisation correlates at single lags, which stand for themselves and not for their neighbourhood.
    single = share * (functions * overlap) @ functions.T
    spiky = np.array([name == "Q" for name in terms])
    form = np.where(spiky[:, None] | spiky, single, smooth)
    form.flags.writeable = False
    return form


def _lags(short: int, long: int) -> Integers:
    """Lags at which the covariance function is taken: finely about its bends, coarsely between and beyond."""
    stride = max(1, short // _GRAIN)
    about = stride * np.arange(-8 * _GRAIN, 8 * _GRAIN + 1)
    bends = np.array([0, long, 2 * long])
    exact = bends[:, None] - short * np.arange(3)
    coarse = np.round(np.linspace(-2 * short - 4 * long, 6 * long, 20 * _GRAIN)).astype(np.int64)
    return np.unique(np.concatenate(((bends[:, None] + about).ravel(), exact.ravel(), coarse)))


def _second_difference_covariance(name: str, lag: Integers, short: int, long: int) -> Floats:
    total = np.zeros(lag.size)
    for p, a in enumerate((1.0, -2.0, 1.0)):
        for q, b in enumerate((1.0, -2.0, 1.0)):
            total += a * b * _integral_covariance(name, lag + p * short - q * long)
    return total


def _integral_covariance(name: str, lag: Integers) -> Floats:
    """Generalised covariance function of the running sum, per unit square and sample.

    The parts that it leaves open, polynomials up to the third degree, vanish in differences of fourth order.
    """
    t = np.abs(lag).astype(np.float64)
    if name == "N":
        return -0.5 * t
    if name == "B":
        return t**2 * np.log(np.maximum(t, 1.0)) / (2.0 * np.pi)
    if name == "K":
        return t**3 / 12.0
    return (t == 0.0).astype(np.float64)
