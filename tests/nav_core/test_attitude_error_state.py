"""The error-state attitude filter: its matrices, its steps, and the scenarios of 002 chapter 9."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nav_core import kalman
from nav_core.attitude.error_state import (
    Direction,
    GyroNoise,
    Start,
    StarTracker,
    estimate,
    mean_rates,
    process_noise,
    transition,
)
from nav_core.errors import NotFiniteError, RangeError, ShapeError
from nav_core.processes import van_loan
from nav_core.rotation import product, quaternion_to_matrix, quaternion_to_rotvec, rotvec_to_quaternion, skew
from nav_core.sensors.noise import NoiseCoefficients
from nav_core.simulate import platform, platform_studies
from nav_core.simulate.platform import GRAVITY_REACTION, PADUA_FIELD, Instruments

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
examples = settings(deadline=None, max_examples=30)
RATES = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)

TABLE_9_1 = [
    (180.0, [4.00, 7.33, 8.09], None),
    (180.0, [7.05, 8.56, 12.84], None),
    (180.0, [5.11, 5.50, 11.08], None),
    (600.0, [2.28, 2.27, 3.84], 120.0),
]
TABLE_9_2 = [[0.071, 0.079, 0.077], [0.080, 0.086, 0.117], [0.066, 0.046, 0.089], [0.030, 0.025, 0.019]]
TABLE_9_3 = [[0.140, 0.137, 0.117], [0.189, 0.165, 0.137], [0.126, 0.124, 0.112], [0.090, 0.105, 0.077]]
TABLE_9_4 = [[0.091, 0.072, 1.012], [0.096, 0.100, 0.804], [0.081, 0.067, 0.328], [0.127, 0.033, 1.324]]
# The filter in the microcontroller, 180 s each: rates of the motion in tables 9.6 and 9.8, errors in 9.7 and 9.9.
TABLE_9_6 = [[5.475, 6.904, 6.969], [5.141, 7.073, 6.040], [5.827, 7.294, 6.359], [6.807, 7.922, 8.070]]
TABLE_9_7 = [[0.062, 0.049, 0.058], [0.063, 0.048, 0.039], [0.059, 0.052, 0.057], [0.068, 0.058, 0.047]]
TABLE_9_8 = [[6.136, 7.709, 6.392], [5.550, 7.816, 6.761], [4.398, 7.342, 7.503], [3.901, 6.000, 7.662]]
TABLE_9_9 = [[0.116, 0.065, 0.421], [0.111, 0.082, 1.074], [0.099, 0.106, 1.067], [0.067, 0.061, 1.155]]


# Matrices -------------------------------------------------------------------------------------------------------


@examples
@given(w=RATES, dt=st.sampled_from([1e-4, 0.01, 0.1, 0.5]))
def test_the_exact_matrices_are_van_loans(w, dt):
    noise = GyroNoise(0.1, 0.3)
    F = np.zeros((6, 6))
    F[:3, :3], F[:3, 3:] = -skew(w), -np.eye(3)
    expected = van_loan(F, np.diag(np.repeat([noise.N**2, noise.K**2], 3)), dt)
    assert transition(w, dt) == pytest.approx(expected.Phi, abs=1e-13)
    assert process_noise(w, dt, noise) == pytest.approx(expected.Q, rel=1e-11, abs=1e-15)


def test_the_printed_bracket_and_sign_of_727_and_728_are_others():
    w, dt, noise = np.array([1.0, -2.0, 2.0]), 0.3, GyroNoise(0.0, 1.0)
    x, W = 3.0 * dt, skew(w)
    printed_11 = np.eye(3) * dt**3 / 3 + x**3 / 3 + (2 * np.sin(x) - 2 * x) / 3.0**5 * W @ W
    printed_12 = -(np.eye(3) * dt**2 / 2 + (x - np.sin(x)) / 27.0 * W + (x * x / 2 + np.cos(x) - 1) / 81.0 * W @ W)
    Q = process_noise(w, dt, noise)
    assert np.abs(Q[:3, :3] - printed_11).max() > 0.1
    assert np.abs(Q[:3, 3:] - printed_12).max() > 1e-3
    corrected_12 = printed_12 + 2.0 * (x - np.sin(x)) / 27.0 * W
    assert Q[:3, 3:] == pytest.approx(corrected_12, abs=1e-13)


def test_the_approximate_matrices_are_the_first_order_of_the_exact():
    w, noise = np.radians([20.0, -30.0, 10.0]), GyroNoise(1e-4, 1e-5)
    for dt, bound in ((0.01, 3e-5), (0.005, 8e-6)):
        difference = transition(w, dt) - transition(w, dt, "approximate")
        assert np.abs(difference).max() < bound
    near = process_noise(w, 0.01, noise, "approximate")
    assert near == pytest.approx(process_noise(w, 0.01, noise), rel=1e-2, abs=1e-16)
    # 8.3, 8.5 with N² dt and K² dt; 5.10's N² / dt would give 2.5° of start covariance as 249°.
    assert near[0, 0] == pytest.approx(noise.N**2 * 0.01, rel=1e-4)
    assert near[3, 3] == noise.K**2 * 0.01


# Steps ----------------------------------------------------------------------------------------------------------


def reference(start, w, dt, noise, stars, star_sigma, directions, discretisation):
    """The filter in matrices, jointly (002 eqs. 7.44-7.57)."""
    q, b, P = start.q_nb, start.bias, start.P
    out = []
    for k in range(len(w)):
        rate = w[k] - b
        q = product(q, rotvec_to_quaternion(rate * dt))
        P = kalman.predict(
            np.zeros(6), P, transition(rate, dt, discretisation), process_noise(rate, dt, noise, discretisation)
        ).P
        H, e, r = [np.zeros((0, 6))], [np.zeros(0)], [np.zeros(0)]
        if np.isfinite(stars[k]).all():
            error = product(q * [-1, -1, -1, 1], stars[k])
            H.append(np.eye(3, 6))
            e.append(2.0 * np.sign(error[3]) * error[:3])
            r.append(np.full(3, star_sigma**2))
        for direction in directions:
            expected = quaternion_to_matrix(q).T @ direction.reference
            H.append(np.hstack([skew(expected), np.zeros((3, 3))]))
            e.append(direction.measured[k] - expected)
            r.append(np.full(3, direction.sigma**2))
        H, e, r = np.vstack(H), np.concatenate(e), np.concatenate(r)
        if e.size:
            step = kalman.update(np.zeros(6), P, e, H, np.diag(r))
            half = 0.5 * step.x[:3]
            q = product(q, np.append(half, np.sqrt(1.0 - half @ half)))
            q, b, P = q / np.linalg.norm(q), b + step.x[3:], step.P
        out.append((q, b, P))
    return [np.array(column) for column in zip(*out, strict=True)]


@pytest.mark.parametrize("discretisation", ["exact", "approximate"])
def test_the_kernel_agrees_with_the_matrices(discretisation):
    rng = np.random.default_rng(5)
    truth = platform.by_hand(6.0, 50.0, np.radians([5.0, 7.0, 9.0]), rng)
    readings = platform.measure(truth, Instruments(tracker_period=1.0, turn_on=1e-3), rng)
    noise, w = GyroNoise(2e-4, 3e-5), mean_rates(readings.w)
    start = Start.of(product(truth.q_nb[0], rotvec_to_quaternion([0.02, -0.01, 0.03])), np.zeros(3), 0.03, 1e-3)
    directions = [Direction(GRAVITY_REACTION, readings.f, 0.03), Direction(PADUA_FIELD, readings.m, 2.0)]
    q, b, P = reference(start, w, 0.02, noise, readings.star, 5e-4, directions, discretisation)
    found = estimate(
        start,
        w,
        0.02,
        noise,
        tracker=StarTracker(-readings.star, 5e-4),
        directions=directions,
        discretisation=discretisation,
    )
    assert np.abs(np.sum(found.q_nb * q, axis=1)) == pytest.approx(1.0, abs=1e-12)
    assert found.bias == pytest.approx(b, abs=1e-10)
    assert pytest.approx(P, rel=1e-6, abs=1e-14) == found.P
    assert found.used.sum() == 3 * 6 + 2 * 3 * 300


def test_without_measurements_it_is_the_integration():
    w = np.tile(np.radians([0.0, 0.0, 30.0]), (300, 1))
    found = estimate(Start.of(LEVEL, np.radians([0.0, 0.0, 10.0]), 0.01, 0.001), w, 0.01, GyroNoise(1e-4, 1e-5))
    assert quaternion_to_rotvec(found.q_nb[-1]) == pytest.approx(np.radians([0.0, 0.0, 60.0]), abs=1e-12)
    assert np.all(np.diff(found.P[:, 2, 2]) > 0.0)


def test_a_star_far_off_is_left_out_by_the_gate():
    star = np.tile(rotvec_to_quaternion([0.0, 0.0, 0.5]), (10, 1))
    start, noise = Start.of(LEVEL, np.zeros(3), 1e-3, 1e-4), GyroNoise(1e-4, 1e-5)
    found = estimate(start, np.zeros((10, 3)), 0.01, noise, tracker=StarTracker(star, 1e-3), gate=kalman.gate(1))
    assert found.rejected.tolist() == [1] * 10  # z alone
    assert quaternion_to_rotvec(found.q_nb[-1]) == pytest.approx(np.zeros(3), abs=1e-9)


def test_the_filter_comes_home_from_far():
    rng = np.random.default_rng(2)
    truth = platform.by_hand(30.0, 100.0, np.radians([4.0, 5.0, 6.0]), rng)
    readings = platform.measure(truth, Instruments(turn_on=0.01), rng)
    away = product(truth.q_nb[0], rotvec_to_quaternion([0.5, -0.4, 0.9]))
    start = Start(away, np.zeros(3), np.eye(6))  # 7.40, 7.41
    found = platform_studies.run_terrestrial(start, readings, Instruments(), 100.0)
    assert np.abs(platform_studies.euler_errors(truth.q_nb[1:], found.q_nb))[-500:].max() < np.radians(0.3)


def test_input_is_checked():
    start, noise, w = Start.of(LEVEL, np.zeros(3), 0.1, 0.1), GyroNoise(1e-4, 1e-5), np.zeros((5, 3))
    with pytest.raises(ShapeError, match="w has shape"):
        estimate(start, w[0], 0.01, noise)
    with pytest.raises(RangeError, match="period"):
        estimate(start, w, 0.0, noise)
    with pytest.raises(NotFiniteError, match="index 3"):
        estimate(start, np.where(np.arange(5)[:, None] == 3, np.nan, w), 0.01, noise)
    with pytest.raises(ShapeError, match="measured"):
        estimate(start, w, 0.01, noise, directions=[Direction(PADUA_FIELD, w[1:], 1.0)])
    with pytest.raises(RangeError, match="sigma"):
        estimate(start, w, 0.01, noise, tracker=StarTracker(np.tile(LEVEL, (5, 1)), 0.0))
    with pytest.raises(ShapeError, match="P"):
        estimate(Start(LEVEL, np.zeros(3), np.eye(7)), w, 0.01, noise)
    with pytest.raises(ShapeError, match=r"\(3,\)"):
        transition(np.zeros(4), 0.1)


# The platform ---------------------------------------------------------------------------------------------------


def test_the_platforms_rates_are_the_derivatives_of_its_attitude():
    truth = platform.by_hand(20.0, 200.0, np.radians([5.0, 8.0, 12.0]), np.random.default_rng(3), moving=15.0)
    assert np.degrees(np.sqrt(np.mean(truth.w**2, axis=0))) == pytest.approx([5.0, 8.0, 12.0], rel=0.01)
    turned = quaternion_to_rotvec(product(truth.q_nb[:-1] * [-1, -1, -1, 1], truth.q_nb[1:])) * 200.0
    assert turned == pytest.approx(mean_rates(truth.w), abs=2e-4)
    assert truth.w[truth.t > 15.0] == pytest.approx(0.0, abs=1e-12)
    thrust = platform.thrusters(100.0)
    assert thrust.w[:, 2].max() == pytest.approx(2.5 * 0.1551)
    assert quaternion_to_rotvec(thrust.q_nb[-1]) == pytest.approx([0.0, 0.0, 0.1551 * 6.25])
    with pytest.raises(RangeError, match="pitch"):
        platform.by_hand(20.0, 50.0, np.radians([5.0, 200.0, 5.0]), np.random.default_rng(3))


def by_hand(duration: float, rms: list[float], moving: float | None, instruments: Instruments, key: list[int]):
    """One test by hand: truth, readings and the filter's start."""
    rng = np.random.default_rng(key)
    truth = platform.by_hand(duration, 100.0, np.radians(rms), rng, moving=moving)
    readings = platform.measure(truth, instruments, rng)
    return truth, readings, Start.of(truth.q_nb[0], np.zeros(3), np.radians(0.1), np.radians(0.02))


