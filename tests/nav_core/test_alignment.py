"""Alignment against scipy, the thesis' own formulas, and many noisy runs; honest where there is no heading."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from nav_core import alignment, kalman
from nav_core.earth import RATE, MagneticField, earth_rate
from nav_core.errors import RangeError, ShapeError, TooLittleDataError
from nav_core.records import Inertial
from nav_core.rotation import angle_between, error_between, euler_to_matrix, matrix_to_euler

G = 9.81
FIELD = np.array([22.0, 1.5, 41.0])
"""Central Italy, µT."""
LAT = np.radians(41.1)
DOWN = np.array([0.0, 0.0, 1.0])
DEGREE = np.radians(1.0)
PER_HOUR = DEGREE / 3600.0

ANGLES = st.floats(-np.pi, np.pi)
PITCHES = st.floats(-1.5, 1.5)
SEEDS = st.integers(0, 2**32 - 1)
examples = settings(deadline=None, max_examples=60)


def turned(seed: int):
    return Rotation.random(random_state=seed).as_matrix()


def felt(R_ta):
    """Specific force and magnetic field in the A axes at rest."""
    return R_ta.T @ (-G * DOWN), R_ta.T @ FIELD


# Levelling ----------------------------------------------------------------------------------------------------


@examples
@given(roll=ANGLES, pitch=PITCHES, yaw=ANGLES)
def test_levelling_finds_roll_and_pitch_any_way_up(roll, pitch, yaw):
    f, _ = felt(euler_to_matrix(roll, pitch, yaw))
    found = alignment.level(f, gravity=G, sigma=0.02)
    assert np.exp(1j * np.array([found.roll, found.pitch])) == pytest.approx(
        np.exp(1j * np.array([roll, pitch])), abs=1e-9
    )
    assert found.R_ta @ f == pytest.approx([0.0, 0.0, -G], abs=1e-9)
    assert abs(found.excess) < 1e-9


def test_a_box_at_rest_and_level_has_no_tilt():
    found = alignment.level(np.array([0.0, 0.0, -G]), gravity=G, sigma=0.02)
    assert (found.roll, found.pitch) == (0.0, 0.0)


def test_nose_up_is_positive_pitch_and_right_side_down_positive_roll():
    """The reaction to gravity points up: with the nose up it has a forward part, right side down a leftward one."""
    assert alignment.tilt(np.array([1.0, 0.0, -G]))[1] > 0.0
    assert alignment.tilt(np.array([0.0, -1.0, -G]))[0] > 0.0


def test_the_stated_tilt_error_is_the_one_of_many_runs():
    rng = np.random.default_rng(1)
    R_ta = euler_to_matrix(0.4, -0.3, 0.0)
    f, _ = felt(R_ta)
    errors = []
    for _ in range(2000):
        found = alignment.level(f + 0.05 * rng.standard_normal(3), gravity=G, sigma=0.05)
        errors.append((found.R_ta @ f)[:2] / G)
    assert np.std(errors, axis=0) == pytest.approx(found.sigma, rel=0.05)


def test_what_is_not_rest_is_refused_with_its_numbers():
    with pytest.raises(RangeError, match=r"specific force is 12, expected 9.81 ± 10% m/s² at rest"):
        alignment.level(np.array([0.0, 0.0, -12.0]), gravity=G, sigma=0.02)


def test_table_71_goes_by_the_sign_of_g_z():
    """000 table 7.1 heads its column g_x: that would turn a level box nose down on its head."""
    roll, pitch = 2.8, -0.4
    g = -felt(euler_to_matrix(roll, pitch, 0.0))[0]
    plain = np.arcsin(g[1] / (G * np.cos(np.arcsin(-g[0] / G))))
    assert alignment.tilt(-g)[0] == pytest.approx(roll)
    by_z = plain if g[2] > 0.0 else np.sign(g[1]) * np.pi - plain
    by_x = plain if g[0] > 0.0 else np.sign(g[1]) * np.pi - plain
    assert by_z == pytest.approx(roll)
    assert abs(by_x - roll) > 1.0


# Gyrocompassing -----------------------------------------------------------------------------------------------

NAVIGATION_GRADE = {"sigma_f": 5e-4, "sigma_w": 0.01 * PER_HOUR}


def compass(R_ta, *, f_error=0.0, w_error=0.0, lat=LAT, limit=DEGREE, **grade):
    f = R_ta.T @ (-G * DOWN) + f_error
    w = R_ta.T @ earth_rate(lat) + w_error
    return alignment.gyrocompass(f, w, lat=lat, gravity=G, limit=limit, **(NAVIGATION_GRADE | grade))


@examples
@given(seed=SEEDS, lat=st.floats(-1.3, 1.3))
def test_exact_sensors_give_the_attitude(seed, lat):
    R_ta = turned(seed)
    found = compass(R_ta, lat=lat)
    assert found.status == "observable"
    assert found.attitude is not None
    assert angle_between(found.attitude.R_ta, R_ta) < 1e-6


@examples
@given(seed=SEEDS)
def test_the_direct_cosines_of_the_lecture(seed):
    """004's C_11 .. C_33, which are C from n to b; its Euler formulas want the transpose."""
    R_ta = turned(seed)
    f, w = R_ta.T @ (-G * DOWN), R_ta.T @ earth_rate(LAT)
    C = np.empty((3, 3))
    C[:, 2] = -f / G
    C[:, 0] = w / (RATE * np.cos(LAT)) - f / G * np.tan(LAT)
    C[0, 1] = C[1, 2] * C[2, 0] - C[1, 0] * C[2, 2]
    C[1, 1] = C[0, 0] * C[2, 2] - C[0, 2] * C[2, 0]
    C[2, 1] = C[0, 2] * C[1, 0] - C[0, 0] * C[1, 2]
    found = compass(R_ta)
    assert found.attitude is not None
    assert found.attitude.R_ta == pytest.approx(C.T, abs=1e-8)


