"""Conversions among matrices, quaternions, rotation vectors and angles, over the whole group and at its ends."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from nav_core.errors import RangeError, ShapeError
from nav_core.rotation import (
    angle_between,
    conjugate,
    euler_to_matrix,
    euler_to_quaternion,
    matrix_to_euler,
    matrix_to_quaternion,
    matrix_to_rotvec,
    matrix_to_thesis,
    normalised,
    product,
    quaternion_to_euler,
    quaternion_to_matrix,
    quaternion_to_rotvec,
    rotvec_to_matrix,
    rotvec_to_quaternion,
    skew,
    thesis_to_matrix,
    wrap,
)

HALF = np.pi / 2.0

angles = st.one_of(st.floats(-np.pi, np.pi), st.sampled_from([0.0, HALF, -HALF, np.pi, -np.pi, 1e-9, HALF - 1e-8]))
components = st.one_of(st.floats(-1.0, 1.0), st.sampled_from([0.0, 1.0, -1.0, 1e-12, -1e-7]))
quaternions = st.tuples(*[components] * 4).map(np.array).filter(lambda q: np.linalg.norm(q) > 1e-6)
axes = st.tuples(*[components] * 3).map(np.array).filter(lambda v: np.linalg.norm(v) > 1e-6)
turns = st.one_of(st.floats(0.0, np.pi), st.sampled_from([0.0, np.pi, 1e-12, 1e-9, np.pi - 1e-9, HALF]))


@st.composite
def rotvecs(draw: st.DrawFn) -> np.ndarray:
    axis = draw(axes)
    return draw(turns) * axis / np.linalg.norm(axis)


# --- against scipy ---------------------------------------------------------------------------------------------


@given(quaternions)
def test_matrix_of_a_quaternion(q):
    assert np.allclose(quaternion_to_matrix(q), Rotation.from_quat(q).as_matrix(), atol=1e-14)


@given(rotvecs())
def test_a_rotation_vector_is_its_exponential(v):
    assert np.allclose(rotvec_to_matrix(v), Rotation.from_rotvec(v).as_matrix(), atol=1e-14)
    assert np.allclose(rotvec_to_quaternion(v), Rotation.from_rotvec(v).as_quat(canonical=True), atol=1e-14) or (
        np.abs(rotvec_to_quaternion(v)[3]) < 1e-14
    )


@given(angles, angles, angles)
def test_roll_pitch_yaw_are_the_sequence_zyx(roll, pitch, yaw):
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    assert np.allclose(euler_to_matrix(roll, pitch, yaw), expected.as_matrix(), atol=1e-14)
    assert np.allclose(quaternion_to_matrix(euler_to_quaternion(roll, pitch, yaw)), expected.as_matrix(), atol=1e-14)


@given(quaternions, quaternions)
def test_the_product_is_the_composition(q, p):
    expected = (Rotation.from_quat(q) * Rotation.from_quat(p)).as_matrix()
    assert np.allclose(quaternion_to_matrix(product(q, p)), expected, atol=1e-13)


# --- group axioms ----------------------------------------------------------------------------------------------


@given(quaternions, quaternions, quaternions)
def test_quaternions_are_a_group(p, q, r):
    p, q, r = normalised(p), normalised(q), normalised(r)
    one = np.array([0.0, 0.0, 0.0, 1.0])
    assert np.allclose(product(product(p, q), r), product(p, product(q, r)), atol=1e-14)
    assert np.linalg.norm(product(p, q)) == pytest.approx(1.0, abs=1e-14)
    assert np.array_equal(product(p, one), p)
    assert np.allclose(product(p, conjugate(p)), one, atol=1e-15)
    assert np.allclose(product(conjugate(p), p), one, atol=1e-15)


@given(quaternions, axes)
def test_a_rotated_vector_is_q_v_q_conjugate(q, v):
    # 000 eqs. 2.6.39, 2.6.40.
    q = normalised(q)
    turned = product(product(q, np.append(v, 0.0)), conjugate(q))
    assert np.allclose(turned[:3], quaternion_to_matrix(q) @ v, atol=1e-14)
    assert turned[3] == pytest.approx(0.0, abs=1e-15)


@given(quaternions, quaternions)
def test_norms_multiply(q, p):
    # 000 eq. 2.6.30.
    assert np.linalg.norm(product(q, p)) == pytest.approx(np.linalg.norm(q) * np.linalg.norm(p), rel=1e-13)


# --- there and back --------------------------------------------------------------------------------------------


@given(quaternions)
@example(np.array([1.0, 0.0, 0.0, 0.0]))
@example(np.array([0.0, 1.0, 0.0, 0.0]))
@example(np.array([0.0, 0.0, 1.0, 0.0]))
@example(np.array([0.6, 0.0, -0.8, 0.0]))
def test_a_quaternion_comes_back_from_its_matrix(q):
    q = normalised(q)
    back = matrix_to_quaternion(quaternion_to_matrix(q))
    assert back[3] >= 0.0
    assert min(np.abs(back - q).max(), np.abs(back + q).max()) < 1e-14


@given(quaternions)
def test_every_representation_comes_back_to_the_matrix(q):
    R = quaternion_to_matrix(q)
    assert np.allclose(rotvec_to_matrix(matrix_to_rotvec(R)), R, atol=1e-13)
    assert np.allclose(quaternion_to_matrix(matrix_to_quaternion(R)), R, atol=1e-13)
    # Within `GIMBAL_LOCK` of it, roll and psi are put to zero.
    assert np.allclose(euler_to_matrix(*matrix_to_euler(R)), R, atol=2e-9)
    assert np.allclose(thesis_to_matrix(*matrix_to_thesis(R)), R, atol=2e-9)
    assert np.allclose(euler_to_matrix(*quaternion_to_euler(q)), R, atol=2e-9)


@given(rotvecs())
def test_a_rotation_vector_comes_back(v):
    back = quaternion_to_rotvec(rotvec_to_quaternion(v))
    error = min(np.abs(back - v).max(), np.abs(back + v).max() if np.linalg.norm(v) > np.pi - 1e-7 else np.inf)
    assert error < 1e-14 + 1e-15 * np.linalg.norm(v)


@given(st.floats(-np.pi, np.pi), st.floats(-HALF + 1e-6, HALF - 1e-6), st.floats(-np.pi, np.pi))
def test_roll_pitch_yaw_come_back_away_from_gimbal_lock(roll, pitch, yaw):
    given_angles = np.array([roll, pitch, yaw])
    assert np.abs(wrap(matrix_to_euler(euler_to_matrix(*given_angles)) - given_angles)).max() < 1e-9
    assert np.abs(wrap(quaternion_to_euler(euler_to_quaternion(*given_angles)) - given_angles)).max() < 1e-9


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_roll_is_zero_in_gimbal_lock(side):
    roll, pitch, yaw = matrix_to_euler(euler_to_matrix(0.3, side * HALF, 0.8))
    assert roll == 0.0
    assert pitch == pytest.approx(side * HALF)
    assert yaw == pytest.approx(0.8 - side * 0.3)


def test_turns_by_pi_do_not_divide_by_zero():
    # 000 eq. 2.6.68 and 001 C.22-C.24 divide by the scalar part.
    for axis in np.vstack([np.eye(3), [[0.6, 0.8, 0.0]], [[-0.48, 0.6, 0.64]]]):
        R = 2.0 * np.outer(axis, axis) - np.eye(3)
        q = matrix_to_quaternion(R)
        assert np.allclose(np.abs(q[:3]), np.abs(axis), atol=1e-15)
        assert angle_between(rotvec_to_matrix(matrix_to_rotvec(R)), R) < 1e-14
        assert np.linalg.norm(matrix_to_rotvec(R)) == pytest.approx(np.pi)


# --- the documents' identities ---------------------------------------------------------------------------------


def test_figure_262_the_order_of_rotations_matters():
    def pitch(angle):
        return euler_to_matrix(0.0, angle, 0.0)

    yaw = euler_to_matrix(0.0, 0.0, HALF)
    assert np.allclose(pitch(HALF) @ yaw @ pitch(-HALF), euler_to_matrix(HALF, 0.0, 0.0), atol=1e-15)
    assert np.allclose(pitch(-HALF) @ yaw @ pitch(HALF), euler_to_matrix(-HALF, 0.0, 0.0), atol=1e-15)


def test_the_printed_2618_is_no_rotation_but_2647_is():
    r, p, y = 0.4, -0.3, 1.1
    cr, sr, cp, sp, cy, sy = np.cos(r), np.sin(r), np.cos(p), np.sin(p), np.cos(y), np.sin(y)
    printed = np.array(
        [
            [cp * cy, -cp * sy + sr * sp * cy, sr * sy + cr * sp * cy],
            [cp * sy, cp * cy + sr * sp * sy, -sr * cy + cr * sp * sy],
            [-sp, sr * cp, cr * cp],
        ]
    )
    assert np.abs(printed.T @ printed - np.eye(3)).max() > 0.01
    corrected = printed.copy()
    corrected[0, 1], corrected[1, 1] = -cr * sy + sr * sp * cy, cr * cy + sr * sp * sy
    assert np.allclose(corrected, euler_to_matrix(r, p, y), atol=1e-15)


def test_the_printed_2669_lacks_a_minus_and_2671_takes_the_wrong_product():
    r, p, y = 0.4, -0.3, 1.1
    b, c, d, a = euler_to_quaternion(r, p, y)
    half = np.cos(0.5 * np.array([r, p, y])), np.sin(0.5 * np.array([r, p, y]))
    printed_d = half[0][0] * half[0][1] * half[1][2] + half[1][0] * half[1][1] * half[0][2]
    assert abs(printed_d - d) > 0.05
    assert a**2 + b**2 + c**2 + printed_d**2 != pytest.approx(1.0, abs=0.01)
    below = a**2 + b**2 - c**2 - d**2
    assert np.arctan2(2 * (a * d + b * c), below) == pytest.approx(y)
    assert abs(np.arctan2(2 * (a * c + b * c), below) - y) > 0.5


def test_the_printed_2670_takes_an_arc_tangent_for_the_arc_sine():
    R = euler_to_matrix(0.2, 1.0, 0.3)
    assert abs(np.arctan(-R[2, 0]) - 1.0) > 0.2
    assert matrix_to_euler(R)[1] == pytest.approx(1.0)


def test_the_printed_scalar_part_of_c6_forgets_the_second_vector():
    # 001 C.6 prints w w' - q', a number less a vector; C.2 calls the sum of squares the norm.
    q, p = np.array([0.1, -0.4, 0.3, 0.8]), np.array([0.5, 0.2, -0.6, 0.4])
    assert product(q, p)[3] == pytest.approx(q[3] * p[3] - q[:3] @ p[:3])
    assert np.linalg.norm(2.0 * normalised(q)) == pytest.approx(2.0)
    assert np.sum((2.0 * normalised(q)) ** 2) == pytest.approx(4.0)


def test_004_prints_the_matrix_of_the_conjugate():
    q = normalised(np.array([0.1, -0.4, 0.3, 0.8]))
    q1, q2, q3, q0 = q
    printed_12 = 2.0 * (q1 * q2 + q0 * q3)
    assert printed_12 == pytest.approx(quaternion_to_matrix(conjugate(q))[0, 1])
    assert abs(printed_12 - quaternion_to_matrix(q)[0, 1]) > 0.5


# --- shapes ----------------------------------------------------------------------------------------------------


def test_leading_axes_pass_through():
    q = np.random.default_rng(1).normal(size=(2, 5, 4))
    R = quaternion_to_matrix(q)
    assert R.shape == (2, 5, 3, 3)
    assert matrix_to_euler(R).shape == (2, 5, 3)
    assert np.allclose(matrix_to_quaternion(R)[1, 3], matrix_to_quaternion(R[1, 3]))
    assert matrix_to_rotvec(np.empty((0, 3, 3))).shape == (0, 3)
    assert np.allclose(skew(np.eye(3))[2] @ np.array([1.0, 2.0, 3.0]), np.cross([0, 0, 1], [1, 2, 3]))
    assert euler_to_matrix(np.zeros(4), 0.0, np.zeros((2, 1))).shape == (2, 4, 3, 3)


def test_the_smallest_quaternion_has_a_direction():
    assert np.allclose(normalised(np.array([0.0, 5e-324, 0.0, 0.0])), [0.0, 1.0, 0.0, 0.0])


def test_what_is_no_rotation_is_refused():
    with pytest.raises(RangeError):
        quaternion_to_matrix(np.zeros(4))
    with pytest.raises(ShapeError):
        quaternion_to_matrix(np.zeros(3))
    with pytest.raises(ShapeError):
        matrix_to_quaternion(np.zeros((3, 4)))
    with pytest.raises(ShapeError):
        product(np.ones((4, 4)), np.ones((4, 3)))
