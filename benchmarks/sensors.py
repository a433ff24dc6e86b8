"""What the Allan deviation and the calibrations cost, and allantools on the same data."""

from __future__ import annotations

import warnings

import numpy as np
from timing import Row, best, print_rows

from nav_core.sensors import (
    MPU6050_GYRO,
    allan_deviation,
    calibrate_positions,
    eighteen_directions,
    identify,
    simulate_noise,
)

RATE = 100.0


def rows() -> list[Row]:
    """Noise and calibration."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import allantools
    rng = np.random.default_rng(1)
    x = simulate_noise(MPU6050_GYRO[0], 1_000_000, RATE, rng)
    taus = allan_deviation(x, RATE).tau
    poses = 9.81 * np.vstack((eighteen_directions(), eighteen_directions())) + 0.01 * rng.standard_normal((36, 3))
    ours = best(lambda: allan_deviation(x, RATE))
    theirs = best(lambda: allantools.oadev(x, rate=RATE, data_type="freq", taus=taus), repeat=2)
    return [
        Row(f"Allan deviation of 1e6 samples, {taus.size} cluster times", ours, "s", "≤ 0.2 s"),
        Row("the same by allantools", theirs, "s"),
        Row("noise coefficients with intervals of 1e6 samples", best(lambda: identify(x, RATE)), "s"),
        Row("simulated noise, 1e6 samples", best(lambda: simulate_noise(MPU6050_GYRO[0], 1_000_000, RATE, rng)), "s"),
        Row("nine parameters from 36 poses", 1e3 * best(lambda: calibrate_positions(poses, 9.81)), "ms"),
    ]


if __name__ == "__main__":
    print_rows(rows())
