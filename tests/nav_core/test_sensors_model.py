"""Error model, compensation, choice of the low-pass filter, performance classes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from nav_core.errors import RangeError, ShapeError, TooLittleDataError
from nav_core.sensors import (
    MPU6050_FILTERS,
    Compensation,
    SensorErrors,
    cep_radius,
    cep_rate,
    choose_cutoff,
    gyro_grade,
    performance,
)
from nav_core.sensors.grades import NAUTICAL_MILE

M = np.array([[0.01, -0.002, 0.003], [0.004, -0.02, 0.005], [-0.006, 0.007, 0.015]])
TRUTH = np.random.default_rng(0).uniform(-20.0, 20.0, (200, 3))


def test_no_errors_change_nothing():
    np.testing.assert_array_equal(SensorErrors().measure(TRUTH), TRUTH)
    np.testing.assert_allclose(SensorErrors().correct(TRUTH), TRUTH)


def test_scale_misalignment_and_bias_are_linear():
    errors = SensorErrors(bias=np.array([0.1, -0.2, 0.3]), M=M)
    read = errors.measure(TRUTH)
    np.testing.assert_allclose(read, TRUTH + TRUTH @ M.T + [0.1, -0.2, 0.3])
    # 000 eq. 1.5.2: (I - M) inverts to the first order only, the error is M² of the input.
    first_order = (read - errors.bias) @ (np.eye(3) - M).T
    np.testing.assert_allclose(first_order - TRUTH, -TRUTH @ (M @ M).T, atol=1e-12)


@given(st.integers(0, 10**6))
def test_what_can_be_inverted_is(seed):
    rng = np.random.default_rng(seed)
    errors = SensorErrors(
        bias=rng.uniform(-1, 1, 3),
        M=rng.uniform(-0.05, 0.05, (3, 3)),
        asymmetry=rng.uniform(-0.05, 0.05, 3),
        quadratic=rng.uniform(-2e-3, 2e-3, 3),
        bias_slope=rng.uniform(-0.01, 0.01, 3),
        scale_slope=rng.uniform(-1e-4, 1e-4, 3),
    )
    truth, temp = rng.uniform(-20, 20, (30, 3)), rng.uniform(-20, 60, 30)
    np.testing.assert_allclose(errors.correct(errors.measure(truth, temp=temp), temp=temp), truth, atol=1e-9)


def test_a_dead_zone_swallows_small_inputs_and_shifts_the_others():
    errors = SensorErrors(dead_zone=0.5)
    truth = np.array([[0.4, -0.4, 0.0], [1.0, -1.0, 0.5]])
    np.testing.assert_allclose(errors.measure(truth), [[0, 0, 0], [0.5, -0.5, 0]])
    np.testing.assert_allclose(errors.correct(errors.measure(truth)), [[0, 0, 0], [1.0, -1.0, 0]])


def test_quantisation_and_clipping_come_last():
    errors = SensorErrors(bias=np.array([0.3, 0.0, 0.0]), resolution=0.25, full_scale=2.1)
    read = errors.measure(np.array([[0.0, 0.37, 5.0]]), noise=np.array([[0.0, 0.01, -9.0]]))
    np.testing.assert_allclose(read, [[0.25, 0.5, -2.1]])
    fine = SensorErrors(resolution=0.1).measure(TRUTH) - TRUTH
    assert np.max(np.abs(fine)) <= 0.05 + 1e-12
    # Of a step evenly spread: LSB / sqrt(12), 002 section 5.2.1.
    assert fine.std() == pytest.approx(0.1 / np.sqrt(12.0), rel=0.1)


def test_asymmetry_and_temperature():
    errors = SensorErrors(
        asymmetry=np.full(3, 0.1), bias_slope=np.array([0.02, 0.0, 0.0]), scale_slope=np.full(3, 1e-3)
    )
    read = errors.measure(np.array([[1.0, 1.0, -1.0]]), temp=35.0)
    np.testing.assert_allclose(read, [[1.1 * 1.01 + 0.2, 1.1 * 1.01, -0.9 * 1.01]])


def test_errors_without_a_meaning_are_refused():
    with pytest.raises(ShapeError):
        SensorErrors(bias=np.zeros(2))
    with pytest.raises(ShapeError):
        SensorErrors().measure(np.zeros(3))
    with pytest.raises(RangeError):
        SensorErrors(asymmetry=np.full(3, 1.0))
    with pytest.raises(RangeError):
        SensorErrors(dead_zone=-1.0)
    with pytest.raises(RangeError):
        SensorErrors(full_scale=0.0)
    with pytest.raises(RangeError):
        SensorErrors(quadratic=np.full(3, -1.0)).correct(np.ones((1, 3)))


def test_compensation_takes_off_what_the_model_put_on():
    errors = SensorErrors(bias=np.array([0.1, -0.2, 0.3]), M=M, bias_slope=np.array([0.01, 0.02, -0.03]))
    work = Compensation(np.eye(3) + M, errors.bias, errors.bias_slope)
    temp = np.linspace(-10.0, 50.0, len(TRUTH))
    np.testing.assert_allclose(work.apply(errors.measure(TRUTH, temp=temp), temp=temp), TRUTH, atol=1e-12)
    np.testing.assert_allclose(work.apply(errors.measure(TRUTH[:1])[0]), TRUTH[0], atol=1e-12)


def test_feedback_adds_up_and_waits_after_a_reset():
    work = Compensation(hold=5.0)
    found = work.corrected(1.0, np.array([0.1, 0.0, 0.0])).corrected(2.0, np.array([0.1, 0.0, -0.2]))
    np.testing.assert_allclose(found.feedback, [0.2, 0.0, -0.2])
    np.testing.assert_allclose(found.apply(np.zeros(3)), [-0.2, 0.0, 0.2])
    waiting = found.reset(10.0)
    assert waiting.corrected(14.9, np.ones(3)) is waiting
    np.testing.assert_allclose(waiting.corrected(15.0, np.ones(3)).feedback, [1.2, 1.0, 0.8])
    np.testing.assert_allclose(work.feedback, 0.0)
    with pytest.raises(ShapeError):
        Compensation(bias=np.zeros(2))
    with pytest.raises(RangeError):
        Compensation(hold=-1.0)


def test_the_cutoff_of_002():
    # 002 section 5.3.1: from 0.1 to 40 °/s at 100 Hz, going below 42 Hz only makes things worse.
    choice = choose_cutoff(MPU6050_FILTERS, np.radians([0.1, 0.2, 1.0, 40.0]), 0.01)
    assert min(setting.cutoff for setting in choice.best) >= 42.0
    assert [setting.cutoff for setting in choice.best] == [98.0, 188.0, 256.0, 256.0]
    # Table 5.2: sigma_w of 0.083 °/s at 188 Hz, so 8.3e-4° a step; table 5.1: 1.9 ms of delay, so 0.076° at 40 °/s.
    assert np.degrees(choice.noise_error[1]) == pytest.approx(8.3e-4)
    assert np.degrees(choice.delay_error[1, 3]) == pytest.approx(0.076)
    slow = choose_cutoff(MPU6050_FILTERS, np.zeros(1), 0.01, sigmas=3.0)
    assert slow.best[0].cutoff == 5.0
    np.testing.assert_allclose(slow.noise_error, 3.0 * choice.noise_error)


def test_a_choice_needs_something_to_choose_from():
    with pytest.raises(TooLittleDataError):
        choose_cutoff((), np.ones(1), 0.01)
    with pytest.raises(RangeError):
        choose_cutoff(MPU6050_FILTERS, np.ones(1), 0.0)


@pytest.mark.parametrize(
    ("quantity", "value", "expected"),
    [
        ("cep_rate", 0.05 * NAUTICAL_MILE / 3600.0, "high"),
        ("cep_rate", 1.0 * NAUTICAL_MILE / 3600.0, "medium"),
        ("cep_rate", 50.0 * NAUTICAL_MILE / 3600.0, "low"),
        ("gyro", np.radians(1e-2) / 3600.0, "medium"),
        ("gyro", np.radians(1.0), "low"),
        ("accelerometer", 9.80665e-8, "high"),
        ("accelerometer", 9.80665e-6, "medium"),
        ("accelerometer", 9.80665e-2, "low"),
    ],
)
def test_performance_by_table_11(quantity, value, expected):
    assert performance(quantity, value) == expected


def test_gyro_grades_by_table_12():
    hour = np.radians(1.0) / 3600.0
    assert gyro_grade(scale=1e-5, bias_stability=1e-3 * hour) == "inertial"
    assert gyro_grade(scale=1e-5, bias_stability=1.0 * hour) == "intermediate"
    assert gyro_grade(bias_drift=np.radians(5.0) / 60.0) == "moderate"
    # An MPU-6050 as in 002: 3 % of scale, degrees per second of bias.
    assert gyro_grade(scale=0.03, bias_stability=np.radians(3.0)) == "below"
    with pytest.raises(RangeError):
        gyro_grade(scale=-1.0)
    with pytest.raises(RangeError):
        performance("gyro", -1.0)


@pytest.mark.parametrize("probability", [0.1, 0.5, 0.95])
def test_the_cep_of_a_circle_and_of_a_line(probability):
    circle = np.sqrt(chi2.ppf(probability, 2))
    assert cep_radius(4.0 * np.eye(2), probability) == pytest.approx(2.0 * circle, rel=1e-5)
    line = np.sqrt(chi2.ppf(probability, 1))
    assert cep_radius(np.diag([0.0, 9.0]), probability) == pytest.approx(3.0 * line, rel=1e-3)


def test_the_cep_of_an_ellipse_is_the_median_radius():
    P = np.array([[4.0, 1.5], [1.5, 1.0]])
    drawn = np.random.default_rng(1).multivariate_normal([0.0, 0.0], P, 200_000)
    assert cep_radius(P) == pytest.approx(np.median(np.hypot(*drawn.T)), rel=0.01)
    assert cep_radius(np.zeros((2, 2))) == 0.0


def test_the_cep_grows_at_its_rate():
    rng = np.random.default_rng(2)
    t = np.linspace(0.0, 3600.0, 50)
    velocity = rng.standard_normal((4000, 1, 2))
    assert cep_rate(t, velocity * t[:, None]) == pytest.approx(1.1774, rel=0.05)


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda: cep_radius(np.eye(3)), ShapeError),
        (lambda: cep_radius(np.eye(2), 1.0), RangeError),
        (lambda: cep_radius(np.diag([-1.0, 1.0])), RangeError),
        (lambda: cep_rate(np.ones(3), np.zeros((2, 4, 2))), ShapeError),
        (lambda: cep_rate(np.zeros(3), np.zeros((2, 3, 2))), TooLittleDataError),
    ],
)
def test_errors_of_position_without_a_meaning_are_refused(call, error):
    with pytest.raises(error):
        call()