def euler_squares(truth: np.ndarray, found: np.ndarray) -> np.ndarray:
    return platform_studies.rms(platform_studies.euler_errors(truth, found), 100.0) ** 2


@pytest.mark.parametrize("row", range(4))
def test_errors_are_no_larger_than_tables_92_and_94(row):
    instruments = Instruments(turn_on=np.radians(0.02), encoders=True)
    squares = np.zeros((3, 3))
    for seed in range(4):
        truth, readings, start = by_hand(*TABLE_9_1[row], instruments, [row, seed])
        space = platform_studies.run_space(start, readings, instruments, 100.0)
        ground = platform_studies.run_terrestrial(start, readings, instruments, 100.0)
        # 002 counts the tracker's errors from the encoders, which are the tracker as well.
        yardstick = platform.encoder_attitude(truth.q_nb[1:]) if row == 3 else truth.q_nb[1:]
        squares[0] += euler_squares(yardstick, space.q_nb)
        squares[1] += euler_squares(truth.q_nb[1:], ground.q_nb)
        squares[2] += platform_studies.rms(readings.w[1:] - space.bias - truth.w[1:], 100.0) ** 2
    found = np.degrees(np.sqrt(squares / 4))
    print(f"test {row + 1}: space {found[0].round(4)}, ground {found[1].round(4)}, rates {found[2].round(4)}")
    assert np.all(found[0] <= TABLE_9_2[row])
    assert np.all(found[1] <= TABLE_9_4[row])
    assert np.all(found[2] <= TABLE_9_3[row])