def test_the_lectures_euler_formulas_want_the_transpose():
    roll, pitch, yaw = 0.5, 0.3, 1.2
    C_bn = euler_to_matrix(roll, pitch, yaw)
    C_nb = C_bn.T  # what 004's alignment yields
    assert np.arctan2(C_bn[2, 1], C_bn[2, 2]) == pytest.approx(roll)
    assert np.arctan(C_nb[2, 1] / C_nb[2, 2]) != pytest.approx(roll, abs=0.1)
    upside_down = euler_to_matrix(2.5, pitch, yaw)
    assert np.arctan(upside_down[2, 1] / upside_down[2, 2]) != pytest.approx(2.5, abs=0.1)
    assert matrix_to_euler(upside_down)[0] == pytest.approx(2.5)


def test_the_stated_heading_error_is_the_one_of_many_runs():
    rng = np.random.default_rng(2)
    R_ta = turned(7)
    grade = {"sigma_f": 0.02, "sigma_w": 0.2 * PER_HOUR}
    squares, yaws = [], []
    for _ in range(800):
        found = compass(
            R_ta,
            f_error=grade["sigma_f"] * rng.standard_normal(3),
            w_error=grade["sigma_w"] * rng.standard_normal(3),
            limit=1.0,
            **grade,
        )
        if found.attitude is not None:
            error = error_between(found.attitude.R_ta, R_ta)
            squares.append(kalman.normalised(error, found.attitude.covariance))
            yaws.append(error[2])
    assert len(squares) > 790
    lower, upper = kalman.mean_band(3, len(squares), 0.999)
    assert lower < np.mean(squares) < upper
    assert np.std(yaws) == pytest.approx(found.sigma_yaw, rel=0.08)


def test_a_mems_gyro_has_no_heading_and_says_why():
    """MPU-6050: 0.1 °/s of bias left, 8 mdeg/s/√Hz, ten minutes at rest."""
    sigma_w = alignment.mean_sigma(np.radians(0.1), np.radians(8e-3), 600.0)
    found = compass(turned(3), sigma_f=0.02, sigma_w=sigma_w, limit=np.radians(5.0))
    assert found.status == "unobservable"
    assert found.attitude is None
    assert found.sigma_yaw > 10.0
    assert found.horizontal_rate / PER_HOUR == pytest.approx(15.041 * np.cos(LAT), rel=1e-3)
    assert found.sigma_rate / PER_HOUR == pytest.approx(360.0, rel=0.01)
    assert found.needed_rate == pytest.approx(found.horizontal_rate * np.radians(5.0), rel=0.01)
    assert "11.3 °/h" in found.reasons[0].text
    assert "360.0 °/h" in found.reasons[0].text


