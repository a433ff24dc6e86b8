"""Calibrations: truth inside the stated intervals, published tables, real poses, and poses that are refused."""

from __future__ import annotations

import csv
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from nav_core.errors import NotFiniteError, OrderError, PosesError, RangeError, ShapeError, TooLittleDataError
from nav_core.rotation import euler_to_matrix
from nav_core.sensors import (
    calibrate_field,
    calibrate_positions,
    calibrate_reference,
    eighteen_directions,
    fit_temperature,
    interval_means,
    moving_spread,
    reference_rates,
    reference_vectors,
    six_positions,
    static_intervals,
    turn_on_bias,
)
from nav_core.sensors.calibration import levenberg_marquardt
from tests.recordings import folder

G = 9.80665
RUNS = 1000

# 000 table 6.1, biases in g; table 6.2, biases in °/s.
TABLE_61 = (np.array([0.012133, 0.023295, -0.03593]) * G, (0.00775, 0.008838, 0.008041), (-0.00086, 0.01142, -0.00049))
TABLE_62 = (np.radians([0.3766, 0.1963, 0.6270]), (0.004818, 0.004042, 0.009385), (-0.00126, -0.00296, -0.00171))

# 002 eqs. 6.17, 6.20, 6.23 and the rms before and after of tables 6.2-6.4; (°/s), g, G.
PRINTED = {
    "gyro": (
        [[0.9822, -0.0003, -0.0072, 0.0188], [-0.0021, 0.9836, 0.0143, -0.0680], [0.0093, 0.0039, 1.0002, 0.0028]],
        np.radians([1.116, 3.977, 0.215]),
        np.radians([0.128, 0.146, 0.115]),
    ),
    "accelerometer": (
        [[0.9941, 0.0025, -0.0123, -0.0163], [0.0015, 0.9896, 0.0, 0.0404], [0.0073, -0.0035, 0.9673, -0.0875]],
        np.array([5.670e-3, 4.001e-2, 5.711e-2]),
        np.array([2.720e-3, 2.916e-3, 3.679e-3]),
    ),
    "magnetometer": (
        [
            [0.9875, -0.0168, -0.1961, -0.0280],
            [-0.0290, 1.0277, -0.0307, 0.0161],
            [-0.0980, -0.0001, 1.0425, -0.0170],
        ],
        np.array([5.402e-2, 1.367e-2, 2.280e-2]),
        np.array([2.189e-2, 1.303e-2, 0.927e-2]),
    ),
}


def directions(count, rng):
    u = rng.standard_normal((count, 3))
    return u / np.linalg.norm(u, axis=1)[:, None]


def spread_out(count, rng):
    """Directions about evenly over the sphere, as poses some 45° apart are, in a random orientation."""
    k = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * k / count, k * np.pi * (1.0 + np.sqrt(5.0))
    u = np.column_stack((np.sqrt(1.0 - z**2) * np.cos(turn), np.sqrt(1.0 - z**2) * np.sin(turn), z))
    return u @ Rotation.random(random_state=rng).as_matrix()


def triangular(scale, theta):
    """S of 000 eq. 6.2.7 as its listing has it: theta_zy in (3,1), -theta_zx in (3,2)."""
    yz, zx, zy = theta
    return np.eye(3) + np.array([[scale[0], 0.0, 0.0], [-yz, scale[1], 0.0], [zy, -zx, scale[2]]])


def coverage(calibrate, truth, runs=RUNS):
    """Share of runs in which each parameter lies in its 95 % interval."""
    inside = np.zeros(len(truth))
    for _ in range(runs):
        interval = calibrate().interval()
        inside += (interval[:, 0] <= truth) & (truth <= interval[:, 1])
    return inside / runs


def is_95_percent(share, runs=RUNS):
    """All parameters together within the bar; each within 4 sigma of a binomial draw."""
    assert np.mean(share) == pytest.approx(0.95, abs=0.02)
    np.testing.assert_allclose(share, 0.95, atol=4.0 * np.sqrt(0.95 * 0.05 / runs))