@pytest.mark.parametrize("row", range(4))
def test_errors_are_no_larger_than_the_on_line_tables_97_and_99(row):
    instruments = Instruments(turn_on=np.radians(0.02), encoders=True)
    squares = np.zeros((2, 3))
    for seed in range(2):
        truth, readings, start = by_hand(180.0, TABLE_9_6[row], None, instruments, [97, row, seed])
        space = platform_studies.run_space(start, readings, instruments, 100.0)
        squares[0] += euler_squares(truth.q_nb[1:], space.q_nb)
        truth, readings, start = by_hand(180.0, TABLE_9_8[row], None, instruments, [99, row, seed])
        ground = platform_studies.run_terrestrial(start, readings, instruments, 100.0)
        squares[1] += euler_squares(truth.q_nb[1:], ground.q_nb)
    found = np.degrees(np.sqrt(squares / 2))
    print(f"test {row + 1} on line: space {found[0].round(4)}, ground {found[1].round(4)}")
    assert np.all(found[0] <= TABLE_9_7[row])
    assert np.all(found[1] <= TABLE_9_9[row])


def errors_of(truth, readings, found):
    turn = -2.0 * platform_studies.quaternion_errors(truth.q_nb[1:], found.q_nb)
    return np.hstack([turn, readings.bias[1:] - found.bias])


