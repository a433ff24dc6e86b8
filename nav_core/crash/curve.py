"""A pulse through what is told of it: samples with noise, and samples known only to exceed a bound.

A beta-shaped pulse ``A x^p (1-x)^q``, whose exponents are free within a prior, plus a smooth departure from it that
grows with the pulse (kriging with a parametric mean), plus the body's ringing.  Half-sines, haversines and triangles
are near special cases; none is built in.  A clipped sample counts as censored (Tobin 1958): it pulls the curve up as
far as it lies below the bound, and ever less above it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import log_ndtr

from nav_core.typing import Flags, Floats

DEPARTURE = 0.2
"""1 sigma of the departure from a beta pulse, share of it."""

LENGTH = 0.12
"""Over which share of the pulse's length the departure persists."""

EXPONENT, EXPONENT_SIGMA = float(np.log(1.4)), 0.55
"""Prior of the logarithm of p and of q.  Half-sine: 1.0 and a parabola; triangle: about 1.2; haversine: about 2.3."""

USUAL_CHANGE, USUAL_SIGMA = 30.0 / 3.6, 0.8
"""Prior of the whole delta-V, m/s, and 1 sigma of its logarithm: what flanks alone leave open must stay possible."""

EXTENT_MEAN = 0.010
"""The pulse ends where the mean over so long has fallen to `EXTENT_LOW` of its top, s."""

EXTENT_LOW = 0.04

MOST = 100
"""Samples that the curve is fitted through."""

GRID = 200
"""Moments at which its covariance is worked out."""

ROUNDS = 30
"""Of Gauss-Newton, at most."""


class Curve(NamedTuple):
    """A pulse with what is not sure of it.

    Attributes
    ----------
    expected : ndarray, shape (n,)
        Each sample as expected, of a bounded one given that it exceeds its bound, m/s².
    times, grid : ndarray
        Of all samples (n,), and of the covariance (m,), s.
    covariance : ndarray, shape (m, m)
        m²/s⁴.
    ringing : float
        1 sigma of the ringing about the curve, m/s².
    misfit : float
        Residuals against what was allowed; 1 is as allowed.
    """

    expected: Floats
    times: Floats
    grid: Floats
    covariance: Floats
    ringing: float
    misfit: float

    def sigma(self, weights: Floats) -> float:
        """1 sigma of a weighted sum over the samples, weights (n,).

        Parameters
        ----------
        weights : ndarray, shape (n,)
            One per sample, in any unit.

        Returns
        -------
        float
            m/s² times the unit of the weights.
        """
        k = np.clip(np.searchsorted(self.grid, self.times), 1, self.grid.size - 1)
        share = np.clip((self.times - self.grid[k - 1]) / (self.grid[k] - self.grid[k - 1]), 0.0, 1.0)
        total = np.bincount(k - 1, weights * (1.0 - share), self.grid.size)
        total += np.bincount(k, weights * share, self.grid.size)
        return float(np.sqrt(max(total @ self.covariance @ total, 0.0)))


class _Points(NamedTuple):
    """Samples taken for the fit: times, values (or bounds), noise variances, which are bounds."""

    t: Floats
    y: Floats
    variance: Floats
    censored: Flags


