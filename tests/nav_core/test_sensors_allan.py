"""Allan deviation against independent programs, and noise coefficients against the truth of simulations."""

from __future__ import annotations

import gzip
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nav_core.errors import ConstantError, NotFiniteError, RangeError, ShapeError, TooLittleDataError
from nav_core.sensors import (
    HMC5883L,
    MPU6050_ACCELEROMETER,
    MPU6050_GYRO,
    NoiseCoefficients,
    allan_deviation,
    cluster_factors,
    confidence,
    equivalent_freedom,
    flicker,
    identify,
    simulate_noise,
)
from nav_core.sensors.allan import _square_sum, square_sum_reference
from nav_core.sensors.noise import BIAS_PLATEAU
from tests.recordings import folder

FOUR_HOURS, RATE = 4 * 3600, 100.0


def table(path):
    """Averaging factor, printed smallest, printed and printed largest sigma of a Stable32 table."""
    rows = [line.split() for line in path.read_text(encoding="latin-1").splitlines() if line and line[0] != "#"]
    return np.array([[float(row[0]), *map(float, row[-3:])] for row in rows]), [row[-2] for row in rows]


def printed(value):
    return f"{value:.4e}"


def runs(coefficients, count, *, rate, seconds, seed, terms="NBK"):
    rng = np.random.default_rng(seed)
    size = round(seconds * rate)
    return [identify(simulate_noise(coefficients, size, rate, rng), rate, terms=terms) for _ in range(count)]


def covered(fits, truth):
    """Share of the runs in which each coefficient lies in its interval, shape (4,)."""
    low, high = np.array([fit.low for fit in fits]), np.array([fit.high for fit in fits])
    return np.mean((low <= np.array(truth)) & (np.array(truth) <= high), axis=0)


@pytest.mark.parametrize("offset", [0.0, 9.81])
@pytest.mark.parametrize("size", [100, 4097, 100_000])
def test_equals_allantools(size, offset):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import allantools

    x = simulate_noise(MPU6050_GYRO[0], size, RATE, np.random.default_rng(size)) + offset * 1e-3
    ours = allan_deviation(x, RATE)
    _, theirs, _, _ = allantools.oadev(x, rate=RATE, data_type="freq", taus=ours.tau)
    np.testing.assert_allclose(ours.sigma[: len(theirs)], theirs, rtol=1e-9)
    assert len(theirs) >= len(ours.sigma) - 4  # allantools leaves out the longest


@pytest.mark.parametrize("name", ["phase_dat_oadev.txt", "phase_dat_oadev_octave.txt"])
def test_equals_the_printed_table_of_phase_data(name):
    base = folder("allantools-reference") / "phasedat"
    phase = np.loadtxt(base / "PHASE.DAT")
    rows, digits = table(base / name)
    ours = allan_deviation(np.diff(phase), 1.0, factors=rows[:, 0].astype(np.int64))
    assert [printed(sigma) for sigma in ours.sigma] == digits


@pytest.fixture(scope="module")
def oscillator():
    base = folder("allantools-reference") / "ocxo"
    return base, np.loadtxt(gzip.open(base / "ocxo_frequency.txt.gz", "rt", encoding="latin-1"))


def test_equals_the_printed_table_of_an_oscillator(oscillator):
    base, frequency = oscillator
    rows, digits = table(base / "stable32_oadev_alltau.txt")
    ours = allan_deviation((frequency - 1e7) / 1e7, 1.0, factors=rows[:, 0].astype(np.int64))
    assert len(digits) == 273
    assert [printed(sigma) for sigma in ours.sigma] == digits


def test_the_octave_table_of_the_oscillator_holds_rounding_of_its_own(oscillator):
    # It was printed from frequencies near one, whose running sum leaves 4e-12 of rounding: summed so, every printed
    # digit comes out.  Ours are those of the other table.
    base, frequency = oscillator
    rows, digits = table(base / "oadev_octave.txt")
    factors = rows[:, 0].astype(np.int64)
    theta = np.concatenate(([0.0], np.cumsum(frequency / 1e7)))
    rounded = [np.sqrt(square_sum_reference(theta, m) / (theta.size - 2 * m) / 2.0) / m for m in factors.tolist()]
    assert [printed(sigma) for sigma in rounded] == digits
    np.testing.assert_allclose(allan_deviation(frequency / 1e7, 1.0, factors=factors).sigma, rows[:, 2], rtol=1.3e-3)


