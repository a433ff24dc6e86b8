"""Attitude from angular rate: kernels against matrices and scipy, orders of accuracy, 004's equations."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from nav_core.attitude import kernels
from nav_core.attitude.propagation import (
    body_rate_against,
    propagate_closed,
    propagate_cosines,
    propagate_euler,
    propagate_rk4,
    propagate_two_speed,
)
from nav_core.errors import RangeError, ShapeError
from nav_core.rotation import (
    angle_between,
    conjugate,
    matrix_to_quaternion,
    quaternion_to_matrix,
    rotvec_to_quaternion,
    skew,
)

START = np.array([0.3, -0.2, 0.5, 0.79])
START /= np.linalg.norm(START)

compiled = settings(deadline=None, max_examples=60)

vectors = st.tuples(*[st.floats(-4.0, 4.0)] * 3).map(np.array)
unit = st.tuples(*[st.floats(-1.0, 1.0)] * 4).map(np.array).filter(lambda q: np.linalg.norm(q) > 0.1)


def coning(t):
    """Rate of an attitude that is known exactly, and that attitude: Rz(2 t) Ry(0.4 sin 3t) Rx(0.7 t)."""
    yaw_rate, pitch, pitch_rate = np.full_like(t, 2.0), 0.4 * np.sin(3.0 * t), 1.2 * np.cos(3.0 * t)
    roll, roll_rate = 0.7 * t, np.full_like(t, 0.7)
    w = np.stack(
        (
            roll_rate - yaw_rate * np.sin(pitch),
            pitch_rate * np.cos(roll) + yaw_rate * np.sin(roll) * np.cos(pitch),
            yaw_rate * np.cos(roll) * np.cos(pitch) - pitch_rate * np.sin(roll),
        ),
        axis=-1,
    )
    return w, Rotation.from_euler("ZYX", np.stack((2.0 * t, pitch, roll), axis=-1)).as_matrix()


def moments(steps, duration=2.0):
    return np.linspace(0.0, duration, 2 * steps + 1), duration / steps


# --- kernels against plain numpy -------------------------------------------------------------------------------


def generator(w):
    """000 eq. 2.6.45 bis in the order (x, y, z, w)."""
    x, y, z = w
    return 0.5 * np.array([[0, z, -y, x], [-z, 0, x, y], [y, -x, 0, z], [-x, -y, -z, 0]])


def rk4_reference(state, slopes, period):
    """The classical rule of 004 with a slope at the start, twice in the middle and at the end."""
    m1 = slopes[0](state)
    m2 = slopes[1](state + 0.5 * period * m1)
    m3 = slopes[1](state + 0.5 * period * m2)
    m4 = slopes[2](state + period * m3)
    return state + period / 6.0 * (m1 + 2.0 * m2 + 2.0 * m3 + m4)


def test_the_closed_form_agrees_with_scipy():
    turns = np.random.default_rng(2).normal(size=(200, 3)) * np.geomspace(1e-6, 2.0, 200)[:, None]
    attitude, expected = propagate_closed(START, turns), Rotation.from_quat(START)
    for k, turn in enumerate(turns):
        expected = expected * Rotation.from_rotvec(turn)
        assert angle_between(quaternion_to_matrix(attitude[k + 1]), expected.as_matrix()) < 1e-13
    assert np.allclose(np.linalg.norm(attitude, axis=1), 1.0, atol=1e-15)


def test_euler_agrees_with_the_matrix_form():
    w = np.random.default_rng(3).normal(size=(50, 3))
    for normalisation in ("exact", "series", "feedback"):
        q = START
        found = propagate_euler(START, w, 0.01, normalisation=normalisation)
        for k, rate in enumerate(w):
            change = generator(rate) @ q
            if normalisation == "feedback":
                change = change + (1.0 - q @ q) * q
            q = q + 0.01 * change
            if normalisation == "exact":
                q = q / np.linalg.norm(q)
            elif normalisation == "series":
                q = q * (1.0 + 0.5 * (1.0 - q @ q))
            assert np.allclose(found[k + 1], q, atol=1e-14)


def test_runge_kutta_agrees_with_the_matrix_form():
    w = np.random.default_rng(4).normal(size=(41, 3))
    found, q = propagate_rk4(START, w, 0.05), START
    for k in range(20):
        slopes = [lambda state, rate=rate: generator(rate) @ state for rate in w[2 * k : 2 * k + 3]]
        q = rk4_reference(q, slopes, 0.05)
        q = q / np.linalg.norm(q)
        assert np.allclose(found[k + 1], q, atol=1e-14)


def test_six_equations_agree_with_nine():
    # Nine equations keep the third row by integration, six by orthogonality; both are fourth-order accurate.
    t, T = moments(20, duration=0.2)
    w, W = coning(t)[0], 0.1 * coning(t + 1.0)[0]
    C = quaternion_to_matrix(START)
    found = propagate_cosines(C, w, W, T)
    for k in range(20):
        slopes = [
            lambda C, b=b, n=n: C @ skew(b) - skew(n) @ C
            for b, n in zip(w[2 * k : 2 * k + 3], W[2 * k : 2 * k + 3], strict=True)
        ]
        C = rk4_reference(C, slopes, T)
    assert np.abs(found[-1] - C).max() < 1e-9
    assert np.array_equal(found[0], quaternion_to_matrix(START))


def test_the_equations_of_the_cosines_are_004s():
    C, w, W = quaternion_to_matrix(START), np.array([0.3, -0.7, 1.1]), np.array([0.2, 0.5, -0.4])
    step = propagate_cosines(C, np.tile(w, (3, 1)), np.tile(W, (3, 1)), 1e-6, rule="euler")
    rate = (step[1] - C) / 1e-6
    assert rate[0, 0] == pytest.approx(C[1, 0] * W[2] - C[2, 0] * W[1] + C[0, 1] * w[2] - C[0, 2] * w[1], abs=1e-9)
    assert rate[0, 1] == pytest.approx(C[1, 1] * W[2] - C[2, 1] * W[1] - C[0, 0] * w[2] + C[0, 2] * w[0], abs=1e-9)
    assert np.array_equal(step[1, 2], np.cross(step[1, 0], step[1, 1]))


@compiled
@given(vectors, vectors, unit)
def test_turning_a_matrix_is_two_exponentials(frame, body, q):
    C = quaternion_to_matrix(q)
    expected = expm(-skew(frame)) @ C @ expm(skew(body))
    kernels.turn(C, tuple(frame), tuple(body))
    assert np.allclose(C, expected, atol=1e-13)


@compiled
@given(vectors, st.floats(1e-9, 1.0))
def test_small_and_large_turns_have_the_same_quaternion(v, scale):
    q = np.empty(4)
    kernels.quaternion_of(scale * v, q)
    expected = rotvec_to_quaternion(scale * v)
    assert min(np.abs(q - expected).max(), np.abs(q + expected).max()) < 2e-16 + 1e-15 * np.linalg.norm(v)


# --- accuracy --------------------------------------------------------------------------------------------------


def errors_of(rule, counts):
    found = []
    for steps in counts:
        t, period = moments(steps)
        w, truth = coning(t)
        found.append(max(angle_between(rule(w, period), truth[-1]), 1e-16))
    return np.array(found)


@pytest.mark.parametrize(
    ("rule", "order"),
    [
        (lambda w, T: quaternion_to_matrix(propagate_rk4([0, 0, 0, 1.0], w, T)[-1]), 4.0),
        (lambda w, T: quaternion_to_matrix(propagate_euler([0, 0, 0, 1.0], w[:-1:2], T)[-1]), 1.0),
        (lambda w, T: quaternion_to_matrix(propagate_closed([0, 0, 0, 1.0], T * w[1::2])[-1]), 2.0),
        (lambda w, T: propagate_cosines(np.eye(3), w, np.zeros_like(w), T)[-1], 4.0),
        (lambda w, T: propagate_cosines(np.eye(3), w, np.zeros_like(w), T, rule="euler")[-1], 1.0),
    ],
    ids=["rk4", "euler", "closed", "cosines-rk4", "cosines-euler"],
)
def test_errors_shrink_with_the_order_of_the_rule(rule, order):
    counts = (100, 200, 400)
    error = errors_of(rule, counts)
    assert np.log2(error[:-1] / error[1:]) == pytest.approx([order, order], abs=0.15)


@compiled
@given(vectors)
def test_the_closed_form_is_exact_for_a_constant_rate(w):
    turned = propagate_closed(START, np.tile(0.01 * w, (100, 1)))
    assert angle_between(quaternion_to_matrix(turned[-1]), quaternion_to_matrix(START) @ expm(skew(w))) < 1e-12


def test_feedback_pulls_a_wrong_length_back_to_one():
    w = np.tile([2.0, 0.0, 1.0], (4000, 1))
    length = np.linalg.norm(propagate_euler(START, w, 0.01, normalisation="feedback"), axis=1)
    # Euler stretches by (|w| T)² / 8 a step; the feedback, 2 T a step of the deviation, holds that at 1/16 |w|² T.
    assert length[-1] - 1.0 == pytest.approx(5.0 * 0.01 / 16.0, rel=0.05)
    assert np.linalg.norm(propagate_euler(START, w, 0.01, normalisation="series")[-1]) == pytest.approx(1.0, abs=1e-6)


# --- two speeds and 004's signs --------------------------------------------------------------------------------


@compiled
@given(vectors)
def test_two_speeds_are_exact_for_a_constant_frame_rate(w_in):
    turns = 0.02 * np.random.default_rng(6).normal(size=(60, 3))
    fast = propagate_closed(START, turns)[-1]
    for slow_steps in (1, 5, 60):
        rates = np.tile(w_in, (slow_steps, 1))
        split = propagate_two_speed(START, turns, rates, 0.6 / slow_steps)
        expected = expm(-0.6 * skew(w_in)) @ quaternion_to_matrix(fast)
        assert angle_between(quaternion_to_matrix(split[-1]), expected) < 1e-12


def test_two_speeds_agree_with_the_unsplit_rate():
    # 004: (p', q', r') = (p, q, r) - C w_in, whose C is held over a step in which b turns by 0.03 rad.
    w_in, T = np.array([5e-5, -2e-6, -6e-5]), 0.01
    t = np.arange(1000) * T
    w_ib, _ = coning(t)
    split = propagate_two_speed(START, T * w_ib, np.tile(w_in, (100, 1)), 10 * T)
    q = START
    for rate in w_ib:
        relative = body_rate_against(rate, quaternion_to_matrix(q), w_in)
        q = propagate_closed(q, T * relative[None])[-1]
    alone = propagate_closed(START, T * w_ib)[-1]
    assert angle_between(quaternion_to_matrix(split[-1]), quaternion_to_matrix(q)) < 1e-5
    assert angle_between(quaternion_to_matrix(split[-1]), quaternion_to_matrix(alone)) > 7e-4


def test_004_wants_the_negative_rate_of_the_body():
    # 004 prints Q' = A(w_bn) Q / 2 and C(Q), which is the conjugate's: they fit only for w_bn = -(p', q', r').
    rate, T = np.array([0.3, -0.5, 0.8]), 1e-3
    x, y, z = -rate
    A = np.array([[0, -x, -y, -z], [x, 0, -z, y], [y, z, 0, -x], [z, -y, x, 0]])
    Q = np.roll(conjugate(START), 1)
    fed = {"minus": Q + 0.5 * T * A @ Q, "plus": Q - 0.5 * T * A @ Q}
    truth = quaternion_to_matrix(propagate_closed(START, T * rate[None])[-1])
    found = {name: quaternion_to_matrix(conjugate(np.roll(value, -1))) for name, value in fed.items()}
    assert angle_between(found["minus"], truth) < 1e-6
    assert angle_between(found["plus"], truth) == pytest.approx(2.0 * T * np.linalg.norm(rate), rel=1e-3)


def test_cosines_and_quaternions_have_one_equation():
    # C' = C [w]x (000 2.6.10) is the derivative of what q' = q w / 2 (2.6.44) turns.
    T, w = 1e-6, np.array([0.4, 0.1, -0.9])
    after = quaternion_to_matrix(propagate_closed(START, T * w[None])[-1])
    C = quaternion_to_matrix(START)
    assert np.allclose((after - C) / T, C @ skew(w), atol=1e-5)


def test_what_cannot_be_propagated_is_refused():
    q, w = START, np.zeros((4, 3))
    with pytest.raises(ShapeError):
        propagate_rk4(q, w, 0.1)
    with pytest.raises(ShapeError):
        propagate_closed(q, np.zeros((4, 2)))
    with pytest.raises(ShapeError):
        propagate_two_speed(q, w, np.zeros((3, 3)), 0.1)
    with pytest.raises(ShapeError):
        propagate_cosines(np.eye(3), np.zeros((3, 3)), np.zeros((5, 3)), 0.1)
    with pytest.raises(RangeError):
        propagate_euler(q, w, 0.0)
    with pytest.raises(RangeError):
        propagate_closed(np.zeros(4), w)
    assert np.allclose(matrix_to_quaternion(quaternion_to_matrix(propagate_closed(q, w)[-1])), q)