def curve_through(t: Floats, s: Floats, variance: Floats, bound: Floats) -> Curve:
    """Pulse through samples and bounds.

    Parameters
    ----------
    t : ndarray, shape (n,)
        s.
    s : ndarray, shape (n,)
        Size of the force, m/s²; NaN where only the bound is known.
    variance : ndarray, shape (n,)
        Of `s`, m²/s⁴.
    bound : ndarray, shape (n,)
        The size is at least this where `s` is NaN, m/s².

    Returns
    -------
    Curve
    """
    censored = ~np.isfinite(s)
    y = np.where(censored, bound, s)
    noise = np.where(censored, 1.0, variance)
    pulse = _extent(t, y)
    chosen = np.flatnonzero(pulse)
    chosen = chosen[:: max(-(-chosen.size // MOST), 1)]
    points = _Points(t[chosen], y[chosen], noise[chosen], censored[chosen])
    span = t[pulse]
    fit = _fit(points, float(span[0]), max(float(span[-1] - span[0]), 0.02))
    grid = np.linspace(t[0], t[-1], min(GRID, max(t.size, 2)))
    mean, covariance = _predicted(fit, points, grid)
    at = np.interp(t, grid, mean)
    ringing = float(np.sqrt(fit.ringing))
    spread = np.sqrt(noise + fit.ringing)
    expected = np.where(censored, at + spread * _mills((bound - at) / spread), at)
    expected = np.where(np.isfinite(s), s, expected)
    return Curve(expected, t, grid, max(fit.misfit, 1.0) ** 2 * covariance, ringing, fit.misfit)


def _extent(t: Floats, y: Floats) -> Flags:
    """Samples of the pulse: around its middle, as long as the size stays positive over some 10 ms."""
    width = max(round(EXTENT_MEAN / float(np.median(np.diff(t)))), 1)
    size = np.convolve(np.pad(y, width // 2, mode="edge"), np.ones(width) / width, mode="valid")[: y.size]
    core = int(np.argmax(size))
    low = EXTENT_LOW * size[core]
    before, after = np.flatnonzero(size[:core] < low), np.flatnonzero(size[core:] < low)
    out = np.zeros(t.size, dtype=np.bool_)
    out[(before[-1] if before.size else 0) : (core + int(after[0]) + 1 if after.size else t.size)] = True
    return out


def _mills(alpha: Floats) -> Floats:
    """Mean of a standard normal variable that exceeds `alpha`: density over upper tail."""
    return np.exp(-0.5 * alpha**2 - 0.5 * np.log(2.0 * np.pi) - log_ndtr(-alpha))


class _Fit(NamedTuple):
    theta: Floats
    covariance: Floats
    ringing: float
    misfit: float


def beta(t: Floats, theta: Floats) -> Floats:
    """Beta pulse: theta has its start, s, and the logarithms of length, top, p and q.

    Parameters
    ----------
    t : ndarray, shape (n,)
        s.
    theta : ndarray, shape (5,)
        Start, s, then the logarithms of length (s), top (m/s²), p and q.

    Returns
    -------
    ndarray, shape (n,)
        Magnitude of the deceleration, m/s²; 0 outside of the pulse.
    """
    begin, length = theta[0], np.exp(theta[1])
    p, q = np.exp(theta[3]), np.exp(theta[4])
    x = np.clip((t - begin) / length, 1e-12, 1.0 - 1e-12)
    peak = p * np.log(p / (p + q)) + q * np.log(q / (p + q))
    inside = (t > begin) & (t < begin + length)
    return np.where(inside, np.exp(theta[2] + p * np.log(x) + q * np.log1p(-x) - peak), 0.0)


def _jacobian(t: Floats, theta: Floats) -> Floats:
    J = np.empty((t.size, 5))
    for k, h in enumerate((1e-5, 1e-4, 1e-4, 1e-3, 1e-3)):
        d = np.zeros(5)
        d[k] = h
        J[:, k] = (beta(t, theta + d) - beta(t, theta - d)) / (2.0 * h)
    return J


def _departure(t: Floats, mean: Floats, t2: Floats, mean2: Floats, theta: Floats) -> Floats:
    """Covariance of the departure: a share of the pulse, alike over a share of its length."""
    apart = (t[:, None] - t2[None, :]) / (LENGTH * np.exp(theta[1]))
    return DEPARTURE**2 * np.outer(mean, mean2) * np.exp(-0.5 * apart**2)


def _working(points: _Points, mean: Floats, ringing: float) -> tuple[Floats, Floats]:
    """Values and variances that stand for all points at this curve: of a bound, its score and information."""
    variance = points.variance + ringing
    sigma = np.sqrt(variance)
    alpha = (points.y - mean) / sigma
    h = _mills(alpha)
    information = np.maximum(h * (h - alpha), 1e-6)
    z = np.where(points.censored, mean + sigma * h / information, points.y)
    return z, np.where(points.censored, variance / information, variance)


def _ringing(points: _Points, mean: Floats, smooth: Floats, ringing: float) -> float:
    """Variance of the ringing from the residuals; of a bound, its expectation."""
    variance = points.variance + ringing
    alpha = (points.y - mean) / np.sqrt(variance)
    square = np.where(points.censored, variance * (1.0 + alpha * _mills(alpha)), (points.y - smooth) ** 2)
    return float(np.clip(np.mean(square - points.variance), 0.0, (0.5 * points.y.max()) ** 2))


def _fit(points: _Points, begin: float, length: float) -> _Fit:
    """Maximum a posteriori by Gauss-Newton on working values, damped where it does not descend."""
    top = np.log(max(1.2 * float(points.y.max()), 1.0))
    # A pulse of usual exponents has a mean of 0.6 of its top.
    usual = float(np.log(USUAL_CHANGE / (0.6 * length)))
    prior = np.array([begin, np.log(length), max(usual, top), EXPONENT, EXPONENT])
    scale = np.array([0.1 * length, 0.2, USUAL_SIGMA, EXPONENT_SIGMA, EXPONENT_SIGMA])
    weight = np.diag(scale**-2.0)
    theta = np.array([begin, np.log(length), top, EXPONENT, EXPONENT])
    ringing, normal, misfit = (0.2 * float(points.y.max())) ** 2, weight, 1.0
    for _ in range(ROUNDS):
        mean, J = beta(points.t, theta), _jacobian(points.t, theta)
        z, variance = _working(points, mean, ringing)
        K = _departure(points.t, mean, points.t, mean, theta)
        factor = cho_factor(K + np.diag(variance))
        solved = cho_solve(factor, np.column_stack([J, z - mean]))
        normal = J.T @ solved[:, :5] + weight
        step = np.linalg.solve(normal, J.T @ solved[:, 5] - weight @ (theta - prior))
        step /= max(1.0, float(np.abs(step / scale).max()) / 0.7)
        theta = theta + step
        smooth = mean + K @ solved[:, 5]
        ringing = 0.5 * (ringing + _ringing(points, mean, smooth, ringing))
        told = ~points.censored
        misfit = float(np.sqrt(max((z - mean)[told] @ solved[told, 5], 0.0) / max(int(told.sum()), 1)))
        if np.abs(step / scale).max() < 1e-3:
            break
    return _Fit(theta, np.asarray(np.linalg.inv(normal), dtype=np.float64), ringing, misfit)


def _predicted(fit: _Fit, points: _Points, t: Floats) -> tuple[Floats, Floats]:
    """The curve at any moments, (m,), and its covariance, (m, m)."""
    theta = fit.theta
    mean_at, mean = beta(points.t, theta), beta(t, theta)
    z, variance = _working(points, mean_at, fit.ringing)
    factor = cho_factor(_departure(points.t, mean_at, points.t, mean_at, theta) + np.diag(variance))
    cross = _departure(t, mean, points.t, mean_at, theta)
    gain = np.asarray(cho_solve(factor, cross.T)).T
    D = _jacobian(t, theta) - gain @ _jacobian(points.t, theta)
    covariance = _departure(t, mean, t, mean, theta) - gain @ cross.T + D @ fit.covariance @ D.T
    return mean + gain @ (z - mean_at), covariance