def test_table_61_with_39_poses():
    rng = np.random.default_rng(61)
    bias, scale, theta = TABLE_61
    S, truth = triangular(scale, theta), np.concatenate(TABLE_61)
    found = []

    def calibrate():
        readings = G * spread_out(39, rng) @ S.T + bias + 0.01 * rng.standard_normal((39, 3))
        found.append(calibrate_positions(readings, G))
        return found[-1]

    is_95_percent(coverage(calibrate, truth))
    assert max(c.iterations for c in found) <= 7  # 000 converges by its fifth
    values = np.array([c.values for c in found])
    np.testing.assert_allclose(values.mean(axis=0)[3:6], scale, rtol=0.01)
    assert np.all(np.abs(values[:, 3:6] - scale) < 6e-3)


def test_table_62_with_nine_poses_at_two_speeds():
    rng = np.random.default_rng(62)
    bias, scale, theta = TABLE_62
    S, truth = triangular(scale, theta), np.concatenate(TABLE_62)
    speed = np.repeat(np.radians([200.0, 270.0]), 9)
    found = []

    def calibrate():
        u = spread_out(9, rng)
        noise = np.radians(0.24) * rng.standard_normal((18, 3))
        readings = speed[:, None] * np.vstack((u, u)) @ S.T + bias + noise
        found.append(calibrate_positions(readings, speed))
        return found[-1]

    is_95_percent(coverage(calibrate, truth))
    values, sigma = np.array([c.values for c in found]), np.array([c.sigma for c in found])
    np.testing.assert_allclose(values.mean(axis=0)[3:6], scale, atol=1e-4)
    # The table's variances, nine times too large by its listing, are those of readings with 0.24 °/s of noise.
    table = np.sqrt(np.array([0.08846, 0.07018, 0.02816]) / 9.0)
    ratio = np.degrees(np.median(sigma, axis=0)[:3]) / table
    assert np.all((ratio > 0.5) & (ratio < 2.0))


def test_the_printed_627_exchanges_the_misalignments_of_z():
    scale, (yz, zx, zy) = (0.01, -0.02, 0.03), (0.02, 0.05, -0.04)
    u = eighteen_directions()
    c = calibrate_positions(u @ triangular(scale, (yz, zx, zy)).T, 1.0, noise=1e-6)
    np.testing.assert_allclose(c.values, [0, 0, 0, *scale, yz, zx, zy], atol=1e-9)
    S = np.eye(3) + np.array([[scale[0], 0, 0], [-yz, scale[1], 0], [zx, -zy, scale[2]]])
    printed = calibrate_positions(u @ S.T, 1.0, noise=1e-6)
    np.testing.assert_allclose(printed.values[7:], [zy, zx], atol=1e-9)


def test_the_derivative_by_scale_is_by_a_squared():
    # 000 6.2.20 divides by a² where a = 1/(1+s) calls for a factor a²: wrong by (1+s)^4 in sigma.
    u, scale = eighteen_directions(), 0.3
    S = np.diag([1.0 + scale, 1.0, 1.0])
    noise = 1e-4
    rng = np.random.default_rng(64)
    spread = [calibrate_positions(u @ S.T + noise * rng.standard_normal(u.shape), 1.0).values[3] for _ in range(300)]
    stated = calibrate_positions(u @ S.T, 1.0, noise=noise).sigma[3]
    assert np.std(spread) == pytest.approx(stated, rel=0.15)


def test_six_positions():
    bias, scale = np.array([0.1, -0.2, 0.3]), np.array([0.01, -0.02, 0.005])
    up, down = G * (1.0 + scale) + bias, -G * (1.0 + scale) + bias
    found = six_positions(up, down, G)
    np.testing.assert_allclose(found[0], bias, atol=1e-12)
    np.testing.assert_allclose(found[1], scale, atol=1e-12)
    with pytest.raises(RangeError):
        six_positions(up, down, 0.0)
    with pytest.raises(ShapeError):
        six_positions(up[:2], down, G)
    # 6.2.2 as printed adds the readings, which leaves nothing of the scale.
    assert not np.allclose((up + down - 2.0 * G) / (2.0 * G), scale, atol=0.5)


