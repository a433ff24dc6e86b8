"""Installation by hand: the published tolerance and errors, the check, and the four orientations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nav_core.alignment import check_level, largest_tilt, orientations, tilt_errors
from nav_core.errors import RangeError, ShapeError
from nav_core.rotation import rotvec_to_matrix

G = 9.81
AXES = st.tuples(st.integers(0, 2), st.sampled_from([1, -1]))


def test_five_per_cent_are_18_degrees_and_the_published_errors():
    # 001 §3.2.
    assert np.degrees(largest_tilt()) == pytest.approx(18.19, abs=0.005)
    axis_error, cross_error = tilt_errors(largest_tilt())
    assert axis_error == pytest.approx(0.05)
    assert cross_error == pytest.approx(0.3122, abs=5e-5)


@given(upright=AXES, tilt=st.floats(0.0, 0.7), towards=st.floats(0.0, 2.0 * np.pi))
def test_a_box_is_level_up_to_the_tolerance(upright, tilt, towards):
    axis, sign = upright
    up = np.zeros(3)
    up[axis] = sign
    aside = np.roll([0.0, np.cos(towards), np.sin(towards)], axis)
    found = check_level(G * (np.cos(tilt) * up + np.sin(tilt) * aside), gravity=G)
    assert (found.axis, found.sign) == upright
    assert found.angle == pytest.approx(tilt, abs=1e-9)
    assert found.axis_error == pytest.approx(1.0 - found.reading, abs=1e-9)
    if abs(tilt - largest_tilt()) > 1e-6:
        assert found.ok == (tilt < largest_tilt())


def test_a_box_that_is_shaken_is_not_ok():
    # Along the axis it reads 1 g, but it is no gravity that it reads across.
    assert not check_level(np.array([0.0, 4.0, -G]), gravity=G).ok
    assert check_level(np.array([0.0, 0.1, -G]), gravity=G).ok


@given(upright=AXES)
def test_each_orientation_reads_gravity_upwards_and_all_differ_by_a_quarter(upright):
    axis, sign = upright
    four = orientations(axis, sign)
    f_a = np.zeros(3)
    f_a[axis] = sign * G
    assert np.allclose(four @ f_a, [0.0, 0.0, -G])
    assert np.allclose(np.linalg.det(four), 1.0)
    assert np.allclose(four[0] @ np.eye(3)[(axis + 1) % 3], [1.0, 0.0, 0.0])
    turn = rotvec_to_matrix(np.array([0.0, 0.0, 0.5 * np.pi]))
    for k in range(4):
        assert np.allclose(four[(k + 1) % 4], turn @ four[k])


def test_what_is_no_axis_is_refused():
    for call in (
        lambda: orientations(3, 1),
        lambda: orientations(0, 0),
        lambda: largest_tilt(1.0),
        lambda: check_level(np.zeros(3), gravity=G),
        lambda: check_level(np.ones(3), gravity=0.0),
    ):
        with pytest.raises(RangeError):
            call()
    with pytest.raises(ShapeError):
        check_level(np.zeros(2), gravity=G)
