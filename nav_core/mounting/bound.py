"""How well a drive could be known at best: a Bayesian Cramér-Rao bound from the simulator's truth.

The whitening filter of the whole-drive estimator, run over the true trajectory with true noise
levels, collects the information that the recording holds about every unknown; its inverse bounds the
covariance of any estimator that knows no more than the priors of the benchmark.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nav_core.mounting.fixes import usable_fixes
from nav_core.mounting.model import TURN, UNKNOWNS, Noise, prior
from nav_core.mounting.refine import view_of, weigh
from nav_core.mounting.stretch import FOLDS, prepare
from nav_core.signal import decimate
from nav_core.simulate import Scenario, simulate
from nav_core.typing import Floats

SLOPE_LENGTH = 137.0
"""Of the second-order process with the variance and the mean square of the derivative of the simulator's
waves, 400 m to 4 km in twelve equal steps of the logarithm: ``1 / rms(2 pi / wavelength)``, m."""

_NONE = 1e-4
"""In place of zero where a variance divides."""


def true_noise(scenario: Scenario) -> Noise:
    """What a scenario's receiver, road, car and box do, as the model's noise levels.

    Parameters
    ----------
    scenario : Scenario
        What is simulated.

    Returns
    -------
    Noise
        SI units, as `Noise`.
    """
    half = np.sqrt(0.5)
    return Noise(
        speed_white=half * scenario.gnss_speed_noise,
        speed_slow=half * scenario.gnss_speed_noise,
        across_white=half * scenario.gnss_course_noise,
        across_slow=half * scenario.gnss_course_noise,
        slow_time=scenario.gnss_correlation,
        height_white=0.05,
        height_slow=scenario.gnss_height_noise,
        height_time=scenario.gnss_correlation,
        slope=scenario.slope,
        slope_length=SLOPE_LENGTH,
        bank=scenario.bank,
        bank_length=scenario.bank_length,
        force=_NONE,
        relative=_NONE,
        relative_turn=_NONE,
        heave=0.01,
        crown=0.0,
        bias=max(scenario.accel_bias, _NONE),
        drift=_NONE,
    )


def mounting_bound(scenario: Scenario, *, seed: int) -> Floats:
    """Bound of the covariance of the mounting of one simulated drive.

    Parameters
    ----------
    scenario : Scenario
        As given to `simulate`, with a receiver.
    seed : int

    Returns
    -------
    ndarray, shape (3, 3)
        Of the small rotation vector about the V axes, rad².  The mean bank of the roads (crown) is not
        in it: it is part of the mounting for all that the data can tell, and comes on top, about x.

    Notes
    -----
    Lags, lever arm, antenna, suspension gains and biases are unknown with the estimator's priors,
    as are slope and bank.  Vibration counts as white noise where it is sampled too slowly to be filtered
    away, at the level of its speed.
    """
    drive, truth = simulate(replace(scenario.faultless(), accel_rate=50.0), seed=seed)
    record = prepare(decimate(drive.inertial), usable_fixes(drive.gnss, thinned=False))
    variance = np.full(record.t.size, scenario.accel_noise**2 + scenario.accel_resolution**2 / 12.0)
    if scenario.accel_rate < FOLDS:
        share = np.minimum(np.abs(np.interp(record.t, truth.t, truth.v)) / scenario.vibration_speed, 1.0)
        variance += (scenario.vibration_idle + (scenario.vibration - scenario.vibration_idle) * share) ** 2
    record = record._replace(density=variance / scenario.accel_rate)
    noise, lags = true_noise(scenario), (0.0, 0.0)
    gram = weigh(record, view_of(record, truth.R_va, lags), noise, np.zeros(UNKNOWNS), np.inf).gram.sum((0, 1))
    diagonal, _ = prior(noise, lags)
    covariance: Floats = np.linalg.inv(gram[1:, 1:] + np.diag(diagonal + 1e-6))
    return covariance[TURN, TURN]