@given(st.integers(2, 400), st.data())
def test_the_kernel_sums_what_array_code_sums(size, data):
    m = data.draw(st.integers(1, max(size // 2 - 1, 1)))
    theta = np.random.default_rng(size).standard_normal(size + 2700)
    assert _square_sum(theta, m) == pytest.approx(square_sum_reference(theta, m), rel=1e-12)


@given(st.floats(-10.0, 10.0), st.floats(0.01, 100.0))
def test_a_constant_changes_nothing_and_a_unit_scales(offset, unit):
    x = np.random.default_rng(5).standard_normal(300)
    base, moved = allan_deviation(x, 10.0), allan_deviation(unit * (x + offset), 10.0)
    np.testing.assert_allclose(moved.sigma, unit * base.sigma, rtol=1e-9)


def test_a_ramp_has_the_known_deviation():
    # A rate ramp R: the means of neighbouring clusters differ by R tau, so sigma = R tau / sqrt(2).
    curve = allan_deviation(0.3 * np.arange(1000) / 50.0, 50.0)
    np.testing.assert_allclose(curve.sigma, 0.3 * curve.tau / np.sqrt(2.0), rtol=1e-9)


def test_factors_are_octaves_and_between():
    factors = cluster_factors(5000)
    assert set(2 ** np.arange(12)) <= set(factors.tolist())
    assert factors.max() <= 2500
    assert np.all(np.diff(factors) > 0)
    assert cluster_factors(1).tolist() == [1]


@pytest.mark.parametrize(
    ("x", "rate", "factors", "error"),
    [
        (np.zeros((4, 2)), 1.0, None, ShapeError),
        (np.zeros(2), 1.0, None, TooLittleDataError),
        (np.array([1.0, np.nan, 2.0, 3.0]), 1.0, None, NotFiniteError),
        (np.zeros(10), 0.0, None, RangeError),
        (np.zeros(10), 1.0, [6], RangeError),
        (np.zeros(10), 1.0, [0], RangeError),
    ],
)
def test_what_is_no_recording_is_refused(x, rate, factors, error):
    with pytest.raises(error):
        allan_deviation(x, rate, factors=factors)


def test_the_band_is_stable32s_to_a_few_percent():
    # Stable32 takes phase that is smoothed over a period; ours is a sum of means, so short clusters differ a little.
    base = folder("allantools-reference") / "phasedat"
    rows, _ = table(base / "phase_dat_oadev_octave.txt")
    curve = allan_deviation(np.diff(np.loadtxt(base / "PHASE.DAT")), 1.0, factors=rows[:, 0].astype(np.int64))
    low, high = confidence(curve, equivalent_freedom(curve, NoiseCoefficients(N=1.0)), 0.683)
    np.testing.assert_allclose(low, rows[:, 1], rtol=0.01)
    np.testing.assert_allclose(high, rows[:, 3], rtol=0.01)


@pytest.mark.parametrize(("name", "alpha"), [("Q", 2), ("N", 0), ("B", -1), ("K", -2)])
def test_degrees_of_freedom_of_a_power_law(name, alpha):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from allantools.ci import edf_greenhall
    size = 4096
    curve = allan_deviation(np.random.default_rng(0).standard_normal(size), 1.0, factors=2 ** np.arange(4, 11))
    ours = equivalent_freedom(curve, NoiseCoefficients(**{name: 1e-5}))
    theirs = [edf_greenhall(alpha, 2, int(m), size + 1, overlapping=True) for m in curve.factor]
    np.testing.assert_allclose(ours, theirs, rtol=0.1)


def test_degrees_of_freedom_are_those_of_simulations():
    truth = NoiseCoefficients(N=1.0, B=0.3, K=0.05)
    rng = np.random.default_rng(1)
    factors = 2 ** np.arange(10)
    curves = [allan_deviation(simulate_noise(truth, 4096, 1.0, rng), 1.0, factors=factors) for _ in range(600)]
    variances = np.array([curve.sigma for curve in curves]) ** 2
    found = 2.0 * variances.mean(axis=0) ** 2 / variances.var(axis=0)
    np.testing.assert_allclose(equivalent_freedom(curves[0], truth), found, rtol=0.25)


def test_simulated_noise_has_the_curve_of_its_coefficients():
    rng = np.random.default_rng(2)
    for truth in (
        NoiseCoefficients(N=1.0),
        NoiseCoefficients(B=1.0),
        NoiseCoefficients(K=1.0),
        NoiseCoefficients(Q=1.0),
        NoiseCoefficients(1.0, 0.5, 0.2, 0.01),
    ):
        factors = 4 ** np.arange(1, 6)
        curves = [allan_deviation(simulate_noise(truth, 8192, 10.0, rng), 10.0, factors=factors) for _ in range(60)]
        mean = np.sqrt(np.mean([curve.sigma**2 for curve in curves], axis=0))
        np.testing.assert_allclose(mean, truth.allan_deviation(curves[0].tau), rtol=0.12)


def test_flicker_is_flat_from_the_first_sample():
    rng = np.random.default_rng(3)
    factors = np.array([1, 2, 3, 8, 64])
    squares = [allan_deviation(flicker(4096, rng), 1.0, factors=factors).sigma ** 2 for _ in range(60)]
    np.testing.assert_allclose(np.sqrt(np.mean(squares, axis=0)), BIAS_PLATEAU, rtol=0.02)
    assert pytest.approx(0.664, abs=5e-4) == BIAS_PLATEAU


def test_a_gauss_markov_bias_is_a_walk_before_its_correlation_time_and_bounded_beyond():
    rng = np.random.default_rng(4)
    walk = NoiseCoefficients(K=0.1)
    bound = [simulate_noise(walk, 20_000, 10.0, rng, correlation_time=20.0) for _ in range(40)]
    assert np.std(bound) == pytest.approx(0.1 * np.sqrt(10.0), rel=0.1)
    curve = [allan_deviation(x, 10.0, factors=np.array([10, 5000])).sigma ** 2 for x in bound]
    short, long = np.sqrt(np.mean(curve, axis=0))
    assert short == pytest.approx(walk.allan_deviation(1.0), rel=0.05)
    assert long < 0.2 * walk.allan_deviation(500.0)


@pytest.mark.parametrize("argument", [{"rate": 0.0}, {"rate": 1.0, "correlation_time": 0.0}])
def test_noise_without_a_clock_is_refused(argument):
    with pytest.raises(RangeError):
        simulate_noise(NoiseCoefficients(N=1.0), 10, rng=np.random.default_rng(0), **argument)


def test_published_tables_in_si():
    assert pytest.approx(np.radians(9.281e-3)) == MPU6050_GYRO[1].N
    assert pytest.approx(4.280e-5 * 9.80665) == MPU6050_ACCELEROMETER[2].B
    assert pytest.approx(4e-4) == HMC5883L[2].K


@pytest.mark.slow
def test_four_hours_of_the_mpu6050_give_their_coefficients_back():
    # 002 tables 5.3 and 5.5: 4 h at 100 Hz, 50 runs.
    truth = MPU6050_GYRO[0]
    fits = runs(truth, 50, rate=RATE, seconds=FOUR_HOURS, seed=11)
    found = np.array([fit.coefficients for fit in fits])[:, :3]
    assert np.all(np.abs(found[:, 0] / truth.N - 1.0) < 0.03)
    mean = found.mean(axis=0) / np.array(truth[:3])
    assert np.all(np.abs(mean - 1.0) < 0.10)
    # 50 runs at 95 % give 43 or fewer once in 500; the coverage itself is measured on more runs below.
    assert np.all(covered(fits, truth)[:3] >= 0.86)


@pytest.mark.parametrize(
    "truth",
    [MPU6050_GYRO[0], MPU6050_ACCELEROMETER[2], HMC5883L[2]],
    ids=["gyro x", "accelerometer z", "magnetometer z"],
)
def test_intervals_cover_the_published_coefficients(truth):
    # At 2 Hz a sample is the mean of 50 at 100 Hz: N, B and K mean the same, and B and K show beyond seconds.
    fits = runs(truth, 200, rate=2.0, seconds=FOUR_HOURS, seed=12)
    share = covered(fits, truth)[:3]
    # 200 runs at 95 %: sigma 1.5 %; a coefficient of zero is covered more often, for its interval cannot miss below.
    assert np.all(share >= 0.90)
    assert share[0] <= 0.99
    for index in (0, 1, 2):
        if truth[index] > 0.0 and np.median([fit.low[index] for fit in fits]) > 0.0:
            assert np.mean([fit.coefficients[index] for fit in fits]) == pytest.approx(truth[index], rel=0.10)


def test_quantisation_is_told_from_white_noise():
    truth = NoiseCoefficients(N=1e-3, Q=1e-4)
    fits = runs(truth, 30, rate=100.0, seconds=60.0, seed=13, terms="NQ")
    assert np.mean([fit.coefficients.Q for fit in fits]) == pytest.approx(truth.Q, rel=0.02)
    assert np.mean([fit.coefficients.N for fit in fits]) == pytest.approx(truth.N, rel=0.03)
    assert fits[0].coefficients.B == 0.0
    assert np.isinf(fits[0].high.K)


def test_the_curve_of_a_fit_carries_its_band():
    fit = runs(NoiseCoefficients(N=1.0), 1, rate=10.0, seconds=100.0, seed=14)[0]
    low, high = fit.band()
    assert np.all((low < fit.curve.sigma) & (fit.curve.sigma < high))
    assert fit.curve.count[0] == 999
    assert fit.level == 0.95


def test_a_curve_of_other_terms_is_found_out_and_the_filtered_part_left_out():
    rng = np.random.default_rng(15)
    white = simulate_noise(NoiseCoefficients(N=1.0), 40_000, 100.0, rng)
    assert identify(white, 100.0).likelihood > 1e-3
    smooth = np.convolve(white, np.full(20, 0.05), "valid")  # 0.2 s
    assert identify(smooth, 100.0).likelihood < 1e-4
    fit = identify(smooth, 100.0, shortest=2.0)
    assert fit.likelihood > 1e-3
    assert fit.low.N < 1.0 < fit.high.N
    assert fit.high.N < 1.15
    with pytest.raises(TooLittleDataError):
        identify(smooth, 100.0, shortest=50.0)


def test_a_line_at_a_high_frequency_does_not_spoil_the_fit_of_the_rest():
    # Of the shortest cluster times so much is known that they alone would decide: N would come out a fifth too large.
    rng = np.random.default_rng(17)
    t = np.arange(60_000) / 100.0
    shaken = simulate_noise(NoiseCoefficients(N=1.0), t.size, 100.0, rng) + 8.0 * np.sin(2.0 * np.pi * 37.0 * t)
    fit = identify(shaken, 100.0)
    assert fit.likelihood < 1e-4
    assert pytest.approx(1.0, rel=0.1) == fit.coefficients.N
    assert fit.low.N < 1.0 < fit.high.N


@pytest.mark.parametrize("pattern", [[0.3], [0.0, 1.0], [0.0, 1.0, 2.0, 1.0]])
def test_samples_that_repeat_themselves_show_no_noise(pattern):
    with pytest.raises(ConstantError, match="repeats itself"):
        identify(np.tile(pattern, 400), 100.0)


def test_a_right_model_is_likely():
    fits = runs(MPU6050_GYRO[0], 60, rate=2.0, seconds=FOUR_HOURS, seed=16)
    likelihood = np.array([fit.likelihood for fit in fits])
    assert np.min(likelihood) > 1e-4
    assert 0.3 < np.mean(likelihood) < 0.85


@pytest.mark.parametrize("terms", ["", "NX"])
def test_unknown_terms_are_refused(terms):
    with pytest.raises(RangeError):
        identify(np.zeros(1000), 1.0, terms=terms)


def test_a_fit_needs_data_and_a_level():
    x = np.random.default_rng(0).standard_normal(1000)
    with pytest.raises(TooLittleDataError):
        identify(x[:200], 1.0)
    with pytest.raises(RangeError):
        identify(x, 1.0, level=1.0)
    with pytest.raises(RangeError):
        equivalent_freedom(allan_deviation(x, 1.0), NoiseCoefficients())


@pytest.mark.parametrize(("axis", "noted"), [(1, 1.31e-2), (2, 9.3e-3), (3, 9.5e-3)])
def test_a_real_mpu6050_gyro_at_one_second(axis, noted):
    path = folder("sunsided-mpu6050-hmc5883l") / "unmoved-with-x-pointing-forward-10min__mpu6050_gyroscope.csv.gz"
    rate = np.loadtxt(path, delimiter=",", skiprows=1)[:, axis]
    curve = allan_deviation(rate, 99.32, factors=np.array([99]))
    assert curve.sigma[0] == pytest.approx(noted, rel=0.1)
    # White noise up to a second; the z axis is no sum of the terms.
    assert pytest.approx(noted, rel=0.1) == identify(rate, 99.32).coefficients.N
