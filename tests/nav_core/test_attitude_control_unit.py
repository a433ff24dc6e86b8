"""The quaternion filter of 000 section 7.2, the vertical reference and the control unit around them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nav_core import kalman
from nav_core.attitude import control_unit, quaternion_ekf
from nav_core.attitude.control_unit import TABLE_7_3, Control, Surroundings, measurement_variance, run_controlled
from nav_core.attitude.quaternion_ekf import QuaternionState
from nav_core.attitude.vertical import force_at_rest, speed_and_rate, vehicle_acceleration
from nav_core.errors import NotFiniteError, RangeError, ShapeError
from nav_core.kalman import jacobian
from nav_core.rotation import (
    euler_to_matrix,
    euler_to_quaternion,
    normalised,
    product,
    quaternion_to_euler,
    rotvec_to_quaternion,
    wrap,
)
from nav_core.simulate.platform_studies import drift_at_rest

G = 9.81
FIELD = np.array([22.0, 1.5, 42.0])
PLACE = Surroundings(gravity=G, field=FIELD, sigma_f=0.02, sigma_m=0.2)
examples = settings(deadline=None, max_examples=30)
QUATERNIONS = st.integers(0, 2**32 - 1).map(lambda s: normalised(np.random.default_rng(s).standard_normal(4)))


# The filter -----------------------------------------------------------------------------------------------------


def derivative(q, rate):
    """000 eqs. 7.2.1, 7.2.2: the quaternion's rate with the pull to unit length."""
    turning = 0.5 * product(q, np.append(rate, 0.0))
    return turning + (1.0 / np.linalg.norm(q) - 1.0) * q


@examples
@given(q=QUATERNIONS)
def test_the_perturbation_model_is_the_derivative_and_the_print_is_not(q):
    rate = np.array([0.3, -0.2, 0.5])
    F, D = quaternion_ekf.dynamics(q, rate)
    assert F[:4, :4] == pytest.approx(jacobian(lambda v: derivative(v, rate), q), abs=1e-7)
    assert F[:4, 4:] == pytest.approx(jacobian(lambda b: derivative(q, rate - b), np.zeros(3)), abs=1e-7)
    assert D[:4, :3] == pytest.approx(F[:4, 4:])
    assert D[4:, 3:] == pytest.approx(np.eye(3))
    printed = F[:4, :4] - np.outer(q, q)  # 7.2.8
    assert np.abs(printed @ q - F[:4, :4] @ q).max() > 0.4
    # 7.2.36 as printed adds F q and D w, which count the rate twice.
    turn = derivative(q, rate)
    assert F[:4, :4] @ q + np.outer(q, q) @ q - D[:4, :3] @ rate == pytest.approx(2.0 * turn, abs=1e-12)


def test_the_kernel_agrees_with_the_matrices():
    rng = np.random.default_rng(4)
    w = 0.4 * rng.standard_normal((60, 3))
    start = QuaternionState(
        normalised([0.1, 0.2, 0.3, 0.9]), np.array([0.01, 0.02, -0.03]), np.diag([1e-2] * 4 + [1e-4] * 3)
    )
    found, history = quaternion_ekf.propagate(start, w, 0.01, 1e-6, 1e-9)
    q, P = start.q_nb, start.P
    for k, rate in enumerate(w - start.bias):
        step = quaternion_ekf.discretise(q, rate, 0.01, 1e-6, 1e-9)
        P = kalman.predict(np.zeros(7), P, step.Phi, step.Q).P
        q = product(q, rotvec_to_quaternion(0.01 * rate))
        assert history[k] == pytest.approx(q, abs=1e-14)
    assert pytest.approx(P, rel=1e-12, abs=1e-18) == found.P


def test_the_filter_finds_the_bias_from_either_sign_of_the_quaternion():
    rng = np.random.default_rng(6)
    bias, q = np.array([0.02, -0.01, 0.03]), np.array([0.0, 0.0, 0.0, 1.0])
    state = QuaternionState(q, np.zeros(3), np.diag([1e-4] * 4 + [1e-2] * 3))
    for second in range(60):
        w = bias + 0.002 * rng.standard_normal((50, 3))
        state, _ = quaternion_ekf.propagate(state, w, 0.02, 1e-7, 1e-12)
        measured = product(q, rotvec_to_quaternion(0.005 * rng.standard_normal(3)))
        state = quaternion_ekf.correct(state, measured * (-1) ** second, 0.0025**2).state
    assert state.bias == pytest.approx(bias, abs=5e-4)
    assert np.abs(state.bias - bias).max() < 4.0 * np.sqrt(state.P[4, 4])
    held = quaternion_ekf.correct(state, rotvec_to_quaternion(np.array([0.1, 0.0, 0.0])), 1e-6, hold_bias=True).state
    assert held.bias == pytest.approx(state.bias, abs=0.0)
    assert held.P[4:, 4:] == pytest.approx(state.P[4:, 4:], abs=0.0)
    assert quaternion_to_euler(held.q_nb)[0] > quaternion_to_euler(state.q_nb)[0]


