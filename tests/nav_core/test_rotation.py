"""Rotations: the thesis' angles, small rotations, order of quaternions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from nav_core.errors import ShapeError
from nav_core.rotation import (
    angle_between,
    error_between,
    matrix_to_thesis,
    skew,
    thesis_to_matrix,
    wrap,
    xyzw_to_wxyz,
)

angles = st.floats(-np.pi, np.pi)
right_angles = st.floats(-np.pi / 2.0, np.pi / 2.0)
lengths = st.floats(-10.0, 10.0)
vectors = st.tuples(lengths, lengths, lengths).map(np.array)
small_turns = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array)


def axis_turn(axis: str, angle: float) -> np.ndarray:
    """001 eqs. 3.6-3.8, written out."""
    c, s = np.cos(angle), np.sin(angle)
    return {
        "y": np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]),
        "z": np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]),
        "x": np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]),
    }[axis]


@st.composite
def rotations(draw: st.DrawFn) -> np.ndarray:
    return thesis_to_matrix(draw(angles), draw(angles), draw(angles))


def printed_39(theta: float, phi: float, psi: float) -> np.ndarray:
    """The matrix of 001 eqs. 3.9 and C.10 as printed."""
    ct, stheta, cf, sf, cp, sp = (f(a) for a in (theta, phi, psi) for f in (np.cos, np.sin))
    return np.array(
        [
            [cf * ct, sf * sp - cf * cp * stheta, cp * sf + cf * sp * stheta],
            [stheta, cp * ct, -ct * sp],
            [-ct * sf, cf * sp + cp * sf * stheta, cf * cp - sf * sp * stheta],
        ]
    )


def test_the_thesis_triple_is_the_product_of_its_three_rotations():
    expected = [
        [0.769751, 0.137050, -0.623459],
        [-0.573576, -0.280166, -0.769751],
        [-0.280166, 0.950118, -0.137050],
    ]
    assert np.allclose(thesis_to_matrix(*np.radians([20.0, -35.0, 110.0])), expected, atol=5e-7)


@given(angles, angles, angles)
def test_thesis_to_matrix_is_the_product_of_36_37_38(theta, phi, psi):
    product = axis_turn("y", theta) @ axis_turn("z", phi) @ axis_turn("x", psi)
    assert np.allclose(thesis_to_matrix(theta, phi, psi), product, atol=1e-14)


@given(angles, angles, angles)
def test_the_printed_39_exchanges_theta_and_phi(theta, phi, psi):
    assert np.allclose(printed_39(theta, phi, psi), thesis_to_matrix(phi, theta, psi), atol=1e-14)


def test_the_printed_39_is_another_rotation_for_the_triple():
    triple = np.radians([20.0, -35.0, 110.0])
    assert angle_between(printed_39(*triple), thesis_to_matrix(*triple)) > np.radians(40.0)


@given(rotations(), rotations(), rotations())
def test_group_axioms(a, b, c):
    assert np.allclose((a @ b) @ c, a @ (b @ c), atol=1e-14)
    assert np.allclose(a @ np.eye(3), a)
    assert np.allclose(a @ a.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(a @ b) == pytest.approx(1.0, abs=1e-13)


@given(angles, st.floats(-np.pi / 2.0 + 1e-6, np.pi / 2.0 - 1e-6), angles)
def test_the_angles_come_back_away_from_the_singularity(theta, phi, psi):
    back = matrix_to_thesis(thesis_to_matrix(theta, phi, psi))
    assert np.allclose(wrap(back - [theta, phi, psi]), 0.0, atol=1e-8)


@given(rotations())
def test_the_matrix_comes_back_over_the_whole_sphere(R_va):
    theta, phi, psi = matrix_to_thesis(R_va)
    assert -np.pi <= theta <= np.pi
    assert -np.pi / 2.0 <= phi <= np.pi / 2.0
    assert -np.pi <= psi <= np.pi
    assert np.allclose(thesis_to_matrix(theta, phi, psi), R_va, atol=1e-8)


@given(angles, angles, st.sampled_from([1.0, -1.0]), st.floats(0.0, 1e-8))
def test_the_matrix_comes_back_at_the_singularity(theta, psi, side, off):
    R_va = thesis_to_matrix(theta, side * (np.pi / 2.0 - off), psi)
    assert np.allclose(thesis_to_matrix(*matrix_to_thesis(R_va)), R_va, atol=1e-7)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_psi_is_zero_at_the_singularity(side):
    theta, phi, psi = matrix_to_thesis(thesis_to_matrix(0.7, side * np.pi / 2.0, 0.4))
    assert psi == 0.0
    assert phi == pytest.approx(side * np.pi / 2.0)
    assert theta == pytest.approx(0.7 - side * -0.4)


@pytest.mark.parametrize("triple", [(-180.0, 90.0, 0.0), (-90.0, 0.0, 40.0)])
def test_the_poses_of_the_thesis_experiments(triple):
    R_va = thesis_to_matrix(*np.radians(triple))
    assert angle_between(thesis_to_matrix(*matrix_to_thesis(R_va)), R_va) < 1e-9


def test_published_estimates_are_as_far_from_their_truth_as_reported():
    truth = thesis_to_matrix(*np.radians([-180.0, 90.0, 0.0]))
    for estimate, total in (
        ((175.65, -46.77, -2.51), 136.9),
        ((172.38, -29.712, -9.779), 120.5),
        ((-176.8, 90.02, 0.02), 3.2),
    ):
        assert np.degrees(angle_between(thesis_to_matrix(*np.radians(estimate)), truth)) == pytest.approx(
            total, abs=0.06
        )
    truth = thesis_to_matrix(*np.radians([-90.0, 0.0, 40.0]))
    for estimate, total in (((-93.2120, -5.6945, 23.3673), 17.7), ((-93.0093, -3.1417, 39.9257), 4.3)):
        assert np.degrees(angle_between(thesis_to_matrix(*np.radians(estimate)), truth)) == pytest.approx(
            total, abs=0.06
        )


def test_a_matrix_of_another_shape_is_refused():
    with pytest.raises(ShapeError):
        matrix_to_thesis(np.eye(4))


@given(rotations(), small_turns)
def test_the_error_is_about_the_vehicle_axes(truth, turn):
    estimate = Rotation.from_rotvec(turn).as_matrix() @ truth
    assert np.allclose(error_between(estimate, truth), turn, atol=1e-7)
    assert angle_between(estimate, truth) == pytest.approx(np.linalg.norm(turn), abs=1e-7)


@given(rotations(), rotations())
def test_the_angle_between_is_a_symmetric_distance(a, b):
    assert angle_between(a, b) == pytest.approx(angle_between(b, a), abs=1e-7)
    assert 0.0 <= angle_between(a, b) <= np.pi + 1e-12
    assert angle_between(a, a) < 1e-7


@given(vectors, vectors)
def test_skew_is_the_cross_product(v, u):
    assert np.allclose(skew(v) @ u, np.cross(v, u), atol=1e-12)
    assert np.array_equal(skew(v).T, -skew(v))


@given(st.floats(-1e4, 1e4))
def test_wrap_keeps_the_direction_and_the_interval(angle):
    wrapped = float(wrap(np.array(angle)))
    assert -np.pi < wrapped <= np.pi
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * angle), abs=1e-10)


def test_wrap_closes_the_interval_above():
    assert float(wrap(np.array(np.pi))) == np.pi
    assert float(wrap(np.array(-np.pi))) == np.pi
    assert np.allclose(wrap(np.radians([359.0, 181.0, -190.0])), np.radians([-1.0, -179.0, 170.0]))


@given(rotations())
def test_wxyz_is_the_scalar_first_order(R_va):
    rotation = Rotation.from_matrix(R_va)
    assert np.array_equal(xyzw_to_wxyz(rotation.as_quat()), rotation.as_quat(scalar_first=True))


def test_wxyz_of_many():
    assert np.array_equal(xyzw_to_wxyz(np.array([[1.0, 2.0, 3.0, 4.0]] * 2)), [[4.0, 1.0, 2.0, 3.0]] * 2)
