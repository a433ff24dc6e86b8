"""The filter's equations against differences and against matrices, and what a single step's corrections change."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from nav_core.mounting import thesis_kernel, thesis_reference, thesis_rotations
from nav_core.mounting.thesis_model import CORRECTED, GRAVITY, PRINTED, Tuning

TUNING = Tuning()

compiled = settings(deadline=None, max_examples=60)
"""The first example of a kernel pays for its compilation."""

small = st.tuples(*[st.floats(-0.5, 0.5)] * 3).map(np.array)
quaternions = st.tuples(*[st.floats(-1.0, 1.0)] * 4).map(np.array).filter(lambda q: np.linalg.norm(q) > 0.1)


def model(x, q_V, q_A, sense=1.0, *, steering=False):
    h, H = np.empty(7), np.zeros((7, 9))
    thesis_kernel.measurement_model(
        x, q_V / np.linalg.norm(q_V), q_A / np.linalg.norm(q_A), sense, steering, h, H, np.empty((12, 3))
    )
    return h, H


# --- rotations -------------------------------------------------------------------------------------------------


@compiled
@given(quaternions)
def test_matrix_of_a_quaternion(q):
    R = np.empty((3, 3))
    thesis_rotations.rotation_of(q / np.linalg.norm(q), R)
    assert np.allclose(R, Rotation.from_quat(q).as_matrix(), atol=1e-14)


@compiled
@given(small, small)
def test_small_rotation_and_its_derivative(a, v):
    turned, J = np.empty(3), np.empty((3, 3))
    thesis_rotations.small_rotation(a, v, turned, J)
    assert np.allclose(turned, thesis_reference.small_matrix(a) @ v, atol=1e-14)
    assert np.allclose(J, thesis_reference.small_derivative(a, v), atol=1e-14)
    step = 1e-6
    differences = [
        (thesis_reference.small_matrix(a + d) - thesis_reference.small_matrix(a - d)) @ v / (2.0 * step)
        for d in step * np.eye(3)
    ]
    assert np.allclose(J, np.transpose(differences), atol=1e-8)


@compiled
@given(small)
def test_a_is_the_rotation_vector_to_second_order(a):
    # So the block of P is the covariance of a small angle: 2 tan(angle/2), not the Gibbs vector tan(angle/2).
    rotvec = Rotation.from_matrix(thesis_reference.small_matrix(a)).as_rotvec()
    assert np.linalg.norm(rotvec - a) <= np.linalg.norm(a) ** 3 / 12.0 + 1e-12


@compiled
@given(small, quaternions)
def test_moving_the_reference_multiplies_on_the_left(a, q):
    unit = q / np.linalg.norm(q)
    moved = unit.copy()
    thesis_rotations.turn_reference(a, moved)
    expected = thesis_reference.small_matrix(a) @ Rotation.from_quat(unit).as_matrix()
    assert np.allclose(Rotation.from_quat(moved).as_matrix(), expected, atol=1e-14)
    assert np.linalg.norm(moved) == pytest.approx(1.0, abs=1e-14)


@compiled
@given(small)
def test_transport_is_the_derivative_of_what_is_left_of_a_small_rotation(a):
    def left_over(b):
        q = Rotation.from_matrix(thesis_reference.small_matrix(b) @ thesis_reference.small_matrix(a).T).as_quat()
        return 2.0 * q[:3] / q[3]

    step = 1e-6
    M = np.transpose([(left_over(a + d) - left_over(a - d)) / (2.0 * step) for d in step * np.eye(3)])
    assert np.allclose(thesis_reference.reset_matrix(a), M, atol=1e-8)
    P = np.diag(np.arange(1.0, 10.0)) + 0.1
    full = np.eye(9)
    full[3:6, 3:6] = M
    expected = full @ P @ full.T
    thesis_rotations.transport(a, 3, P)
    assert np.allclose(P, expected, atol=1e-7)


# --- measurement model -----------------------------------------------------------------------------------------


@compiled
@given(
    st.floats(-20.0, 20.0), st.floats(-3.0, 3.0), st.floats(-0.6, 0.6), small, quaternions, quaternions, st.booleans()
)
def test_measurement_jacobian_against_differences(v, a, w, a_V, q_V, q_A, steering):
    x = np.array([v, a, 0.1 * w if steering else w, *a_V, 0.0, 0.0, 0.0])
    h, H = model(x, q_V, q_A, steering=steering)
    q_V, q_A = q_V / np.linalg.norm(q_V), q_A / np.linalg.norm(q_A)
    plain = thesis_reference.measured(
        x, Rotation.from_quat(q_V).as_matrix(), Rotation.from_quat(q_A).as_matrix(), CORRECTED, steering=steering
    )
    assert np.allclose(h, plain[0], atol=1e-12)
    assert np.allclose(H, plain[1], atol=1e-11)

    def moved(d):
        q = q_A.copy()
        thesis_rotations.turn_reference(d[6:], q)
        return model(x + np.append(d[:6], np.zeros(3)), q_V, q, steering=steering)[0]

    step = 1e-6
    differences = np.transpose([(moved(d) - moved(-d)) / (2.0 * step) for d in step * np.eye(9)])
    assert np.allclose(H, differences, atol=1e-6)


def test_what_a_level_car_measures():
    identity = np.array([0.0, 0.0, 0.0, 1.0])
    right_turn = np.array([10.0, 1.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    h, _ = model(right_turn, identity, identity)
    assert np.allclose(h, [1.0, 3.0, -GRAVITY, 10.0, 0.0, 0.0, 0.3])


def test_printed_turn_is_the_same_turn_counted_counter_clockwise():
    identity = np.array([0.0, 0.0, 0.0, 1.0])
    clockwise = np.array([10.0, 1.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    counter = clockwise * [1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    assert np.allclose(
        model(clockwise, identity, identity, 1.0)[0][:6], model(counter, identity, identity, -1.0)[0][:6]
    )
    # The print fed with a clockwise course would feel the turn on the wrong side.
    assert model(clockwise, identity, identity, -1.0)[0][1] == pytest.approx(-3.0)


# --- prediction ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("errata", [CORRECTED, PRINTED])
def test_prediction_against_matrices(errata):
    x = np.array([9.0, 1.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    root = np.random.default_rng(1).standard_normal((9, 9))
    P = root @ root.T
    expected = thesis_reference.predicted(x, P, 0.25, TUNING, errata)
    thesis_kernel.predict(x, P, 0.25, TUNING, errata)
    assert np.allclose(x, expected[0], atol=1e-14)
    assert np.allclose(P, expected[1], atol=1e-12)
    assert np.array_equal(P, P.T)


def test_only_the_corrected_equations_turn_the_attitude_error_with_the_vehicle():
    # A left error is about the T axes: F_2 and the reset turn it by omega T, each by half.
    exact = Rotation.from_rotvec([0.0, 0.0, 0.3 * 0.25]).as_matrix()
    tilt = np.diag([4.0, 1.0, 1.0])

    def carried(errata):
        x, P = np.zeros(9), np.zeros((9, 9))
        x[2] = 0.3 if errata.course else -0.3
        P[3:6, 3:6] = tilt
        thesis_kernel.predict(x, P, 0.25, TUNING._replace(attitude=0.0), errata)
        thesis_rotations.transport(x[3:6], 3, P)
        return P[3:6, 3:6]

    assert np.allclose(carried(CORRECTED), exact @ tilt @ exact.T, atol=0.01)
    assert np.allclose(carried(PRINTED), tilt, atol=0.02)
    assert np.abs(exact @ tilt @ exact.T - tilt).max() > 0.2


def test_the_printed_jacobian_forgets_that_the_turn_rate_turns_the_vehicle():
    def spread(errata):
        x, P = np.zeros(9), np.zeros((9, 9))
        P[2, 2] = 1.0
        thesis_kernel.predict(x, P, 0.25, Tuning(0.0, 0.0, 0.0, 0.0), errata)
        return P[5, 5], P[5, 2]

    assert spread(CORRECTED) == pytest.approx((0.25**2, 0.25))
    assert spread(PRINTED) == (0.0, 0.0)


def test_only_the_corrected_noise_has_a_floor_when_driving_straight():
    def added(errata):
        x, P = np.zeros(9), np.zeros((9, 9))
        thesis_kernel.predict(x, P, 0.25, TUNING, errata)
        return np.diag(P)

    assert np.all(added(PRINTED)[2:] == 0.0)
    assert np.all(added(CORRECTED)[2:] > 0.0)
    assert np.allclose(added(CORRECTED)[6:], 0.1 * 0.01**2)


def test_table_51_in_si_units():
    assert np.sqrt(TUNING.accelerometer) == pytest.approx(0.38, abs=0.001)
    assert np.degrees(np.sqrt(TUNING.turn_rate)) == pytest.approx(np.sqrt(2.0))
