"""What a step of the 15-state filter costs: one sample, predict, and an update with position, speed and course."""

from __future__ import annotations

import time

import numpy as np

from nav_core.navigation import Receiver, Vehicle, inertial_gnss, kernels
from nav_core.simulate import Scenario, simulate


def rows() -> list[tuple[str, float, str]]:
    """Name, value, unit."""
    drive, truth = simulate(Scenario(duration=120.0, accel_rate=10.0, gnss_rate=10.0, with_gyro=True), seed=1)
    record = inertial_gnss.prepare(
        drive, truth.R_va, receiver=Receiver(), vehicle=Vehicle(), speed_lag=0.0, course_lag=0.0
    )

    start = record.start
    best = np.inf
    for _ in range(12):
        began = time.perf_counter()
        kernels.run(
            record.t,
            record.increments.rotation,
            record.increments.velocity,
            *record.epochs,
            record.arm,
            record.weights,
            start.place.copy(),
            start.v.copy(),
            start.C.copy(),
            start.P.copy(),
        )
        best = min(best, time.perf_counter() - began)
    name = "15-state filter, predict and update with fix and constraints"
    return [(name, 1e6 * best / record.epochs.sample.size, "µs")]


if __name__ == "__main__":
    for name, value, unit in rows():
        print(f"{name:<64}{value:>10.4g} {unit}")
