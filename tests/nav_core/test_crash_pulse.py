"""Samples around a blow: how the axes turn in it, and what is integrated in the axes at time zero."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nav_core.crash.pulse import blow_of, turn_since
from nav_core.events.level import Gravity
from nav_core.events.trigger import Window, stream_of
from nav_core.records import Inertial


def test_turning_is_multiplied_up_step_by_step():
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(0.004, 0.006, 60))
    w = rng.normal(0.0, 3.0, (60, 3))
    expected = Rotation.identity()
    found = turn_since(t, w)
    assert found[0] == pytest.approx(np.eye(3), abs=1e-15)
    for k in range(1, t.size):
        # Body rates: each small turn is about axes that the ones before have turned.
        expected = expected * Rotation.from_rotvec(0.5 * (w[k] + w[k - 1]) * (t[k] - t[k - 1]))
        assert found[k] == pytest.approx(expected.as_matrix(), abs=1e-12)


def test_a_blow_that_turns_the_vehicle_is_integrated_in_the_axes_at_time_zero():
    """Pushed backwards along a fixed direction while it turns right: seen in its own axes, the push goes round."""
    t = np.arange(0.0, 1.0, 0.001)
    zero, last = 400, 600
    rate = np.where(t >= t[zero], 4.0, 0.0)
    push = np.where((t >= t[zero]) & (t < t[last]), -50.0, 0.0)
    heading = np.cumsum(rate) * 0.001
    f_v = np.column_stack((push * np.cos(heading), -push * np.sin(heading), np.full(t.size, -9.81)))
    w_v = np.column_stack((np.zeros((t.size, 2)), rate))
    stream = stream_of(Inertial(t=t, f=f_v), np.eye(3))
    steady = Gravity(np.array([0.0, 0.0, -9.81]), 0.0, 1.0)
    blow = blow_of(stream, Window(zero, last, last), steady, w_v, margin=0.0995, tail=0.1)
    assert blow.zero == 99
    assert blow.v[blow.zero] == pytest.approx(np.zeros(3), abs=1e-12)
    assert blow.v[blow.last] == pytest.approx([-10.0, 0.0, 0.0], abs=0.05)
    assert blow.velocity(blow.a) == pytest.approx(blow.v, abs=1e-12)
    turned = Rotation.from_matrix(blow.C[blow.last]).as_rotvec()
    assert turned == pytest.approx([0.0, 0.0, 0.8], abs=0.01)
    assert blow.gyro_gap == 0.0
    blind = blow_of(stream, Window(zero, last, last), steady, None, margin=0.0995, tail=0.1)
    assert np.array_equal(blind.C[-1], np.eye(3))
    assert abs(blind.v[blind.last, 1]) > 3.0