def test_eighteen_levelled_positions_give_twelve_parameters():
    u = eighteen_directions()
    assert np.linalg.norm(u, axis=1) == pytest.approx(np.ones(18))
    assert len(np.unique(np.round(u, 9), axis=0)) == 18
    gain = np.array([[1.01, 0.002, -0.003], [0.004, 0.99, 0.005], [-0.006, 0.007, 1.02]])
    c = calibrate_reference(G * u @ gain.T + [0.1, 0.2, 0.3], G * u)
    np.testing.assert_allclose(c.gain, gain, atol=1e-12)
    np.testing.assert_allclose(c.bias, [0.1, 0.2, 0.3], atol=1e-12)


def test_the_symmetric_form_is_the_triangular_one_turned():
    rng = np.random.default_rng(65)
    gain = np.array([[410.0, 20.0, -10.0], [5.0, 395.0, 12.0], [-8.0, 3.0, 420.0]])
    readings = G * spread_out(39, rng) @ gain.T + [33_000.0, 32_500.0, 32_700.0] + rng.standard_normal((39, 3))
    one, other = calibrate_positions(readings, G), calibrate_positions(readings, G, form="symmetric")
    np.testing.assert_allclose(one.gain @ one.gain.T, other.gain @ other.gain.T, rtol=1e-9)
    np.testing.assert_allclose(one.bias, other.bias, rtol=1e-12)
    np.testing.assert_allclose(other.gain, other.gain.T)
    np.testing.assert_allclose(np.abs(one.residuals), np.abs(other.residuals), atol=1e-6)
    assert other.names[3] == "alpha_x"
    assert other.values[3] == pytest.approx(other.gain[0, 0])
    assert other.values[8] == pytest.approx(other.gain[1, 2])
    np.testing.assert_allclose(np.linalg.norm(one.correct(readings), axis=1) - G, one.residuals, atol=1e-12)


def test_nine_poses_calibrate_the_voltages_of_001_b3():
    # MMA7341L at 11 g: 117.5 mV/g about half of 3.3 V, read by 10 bits.  B.3 promises 1e-2 V and 1e-2 V/g from nine.
    rng = np.random.default_rng(73)
    step = 3.3 / 1024.0
    for _ in range(200):
        own, cross = 0.1175 * rng.uniform(0.95, 1.05, 3), rng.uniform(-2e-3, 2e-3, 3)
        A = np.diag(own) + np.array([[0, cross[0], cross[1]], [cross[0], 0, cross[2]], [cross[1], cross[2], 0]])
        beta = 1.65 + rng.uniform(-0.1, 0.1, 3)
        volts = step * np.round((spread_out(9, rng) @ A + beta) / step)
        found = calibrate_positions(volts, 1.0, form="symmetric", noise=step / np.sqrt(12.0))
        np.testing.assert_allclose(found.values, [*beta, *own, *cross], atol=1e-2)
        assert found.poses.count == 9


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(["triangular", "symmetric"]))
def test_how_the_poses_are_turned_does_not_matter(seed, form):
    rng = np.random.default_rng(seed)
    scale, theta = rng.uniform(-0.1, 0.1, (2, 3))
    S, bias = triangular(scale, theta), rng.uniform(-1.0, 1.0, 3)
    c = calibrate_positions(G * spread_out(24, rng) @ S.T + bias, G, form=form, noise=1.0)
    np.testing.assert_allclose(c.gain @ c.gain.T, S @ S.T, atol=1e-8)
    np.testing.assert_allclose(c.bias, bias, atol=1e-8)


@pytest.mark.parametrize("form", ["triangular", "symmetric"])
def test_the_stated_covariance_is_that_of_the_errors(form):
    rng = np.random.default_rng(66)
    S = triangular((0.02, -0.03, 0.01), (0.05, -0.04, 0.03))
    w, V = np.linalg.eigh(S @ S.T)
    gain = S if form == "triangular" else (V * np.sqrt(w)) @ V.T
    squares = []
    for _ in range(300):
        c = calibrate_positions(
            G * spread_out(20, rng) @ S.T + 0.01 * rng.standard_normal((20, 3)), G, form=form, noise=0.01
        )
        places = [(0, 0), (1, 1), (2, 2)]
        rest = [(1, 0, -1), (2, 1, -1), (2, 0, 1)] if form == "triangular" else [(0, 1, 1), (0, 2, 1), (1, 2, 1)]
        less = 1.0 if form == "triangular" else 0.0
        truth = [0.0] * 3 + [gain[p] - less for p in places] + [sign * gain[i, j] for i, j, sign in rest]
        error = c.values - truth
        squares.append(error @ np.linalg.solve(c.covariance, error))
        assert c.freedom is None
    # The mean of 300 chi-squares of 9 degrees lies within 4 sigma.
    assert np.mean(squares) == pytest.approx(9.0, abs=4.0 * np.sqrt(18.0 / 300.0))
    assert np.mean(np.array(squares) < chi2.ppf(0.95, 9)) == pytest.approx(0.95, abs=0.05)