def test_averaging_helps_until_the_bias_is_reached():
    sigmas = [alignment.mean_sigma(1e-5, 1e-3, duration) for duration in (1.0, 1e4, 1e8)]
    assert sigmas == pytest.approx([1e-3, np.sqrt(2.0) * 1e-5, 1e-5], rel=1e-2)


def test_near_the_pole_there_is_no_north_to_find():
    assert compass(turned(1), lat=np.radians(89.9)).status == "unobservable"


def test_a_box_that_turned_is_told_from_the_earth():
    found = compass(turned(5), w_error=np.array([0.0, 0.0, 40.0 * PER_HOUR]))
    assert found.status == "disturbed"
    assert found.attitude is None
    assert "the Earth gives 15.0 °/h" in found.reasons[0].text


# Two directions and more --------------------------------------------------------------------------------------


@examples
@given(seed=SEEDS)
def test_triad_is_scipys_with_an_infinite_weight(seed):
    rng = np.random.default_rng(seed)
    R_ta = turned(seed)
    t = rng.standard_normal((2, 3))
    a = t @ R_ta + 0.05 * rng.standard_normal((2, 3))
    ours = alignment.triad(a[0], a[1], t[0], t[1], sigma_master=0.01, sigma_slave=0.01)
    theirs, _ = Rotation.align_vectors(t, a, weights=[np.inf, 1.0])
    assert angle_between(ours.R_ta, theirs.as_matrix()) < 1e-6


@examples
@given(seed=SEEDS, count=st.integers(2, 6))
def test_wahba_is_scipys(seed, count):
    rng = np.random.default_rng(seed)
    R_ta = turned(seed)
    t = rng.standard_normal((count, 3))
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    a = t @ R_ta + 0.05 * rng.standard_normal((count, 3))
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    sigmas = rng.uniform(0.02, 0.2, count)
    ours = alignment.wahba(a, t, sigmas)
    theirs, rssd = Rotation.align_vectors(t, a, weights=1.0 / sigmas**2)
    assert angle_between(ours.attitude.R_ta, theirs.as_matrix()) < 1e-6
    assert ours.chi2 == pytest.approx(rssd**2, rel=1e-6, abs=1e-9)
    assert ours.freedom == 2 * count - 3


@examples
@given(seed=SEEDS, exchange=SEEDS)
def test_turning_the_box_turns_the_answer(seed, exchange):
    rng = np.random.default_rng(seed)
    t, a = rng.standard_normal((3, 3)), rng.standard_normal((3, 3))
    turn = turned(exchange)
    sigmas = np.array([0.01, 0.02, 0.05])
    before, after = alignment.wahba(a, t, sigmas), alignment.wahba(a @ turn.T, t, sigmas)
    assert after.attitude.R_ta @ turn == pytest.approx(before.attitude.R_ta, abs=1e-6)
    assert after.attitude.covariance == pytest.approx(before.attitude.covariance)


@pytest.mark.parametrize("method", ["triad", "wahba"])
def test_the_stated_covariance_of_directions(method):
    rng = np.random.default_rng(3)
    R_ta = turned(9)
    t = np.array([[0.0, 0.0, 1.0], FIELD / np.linalg.norm(FIELD)])
    sigmas = np.array([0.003, 0.02])
    squares = []
    for _ in range(800):
        a = t @ R_ta + sigmas[:, None] * rng.standard_normal((2, 3))
        if method == "triad":
            found = alignment.triad(a[0], a[1], t[0], t[1], sigma_master=sigmas[0], sigma_slave=sigmas[1])
        else:
            found = alignment.wahba(a, t, sigmas).attitude
        squares.append(kalman.normalised(error_between(found.R_ta, R_ta), found.covariance))
    lower, upper = kalman.mean_band(3, 800, 0.999)
    assert lower < np.mean(squares) < upper


# Gravity and field --------------------------------------------------------------------------------------------


