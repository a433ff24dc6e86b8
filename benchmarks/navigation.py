"""What a step of the 15-state filter costs, and of the peers' filters on the same data."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
from timing import Row, best, once, print_rows

from nav_core.kalman import filter_record
from nav_core.navigation import Receiver, Vehicle, inertial_gnss
from nav_core.simulate import Scenario, simulate


def every_epoch() -> list[Row]:
    """A fix at every epoch: the dearest step there is."""
    drive, truth = simulate(Scenario(duration=120.0, accel_rate=10.0, gnss_rate=10.0, with_gyro=True), seed=1)
    record = inertial_gnss.prepare(
        drive, truth.R_va, receiver=Receiver(), vehicle=Vehicle(), speed_lag=0.0, course_lag=0.0
    )
    step = 1e6 * best(lambda: inertial_gnss.forward(record), repeat=40) / record.epochs.sample.size
    return [Row("15-state filter: predict, update with fix and constraints, per step", step, "µs", "≤ 20 µs")]


def against_python_ins() -> list[Row]:
    """The record and the call of the test that compares the results (tests/nav_core/python_ins.py)."""
    sys.path.append(str(Path(__file__).parents[1]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from tests.nav_core import python_ins

    record = python_ins.comparable(python_ins.comparable_world(4, duration=18.0))
    samples = record.t.size
    ours, theirs = best(lambda: inertial_gnss.forward(record), repeat=30), once(python_ins.peer(record))
    return [
        Row("15-state filter, 100 Hz, positions at 4 Hz, per sample", 1e6 * ours / samples, "µs"),
        Row("python-ins run_feedback_filter, same record, per sample", 1e6 * theirs / samples, "µs"),
        Row("python-ins over ours", theirs / ours, "x", "≥ 20"),
    ]


def linearised(states: int) -> tuple[np.ndarray, np.ndarray]:
    """Transitions and start of a filter of one drive: the first 15 states of the record, or position and velocity."""
    drive, truth = simulate(Scenario(duration=60.0, accel_rate=50.0, with_gyro=True), seed=1)
    record = inertial_gnss.prepare(
        drive, truth.R_va, receiver=Receiver(), vehicle=Vehicle(), speed_lag=0.0, course_lag=0.0
    )
    return inertial_gnss.forward(record).Phi[1:, :states, :states].copy(), record.start.P[:states, :states].copy()


def against_filterpy(states: int) -> list[Row]:
    """The same transitions, matrices and residuals through filterpy's EKF and through `filter_record`."""
    from filterpy.kalman import ExtendedKalmanFilter

    Phi, P = linearised(states)
    n = Phi.shape[0] + 1
    Q, H = 1e-6 * np.eye(states), np.eye(3, states)
    z = 2.0 * np.random.default_rng(1).standard_normal((n, 3))
    r = np.full(3, 4.0)

    def ours(*, keep: bool = False) -> np.ndarray:
        return filter_record(np.zeros(states), P, Phi=Phi, Q=Q, z=z, H=H, r=r, keep_covariances=keep).x

    def theirs() -> np.ndarray:
        ekf = ExtendedKalmanFilter(states, 3)
        ekf.x, ekf.P, ekf.Q, ekf.R = np.zeros((states, 1)), P.copy(), Q, 4.0 * np.eye(3)
        for k in range(n):
            if k > 0:
                ekf.F = Phi[k - 1]
                ekf.predict()
            ekf.update(z[k][:, None], lambda _: H, lambda x: H @ x)
        return ekf.x[:, 0]

    if not np.allclose(ours()[-1], theirs(), rtol=1e-6, atol=1e-9):
        raise AssertionError("filterpy's EKF finds another state")
    mine, peer = best(ours, repeat=60), best(theirs)
    kept = best(lambda: ours(keep=True), repeat=30)
    return [
        Row(f"Kalman filter, {states} states, 3 measurements, per step", 1e6 * mine / n, "µs"),
        Row("the same with the covariances of all epochs, for a smoother", 1e6 * kept / n, "µs"),
        Row("filterpy ExtendedKalmanFilter, same matrices, per step", 1e6 * peer / n, "µs"),
        Row(f"filterpy over ours, {states} states", peer / mine, "x", "≥ 20"),
    ]


def rows() -> list[Row]:
    """All of the above."""
    return [*every_epoch(), *against_python_ins(), *against_filterpy(6), *against_filterpy(15)]


if __name__ == "__main__":
    print_rows(rows())
