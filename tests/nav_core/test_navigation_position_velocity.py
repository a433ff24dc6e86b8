"""The 12-state filter of 000 §7.7.2: print against correction, exactness, and drives without a gyro."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nav_core.errors import RangeError, ShapeError, TooLittleDataError
from nav_core.navigation import inside, miss, navigate_without_gyro, position_velocity
from nav_core.navigation.position_velocity import THESIS, THESIS_MEASUREMENT, Noise, augmented_transition, run
from nav_core.processes import transition
from nav_core.records import Inertial
from tests.nav_core.drives_on_the_globe import world


def test_transition_is_that_of_two_accelerations_integrated_twice():
    Phi = augmented_transition(0.7)
    x = np.arange(1.0, 13.0)
    p, v, a, b = x.reshape(4, 3)
    after = (Phi @ x).reshape(4, 3)
    assert after == pytest.approx(np.array([p + 0.7 * v + 0.245 * (a + b), v + 0.7 * (a + b), a, b]))
    F = (augmented_transition(1e-6) - np.eye(12)) / 1e-6
    assert Phi == pytest.approx(transition(np.round(F), 0.7), abs=1e-12)


def test_printed_transition_loses_the_position_and_piles_up_the_bias():
    x = np.zeros(12)
    x[3], x[9] = 2.0, 0.1
    printed, corrected = augmented_transition(1.0, errata="printed"), augmented_transition(1.0)
    for _ in range(10):
        x = printed @ x
    assert x[0] == 0.0  # though it moved at 2 m/s and more
    assert x[6] == pytest.approx(1.0)  # an acceleration that nothing caused
    y = np.zeros(12)
    y[3], y[9] = 2.0, 0.1
    for _ in range(10):
        y = corrected @ y
    assert y[0] == pytest.approx(2.0 * 10.0 + 0.5 * 0.1 * 100.0)
    assert y[6] == 0.0
    with pytest.raises(RangeError):
        augmented_transition(0.0)


def test_a_constant_bias_is_found_with_the_thesis_matrices():
    rng = np.random.default_rng(3)
    t = np.arange(200.0)
    bias = np.array([0.3, -0.2, 0.1])
    truth = np.hstack((0.5 * t[:, None] ** 2 * bias, t[:, None] * bias))
    z = truth + np.sqrt(THESIS_MEASUREMENT) * rng.standard_normal((t.size, 6))
    found = run(t, z, np.tile(THESIS_MEASUREMENT, (t.size, 1)), THESIS, smoothed=True)
    acceleration = found.x[:, 6:9] + found.x[:, 9:12]
    assert acceleration[50:150].mean(axis=0) == pytest.approx(bias, abs=0.05)
    # With nearly no noise of its own the same filter is a fit of a parabola.
    calm = Noise(position=1e-9, velocity=1e-9, acceleration=1e-9, bias=1e-9)
    found = run(t, z, np.tile(THESIS_MEASUREMENT, (t.size, 1)), calm)
    assert (found.x[-1, 6:9] + found.x[-1, 9:12]) == pytest.approx(bias, abs=0.01)


def test_text_and_matrix_of_the_measurement_noise_exchange_position_and_velocity():
    assert THESIS_MEASUREMENT.tolist() == [4.0] * 3 + [9.0] * 3


def test_errors_stay_within_their_covariance_when_all_is_as_modelled():
    rng = np.random.default_rng(8)
    noise = Noise(position=1e-4, velocity=0.01, acceleration=0.01, bias=1e-4, start=1.0)
    t = np.arange(60.0)
    half = np.sqrt(0.5 * noise.diagonal())
    Phi = augmented_transition(1.0)
    squares = []
    for _ in range(100):
        x = rng.standard_normal(12)
        path = [x]
        for _ in range(59):
            x = Phi @ (x + half * rng.standard_normal(12)) + half * rng.standard_normal(12)
            path.append(x)
        truth = np.array(path)
        z = truth[:, :6] + 2.0 * rng.standard_normal((60, 6))
        found = run(t, z, np.full((60, 6), 4.0), noise, smoothed=True)
        e = truth[30] - found.x[30]
        squares.append(e @ np.linalg.solve(found.P[30], e))
    assert np.mean(squares) == pytest.approx(12.0, abs=1.5)  # its sigma is 0.49


@pytest.mark.parametrize("seed", [1, 5])
def test_a_drive_without_gyro(seed):
    drive, truth, globe = seen = world(seed, duration=120.0)
    drive = replace(drive, inertial=Inertial(t=drive.inertial.t, f=drive.inertial.f))
    solution = navigate_without_gyro(drive, truth.R_va, **seen.lags)
    inner = (globe.t > solution.t[0] + 10.0) & (globe.t < solution.t[-1] - 5.0)
    found = miss(solution, globe.t[inner], globe.lat[inner], globe.lon[inner])
    assert found.distance.mean() < 2.0
    assert inside(found).mean() > 0.8
    assert np.isnan(solution.euler_sigma).all()
    speed = np.hypot(*solution.velocity[:, :2].T)
    assert speed == pytest.approx(np.interp(solution.t, truth.t, truth.v), abs=1.5)


def test_fixes_that_the_gate_leaves_out_are_counted():
    drive, truth, _ = seen = world(1, duration=60.0)
    gnss = drive.gnss
    jump = (gnss.t > 40.0) & (gnss.t < 42.0)
    jumped = replace(drive, gnss=replace(gnss, lat=gnss.lat + jump * 500.0 / 6.37e6))
    assert navigate_without_gyro(drive, truth.R_va, **seen.lags).rejected == 0
    found = navigate_without_gyro(jumped, truth.R_va, **seen.lags)
    assert found.rejected == pytest.approx(np.count_nonzero(jump), abs=2)


def test_what_the_filter_refuses():
    drive, truth, _ = world(1, duration=20.0)
    silent = replace(drive, gnss=replace(drive.gnss, fix=np.zeros(drive.gnss.t.size, dtype=bool)))
    with pytest.raises(TooLittleDataError):
        navigate_without_gyro(silent, truth.R_va)
    with pytest.raises(ShapeError):
        run(np.arange(3.0), np.zeros((2, 6)), np.ones((3, 6)))


def test_a_hole_in_the_record_is_uncertain():
    drive, truth, _ = seen = world(1, duration=60.0)
    keep = (drive.inertial.t < 30.0) | (drive.inertial.t > 34.0)
    inertial = Inertial(t=drive.inertial.t[keep], f=drive.inertial.f[keep])
    whole = navigate_without_gyro(drive, truth.R_va, smoothed=False, **seen.lags)
    holed = navigate_without_gyro(replace(drive, inertial=inertial), truth.R_va, smoothed=False, **seen.lags)
    at = np.searchsorted(whole.t, 33.9)
    assert holed.sigma[at, 3] > 1.3 * whole.sigma[at, 3]
    assert position_velocity.STATES == 12