def master(R_ta, f_error=0.0, m_error=0.0):
    f, m = felt(R_ta)
    declination = float(np.arctan2(FIELD[1], FIELD[0]))
    return alignment.master_slave(f + f_error, m + m_error, declination=declination, sigma_f=0.03, sigma_m=0.4)


def fitted(R_ta, f_error=0.0, m_error=0.0, **options):
    f, m = felt(R_ta)
    return alignment.gauss_newton(
        f + f_error, m + m_error, **({"gravity": G, "field": FIELD, "sigma_f": 0.03, "sigma_m": 0.4} | options)
    )


@examples
@given(roll=ANGLES, pitch=PITCHES, yaw=ANGLES)
def test_gravity_and_field_give_the_attitude_all_around(roll, pitch, yaw):
    R_ta = euler_to_matrix(roll, pitch, yaw)
    assert angle_between(master(R_ta).R_ta, R_ta) < 1e-7
    found = fitted(R_ta)
    assert found.converged
    assert angle_between(found.attitude.R_ta, R_ta) < 1e-7
    assert np.exp(1j * master(R_ta).euler) == pytest.approx(np.exp(1j * np.array([roll, pitch, yaw])), abs=1e-6)


def test_the_declination_is_added():
    """000 eq. 7.6.16: true heading = magnetic heading + declination."""
    f, m = felt(np.eye(3))
    facing_magnetic_north = alignment.master_slave(
        f, np.array([22.0, 0.0, 41.0]), declination=0.1, sigma_f=0.03, sigma_m=0.4
    )
    assert facing_magnetic_north.euler[2] == pytest.approx(0.1)
    assert m[1] > 0.0


