"""Noise of inertial and magnetic sensors: coefficients, and samples that have them (002 ch. 5).

Units: with readings in a unit u (rad/s, m/s², µT), N is in u/√Hz, B in u, K in u√Hz and Q in u s.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.errors import RangeError
from nav_core.processes import gauss_markov_discrete
from nav_core.typing import Floats

BIAS_PLATEAU = float(np.sqrt(2.0 * np.log(2.0) / np.pi))
"""Allan deviation of 1/f noise with B = 1: the 0.664 of 002 eq. 5.11."""


class NoiseCoefficients(NamedTuple):
    """What the noise of one axis is made of, in the terms of 002 section 5.2.

    Attributes
    ----------
    N : float
        White noise: angle or velocity random walk; its spectral density (two-sided) is N².
    B : float
        Bias instability: 1/f noise of spectral density ``B² / (2 pi f)``.
    K : float
        Rate random walk: a bias that is driven by white noise of density K².
    Q : float
        Quantisation of the integrated signal; at least ``LSB / sqrt(12)`` of the increments.
    """

    N: float = 0.0
    B: float = 0.0
    K: float = 0.0
    Q: float = 0.0

    def allan_deviation(self, tau: Floats | float) -> Floats:
        """Allan deviation that this noise has at the cluster times `tau`, s (002 eqs. 5.8-5.12).

        Parameters
        ----------
        tau : ndarray or float, shape (...)
            s.

        Returns
        -------
        ndarray, shape (...)
            In the unit of the readings.
        """
        tau = np.asarray(tau, dtype=np.float64)
        white, flicker = self.N**2 / tau, (BIAS_PLATEAU * self.B) ** 2
        return np.sqrt(white + flicker + self.K**2 * tau / 3.0 + 3.0 * (self.Q / tau) ** 2)

    def scaled(self, factor: float) -> NoiseCoefficients:
        """The same noise in another unit, all coefficients times `factor`.

        Parameters
        ----------
        factor : float
            New unit per old one.

        Returns
        -------
        NoiseCoefficients
            In the new unit.
        """
        return NoiseCoefficients(*(factor * value for value in self))


def _axes(
    unit: float, N: tuple[float, ...], B: tuple[float, ...], K: tuple[float, ...]
) -> tuple[NoiseCoefficients, ...]:
    return tuple(NoiseCoefficients(n, b, k).scaled(unit) for n, b, k in zip(N, B, K, strict=True))


MPU6050_GYRO = _axes(
    np.radians(1.0), (7.867e-3, 9.281e-3, 7.389e-3), (1.241e-3, 1.418e-3, 1.117e-3), (1.111e-4, 1.389e-4, 1.111e-4)
)
"""x, y, z of 002 table 5.3, rad/s."""

MPU6050_ACCELEROMETER = _axes(9.80665, (2.426e-4, 2.685e-4, 3.920e-4), (0.0, 0.0, 4.280e-5), (0.0, 0.0, 0.0))
"""x, y, z of 002 table 5.5, m/s²; coefficients that the table leaves out are zero."""

HMC5883L = _axes(100.0, (1.559e-4, 1.473e-4, 1.537e-4), (2.531e-5, 3.234e-5, 3.790e-5), (2e-6, 2e-6, 4e-6))
"""x, y, z of 002 table 5.7, µT."""


def simulate_noise(
    coefficients: NoiseCoefficients,
    count: int,
    rate: float,
    rng: np.random.Generator,
    *,
    correlation_time: float = np.inf,
) -> Floats:
    """Samples of noise with these coefficients.

    Parameters
    ----------
    coefficients : NoiseCoefficients
        Of one axis.
    count : int
        Number of samples.
    rate : float
        Hz.
    rng : numpy.random.Generator
    correlation_time : float
        Of the bias that K drives, s (tau_b of 002 eq. 5.2).  Infinite: a random walk from zero.  Finite: a stationary
        first-order Gauss-Markov process of variance ``K² tau_b / 2``, which the Allan deviation tells from the walk
        only beyond tau_b.

    Returns
    -------
    ndarray, shape (count,)
        In the unit of the coefficients.

    Raises
    ------
    RangeError
        `rate` or `correlation_time` is not positive.

    Notes
    -----
    White noise has the variance N² rate (5.10), each step of the bias K² / rate: 5.6 with 5.13.  Quantisation noise
    is the difference of independent errors of the integral.
    """
    for name, value in (("rate", rate), ("correlation_time", correlation_time)):
        if not value > 0.0:
            raise RangeError(name, value, "> 0")
    N, B, K, Q = coefficients
    noise = N * np.sqrt(rate) * rng.standard_normal(count)
    if B > 0.0:
        noise += B * flicker(count, rng)
    if K > 0.0:
        noise += _driven_bias(K, count, rate, correlation_time, rng)
    if Q > 0.0:
        noise += Q * rate * np.diff(rng.standard_normal(count + 1))
    return noise


def flicker(count: int, rng: np.random.Generator) -> Floats:
    """Samples of 1/f noise with B = 1.

    Parameters
    ----------
    count : int
    rng : numpy.random.Generator

    Returns
    -------
    ndarray, shape (count,)
        Each sample is the mean of the process over its period, so the Allan deviation is `BIAS_PLATEAU` at every
        cluster time, from one sample on, and does not depend on the rate.

    Notes
    -----
    Synthesised line by line from the density ``1 / (2 pi f)``, weighted with the transfer of the mean over a period
    and folded at the sampling rate, over at least twice the length: lower frequencies shift all samples alike.
    """
    from scipy.fft import irfft, next_fast_len

    length: int = next_fast_len(2 * max(count, 8), real=True)  # pyright: ignore[reportAssignmentType]  untyped in scipy
    x = np.arange(1, length // 2 + 1) / length
    # Sum over all images of 1 / |x + k|³; beyond the second it is replaced by its integral.
    images = sum(
        (1.0 / (shifted * shifted * shifted) for shifted in (x, 1.0 - x, 1.0 + x, 2.0 - x, 2.0 + x)), 1.0 / 2.5**2
    )
    density = np.sin(np.pi * x) ** 2 / (2.0 * np.pi**3) * images
    lines = np.zeros(length // 2 + 1, dtype=np.complex128)
    real, imaginary = rng.standard_normal((2, x.size))
    lines[1:] = np.sqrt(0.5 * length * density) * (real + 1j * imaginary)
    return np.asarray(irfft(lines, length), dtype=np.float64)[:count]


def _driven_bias(K: float, count: int, rate: float, correlation_time: float, rng: np.random.Generator) -> Floats:
    if np.isinf(correlation_time):
        return K / np.sqrt(rate) * np.cumsum(rng.standard_normal(count))
    from scipy.signal import lfilter

    sigma = K * np.sqrt(0.5 * correlation_time)
    step = gauss_markov_discrete(sigma, correlation_time, 1.0 / rate)
    drive = np.sqrt(step.Q[0, 0]) * rng.standard_normal(count)
    drive[:1] *= sigma / np.sqrt(step.Q[0, 0])
    return np.asarray(lfilter([1.0], [1.0, -step.Phi[0, 0]], drive), dtype=np.float64)
