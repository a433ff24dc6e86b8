"""Orthonormalisation and the equations of the angles: 004's identities."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import sqrtm

from nav_core.attitude.euler_rates import body_rate, euler_holding_roll, euler_rates, gimbal_sums
from nav_core.attitude.orthonormal import (
    normalise_series,
    orthonormalise,
    orthonormalise_series,
    orthonormality_error,
)
from nav_core.errors import RangeError, ShapeError
from nav_core.rotation import angle_between, euler_to_matrix, matrix_to_rotvec, quaternion_to_matrix, wrap

HALF = np.pi / 2.0

angles = st.floats(-np.pi, np.pi)
pitches = st.floats(-HALF + 0.01, HALF - 0.01)
rates = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)
unit = st.tuples(*[st.floats(-1.0, 1.0)] * 4).map(np.array).filter(lambda q: np.linalg.norm(q) > 0.1)
bends = st.tuples(*[st.floats(-0.1, 0.1)] * 9).map(lambda v: np.reshape(v, (3, 3)))


# --- orthonormalisation ----------------------------------------------------------------------------------------


@given(unit, bends)
def test_the_exact_form_is_c_times_the_inverse_root(q, bend):
    C = quaternion_to_matrix(q) + bend
    X = orthonormalise(C)
    assert np.allclose(X, C @ np.linalg.inv(np.real(sqrtm(C.T @ C))), atol=1e-12)
    assert np.abs(orthonormality_error(X)).max() < 1e-14
    assert np.linalg.det(X) == pytest.approx(1.0)


@given(unit, bends)
def test_the_series_of_eq_15_approaches_it(q, bend):
    C = quaternion_to_matrix(q) + 0.2 * bend
    E = orthonormality_error(C)
    size = np.abs(np.linalg.eigvalsh(E)).max()
    for terms in (1, 2, 3, 6):
        # The ratio of binomial coefficients is below 1, so the rest is below a geometric series.
        bound = 1.03 * size ** (terms + 1) / (1.0 - size) + 1e-14
        assert np.linalg.norm(orthonormalise_series(C, terms=terms) - orthonormalise(C), 2) <= bound


def test_three_terms_are_eq_15_as_printed():
    C = quaternion_to_matrix([0.1, 0.5, -0.3, 0.8]) @ (
        np.eye(3) + 0.05 * np.array([[1, 2, 0], [0, -1, 1], [1, 0, 0.5]])
    )
    E = C.T @ C - np.eye(3)
    printed = C @ (np.eye(3) - 0.5 * E + 3.0 / 8.0 * E @ E - 5.0 / 16.0 * E @ E @ E)
    assert np.allclose(orthonormalise_series(C), printed, atol=1e-15)


@given(unit, bends)
def test_no_rotation_is_nearer(q, bend):
    C = quaternion_to_matrix(q) + bend
    best = np.linalg.norm(C - orthonormalise(C))
    for axis in np.eye(3):
        for angle in (-1e-3, 1e-3):
            other = orthonormalise(C) @ quaternion_to_matrix(np.append(np.sin(angle / 2) * axis, np.cos(angle / 2)))
            assert np.linalg.norm(C - other) > best


def test_one_wrong_element_is_spread_and_not_corrected():
    # 004's warning.
    C = np.eye(3)
    C[0, 1] += 0.02
    assert angle_between(orthonormalise(C), np.eye(3)) == pytest.approx(0.01, rel=1e-3)


def test_what_is_far_from_a_rotation_is_refused():
    with pytest.raises(RangeError):
        orthonormalise(np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(RangeError):
        orthonormalise_series(1.5 * np.eye(3))
    with pytest.raises(ShapeError):
        orthonormality_error(np.eye(2))
    with pytest.raises(RangeError):
        normalise_series(np.zeros(4))


def test_the_first_order_length_of_a_quaternion():
    q = np.array([0.1, 0.5, -0.3, 0.8])
    q /= np.linalg.norm(q)
    for stretch in (0.99, 1.01):
        left = np.linalg.norm(normalise_series(stretch * q)) - 1.0
        # D = 1 - stretch²; the remainder of the series is 3 D² / 8.
        assert left == pytest.approx(-3.0 / 8.0 * (1.0 - stretch**2) ** 2, rel=0.03)


# --- Euler rates -----------------------------------------------------------------------------------------------


@given(angles, pitches, angles, rates)
def test_rates_go_there_and_back(roll, pitch, yaw, w):
    euler = np.array([roll, pitch, yaw])
    assert np.allclose(body_rate(euler, euler_rates(euler, w)), w, atol=1e-12)


@given(angles, st.floats(-1.4, 1.4), angles, rates)
def test_rates_are_those_of_the_matrix(roll, pitch, yaw, w):
    step = 1e-6
    before = np.array([roll, pitch, yaw])
    after = before + step * euler_rates(before, w)
    turned = matrix_to_rotvec(euler_to_matrix(*before).T @ euler_to_matrix(*after)) / step
    assert np.allclose(turned, w, atol=2e-3)


def test_rates_end_in_gimbal_lock():
    with pytest.raises(RangeError):
        euler_rates(np.array([0.1, HALF, 0.2]), np.ones(3))
    with pytest.raises(ShapeError):
        euler_rates(np.zeros(2), np.zeros(3))
    assert np.isfinite(euler_rates(np.array([0.1, HALF - 1e-6, 0.2]), np.ones(3))).all()


@given(angles, st.floats(-HALF, HALF), angles)
def test_the_four_identities(roll, pitch, yaw):
    C = euler_to_matrix(roll, pitch, yaw)
    s = np.sin(pitch)
    assert C[1, 2] + C[0, 1] == pytest.approx((s - 1.0) * np.sin(yaw + roll), abs=1e-14)
    assert C[0, 2] - C[1, 1] == pytest.approx((s - 1.0) * np.cos(yaw + roll), abs=1e-14)
    assert C[1, 2] - C[0, 1] == pytest.approx((s + 1.0) * np.sin(yaw - roll), abs=1e-14)
    assert C[0, 2] + C[1, 1] == pytest.approx((s + 1.0) * np.cos(yaw - roll), abs=1e-14)


@given(angles, st.floats(-1.5, 1.5), angles)
def test_sum_and_difference_of_yaw_and_roll(roll, pitch, yaw):
    plus, minus = gimbal_sums(euler_to_matrix(roll, pitch, yaw))
    assert wrap(plus - (yaw + roll)) == pytest.approx(0.0, abs=1e-10)
    assert wrap(minus - (yaw - roll)) == pytest.approx(0.0, abs=1e-10)


@given(angles, st.sampled_from([1.0, -1.0]), angles, angles)
def test_any_roll_can_be_held_in_gimbal_lock(roll, side, yaw, held):
    C = euler_to_matrix(roll, side * HALF, yaw)
    found = euler_holding_roll(C, held)
    assert found[0] == held
    assert np.allclose(euler_to_matrix(*found), C, atol=1e-12)


def test_a_pull_up_through_the_vertical_keeps_its_roll():
    roll, yaw = 0.3, 1.0
    for off in (1e-3, 1e-7, 0.0, -1e-7, -1e-3):
        C = euler_to_matrix(roll, HALF + off, yaw)
        assert angle_between(euler_to_matrix(*euler_holding_roll(C, roll)), C) <= 2.5 * abs(off) + 1e-12
