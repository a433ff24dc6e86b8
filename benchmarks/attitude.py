"""What a step of the attitude filters costs, and that of `ahrs`' extended Kalman filter on the same data."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from ahrs.filters import EKF

from nav_core.attitude.error_state import Start as ErrorStateStart
from nav_core.attitude.error_state import StarTracker, estimate, mean_rates
from nav_core.attitude.quaternion_ekf import QuaternionState, propagate
from nav_core.simulate import platform, platform_studies

RATE = 100.0


def per_step(function: Callable[[], object], steps: int, *, repeat: int = 7) -> float:
    """Shortest of a few runs over the steps, µs; one more before them compiles."""
    function()
    durations: list[float] = []
    for _ in range(repeat):
        began = time.perf_counter()
        function()
        durations.append(time.perf_counter() - began)
    return 1e6 * min(durations) / steps


def rows() -> list[tuple[str, float, str]]:
    """Name, value, unit."""
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
        ("attitude filter (002): predict", per_step(predict, steps), "µs"),
        ("attitude filter (002): star tracker, 0.33 Hz", per_step(space, steps), "µs"),
        ("attitude filter (002): accelerometer + magnetometer", ours, "µs"),
        ("the same, approximate matrices", per_step(approximate, steps), "µs"),
        ("quaternion filter (000): predict", per_step(quaternion, steps), "µs"),
        ("ahrs EKF, accelerometer + magnetometer", theirs, "µs"),
        ("ahrs EKF over ours", theirs / ours, "x"),
    ]


def main() -> None:
    """Print the table."""
    for name, value, unit in rows():
        print(f"{name:<56}{value:>10.3g} {unit}")


if __name__ == "__main__":
    main()