def refused(readings, magnitude=G, **options):
    with pytest.raises(PosesError) as caught:
        calibrate_positions(readings, magnitude, **options)
    return caught.value


def test_too_few_poses_are_refused():
    rng = np.random.default_rng(67)
    u = spread_out(9, rng)
    assert "9 are needed" in refused(G * u[:8]).reason
    nine = refused(G * u)
    assert "noise" in nine.reason
    assert nine.count == 9
    assert calibrate_positions(G * u, G, noise=0.01).poses.count == 9


def test_coplanar_poses_are_refused():
    angle = np.linspace(0.0, 2.0 * np.pi, 30)
    rng = np.random.default_rng(68)
    flat = G * np.column_stack((np.cos(angle), np.sin(angle), np.zeros(30))) + 0.02 * rng.standard_normal((30, 3))
    assert "coplanar" in refused(flat).reason
    assert "coplanar" in str(refused(flat @ Rotation.from_rotvec([0.3, 0.7, 0.2]).as_matrix() + 5.0))


def test_poses_that_leave_parameters_open_are_refused_by_name():
    rng = np.random.default_rng(69)
    faces = np.tile(np.vstack((np.eye(3), -np.eye(3))), (3, 1))
    assert "theta" in refused(G * faces + 1e-3 * rng.standard_normal((18, 3))).reason
    # Two circles of latitude: no way to tell the bias from the scale of z.
    angle, z = np.linspace(0.0, 2.0 * np.pi, 20, endpoint=False), np.tile([0.5, -0.5], 10)
    circles = np.column_stack((np.cos(angle) * np.sqrt(0.75), np.sin(angle) * np.sqrt(0.75), z))
    error = refused(G * circles + 1e-3 * rng.standard_normal((20, 3)))
    assert "s_z" in error.reason
    assert error.condition > 200.0
    small = np.array([d for d in directions(400, rng) if d[2] > 0.85])
    refused(G * small + 1e-3 * rng.standard_normal(small.shape))


def within(degrees, count, rng):
    """Directions no farther than this from the plane of x and y."""
    u = directions(20 * count, rng)
    return u[np.abs(u[:, 2]) < np.sin(np.radians(degrees))][:count]


def test_a_band_about_a_plane_is_refused_with_the_direction_that_is_missing():
    # Far beyond the noise: the sphere's third axis is what the readings never come near.
    rng = np.random.default_rng(70)
    narrow = within(15.0, 300, rng)
    reason = refused(G * narrow + 1e-3 * rng.standard_normal(narrow.shape)).reason
    assert re.search(r"direction \(-?0\.0\d, -?0\.0\d, 1\.00\)", reason)
    wide = within(30.0, 300, rng)
    found = calibrate_positions(G * wide + 1e-3 * rng.standard_normal(wide.shape), G)
    np.testing.assert_allclose(found.gain, np.eye(3), atol=1e-3)


def test_a_magnetometer_that_only_circled_on_the_level_is_refused():
    # Iron of the street bends the circle by more than the noise; a fit of it says 0.24 of the vertical scale.
    path = folder("northeastern-vn100-circles") / "circle_data_0_imu.csv"
    with path.open(newline="", encoding="utf-8") as file:
        rows = [row[8:11] for row in csv.reader(file) if len(row) > 10][1:]
    with pytest.raises(PosesError, match="coplanar"):
        calibrate_field(1e6 * np.array(rows, dtype=np.float64), 51.22)


def test_readings_on_no_ellipsoid_are_refused():
    angle, height = np.meshgrid(np.linspace(0.0, 6.0, 12), np.linspace(-1.5, 1.5, 5))
    waist = np.sqrt(1.0 + height**2)
    sheet = np.column_stack(((waist * np.cos(angle)).ravel(), (waist * np.sin(angle)).ravel(), height.ravel()))
    assert "ellipsoid" in refused(sheet).reason