def test_the_filters_input_is_checked():
    state = QuaternionState(np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), np.eye(7))
    with pytest.raises(ShapeError, match="w has shape"):
        quaternion_ekf.propagate(state, np.zeros(3), 0.01, 1e-6, 1e-9)
    with pytest.raises(RangeError, match="period"):
        quaternion_ekf.propagate(state, np.zeros((2, 3)), 0.0, 1e-6, 1e-9)
    with pytest.raises(ShapeError, match="P has shape"):
        quaternion_ekf.propagate(replace(state, P=np.eye(6)), np.zeros((2, 3)), 0.1, 1e-6, 1e-9)


# The vertical ---------------------------------------------------------------------------------------------------


def test_a_right_turn_accelerates_to_the_right_and_climbing_over_a_crest_downwards():
    assert vehicle_acceleration(10.0, 2.0, [0.0, 0.0, 0.3]) == pytest.approx([2.0, 3.0, 0.0])
    # The nose sinks (q < 0) on a crest: the acceleration points down, z positive.
    assert vehicle_acceleration(10.0, 0.0, [0.0, -0.1, 0.0]) == pytest.approx([0.0, 0.0, 1.0])
    f = np.array([[2.0, 3.0, -G]])
    w = np.array([[0.0, 0.0, 0.3]])
    assert force_at_rest(f, w, np.array([10.0]), np.array([2.0])) == pytest.approx(np.array([[0.0, 0.0, -G]]))
    assert force_at_rest(f, w, np.array([10.0]), np.array([np.nan])) == pytest.approx(f)


def test_speed_is_carried_on_and_given_up():
    t = np.array([0.5, 1.0, 1.5, 3.4, 4.0, 6.5])
    u, u_rate = speed_and_rate(t, np.array([0.0, 1.0, 6.0]), np.array([4.0, 6.0, 6.0]))
    assert u_rate == pytest.approx([np.nan, 2.0, 2.0, 2.0, np.nan, np.nan], nan_ok=True)
    assert u == pytest.approx([np.nan, 6.0, 7.0, 10.8, np.nan, np.nan], nan_ok=True)
    with pytest.raises(ShapeError):
        speed_and_rate(t, np.zeros(3), np.zeros(2))


# The control unit -----------------------------------------------------------------------------------------------


def test_the_variance_grows_with_the_manoeuvre_alike_to_both_sides():
    gps, blind = TABLE_7_3["gps"], TABLE_7_3["no_gps"]
    assert measurement_variance(gps, 0.0, 0.0) == pytest.approx(1e-2)
    assert measurement_variance(gps, 1.0, 0.0) == pytest.approx(1e-1)
    assert measurement_variance(blind, -3.0, 0.0) == pytest.approx(10.0)
    assert measurement_variance(blind, 0.0, -0.5) == pytest.approx(1e-2 * np.sqrt(6.0))
    assert measurement_variance(blind, 0.0, -0.5) == measurement_variance(blind, 0.0, 0.5)
    assert measurement_variance(TABLE_7_3["alignment"], 5.0, 5.0) == pytest.approx(1e-9)


BIAS = np.array([0.01, -0.008, 0.012])


