"""Records refuse what they cannot mean, and cannot be changed."""

import dataclasses

import numpy as np
import pytest

from nav_core.errors import NavigationError, NotFiniteError, OrderError, RangeError, ShapeError, TooLittleDataError
from nav_core.records import Drive, Gnss, Inertial, MountingEstimate, Remark

T = np.array([0.0, 0.5, 1.0])
F = np.tile([0.0, 0.0, -9.81], (3, 1))


def fixes(**changes):
    columns = dict.fromkeys(("lat", "lon", "alt", "speed", "course"), np.zeros(3)) | {"fix": np.ones(3, dtype=bool)}
    return Gnss(t=changes.pop("t", T), **(columns | changes))


def test_inertial_keeps_its_columns():
    inertial = Inertial(T, F, w=np.full((3, 3), np.nan), temp=np.array([20.0, np.nan, 21.0]))
    assert inertial.t.dtype == inertial.f.dtype == np.float64
    assert np.isnan(inertial.w).all()
    assert inertial.m is None


def test_lists_become_arrays():
    inertial = Inertial([0, 1], [[0, 0, 1], [0, 0, 1]])
    assert inertial.f.shape == (2, 3)
    assert inertial.t.dtype == np.float64


def test_arrays_are_read_only_and_the_callers_stay_writable():
    f = F.copy()
    inertial = Inertial(T, f)
    with pytest.raises(ValueError, match="read-only"):
        inertial.f[0, 0] = 1.0
    f[0, 0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        inertial.t = T


@pytest.mark.parametrize(
    ("t", "f", "extra", "error"),
    [
        (T, F[:2], {}, ShapeError),
        (T, F[:, :2], {}, ShapeError),
        (T[None, :], F, {}, ShapeError),
        (T, np.where(F == 0.0, np.nan, F), {}, NotFiniteError),
        (np.array([0.0, np.inf, 1.0]), F, {}, NotFiniteError),
        (np.array([0.0, 0.5, 0.5]), F, {}, OrderError),
        (T[::-1], F, {}, OrderError),
        (T, F, {"w": F[:2]}, ShapeError),
        (T, F, {"m": np.zeros(3)}, ShapeError),
        (T, F, {"temp": np.zeros(2)}, ShapeError),
    ],
)
def test_inertial_refuses(t, f, extra, error):
    with pytest.raises(error):
        Inertial(t, f, **extra)


def test_errors_say_where():
    with pytest.raises(OrderError, match=r"inertial\.t does not increase at index 2") as caught:
        Inertial(np.array([0.0, 0.5, 0.5]), F)
    assert (caught.value.name, caught.value.index) == ("inertial.t", 2)
    f = F.copy()
    f[1, 2] = np.nan
    with pytest.raises(NotFiniteError, match="index 1") as caught:
        Inertial(T, f)
    assert caught.value.index == 1


def test_an_empty_recording_is_a_recording():
    empty = Inertial(np.zeros(0), np.zeros((0, 3)))
    assert empty.t.size == 0


def test_gnss_takes_holes_and_a_single_fix():
    gnss = fixes(speed=np.array([np.nan, 1.0, 2.0]), hdop=np.full(3, np.nan))
    assert np.isnan(gnss.speed[0])
    assert gnss.fix.dtype == np.bool_
    assert gnss.utc is None
    one = np.zeros(1)
    assert Gnss(one, one, one, one, one, one, [1]).fix[0]


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"lat": np.zeros(2)}, ShapeError),
        ({"sats": np.zeros(4)}, ShapeError),
        ({"course": np.zeros((3, 1))}, ShapeError),
        ({"fix": np.ones(2, dtype=bool)}, ShapeError),
        ({"t": np.array([0.0, 0.0, 1.0])}, OrderError),
        ({"t": np.array([0.0, np.nan, 1.0])}, NotFiniteError),
    ],
)
def test_gnss_refuses(changes, error):
    with pytest.raises(error):
        fixes(**changes)


def test_gnss_is_read_only():
    gnss = fixes()
    for column in (gnss.speed, gnss.fix):
        with pytest.raises(ValueError, match="read-only"):
            column[0] = 0


def test_a_drive_holds_both_and_remarks():
    drive = Drive(Inertial(T, F), fixes(), (Remark("rows_repeated", "2 rows were repeated"),))
    assert drive.remarks[0].code == "rows_repeated"
    assert Drive(Inertial(T, F), fixes()).remarks == ()


@pytest.mark.parametrize("status", ["ready", "settling"])
def test_a_known_mounting_has_matrix_and_covariance(status):
    estimate = MountingEstimate(status, "mekf", R_va=np.eye(3), covariance=np.diag([1.0, 4.0, 9.0]))
    assert np.array_equal(estimate.sigma, [1.0, 2.0, 3.0])
    with pytest.raises(ShapeError):
        MountingEstimate(status, "mekf")
    with pytest.raises(ShapeError):
        MountingEstimate(status, "mekf", R_va=np.eye(3))


@pytest.mark.parametrize("status", ["insufficient", "not_fixed"])
def test_an_unknown_mounting_has_none(status):
    assert MountingEstimate(status, "whole-drive").sigma is None
    with pytest.raises(ShapeError):
        MountingEstimate(status, "whole-drive", R_va=np.eye(3), covariance=np.eye(3))


def test_an_estimate_refuses_wrong_shapes_numbers_and_progress():
    with pytest.raises(ShapeError):
        MountingEstimate("ready", "mekf", R_va=np.eye(4), covariance=np.eye(3))
    with pytest.raises(NotFiniteError):
        MountingEstimate("ready", "mekf", R_va=np.eye(3), covariance=np.full((3, 3), np.nan))
    for progress in (-0.1, 1.1):
        with pytest.raises(RangeError, match="progress"):
            MountingEstimate("insufficient", "mekf", progress=progress)


def test_every_error_is_a_value_error_with_numbers():
    error = TooLittleDataError("fixes", 1, 2)
    assert isinstance(error, NavigationError)
    assert isinstance(error, ValueError)
    assert str(error) == "fixes: 1 samples, at least 2 needed"