@pytest.mark.parametrize(
    ("readings", "magnitude", "options", "error"),
    [
        (np.zeros((12, 2)), G, {}, ShapeError),
        (np.full((12, 3), np.nan), G, {}, NotFiniteError),
        (eighteen_directions(), np.ones(3), {}, ShapeError),
        (eighteen_directions(), 0.0, {}, RangeError),
        (eighteen_directions(), 1.0, {"noise": 0.0}, RangeError),
    ],
)
def test_what_is_no_set_of_poses_is_refused(readings, magnitude, options, error):
    with pytest.raises(error):
        calibrate_positions(readings, magnitude, **options)


def test_real_poses_of_an_xsens():
    path = folder("imu-tk-xsens") / "xsens_acc.txt.gz"
    t, *axes = np.loadtxt(path).T
    counts = np.column_stack(axes)
    quiet = float(np.median(moving_spread(counts[t - t[0] < 50.0], 100)))
    stretches = static_intervals(t, counts, quiet=quiet)
    assert 30 <= len(stretches) <= 45  # 38 by another detector
    c = calibrate_positions(interval_means(counts, stretches).mean, 9.81744)
    assert c.rms < 0.01
    assert c.rms == pytest.approx(0.001, abs=0.0005)
    # Without what the notes say of the start: half the counters' range, and scales within a percent of each other.
    np.testing.assert_allclose(c.bias, 32768.0, atol=600.0)
    assert np.ptp(np.diag(c.gain)) < 0.01 * c.gain[0, 0]


def simulated_triad(name, rng, count):
    """Readings and true input with a printed calibration matrix and the noise after it."""
    matrix, before, after = PRINTED[name]
    inverse, offset = np.array(matrix)[:, :3], np.array(matrix)[:, 3]
    gain = np.linalg.inv(inverse)
    if name == "gyro":
        truth = np.radians(40.0) * rng.uniform(-1.0, 1.0, (count, 3))
    else:
        # "In different configurations": tilts of some 20° about level, and any heading.
        euler = np.column_stack((0.35 * rng.standard_normal((count, 2)), rng.uniform(-np.pi, np.pi, count)))
        vector = [0.0, 0.0, -1.0] if name == "accelerometer" else [0.225, 0.0, 0.418]
        truth = reference_vectors(euler, np.array(vector))
    readings = (truth - offset + after * rng.standard_normal((count, 3))) @ gain.T
    return readings, truth, gain, -gain @ offset, before, after


@pytest.mark.parametrize("name", sorted(PRINTED))
def test_the_errors_before_and_after_of_002(name):
    readings, truth, _, _, before, after = simulated_triad(name, np.random.default_rng(71), 2500)
    c = calibrate_reference(readings, truth)
    np.testing.assert_allclose(c.rms, after, rtol=0.06)
    rms = np.sqrt(np.mean((readings - truth) ** 2, axis=0))
    # What went in is not printed, so the error before is reproduced to a factor: its size and its order by axes.
    assert np.all((rms > 0.5 * before) & (rms < 3.0 * before))
    np.testing.assert_allclose(c.matrix, PRINTED[name][0], atol=8.0 * float(np.max(after)) / np.sqrt(2500.0) / 0.2)


@pytest.mark.parametrize("name", sorted(PRINTED))
def test_twelve_parameters_lie_in_their_intervals(name):
    rng = np.random.default_rng(72)
    matrix = np.array(PRINTED[name][0])
    inverse = matrix[:, :3]
    gain = np.linalg.inv(inverse)
    bias, k = -gain @ matrix[:, 3], 1.0 / np.diag(inverse)
    K = np.diag(k)
    T = inverse @ K
    # 6.3 as corrected: T = [[1, -yz, zy], [xz, 1, -zx], [-xy, yx, 1]].
    truth = np.concatenate((bias, k, [-T[0, 1], T[0, 2], T[1, 0], -T[1, 2], -T[2, 0], T[2, 1]]))
    _, after = PRINTED[name][1:]

    def calibrate():
        _, truth_input, *_ = simulated_triad(name, rng, 60)
        # Errors of equal size on each axis of the readings, as the method takes them.
        return calibrate_reference(truth_input @ gain.T + bias + after * rng.standard_normal((60, 3)), truth_input)

    is_95_percent(coverage(calibrate, truth))