def drive(seed=0, *, rate=50.0):
    """Rest 20 s, straight acceleration 10 s, cruise 10 s, a circle 40 s, level; in a vehicle that stays level."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(80.0 * rate)) / rate
    u_rate = np.where((t >= 20.0) & (t < 30.0), 1.5, 0.0)
    u = np.cumsum(u_rate) / rate
    r = np.where(t >= 40.0, 0.25, 0.0)
    yaw = 0.7 + np.cumsum(r) / rate
    f = np.stack([u_rate, u * r, np.full(t.size, -G)], axis=1) + 0.02 * rng.standard_normal((t.size, 3))
    w = np.stack([0 * r, 0 * r, r], axis=1) + BIAS + 0.002 * rng.standard_normal((t.size, 3))
    m = np.einsum("nji,j->ni", euler_to_matrix(0.0, 0.0, yaw), FIELD) + 0.2 * rng.standard_normal((t.size, 3))
    return t, f, w, m, u, u_rate, np.stack([0 * r, 0 * r, yaw], axis=1)


def errors(found, truth):
    known = np.isfinite(found.q_tv[:, 0])
    return np.where(
        known[:, None], wrap(quaternion_to_euler(np.where(known[:, None], found.q_tv, [0, 0, 0, 1.0])) - truth), np.nan
    )


def test_gps_keeps_the_vertical_in_a_turn():
    t, f, w, m, u, u_rate, truth = drive()
    with_gps = run_controlled(f, w, m, 0.02, PLACE, speed=u, speed_rate=u_rate)
    without = run_controlled(f, w, m, 0.02, PLACE)
    turn = t > 60.0
    good, bad = (np.sqrt(np.mean(errors(run, truth)[turn] ** 2, axis=0)) for run in (with_gps, without))
    print(np.degrees(good), np.degrees(bad))
    assert np.all(good < np.radians(1.5))
    assert bad[0] > 3.0 * good[0]  # 3.75 m/s² to the right look like 21° of roll
    assert {tick.mode for tick in with_gps.ticks} == {"alignment", "gps"}
    assert {tick.mode for tick in without.ticks} == {"alignment", "no_gps"}


def test_the_alignment_finds_attitude_and_bias():
    t, f, w, m, _, _, truth = drive()
    found = run_controlled(f, w, m, 0.02, PLACE, control=Control(alignment=20.0))
    assert found.ticks[0].action == "start"
    assert found.bias[t < 20.0][-1] == pytest.approx(BIAS, abs=2e-3)
    assert np.abs(errors(found, truth)[(t > 10.0) & (t < 20.0)]).max() < np.radians(1.0)
    assert np.all(np.isnan(found.q_tv[:49]))


def test_it_resets_in_uniform_motion_and_holds_the_bias_after():
    t, f, w, m, u, u_rate, _ = drive()
    found = run_controlled(f, w, m, 0.02, PLACE, speed=u, speed_rate=u_rate, control=Control(alignment=18.0))
    resets = [t[tick.index] for tick in found.ticks if tick.action == "reset"]
    assert resets
    assert all(18.0 < moment < 20.1 or 29.9 < moment < 40.1 for moment in resets)
    after = (t > max(resets)) & (t < max(resets) + 4.5)
    assert np.ptp(found.bias[after], axis=0) == pytest.approx(0.0, abs=1e-12)
    assert np.ptp(found.bias[t > max(resets) + 6.5], axis=0).max() > 0.0
    updates = [tick.variance for tick in found.ticks if tick.action == "update" and t[tick.index] > 41.0]
    assert min(updates) > 1e-2 * 1.5**0.2


def test_a_measurement_far_off_is_rejected():
    t, f, w, m, u, u_rate, truth = drive()
    m = m.copy()
    m[(t > 50.0) & (t < 60.0)] += [0.0, 60.0, 0.0]  # a steel bridge
    found = run_controlled(f, w, m, 0.02, PLACE, speed=u, speed_rate=u_rate)
    rejected = [t[tick.index] for tick in found.ticks if tick.action == "rejected"]
    assert len(rejected) >= 5
    assert all(50.0 < moment < 60.1 for moment in rejected)
    assert np.abs(errors(found, truth)[t > 62.0][:, 2]).max() < np.radians(3.0)
    assert all(tick.residual > Control().most_residual for tick in found.ticks if tick.action == "rejected")


def test_the_control_units_input_is_checked():
    _, f, w, m, *_ = drive()
    with pytest.raises(ShapeError, match="m has shape"):
        run_controlled(f, w, m[1:], 0.02, PLACE)
    with pytest.raises(NotFiniteError, match="w is not finite at index 7"):
        run_controlled(f, np.where(np.arange(len(w))[:, None] == 7, np.nan, w), m, 0.02, PLACE)
    with pytest.raises(RangeError, match="control unit"):
        run_controlled(f, w, m, 0.02, PLACE, control=Control(period=0.001))
    with pytest.raises(RangeError, match="duration"):
        run_controlled(f[:10], w[:10], m[:10], 0.02, PLACE)


def test_a_record_that_ends_between_two_ticks_is_carried_to_its_end():
    _, f, w, m, *_ = drive()
    found = run_controlled(f[:525], w[:525], m[:525], 0.02, PLACE)
    assert np.isfinite(found.q_tv[-1]).all()
    assert len(found.ticks) == 10
    assert control_unit.Controlled is type(found)


def test_the_drift_at_rest_is_that_of_chapter_9():
    drifts = [drift_at_rest(np.random.default_rng(seed)) for seed in range(5)]
    unfiltered = np.array([np.abs(drift.unfiltered[-1]) for drift in drifts])
    filtered = np.array([np.abs(drift.filtered[-1]) for drift in drifts])
    print(unfiltered.mean(axis=0), filtered.mean(axis=0), filtered.max())
    assert unfiltered.min() > 1000.0
    assert np.median(filtered) < 10.0  # "some metres"
    assert filtered.max() < 25.0  # "almost 20" on the worst axis of its one run


def test_roll_and_pitch_come_back_in_any_attitude():
    rng = np.random.default_rng(9)
    for angles in rng.uniform([-3.0, -1.4, -3.0], [3.0, 1.4, 3.0], (5, 3)):
        R = euler_to_matrix(*angles)
        f, m = (np.tile(R.T @ v, (300, 1)) for v in (np.array([0.0, 0.0, -G]), FIELD))
        found = run_controlled(f, np.zeros((300, 3)), m, 0.02, PLACE)
        assert np.abs(found.q_tv[-1] @ euler_to_quaternion(*angles)) == pytest.approx(1.0, abs=1e-6)