def quaternion_step(q, y_vl, y_b):
    """One step of 7.6.9 with four quaternion components (a, b, c, d), six residuals, correct direction."""

    def residual(q):
        a, b, c, d = q
        R = np.array(
            [
                [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
                [2 * (b * c + a * d), a * a - b * b + c * c - d * d, 2 * (c * d - a * b)],
                [2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d],
            ]
        )
        # 2.6.42 takes body to navigation: transposed it takes y_VL to the body.
        return np.concatenate([R.T @ y_vl[:3], R.T @ y_vl[3:]]) - y_b

    A = kalman.jacobian(residual, q)
    return q - np.linalg.lstsq(A, residual(q), rcond=None)[0], R_of(q)


def R_of(q):
    a, b, c, d = q
    return Rotation.from_quat([b, c, d, a]).as_matrix()


def test_the_four_parameter_iteration_of_the_thesis_ends_at_the_same_attitude():
    R_ta = euler_to_matrix(0.3, -0.2, 1.1)
    f, m = felt(R_ta)
    y_vl, y_b = np.concatenate([G * DOWN, FIELD]), np.concatenate([-f, m])
    x, y, z, w = Rotation.from_matrix(euler_to_matrix(0.2, -0.1, 0.9)).as_quat()
    q = np.array([w, x, y, z])
    for _ in range(15):
        q, _ = quaternion_step(q, y_vl, y_b)
    assert angle_between(R_of(q), fitted(R_ta).attitude.R_ta) < 1e-6


def test_the_quoted_matrix_goes_the_other_way():
    """7.6.4 quotes 2.6.42 as navigation to body; it is body to navigation."""
    R_ta = euler_to_matrix(0.3, -0.2, 1.1)
    _, m = felt(R_ta)
    assert pytest.approx(m) == R_ta.T @ FIELD
    assert R_ta @ FIELD != pytest.approx(m, abs=1.0)


def test_gauss_newton_is_wahba():
    rng = np.random.default_rng(4)
    R_ta = turned(2)
    f, m = felt(R_ta)
    f, m = f + 0.03 * rng.standard_normal(3), m + 0.4 * rng.standard_normal(3)
    found = alignment.gauss_newton(f, m, gravity=G, field=FIELD, sigma_f=0.03, sigma_m=0.4)
    strength = np.linalg.norm(FIELD)
    # Lengths do not turn anything; they weigh a direction in proportion.
    sigmas = np.array([0.03 / np.sqrt(G * np.linalg.norm(f)), 0.4 / np.sqrt(strength * np.linalg.norm(m))])
    best = alignment.wahba(np.array([-f, m]), np.array([DOWN, FIELD]), sigmas)
    assert angle_between(found.attitude.R_ta, best.attitude.R_ta) < 1e-7


def test_errors_of_both_methods_are_as_stated():
    rng = np.random.default_rng(5)
    R_ta = turned(4)
    masters, fits, chi2s = [], [], []
    for _ in range(600):
        noise = 0.03 * rng.standard_normal(3), 0.4 * rng.standard_normal(3)
        found = master(R_ta, *noise)
        masters.append(kalman.normalised(error_between(found.R_ta, R_ta), found.covariance))
        fit = fitted(R_ta, *noise)
        fits.append(kalman.normalised(error_between(fit.attitude.R_ta, R_ta), fit.attitude.covariance))
        chi2s.append(fit.chi2)
    lower, upper = kalman.mean_band(3, 600, 0.999)
    for squares in (masters, fits, chi2s):
        assert lower < np.mean(squares) < upper


def test_weights_keep_the_field_from_spoiling_the_tilt():
    """Unweighted, 48 µT count 24 times as much as 9.8 m/s²: a disturbed field tilts the box."""
    R_ta = euler_to_matrix(0.1, 0.2, 0.3)
    disturbance = R_ta.T @ np.array([0.0, 0.0, 6.0]) + np.array([2.0, -3.0, 1.0])
    weighted = fitted(R_ta, 0.0, disturbance)
    plain = fitted(R_ta, 0.0, disturbance, sigma_f=1.0, sigma_m=1.0)
    tilts = [np.linalg.norm(error_between(found.attitude.R_ta, R_ta)[:2]) for found in (weighted, plain)]
    assert tilts[0] < 0.2 * tilts[1]


def test_in_manoeuvres_the_weighted_fit_suffers_less_than_the_master():
    """000 section 7.6.3, with horizontal accelerations of 1 m/s² that gravity's weight knows of."""
    rng = np.random.default_rng(6)
    errors = []
    for seed in range(200):
        R_ta = turned(seed)
        push = R_ta.T @ np.append(rng.standard_normal(2), 0.0)
        both = fitted(R_ta, push, sigma_f=1.0).attitude.R_ta
        errors.append([angle_between(master(R_ta, push).R_ta, R_ta), angle_between(both, R_ta)])
    ruled, weighted = np.sqrt(np.mean(np.square(errors), axis=0))
    assert weighted < 0.95 * ruled


def test_a_start_turned_about_is_a_stationary_point_and_shows_in_the_residuals():
    """Why the iteration begins with master and slave (000 section 7.6.3)."""
    about = fitted(np.eye(3), start=np.diag([-1.0, -1.0, 1.0]))
    assert about.converged
    assert angle_between(about.attitude.R_ta, np.eye(3)) == pytest.approx(np.pi)
    assert about.chi2 > 1e4
    near = fitted(np.eye(3), start=euler_to_matrix(0.4, -0.4, 0.5))
    assert near.rounds <= 10
    assert near.chi2 < 1e-9
    assert not fitted(np.eye(3), start=euler_to_matrix(0.4, -0.4, 0.5), most_rounds=2).converged


# A recording ---------------------------------------------------------------------------------------------------


def recording(*, busy=None, w=None, seconds=30.0):
    """A level box, restless where `busy` says, with a gyro where `w` says."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, seconds, 0.02)
    f = np.array([0.0, 0.0, -G]) + 0.02 * rng.standard_normal((t.size, 3))
    if busy is not None:
        f[busy(t)] += 3.0 * rng.standard_normal((int(busy(t).sum()), 3))
    rates = None
    if w is not None:
        rates = np.where(w(t)[:, None], 1e-3 * rng.standard_normal((t.size, 3)), np.nan)
    return Inertial(t=t, f=f, w=rates)


def test_rests_of_a_second_are_no_rest():
    found = alignment.align(recording(busy=lambda t: t % 3.0 > 1.2))
    assert found.rest is None
    assert [reason.code for reason in found.reasons] == ["no_rest"]


@pytest.mark.parametrize("sampled", [lambda t: t < 0.0, lambda t: t < 5.3, lambda t: (t > 7.0) & (t < 7.5)])
def test_a_gyro_that_hardly_spoke_at_rest_is_none(sampled):
    found = alignment.align(recording(busy=lambda t: t < 5.0, w=sampled), place=alignment.Place(lat=LAT, height=0.0))
    assert found.rest is not None
    assert found.compass is None
    assert "no_gyro" in [reason.code for reason in found.reasons]


def test_a_gyro_that_missed_samples_is_averaged_over_the_others():
    found = alignment.align(recording(w=lambda t: t % 1.0 < 0.3), place=alignment.Place(lat=LAT, height=0.0))
    assert found.compass is not None
    assert found.compass.status == "unobservable"
    assert found.rest is not None
    assert found.rest.w_noise == pytest.approx(1e-3 / np.sqrt(450.0), rel=0.4)


def magnetic(field, heading=0.7, *, iron=0.0):
    """A level box heading `heading`, its magnetometer beside iron that adds `iron` µT along x."""
    given = recording(w=lambda t: t >= 0.0)
    R_ta = euler_to_matrix(0.0, 0.0, heading)
    rng = np.random.default_rng(2)
    m = field @ R_ta + np.array([iron, 0.0, 0.0]) + 0.1 * rng.standard_normal((given.t.size, 3))
    return Inertial(t=given.t, f=given.f, w=given.w, m=m)


def test_the_magnetic_field_at_rest_gives_the_heading():
    known = MagneticField(*FIELD)
    found = alignment.align(magnetic(FIELD), field=known, place=alignment.Place(lat=LAT, height=0.0))
    assert found.source == "magnetic"
    assert found.best is not None
    assert matrix_to_euler(found.best.R_ta)[2] == pytest.approx(0.7, abs=3.0 * found.best.sigma[2])
    assert found.best.sigma[2] < 5.0 * DEGREE


@pytest.mark.parametrize(
    ("true", "known", "iron", "place", "code"),
    [
        (FIELD, MagneticField(*FIELD), 30.0, None, "field_disturbed"),
        (np.array([1.5, 0.0, 55.0]), MagneticField(1.5, 0.0, 55.0), 0.0, None, "field_steep"),
        (FIELD, None, 0.0, None, "no_field_model"),
        (FIELD, MagneticField(*FIELD), 0.0, None, "no_place"),
    ],
)
def test_why_there_is_no_heading_is_said(true, known, iron, place, code):
    found = alignment.align(magnetic(true, iron=iron), field=known, place=place)
    assert code in [reason.code for reason in found.reasons]
    assert found.source == ("magnetic" if code == "no_place" else None)


# Refusals -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "error"),
    [
        (lambda: alignment.triad(DOWN, DOWN, DOWN, FIELD, sigma_master=1.0, sigma_slave=1.0), RangeError),
        (lambda: alignment.triad(0.0 * DOWN, FIELD, DOWN, FIELD, sigma_master=1.0, sigma_slave=1.0), RangeError),
        (lambda: alignment.wahba(np.eye(3)[:1], np.eye(3)[:1], np.ones(1)), TooLittleDataError),
        (lambda: alignment.wahba(np.ones((3, 3)), np.ones((3, 3)), np.ones(3)), RangeError),
        (lambda: alignment.wahba(np.eye(3), np.eye(3), np.ones(2)), ShapeError),
        (lambda: alignment.wahba(np.eye(3), np.eye(3)[:2], np.ones(3)), ShapeError),
        (lambda: alignment.level(np.zeros(2), gravity=G, sigma=0.1), ShapeError),
        (lambda: alignment.mean_sigma(1.0, 1.0, 0.0), RangeError),
        (lambda: alignment.master_slave(DOWN, 0.0 * DOWN, declination=0.0, sigma_f=1.0, sigma_m=1.0), RangeError),
        (lambda: alignment.master_slave(DOWN, DOWN, declination=0.0, sigma_f=1.0, sigma_m=1.0), RangeError),
        (lambda: fitted(np.eye(3), field=DOWN, start=np.eye(3)), RangeError),
        (lambda: alignment.align(recording(seconds=0.06)), TooLittleDataError),
    ],
)
def test_what_has_no_meaning_is_refused(wrong, error):
    with pytest.raises(error):
        wrong()