def test_printed_611_gives_another_alpha_yz():
    rng = np.random.default_rng(73)
    T = np.array([[1.0, -0.03, 0.02], [0.04, 1.0, -0.05], [-0.06, 0.07, 1.0]])
    gain = np.diag([2.0, 3.0, 4.0]) @ np.linalg.inv(T)
    x = directions(30, rng)
    c = calibrate_reference(x @ gain.T, x)
    named = dict(zip(c.names, c.values, strict=True))
    assert [named[f"k_{axis}"] for axis in "xyz"] == pytest.approx([2.0, 3.0, 4.0])
    expected = {"yz": 0.03, "zy": 0.02, "xz": 0.04, "zx": 0.05, "xy": 0.06, "yx": 0.07}
    for name, value in expected.items():
        assert named[f"alpha_{name}"] == pytest.approx(value, abs=1e-12)
    # 6.11 prints alpha_yx = -beta2/beta6 for alpha_yz, and again alpha_yx = beta10/beta6: one overwrites the other.
    beta = c.matrix
    assert -beta[0, 1] / beta[1, 1] == pytest.approx(named["alpha_yz"], abs=1e-12)
    assert -beta[0, 1] / beta[1, 1] != pytest.approx(named["alpha_yx"], abs=1e-3)


def test_regressing_truth_on_readings_shrinks_the_gain():
    # 002 eq. 6.16 with a signal only five times its noise; the bias of its slope is noise²/(signal² + noise²).
    rng = np.random.default_rng(74)
    x = rng.standard_normal((20_000, 3))
    y = x + 0.2 * rng.standard_normal(x.shape)
    printed = np.linalg.lstsq(np.column_stack((y, np.ones(len(y)))), x, rcond=None)[0][:3].T
    assert np.trace(printed) / 3.0 == pytest.approx(1.0 / 1.04, abs=0.005)
    assert np.trace(calibrate_reference(y, x).gain) / 3.0 == pytest.approx(1.0, abs=0.005)


def test_references_that_do_not_excite_a_direction_are_refused():
    rng = np.random.default_rng(75)
    x = rng.standard_normal((50, 3)) * [1.0, 1.0, 0.0]
    with pytest.raises(PosesError, match="coplanar"):
        calibrate_reference(x, x)
    with pytest.raises(PosesError, match="5 are needed"):
        calibrate_reference(x[:4], x[:4])
    with pytest.raises(ShapeError):
        calibrate_reference(x, x[:10])
    with pytest.raises(PosesError):
        calibrate_reference(np.zeros((6, 3)), np.zeros((6, 3)))


def test_reference_rates_are_those_of_the_attitude():
    t = np.arange(0.0, 25.0, 0.01)
    euler = np.column_stack((0.5 * np.sin(0.7 * t), 0.4 * np.sin(0.5 * t + 1.0), 0.3 * t + 0.2 * np.sin(0.9 * t)))
    R = euler_to_matrix(*euler.T)
    between = Rotation.from_matrix(np.swapaxes(R[:-2], 1, 2) @ R[2:]).as_rotvec() / 0.02
    noisy = euler + 1e-4 * np.random.default_rng(76).standard_normal(euler.shape)
    np.testing.assert_allclose(reference_rates(t, euler, smoothing=0.0)[5:-5], between[4:-4], atol=2e-4)
    smooth = reference_rates(t[::5], noisy[::5])
    np.testing.assert_allclose(smooth[20:-20], between[4::5][19 : 19 + len(smooth) - 40], atol=3e-3)


@pytest.mark.parametrize(
    ("t", "euler", "error"),
    [
        (np.arange(6.0), np.zeros((5, 3)), ShapeError),
        (np.arange(4.0), np.zeros((4, 3)), TooLittleDataError),
        (np.zeros(6), np.zeros((6, 3)), OrderError),
    ],
)
def test_what_are_no_encoder_angles_is_refused(t, euler, error):
    with pytest.raises(error):
        reference_rates(t, euler)


