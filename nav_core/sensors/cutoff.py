"""Choice of a gyro's low-pass filter: noise error against delay error (002 section 5.3.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from nav_core.errors import RangeError, TooLittleDataError
from nav_core.typing import Floats


class LowPass(NamedTuple):
    """One setting of a sensor's internal filter."""

    cutoff: float
    """Hz."""
    delay: float
    """s."""
    N: float
    """White noise that is left, (rad/s)/√Hz."""


MPU6050_FILTERS = tuple(
    LowPass(cutoff, 1e-3 * delay, float(np.radians(N)))
    for cutoff, delay, N in (
        (256.0, 0.98, 0.0110),
        (188.0, 1.9, 0.0083),
        (98.0, 2.8, 0.0069),
        (42.0, 4.8, 0.0055),
        (20.0, 8.3, 0.0046),
        (10.0, 13.4, 0.0045),
        (5.0, 18.6, 0.0044),
    )
)
"""002 tables 5.1 and 5.2."""


@dataclass(frozen=True, slots=True)
class CutoffChoice:
    """Errors of the angle in one step, per setting and rate of turn.

    Attributes
    ----------
    settings : tuple of LowPass
    rates : ndarray, shape (r,)
        rad/s.
    noise_error : ndarray, shape (k,)
        rad.
    delay_error : ndarray, shape (k, r)
        rad.
    best : tuple of LowPass
        The setting with the smallest sum of both, for each rate.
    """

    settings: tuple[LowPass, ...]
    rates: Floats
    noise_error: Floats
    delay_error: Floats
    best: tuple[LowPass, ...]


def choose_cutoff(settings: tuple[LowPass, ...], rates: Floats, period: float, *, sigmas: float = 1.0) -> CutoffChoice:
    """Weigh the settings of a filter against each other.

    Parameters
    ----------
    settings : tuple of LowPass
        At least one.
    rates : ndarray, shape (r,)
        Rates of turn at which the sensor works, rad/s.
    period : float
        Integration step, s.
    sigmas : float
        How many standard deviations of noise count; 002 figure 5.8 shows one to three.

    Returns
    -------
    CutoffChoice

    Raises
    ------
    RangeError, TooLittleDataError
        `period` or `sigmas` is not positive; no setting.

    Notes
    -----
    Noise error ``sigma_w dt`` with ``sigma_w = N / sqrt(dt)`` (002 eqs. 5.10, 5.14); delay error
    ``omega delay`` (5.15).
    """
    for name, value in (("period", period), ("sigmas", sigmas)):
        if not value > 0.0:
            raise RangeError(name, value, "> 0")
    if not settings:
        raise TooLittleDataError("settings", 0, 1)
    turn = np.abs(np.atleast_1d(np.asarray(rates, dtype=np.float64)))
    noise = sigmas * np.sqrt(period) * np.array([setting.N for setting in settings])
    delay = np.outer([setting.delay for setting in settings], turn)
    best = np.argmin(noise[:, None] + delay, axis=0)
    return CutoffChoice(settings, turn, noise, delay, tuple(settings[i] for i in best))
