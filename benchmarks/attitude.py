"""What a step of the attitude filters costs, and that of `ahrs`' extended Kalman filter on the same data."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from ahrs.filters import EKF
from timing import Row, best, print_rows

from nav_core.attitude.error_state import Start as ErrorStateStart
from nav_core.attitude.error_state import StarTracker, estimate, mean_rates
from nav_core.attitude.quaternion_ekf import QuaternionState, propagate
from nav_core.simulate import platform, platform_studies

RATE = 100.0


def per_step(function: Callable[[], object], steps: int, *, repeat: int = 7) -> float:
    """µs."""
    return 1e6 * best(function, repeat=repeat) / steps


def rows() -> list[Row]:
    """Steps over two minutes of readings at 100 Hz."""
    instruments = platform.Instruments()
    truth = platform.by_hand(120.0, RATE, np.radians([5.0, 7.0, 10.0]), np.random.default_rng(1))
    readings = platform.measure(truth, instruments, np.random.default_rng(2))
    start = ErrorStateStart.of(truth.q_nb[0], np.zeros(3), 1e-3, 1e-4)
    w, noise, steps = mean_rates(readings.w), platform_studies.common(instruments.gyro), len(readings.f)
    seen = platform_studies.terrestrial(readings, instruments, RATE)
    tracker = StarTracker(readings.star, platform.ENCODER_SIGMA)
    seven = QuaternionState(truth.q_nb[0], np.zeros(3), np.diag([1e-4] * 4 + [1e-6] * 3))
    few = steps // 10

    def predict() -> object:
        return estimate(start, w, 1.0 / RATE, noise)

    def space() -> object:
        return estimate(start, w, 1.0 / RATE, noise, tracker=tracker)

    def ground() -> object:
        return estimate(start, w, 1.0 / RATE, noise, directions=seen)

    def approximate() -> object:
        return estimate(start, w, 1.0 / RATE, noise, directions=seen, discretisation="approximate")

    def quaternion() -> object:
        return propagate(seven, w, 1.0 / RATE, noise.N**2, noise.K**2)

    def peer() -> object:
        return EKF(gyr=w[:few], acc=-readings.f[:few], mag=1e3 * readings.m[:few], frequency=RATE, frame="NED")

    ours, theirs = per_step(ground, steps), per_step(peer, few, repeat=2)
    return [
        Row("attitude filter (002): predict", per_step(predict, steps), "µs", "≤ 3 µs"),
        Row("attitude filter (002): star tracker, 0.33 Hz", per_step(space, steps), "µs", "≤ 3 µs"),
        Row("attitude filter (002): accelerometer + magnetometer", ours, "µs", "≤ 3 µs"),
        Row("the same, approximate matrices", per_step(approximate, steps), "µs", "≤ 3 µs"),
        Row("quaternion filter (000): predict", per_step(quaternion, steps), "µs", "≤ 3 µs"),
        Row("ahrs EKF, accelerometer + magnetometer", theirs, "µs"),
        Row("ahrs EKF over ours", theirs / ours, "x", "≥ 20"),
    ]


if __name__ == "__main__":
    print_rows(rows())