SOFT = np.array([[1.1, 0.05, 0.1], [0.05, 0.95, -0.08], [0.1, -0.08, 1.02]])


@pytest.mark.parametrize("known", [True, False])
def test_hard_and_soft_iron_lie_in_their_intervals(known):
    rng = np.random.default_rng(77)
    gain = SOFT if known else SOFT / np.linalg.det(SOFT) ** (1.0 / 3.0)
    hard = np.array([5.0, -10.0, 20.0])
    truth = np.concatenate((hard, np.diag(gain), [gain[0, 1], gain[0, 2], gain[1, 2]]))

    def calibrate():
        readings = 48.0 * directions(60, rng) @ gain.T + hard + 0.3 * rng.standard_normal((60, 3))
        return calibrate_field(readings, 48.0 if known else None).calibration

    is_95_percent(coverage(calibrate, truth))


def test_an_unknown_field_leaves_volumes_alone():
    rng = np.random.default_rng(78)
    found = calibrate_field(48.0 * spread_out(200, rng) @ SOFT.T + 3.0)
    assert np.linalg.det(found.calibration.gain) == pytest.approx(1.0)
    assert found.field == pytest.approx(48.0 * np.linalg.det(SOFT) ** (1.0 / 3.0))
    np.testing.assert_allclose(found.semi_axes, 48.0 * np.linalg.svd(SOFT, compute_uv=False), rtol=1e-6)
    assert np.max(np.abs(found.calibration.residuals)) < 1e-6


def test_a_real_hmc5883l_lies_on_its_ellipsoid():
    path = folder("sunsided-mpu6050-hmc5883l") / "full-sphere__hmc5883l_compass.csv.gz"
    found = calibrate_field(np.loadtxt(path, delimiter=",", skiprows=1)[:, 1:])
    np.testing.assert_allclose(found.semi_axes, [0.583, 0.545, 0.474], atol=2e-3)
    np.testing.assert_allclose(found.calibration.bias, [-0.0065, -0.1054, 0.0203], atol=1e-3)
    assert found.calibration.rms / found.field == pytest.approx(0.0046, abs=3e-4)


def test_a_bias_against_temperature_lies_in_its_interval():
    # 002 table 6.5, first test of the gyro: 10 minutes from 20 to 40 °C.
    rng = np.random.default_rng(79)
    slope, intercept = np.array([4.339e-3, 2.039e-2, -5.197e-4]), np.array([0.934, 3.216, 0.153])
    temp = np.linspace(20.0, 40.0, 200)
    inside = np.zeros(3)
    for _ in range(RUNS):
        fit = fit_temperature(temp, np.outer(temp, slope) + intercept + 0.08 * rng.standard_normal((200, 3)))
        interval = fit.interval()
        inside += (interval[:, 0] <= slope) & (slope <= interval[:, 1])
    is_95_percent(inside / RUNS)
    np.testing.assert_allclose(fit.intercept, intercept, atol=0.1)
    np.testing.assert_allclose(fit.bias(np.array([20.0, 40.0])), np.outer([20.0, 40.0], slope) + intercept, atol=0.1)
    # The offset's own variance: at 25 °C, not at the middle of the test.
    assert fit.covariance[0, 0, 0] == pytest.approx(
        fit.covariance[0, 1, 1] * ((temp - temp.mean()) @ (temp - temp.mean()) / 200 + (25.0 - temp.mean()) ** 2)
    )


@pytest.mark.parametrize(
    ("temp", "readings", "error"),
    [
        (np.full(10, 21.0), np.zeros((10, 3)), RangeError),
        (np.arange(2.0), np.zeros((2, 3)), TooLittleDataError),
        (np.arange(9.0), np.zeros((10, 3)), ShapeError),
    ],
)
def test_temperatures_that_say_nothing_are_refused(temp, readings, error):
    with pytest.raises(error):
        fit_temperature(temp, readings)


