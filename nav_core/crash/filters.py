"""Channel frequency classes of SAE J211-1 / ISO 6487, and the low-pass of EN 1317-1:2010.

The class filter is a two-pole Butterworth run forward and backward.  Its recursion holds a tangent that wraps below
4.155 samples per class hertz; below the standards' own rates it is no longer the filter it is named after.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfiltfilt

from nav_core.errors import NavigationError
from nav_core.typing import Floats

LEAST_RATE = {60: 600.0, 180: 1800.0, 600: 6000.0, 1000: 10_000.0}
"""Samples per second that a class needs: ten times its class (SAE J211-1), Hz."""

CLASS_FACTOR = 2.0775
"""Of the recursion's corner to the class (SAE J211-1 appendix C)."""

TWO_PASSES = (np.sqrt(2.0) - 1.0) ** -0.25
"""Corner of one pass that gives -3 dB at 1 after two passes of two poles."""

ASI_CUTOFF = 13.0


class RateError(NavigationError):
    """The sampling is too slow for a filter to be what it is named after."""

    def __init__(self, name: str, rate: float, needed: float) -> None:
        self.name, self.rate, self.needed = name, rate, needed
        super().__init__(f"{name} needs {needed:g} samples per second, there are {rate:.0f}")


def cfc(x: Floats, rate: float, channel_class: int) -> Floats:
    """Filter of a channel frequency class, without delay.

    Parameters
    ----------
    x : ndarray, shape (n,) or (n, k)
        Evenly sampled.
    rate : float
        Hz.
    channel_class : {60, 180, 600, 1000}

    Returns
    -------
    ndarray
        Same shape.  CFC 60 is -3 dB at 100.0 Hz after both passes.

    Raises
    ------
    RateError
        Below the standard's rate for the class.
    """
    needed = max(LEAST_RATE[channel_class], 2.0 * CLASS_FACTOR * channel_class)
    if rate < needed * (1.0 - 1e-3):
        raise RateError(f"CFC {channel_class}", rate, needed)
    return two_passes(x, rate, CLASS_FACTOR * channel_class)


def two_passes(x: Floats, rate: float, corner: float) -> Floats:
    """Two-pole Butterworth of this corner, Hz, forward and backward along the first axis.

    The recursion starts as if the ends had always been as the first and last 20 ms are.

    Parameters
    ----------
    x : ndarray, shape (n, ...)
        Evenly sampled, in any unit.
    rate : float
        Hz.
    corner : float
        Of a single pass, -3 dB, Hz.

    Returns
    -------
    ndarray, shape (n, ...)
        Without delay.
    """
    sos = np.asarray(butter(2, corner, fs=rate, output="sos"))
    pad = min(max(round(0.5 * rate), 12), 20_000)
    few = max(round(0.02 * rate), 1)
    ends = x[:few].mean(axis=0), x[-few:].mean(axis=0)
    padded = np.concatenate([np.repeat(end[None], pad, axis=0) for end in ends])
    padded = np.concatenate([padded[:pad], x, padded[pad:]])
    filtered: Floats = np.asarray(sosfiltfilt(sos, padded, axis=0, padlen=0))
    return filtered[pad : pad + x.shape[0]]


def low_pass(x: Floats, rate: float, cutoff: float) -> Floats:
    """Four-pole phaseless Butterworth that is -3 dB at `cutoff`, Hz, after both passes.

    Parameters
    ----------
    x : ndarray, shape (n, ...)
        Evenly sampled, in any unit.
    rate, cutoff : float
        Hz.

    Returns
    -------
    ndarray, shape (n, ...)
        Without delay.

    Raises
    ------
    RateError
        With less than six samples per period of the cutoff.
    """
    if rate < 6.0 * cutoff:
        raise RateError(f"a {cutoff:g} Hz low-pass", rate, 6.0 * cutoff)
    # The bilinear transform bends frequencies: the corner is placed where it makes the cutoff exact at any rate.
    corner = float(np.arctan(TWO_PASSES * np.tan(np.pi * cutoff / rate)) * rate / np.pi)
    return two_passes(x, rate, corner)


def moving_mean(x: Floats, rate: float, span: float) -> Floats:
    """Mean over `span` s about each sample, along the first axis; shorter at the ends.

    Parameters
    ----------
    x : ndarray, shape (n, ...)
        Evenly sampled, in any unit.
    rate : float
        Hz.
    span : float
        s.

    Returns
    -------
    ndarray, shape (n, ...)
        In the unit of `x`.
    """
    half = 0.5 * span * rate
    total = np.concatenate([np.zeros((1, *x.shape[1:])), np.cumsum(x, axis=0)])
    edges = np.arange(x.shape[0] + 1, dtype=np.float64)
    middle = edges[:-1] + 0.5
    low, high = np.clip(middle - half, 0.0, edges[-1]), np.clip(middle + half, 0.0, edges[-1])
    flat = total.reshape(total.shape[0], -1)
    sums = np.stack([np.interp(high, edges, each) - np.interp(low, edges, each) for each in flat.T], axis=1)
    return (sums / (high - low)[:, None]).reshape(x.shape)


def evenly(t: Floats, x: Floats) -> tuple[Floats, float]:
    """Samples on an even grid of the median step from the first on, shape as `x`, and its rate, Hz.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Increasing, s.
    x : ndarray, shape (n, k)
        In any unit.

    Returns
    -------
    values : ndarray, shape (m, k)
        Linear between the samples.
    rate : float
        Hz.
    """
    step = float(np.median(np.diff(t)))
    grid = t[0] + step * np.arange(int((t[-1] - t[0]) / step + 1e-6) + 1)
    return np.column_stack([np.interp(grid, t, column) for column in x.T]), 1.0 / step
