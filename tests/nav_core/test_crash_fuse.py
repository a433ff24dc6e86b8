"""Fusion of accelerometer and fixes against the closed forms it must reduce to."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nav_core.crash.fuse import Change, fuse, quantiles
from nav_core.events.record import Estimate

NOTHING = np.zeros(2)


def test_without_clipping_it_is_the_kalman_update():
    S, R = np.array([[0.04, 0.01], [0.01, 0.09]]), np.diag([0.02, 0.05])
    change, gps = Change(np.array([-8.0, 1.0]), NOTHING, 0.0, S), np.array([-8.2, 1.2])
    cloud = fuse(change, gps, R)
    gain = S @ np.linalg.inv(S + R)
    assert cloud.fused
    assert cloud.mean == pytest.approx(change.recorded + gain @ (gps - change.recorded), abs=1e-9)
    spread = np.einsum("k,ki,kj->ij", cloud.weights, cloud.points - cloud.mean, cloud.points - cloud.mean)
    assert spread == pytest.approx(S - gain @ S, abs=1e-9)


def test_intervals_are_those_of_the_normal_distribution():
    cloud = fuse(Change(np.array([-10.0, 0.0]), NOTHING, 0.0, np.diag([0.25, 0.01])))
    along = cloud.component(0)
    assert (along.low, along.high) == pytest.approx((-10.98, -9.02), abs=0.06)
    pdof = cloud.pdof()
    assert pdof.high == pytest.approx(1.96 * 0.1 / 10.0, rel=0.1)


def test_fixes_find_the_factor_of_what_was_missing():
    change = Change(np.array([-5.0, 0.0]), np.array([-5.0, 0.0]), 0.3, 0.05**2 * np.eye(2))
    alone, both = fuse(change), fuse(change, np.array([-12.0, 0.0]), 0.1**2 * np.eye(2))
    assert both.factor == pytest.approx(1.4, abs=0.02)
    assert both.resultant().value == pytest.approx(12.0, abs=0.1)
    assert both.resultant().high - both.resultant().low < 0.25 * (alone.resultant().high - alone.resultant().low)
    # Never less than what was recorded, as far as the rest is sure.
    assert alone.resultant().low > 5.5


def test_fixes_that_contradict_are_left_out_and_said_so():
    change = Change(np.array([-8.0, 0.0]), NOTHING, 0.0, 0.05**2 * np.eye(2))
    cloud = fuse(change, np.array([0.0, 0.0]), 0.2**2 * np.eye(2))
    assert not cloud.fused
    assert cloud.chi2 > 100.0
    assert cloud.mean == pytest.approx(change.recorded)


@given(st.floats(-np.pi, np.pi))
def test_pdof_turns_with_the_blow_and_its_interval_may_pass_180(angle):
    blow = -10.0 * np.array([np.cos(angle), np.sin(angle)])
    pdof = fuse(Change(blow, NOTHING, 0.0, 0.1**2 * np.eye(2))).pdof()
    assert np.cos(pdof.value - angle) == pytest.approx(1.0, abs=1e-6)
    assert -np.pi <= pdof.value <= np.pi
    assert pdof.low <= pdof.value <= pdof.high
    assert pdof.high - pdof.low == pytest.approx(4.0 * 0.01, rel=0.15)


def test_a_direction_not_known_turns_and_makes_nothing_longer():
    sure = fuse(Change(np.array([-10.0, 0.0]), NOTHING, 0.0, 0.1**2 * np.eye(2))).resultant()
    cloud = fuse(Change(np.array([-10.0, 0.0]), NOTHING, 0.0, 0.1**2 * np.eye(2), turn=0.3))
    assert cloud.resultant().high == pytest.approx(sure.high, abs=0.02)
    assert cloud.resultant().low == pytest.approx(sure.low, abs=0.02)
    assert cloud.pdof().high == pytest.approx(1.96 * 0.3, rel=0.05)


@given(st.floats(1e-4, 30.0), st.floats(0.02, 2.5), st.floats(0.0, 1.5), st.floats(-np.pi, np.pi), st.floats(0.0, 40.0))
def test_whatever_clipping_hides_the_numbers_are_those_of_a_road(missing, spread, stray, angle, gps):
    """Neither the tail of the factor nor a guess that knows nothing ends in hundreds of km/h, or in no number."""
    guess = missing * np.array([np.cos(angle), np.sin(angle)])
    change = Change(np.array([-8.0, 1.0]), guess, spread, 0.01 * np.eye(2), 0.01, stray)
    for cloud in (fuse(change), fuse(change, np.array([-gps, 0.0]), 0.1 * np.eye(2))):
        resultant = cloud.resultant()
        assert np.isfinite([resultant.low, resultant.value, resultant.high]).all()
        assert resultant.value < 60.0
        assert resultant.high < 90.0


def test_quantiles_of_weighted_points():
    values, weights = np.array([3.0, 1.0, 2.0]), np.array([0.25, 0.5, 0.25])
    assert quantiles(values, weights, (0.25, 0.625, 0.875)) == pytest.approx([1.0, 2.0, 3.0])


def test_an_estimate_lies_in_its_interval():
    with pytest.raises(ValueError, match="estimate"):
        Estimate(1.0, 2.0, 3.0)