def test_turn_on_bias_is_the_mean_of_two_seconds():
    rng = np.random.default_rng(80)
    t = np.arange(0.0, 10.0, 0.01)
    bias, sigma = np.radians([1.0, -0.5, 0.2]), np.radians(0.08)
    moving = np.where(t[:, None] < 3.0, 0.0, 1.0)
    squares = []
    for _ in range(200):
        found = turn_on_bias(t, bias + moving + sigma * rng.standard_normal((t.size, 3)))
        squares.append((found.bias - bias) @ np.linalg.solve(found.covariance, found.bias - bias))
    assert found.count == 200
    assert np.mean(squares) == pytest.approx(3.0, abs=4.0 * np.sqrt(6.0 / 200.0))
    matrix = np.array(PRINTED["gyro"][0])
    np.testing.assert_allclose(found.in_body(matrix), matrix[:, :3] @ found.bias)


def test_turn_on_bias_wants_two_seconds_of_rest():
    t = np.arange(0.0, 10.0, 0.01)
    still = np.zeros((t.size, 3))
    with pytest.raises(RangeError, match="moved"):
        turn_on_bias(t, still + 0.3 * np.sin(5.0 * t)[:, None])
    with pytest.raises(TooLittleDataError):
        turn_on_bias(t[:150], still[:150])
    with pytest.raises(TooLittleDataError):
        turn_on_bias(t[:0], still[:0])
    with pytest.raises(ShapeError):
        turn_on_bias(t[:5], still)
    assert turn_on_bias(t[:200], still[:200]).count == 200


def test_rest_is_told_from_motion():
    rng = np.random.default_rng(81)
    t = np.arange(0.0, 60.0, 0.01)
    moving = ((t > 10.0) & (t < 20.0)) | ((t > 30.0) & (t < 31.0))
    f = 0.02 * rng.standard_normal((t.size, 3)) + np.where(moving, np.sin(9.0 * t), 0.0)[:, None]
    spans = static_intervals(t, f)
    assert len(spans) == 3
    np.testing.assert_allclose(t[spans[:, 0]], [0.0, 20.5, 31.5], atol=0.15)
    np.testing.assert_allclose(t[spans[:, 1] - 1], [9.5, 29.5, 59.99], atol=0.15)
    means = interval_means(f, spans)
    np.testing.assert_allclose(means.mean, 0.0, atol=0.005)
    np.testing.assert_allclose(means.deviation, 0.02, rtol=0.15)
    assert means.count.tolist() == np.diff(spans).ravel().tolist()
    assert static_intervals(t, f, quiet=1e-6).shape == (0, 2)
    assert interval_means(f, static_intervals(t, f, quiet=1e-6)).mean.shape == (0, 3)
    assert len(static_intervals(t, f, shortest=20.0)) == 1


@given(st.integers(2, 30), st.integers(30, 60))
def test_the_moving_spread_is_that_of_each_window(width, size):
    v = np.random.default_rng(size).standard_normal((size, 3)) + 9.0
    spread = moving_spread(v, width)
    for i in (0, width // 2, size // 2, size - 1):
        part = v[max(i - width // 2, 0) : min(i + width - width // 2, size)]
        assert spread[i] == pytest.approx(np.sqrt(part.var(axis=0).sum()), abs=1e-9)


@pytest.mark.parametrize(
    ("t", "options", "error"),
    [
        (np.arange(9.0), {}, ShapeError),
        (np.zeros(10), {}, OrderError),
        (np.arange(10.0), {"factor": 1.0}, RangeError),
        (np.arange(10.0), {"window": 8.0}, TooLittleDataError),
    ],
)
def test_what_cannot_be_watched_is_refused(t, options, error):
    with pytest.raises(error):
        static_intervals(t, np.zeros((10, 3)), **options)
    with pytest.raises(TooLittleDataError):
        static_intervals(np.arange(3.0), np.zeros((3, 3)))
    with pytest.raises(RangeError):
        moving_spread(np.zeros((5, 3)), 6)


def test_levenberg_marquardt_finds_the_bottom_of_a_bent_valley():
    def rosenbrock(x):
        return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]), np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])

    found = levenberg_marquardt(rosenbrock, np.array([-1.2, 1.0]))
    np.testing.assert_allclose(found.x, [1.0, 1.0], atol=1e-9)
    assert found.iterations < 60


def test_levenberg_marquardt_stops_where_no_step_helps():
    def uphill(x):
        return np.array([np.exp(float(np.clip(x[0], -50.0, 50.0)))]), np.array([[-1.0]])

    assert levenberg_marquardt(uphill, np.zeros(1)).iterations <= 100