@pytest.mark.parametrize("scenario", ["space", "terrestrial"])
def test_nees_stays_inside_its_band_over_100_runs(scenario):
    gyro = platform_studies.common(Instruments().gyro)
    instruments = Instruments(
        gyro=[NoiseCoefficients(N=gyro.N, K=gyro.K)] * 3,
        accelerometer=[NoiseCoefficients(N=platform_studies.common(Instruments().accelerometer).N)] * 3,
        magnetometer=[NoiseCoefficients(N=platform_studies.common(Instruments().magnetometer).N)] * 3,
    )
    rng = np.random.default_rng(17)
    run = platform_studies.run_space if scenario == "space" else platform_studies.run_terrestrial
    squares = np.empty((100, 30))
    for i in range(100):
        truth = platform.by_hand(30.0, 100.0, np.radians([5.0, 7.0, 10.0]), rng)
        readings = platform.measure(truth, instruments, rng)
        astray = rotvec_to_quaternion(1e-3 * rng.standard_normal(3))
        bias = readings.bias[0] + 1e-4 * rng.standard_normal(3)
        start = Start.of(product(truth.q_nb[0], astray), bias, 1e-3, 1e-4)
        found = run(start, readings, instruments, 100.0)
        squares[i] = kalman.normalised(errors_of(truth, readings, found)[99::100], found.P[99::100])
    outcome = kalman.consistency(squares, 6)
    print(f"{scenario}: mean {outcome.mean.mean():.3f}, inside {outcome.inside:.2f}")
    # 95 % of the epochs on average, which hang together; the mean over all of them is itself in the band.
    assert outcome.inside >= 0.8
    assert outcome.lower < outcome.mean.mean() < outcome.upper


