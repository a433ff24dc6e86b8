"""The 15-state filter: kernel against matrices, truth, its own claims, bad fixes, gaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nav_core.errors import RangeError, ShapeError, TooLittleDataError
from nav_core.kalman import normalised
from nav_core.navigation import NoGyroError, Receiver, Vehicle, inertial_gnss, kernels, navigate, reference, rows
from nav_core.records import Inertial
from nav_core.rotation import matrix_to_euler, rotvec_to_matrix
from tests.nav_core import python_ins
from tests.nav_core.drives_on_the_globe import errors, world


def prepared(seen, receiver=None, vehicle=None):
    return inertial_gnss.prepare(
        seen.drive, seen.truth.R_va, receiver=receiver or Receiver(), vehicle=vehicle or Vehicle(), **seen.lags
    )


def test_the_kernel_agrees_with_the_matrices():
    # With stops, an outage, a jump that the gate strikes and one so long that it is believed in the end.
    seen = world(5, duration=70.0, outages=((40.0, 46.0),))
    gnss = seen.drive.gnss
    jump = ((gnss.t > 30.0) & (gnss.t < 33.0)) | (gnss.t > 52.0)
    gnss = replace(gnss, lat=gnss.lat + jump * 80.0 / 6.37e6)
    record = prepared(seen._replace(drive=replace(seen.drive, gnss=gnss)), vehicle=Vehicle(arm=(-1.2, 0.3, 0.4)))
    places, v, C, bias, _, P, _, dx, left_out, still = inertial_gnss.forward(record)
    assert left_out > 30
    assert still.any()
    expected = reference.run_reference(record)
    for name, ours, theirs in zip(
        ("place", "v", "C", "bias", "P", "dx"), (places, v, C, bias, P, dx), expected, strict=True
    ):
        assert ours == pytest.approx(theirs, abs=1e-7 * max(1.0, float(np.abs(theirs).max()))), name


def test_the_slip_free_point_is_where_the_arm_says():
    C, spin, arm = rotvec_to_matrix(np.array([0.1, -0.2, 2.0])), np.array([0.1, -0.05, 0.4]), np.array([-1.5, 0.2, 0.6])
    # The point moves straight ahead, the box on its rigid arm does not.
    v = C @ (np.array([9.0, 0.0, 0.0]) - np.cross(spin, arm))
    e, H, s, r = np.full(13, np.nan), np.zeros((13, 20)), np.ones(13), np.ones(13)
    rows.slip_rows(v, C, tuple(spin), arm, Vehicle().weights(Receiver()), e, H, s, r)
    assert e[5:7] == pytest.approx(np.zeros(2), abs=1e-12)
    assert np.abs((C.T @ v)[1:]).max() > 0.5


def test_a_track_is_moved_as_the_kernel_moves_an_epoch():
    rng = np.random.default_rng(5)
    places = np.column_stack((rng.uniform(-1.0, 1.0, 4), rng.uniform(-3.0, 3.0, 4), rng.uniform(0.0, 900.0, 4)))
    v, slow, e = rng.normal(0.0, 9.0, (4, 3)), rng.normal(0.0, 0.1, (4, 11)), 0.1 * rng.standard_normal((4, 20))
    C = rotvec_to_matrix(rng.standard_normal((4, 3)))
    found = inertial_gnss.moved(places, v, C, slow, e)
    for k in range(4):
        one = places[k].copy(), v[k].copy(), C[k].copy(), slow[k].copy()
        kernels.apply(*one, e[k])
        for ours, kernel in zip(found, one, strict=True):
            assert ours[k] == pytest.approx(kernel, rel=1e-12, abs=1e-13)


@pytest.mark.slow
def test_python_ins_finds_the_same_track_biases_and_sigmas():
    record = python_ins.comparable(python_ins.comparable_world(4, duration=40.0))
    ours = python_ins.run_ours(record)
    t = record.t[record.epochs.sample]
    theirs = python_ins.read(python_ins.peer(record)(), t)
    # Its sigmas stand at fixes; the last tenth of a second it only integrates.
    fixed = np.flatnonzero(np.isfinite(record.epochs.z[:, 0]) & (t < t[-1] - 0.2))[8:]
    off = (ours.values - theirs.values)[fixed]
    off[:, :2] *= np.radians(6.37e6) * np.array([1.0, np.cos(record.start.place[0])])
    off[:, 6:9] = np.mod(off[:, 6:9] + np.pi, 2.0 * np.pi) - np.pi
    apart = np.sqrt(np.mean((off / theirs.sigma[fixed]) ** 2, axis=0))
    ratio = (ours.sigma / theirs.sigma)[fixed]
    print(f"differences in sigmas, rms {apart.round(3)}; sigmas by theirs {ratio.min():.4f} to {ratio.max():.4f}")
    assert apart.max() < 0.1
    assert ratio == pytest.approx(1.0, abs=0.03)


def test_perfect_instruments_give_the_drive_back():
    seen = world(3, faultless=True, duration=100.0)
    solution = navigate(seen.drive, seen.truth.R_va, **seen.lags)
    off = errors(solution, seen.globe)
    inner = slice(50, -10)
    assert np.abs(off.position[inner]).max() < 0.5
    assert np.abs(off.velocity[inner]).max() < 0.1
    assert np.degrees(np.abs(off.attitude[inner])).max() < 0.5


@pytest.mark.slow
def test_errors_fit_their_covariance_over_drives():
    squares = []
    for seed in range(30):
        seen = world(seed, duration=120.0)
        # The mounting errs by what the filter is told: the attitude of the vehicle is claimed no better.
        off = rotvec_to_matrix(Vehicle().mount_sigma * np.random.default_rng(seed).standard_normal(3))
        solution = navigate(seen.drive, off @ seen.truth.R_va, smoothed=False, **seen.lags)
        off = errors(solution, seen.globe)
        settled = solution.t > 60.0
        parts = (off.position, off.velocity[:, :2], off.velocity[:, 2:], off.attitude)
        where = (slice(0, 3), slice(3, 5), slice(5, 6), slice(6, 9))
        squares.append(
            [normalised(e, solution.P[:, w, w])[settled].mean() / e.shape[1] for e, w in zip(parts, where, strict=True)]
        )
    position, velocity, vertical, attitude = np.mean(squares, axis=0)
    print(f"NEES: position {position:.2f}, velocity {velocity:.2f}, down {vertical:.2f}, attitude {attitude:.2f}")
    # 1 where all is as modelled, with a standard deviation of about 0.15 over 30 drives.
    assert 0.6 < position < 1.4
    assert 0.6 < velocity < 1.4
    assert 0.6 < attitude < 1.4
    # The road's waves and the springs count for more than these drives have of them.
    assert 0.15 < vertical < 1.2


def test_smoothing_helps_and_claims_less_uncertainty():
    seen = world(7, duration=100.0, outages=((60.0, 80.0),))
    forward = navigate(seen.drive, seen.truth.R_va, smoothed=False, **seen.lags)
    smooth = navigate(seen.drive, seen.truth.R_va, **seen.lags)
    dark = (forward.t > 60.0) & (forward.t < 79.0)
    far = [np.hypot(*errors(each, seen.globe).position[dark, :2].T).max() for each in (forward, smooth)]
    assert far[1] < far[0]
    assert (smooth.sigma[dark, :2] <= forward.sigma[dark, :2] + 1e-9).all()
    assert smooth.P[-1] == pytest.approx(forward.P[-1])


def test_a_jump_of_the_receiver_is_left_out_and_a_lasting_one_believed():
    seen = world(6, duration=100.0)
    gnss = seen.drive.gnss
    clean = navigate(seen.drive, seen.truth.R_va, smoothed=False, **seen.lags)
    short = replace(gnss, lon=gnss.lon + ((gnss.t > 50.0) & (gnss.t < 54.0)) * 100.0 / 4.5e6)
    solution = navigate(replace(seen.drive, gnss=short), seen.truth.R_va, smoothed=False, **seen.lags)
    assert solution.rejected >= 15
    assert np.hypot(*errors(solution, seen.globe).position[100:, :2].T).max() < 6.0
    lasting = replace(gnss, lon=gnss.lon + (gnss.t > 50.0) * 100.0 / 4.5e6)
    solution = navigate(replace(seen.drive, gnss=lasting), seen.truth.R_va, smoothed=False, **seen.lags)
    moved = (solution.lon[-1] - clean.lon[-1]) * 4.5e6
    assert moved == pytest.approx(100.0, abs=10.0)


def test_bad_geometry_few_satellites_and_repeats_are_not_believed():
    seen = world(6, duration=60.0, frozen=((30.0, 33.0),))
    gnss = seen.drive.gnss
    hdop = np.where((gnss.t > 40.0) & (gnss.t < 44.0), 20.0, 0.9)
    sats = np.where((gnss.t > 50.0) & (gnss.t < 54.0), 3.0, 9.0)
    graded = replace(gnss, hdop=hdop, sats=sats)
    solution = navigate(replace(seen.drive, gnss=graded), seen.truth.R_va, **seen.lags)
    plain = navigate(replace(seen.drive, gnss=replace(gnss, utc=gnss.utc)), seen.truth.R_va, **seen.lags)
    assert plain.fixes - solution.fixes == pytest.approx(32, abs=2)


def test_rest_is_seen_and_stops_the_velocity():
    seen = world(1, duration=180.0)
    solution = navigate(seen.drive, seen.truth.R_va, smoothed=False, **seen.lags)
    speed = np.interp(solution.t, seen.truth.t, seen.truth.v)
    still = solution.still > 0.0
    assert still.mean() > 0.05
    assert speed[still].max() < 0.3
    assert np.abs(solution.velocity[still]).max() < 0.3


def test_smooth_braking_at_walking_pace_is_no_rest():
    # Without GPS, on a calm road: only the mean force tells it from standing.
    seen = world(2071, outages=((150.0, 180.0),))
    record = prepared(seen)
    speed = np.interp(record.t[record.epochs.sample], seen.truth.t, seen.truth.v)
    assert speed[record.epochs.still > 0.0].max() > 1.5
    solution = navigate(seen.drive, seen.truth.R_va, smoothed=False, **seen.lags)
    assert speed[solution.still > 0.0].max() < 0.5


def test_without_heights_the_rest_of_the_track_is_the_same():
    seen = world(6, duration=60.0)
    gnss = seen.drive.gnss
    low = replace(seen.drive, gnss=replace(gnss, alt=np.full(gnss.t.size, np.nan)))
    plain, without = (navigate(each, seen.truth.R_va, **seen.lags) for each in (seen.drive, low))
    assert np.abs(plain.lat - without.lat).max() * 6.37e6 < 0.1
    assert plain.velocity[:, :2] == pytest.approx(without.velocity[:, :2], abs=0.05)
    assert without.sigma[:, 2].min() > 900.0


def test_the_rest_before_the_first_motion_is_remarked():
    seen = world(1, duration=60.0)
    solution = navigate(seen.drive, seen.truth.R_va, **seen.lags)
    before = solution.t[0] - seen.drive.inertial.t[0]
    assert [remark.code for remark in solution.remarks] == (["begins_moving"] if before > 1.0 else [])


def test_biases_are_found():
    seen = world(8, duration=150.0)
    solution = navigate(seen.drive, seen.truth.R_va, **seen.lags)
    gyro, accel = seen.truth.R_va @ seen.truth.gyro_bias, seen.truth.R_va @ seen.truth.accel_bias
    assert np.degrees(solution.bias[-1, 3:] - gyro) == pytest.approx(np.zeros(3), abs=0.02)
    assert np.abs(solution.bias[-1, :3] - accel).max() < 3.0 * solution.sigma[-1, 9:12].max()


def test_sigmas_of_the_angles_are_those_of_the_rotation_seen_along_the_track():
    # Drawn from the covariance of the rotation about the T axes, the angles scatter by what is stated.
    seen = world(8, duration=40.0)
    solution = navigate(seen.drive, seen.truth.R_va, **seen.lags)
    k = solution.t.size // 2
    drawn = np.random.default_rng(1).multivariate_normal(np.zeros(3), solution.P[k, 6:9, 6:9], 20000)
    scattered = matrix_to_euler(rotvec_to_matrix(drawn) @ solution.R_tv[k]) - solution.euler[k]
    assert np.std(np.mod(scattered + np.pi, 2.0 * np.pi) - np.pi, axis=0) == pytest.approx(
        solution.euler_sigma[k], rel=0.03
    )
    with pytest.raises(ShapeError):
        replace(solution, velocity=solution.velocity[1:])


def test_a_hole_in_the_record_is_uncertain():
    seen = world(1, duration=60.0)
    inertial = seen.drive.inertial
    keep = (inertial.t < 30.0) | (inertial.t > 33.0)
    holed = Inertial(t=inertial.t[keep], f=inertial.f[keep], w=inertial.w[keep])
    solution = navigate(replace(seen.drive, inertial=holed), seen.truth.R_va, smoothed=False, **seen.lags)
    after = np.searchsorted(solution.t, 33.0)
    assert solution.sigma[after, 8] > 2.0 * solution.sigma[after - 1, 8]
    settled = solution.t > 45.0
    assert np.hypot(*errors(solution, seen.globe).position[settled, :2].T).max() < 8.0


def test_what_the_filter_refuses():
    seen = world(1, duration=20.0)
    inertial, gnss = seen.drive.inertial, seen.drive.gnss
    with pytest.raises(NoGyroError):
        navigate(replace(seen.drive, inertial=Inertial(t=inertial.t, f=inertial.f)), seen.truth.R_va)
    with pytest.raises(TooLittleDataError):
        navigate(replace(seen.drive, gnss=replace(gnss, fix=np.zeros(gnss.t.size, dtype=bool))), seen.truth.R_va)
    with pytest.raises(RangeError):
        Vehicle(force_noise=0.0)
    with pytest.raises(RangeError):
        Receiver(position=0.0)
    with pytest.raises(RangeError):
        Receiver(velocity_share=2.0)
