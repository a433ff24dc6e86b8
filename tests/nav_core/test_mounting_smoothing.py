"""Cars whose springs give unlike, and receivers that smooth: found from the drive, and no burden on the mounting."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nav_core.mounting.fixes import usable_fixes
from nav_core.mounting.model import UNLIKE_GAIN, Noise
from nav_core.mounting.smoothing import as_received, low_passed
from nav_core.mounting.solution import Solution, matched, solve
from nav_core.mounting.stretch import Record, prepare
from nav_core.mounting.whole_drive import estimate
from nav_core.rotation import error_between
from nav_core.signal import decimate
from nav_core.simulate import Scenario, simulate


def _record(scenario: Scenario, seed: int) -> tuple[Record, np.ndarray]:
    drive, truth = simulate(scenario, seed=seed)
    return prepare(decimate(drive.inertial), usable_fixes(drive.gnss)), truth.R_va


def _solved(scenario: Scenario, seed: int, noise: Noise | None = None) -> tuple[Solution, np.ndarray]:
    record, R_va = _record(scenario, seed)
    noise = noise or Noise()
    found = matched(solve(record, noise), noise)
    return found, np.degrees(error_between(found.fit.R_va, R_va))


def test_unlike_springs_are_told_from_pitch():
    """The same drives with springs that give half and half as much again in braking: only the springs differ."""

    def shift(noise: Noise) -> tuple[float, float]:
        gains, pitches = [], []
        for seed in (7601, 7602):
            scenario = Scenario(route="urban", duration=400.0)
            (soft, one), (hard, other) = (_solved(replace(scenario, dive=dive), seed, noise) for dive in (0.5, 1.5))
            gains.append(soft.fit.p[UNLIKE_GAIN] - hard.fit.p[UNLIKE_GAIN])
            pitches.append(one[1] - other[1])
        return float(np.degrees(np.mean(gains))), float(abs(np.mean(pitches)))

    (gain, ours), (_, stubborn) = shift(Noise()), shift(Noise(unlike_gain=1e-6))
    assert gain == pytest.approx(1.25, rel=0.35)
    assert ours < 0.5 * stubborn


def test_like_springs_are_not_called_unlike():
    gains = [_solved(Scenario(route="urban", duration=300.0), seed)[0].fit.p[UNLIKE_GAIN] for seed in range(7610, 7613)]
    assert abs(np.mean(gains)) < np.radians(0.25)


@pytest.mark.parametrize(("route", "time"), [("roundabout", 1.0), ("urban", 0.6), ("urban", 1.6)])
def test_how_long_a_receiver_smooths_is_told_from_the_drive(route: str, time: float):
    scenario = Scenario(route=route, duration=240.0, gnss_smoothing=time, speed_lag=0.2, course_lag=0.3)  # type: ignore[arg-type]
    found, error = _solved(scenario, 7620)
    assert found.smoothing == pytest.approx(time, rel=0.2)
    assert found.fit.speed_lag == pytest.approx(0.2, abs=0.12)
    assert found.fit.course_lag == pytest.approx(0.3, abs=0.12)
    assert abs(error[2]) < 1.5


@pytest.mark.parametrize("route", ["urban", "straight", "roundabout", "highway"])
@pytest.mark.parametrize("lag", [0.0, 1.0])
def test_a_late_receiver_is_not_taken_for_one_that_smooths(route: str, lag: float):
    for seed in (7630, 7631):
        scenario = Scenario(route=route, duration=200.0, speed_lag=lag, course_lag=lag, gnss_rate=(1.0, 4.0)[seed % 2])  # type: ignore[arg-type]
        found, _ = _solved(scenario, seed)
        assert found.smoothing == 0.0


def test_a_smoothing_receiver_is_late_as_a_whole():
    drive, _ = simulate(Scenario(gnss_smoothing=1.0, speed_lag=0.2, course_lag=0.3), seed=7640)
    found = estimate(decimate(drive.inertial), drive.gnss)
    assert found.status == "ready"
    assert found.speed_lag == pytest.approx(1.2, abs=0.15)
    assert found.course_lag == pytest.approx(1.3, abs=0.15)


def test_intervals_hold_with_a_smoothing_receiver():
    inside = []
    for seed in range(7650, 7662):
        scenario = Scenario(
            route="roundabout", duration=120.0, gnss_smoothing=1.0, gnss_rate=(1.0, 4.0, 10.0)[seed % 3]
        )
        drive, truth = simulate(scenario, seed=seed)
        found = estimate(decimate(drive.inertial), drive.gnss)
        assert found.R_va is not None
        assert found.sigma is not None
        inside.append(np.abs(error_between(found.R_va, truth.R_va)) < 1.96 * found.sigma)
    assert np.mean(inside) > 0.88


def test_the_low_pass_is_the_simulators():
    """Both filter a ramp exactly: behind it by the time constant, once the beginning is over."""
    record, _ = _record(Scenario(duration=30.0), 7670)
    ramp = 3.0 * record.t
    settled = record.t > record.t[0] + 15.0
    np.testing.assert_allclose(low_passed(record, ramp, 0.9)[settled], (ramp - 2.7)[settled], atol=1e-5)


def test_after_a_gap_the_low_pass_begins_anew():
    record, _ = _record(Scenario(duration=30.0), 7671)
    step = record.step.copy()
    step[100] = 0.0
    values = np.where(np.arange(record.t.size) < 100, 5.0, -2.0)
    np.testing.assert_allclose(low_passed(record._replace(step=step), values, 1.0), values)


def test_length_and_direction_of_a_turning_velocity_are_given_back():
    """In a steady circle smoothing shortens the velocity by sqrt(1 + (w T)²) and turns it by atan(w T), not w T."""
    scenario = replace(Scenario(route="roundabout", duration=120.0).faultless(), lever_arm=(0.0, 0.0, 0.0))
    drive, truth = simulate(replace(scenario, gnss_smoothing=1.0), seed=7672)
    record = prepare(decimate(drive.inertial), usable_fixes(drive.gnss))
    back = as_received(record, 1.0, truth.R_va, 0.0)
    age = np.arange(0.0, 9.0, 0.005)
    weight = np.exp(-age) / np.exp(-age).sum()
    late = record.fixes.t > 15.0
    speed = np.interp(record.fixes.t[late, None] - age, truth.t, truth.v) @ weight
    course = np.interp(record.fixes.t[late, None] - age, truth.t, np.unwrap(truth.yaw)) @ weight
    for before, after, smooth in (
        (record.fixes.speed, back.fixes.speed, speed),
        (record.fixes.course, back.fixes.course, course),
    ):
        was, left = ((np.remainder(each[late] - smooth + np.pi, 2.0 * np.pi) - np.pi) for each in (before, after))
        assert np.sqrt(np.nanmean(left**2)) < 0.35 * np.sqrt(np.nanmean(was**2))


def test_no_smoothing_leaves_the_record_alone():
    record, R_va = _record(Scenario(duration=20.0), 7673)
    assert as_received(record, 0.0, R_va, 0.3) is record


@pytest.mark.parametrize("seed", [7701, 7702, 7703])
def test_ten_samples_a_second_are_too_loud_to_tell(seed: int):
    """Vibration that folds down is no receiver's smoothing, though a low-pass would take it away."""
    record, _ = _record(Scenario(route="highway", duration=600.0, accel_rate=10.0, gnss_rate=4.0), seed)
    assert matched(solve(record, Noise()), Noise()).smoothing == 0.0