# Studies --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scenario", ["space", "terrestrial"])
def test_the_error_falls_with_the_frequency_and_the_approximation_costs_nothing(scenario):
    rates = [10, 20, 50, 100, 200]
    rms = platform_studies.accuracy_against_rate(rates, scenario, np.random.default_rng(1), runs=3)
    print(scenario, rms.T)
    assert np.all(np.diff(rms[:, 0]) < 0.0)
    # A sample held over the step is late by half of it: the error is proportional to the period.
    assert rms[0, 0] / rms[3, 0] > 6.0
    assert rms[:, 1] == pytest.approx(rms[:, 0], rel=0.01)
    mean = platform_studies.accuracy_against_rate(rates[:2], scenario, np.random.default_rng(1), runs=3, sample="mean")
    assert np.all(mean < 0.2 * rms[:2])


def test_from_50_hz_on_the_error_is_inside_three_sigma():
    rng = np.random.default_rng(4)
    truth = platform.thrusters(50.0)
    readings = platform.measure(truth, Instruments(), rng)
    start = Start.of(LEVEL, np.zeros(3), platform.ENCODER_SIGMA, 1e-4)
    found = platform_studies.run_space(start, readings, Instruments(), 50.0)
    error = 2.0 * np.abs(platform_studies.quaternion_errors(truth.q_nb[1:], found.q_nb)[:, 2])
    assert np.all(error < 3.0 * np.sqrt(found.P[:, 2, 2]))


def weighed(factors, runs, key, **given):
    """Sum of the quaternion's rms of each run for each factor, (runs, k): the same motions and noises for all."""
    return np.array(
        [
            platform_studies.magnetometer_weight(
                factors, np.random.default_rng([922, key, run]), runs=1, duration=120.0, **given
            ).total
            for run in range(runs)
        ]
    )


def surely_positive(differences):
    """Whether the mean of paired differences lies three of its standard errors above zero."""
    return differences.mean() > 3.0 * differences.std(ddof=1) / np.sqrt(differences.size)


@pytest.mark.slow
def test_a_magnetometer_with_calibration_errors_wants_less_weight():
    total = weighed((1.0, 10.0, 20.0), 24, key=1)
    print("calibration errors:", total.mean(axis=0), "white alone:", end=" ")
    assert surely_positive(total[:, 0] - total[:, 1])
    # What the magnetometer does to the tilt falls as 1 / k²: of the gain until 10, a hundredth is left after it.
    gain, rest = np.diff(-total, axis=1).mean(axis=0)
    assert abs(rest) < 0.2 * gain
    # With white noise alone the factor 1 is the optimum.
    white = weighed((1.0, 10.0), 12, key=2, left=np.zeros(3))
    print(white.mean(axis=0))
    assert surely_positive(white[:, 1] - white[:, 0])


def test_the_references_stand_28_degrees_apart():
    cosine = -GRAVITY_REACTION @ PADUA_FIELD / np.linalg.norm(GRAVITY_REACTION) / np.linalg.norm(PADUA_FIELD)
    assert np.degrees(np.arccos(cosine)) == pytest.approx(28.29, abs=0.005)
