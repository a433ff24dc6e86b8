"""Positions from synthetic satellites: known truth, stated errors, and where the print differs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nav_core import kalman, positioning
from nav_core.earth import RATE, ecef_to_geodetic, geodetic_to_ecef, tangent_axes
from nav_core.errors import ConvergenceError, GeometryError, RangeError, ShapeError, TooLittleDataError
from nav_core.positioning import LIGHT

ORBIT = 26_560e3
MASK = np.radians(10.0)
LAT, LON = np.radians(41.1), np.radians(16.9)
HERE = geodetic_to_ecef(LAT, LON, 60.0)
WAVELENGTH = LIGHT / positioning.L1
examples = settings(deadline=None, max_examples=40)


def sky(t: float = 0.0) -> np.ndarray:
    """24 satellites in six planes at 55°, e frame, as they stand at `t` s."""
    plane, place = np.divmod(np.arange(24), 4)
    node = plane * np.pi / 3.0 - RATE * t
    along = place * np.pi / 2.0 + plane * 0.7 + np.sqrt(3.986004418e14 / ORBIT**3) * t
    tilt = np.radians(55.0)
    x, y = np.cos(along), np.sin(along) * np.cos(tilt)
    z = np.sin(along) * np.sin(tilt)
    return ORBIT * np.stack((x * np.cos(node) - y * np.sin(node), x * np.sin(node) + y * np.cos(node), z), axis=-1)


def visible(receiver: np.ndarray, satellites: np.ndarray) -> np.ndarray:
    return satellites[positioning.elevation_azimuth(satellites, receiver)[0] > MASK]


SEEN = visible(HERE, sky())


def ranges(satellites: np.ndarray, receiver: np.ndarray, clock: float = 0.0) -> np.ndarray:
    return np.linalg.norm(satellites - receiver, axis=-1) + clock


# Single point -------------------------------------------------------------------------------------------------


@examples
@given(lat=st.floats(-1.5, 1.5), lon=st.floats(-3.1, 3.1), height=st.floats(-100.0, 9000.0), clock=st.floats(-3e5, 3e5))
def test_exact_ranges_give_the_position_from_no_start(lat, lon, height, clock):
    truth = geodetic_to_ecef(lat, lon, height)
    satellites = visible(truth, sky(1000.0))
    fix = positioning.single_point(satellites, ranges(satellites, truth, clock), np.ones(len(satellites)))
    assert np.linalg.norm(fix.r_e - truth) < 1e-3
    assert fix.clock == pytest.approx(clock, abs=1e-3)
    assert fix.chi2 < 1e-6


def test_errors_are_as_stated_and_weights_help():
    rng = np.random.default_rng(1)
    sigma = np.linspace(1.0, 8.0, len(SEEN))
    axes = tangent_axes(LAT, LON)
    squares, chi2s, weighted, plain = [], [], [], []
    for _ in range(1500):
        measured = ranges(SEEN, HERE, 1234.5) + sigma * rng.standard_normal(len(SEEN))
        fix = positioning.single_point(SEEN, measured, sigma)
        error = np.append((fix.r_e - HERE) @ axes, fix.clock - 1234.5)
        squares.append(kalman.normalised(error, fix.covariance))
        chi2s.append(fix.chi2)
        weighted.append(error[:3])
        plain.append(positioning.single_point(SEEN, measured, np.ones(len(SEEN))).r_e - HERE)
    lower, upper = kalman.mean_band(4, 1500, 0.999)
    assert lower < np.mean(squares) < upper
    lower, upper = kalman.mean_band(len(SEEN) - 4, 1500, 0.999)
    assert lower < np.mean(chi2s) < upper
    assert np.std(weighted) < 0.9 * np.std(plain)


def test_dilutions_are_the_errors_of_unit_ranges():
    rng = np.random.default_rng(2)
    axes = tangent_axes(LAT, LON)
    errors = []
    for _ in range(3000):
        fix = positioning.single_point(
            SEEN, ranges(SEEN, HERE) + rng.standard_normal(len(SEEN)), np.ones(len(SEEN)), start=HERE
        )
        errors.append(np.append((fix.r_e - HERE) @ axes, fix.clock))
    n, e, d, t = np.var(errors, axis=0)
    found = positioning.dilution(SEEN, HERE)
    assert found.hdop == pytest.approx(np.sqrt(n + e), rel=0.05)
    assert found.vdop == pytest.approx(np.sqrt(d), rel=0.05)
    assert found.pdop == pytest.approx(np.sqrt(n + e + d), rel=0.05)
    assert found.tdop == pytest.approx(np.sqrt(t), rel=0.05)
    assert found.gdop == pytest.approx(np.hypot(found.pdop, found.tdop))
    assert found.vdop > found.hdop / np.sqrt(2.0)


def test_horizontal_means_local_axes():
    """000 eq. 5.5.16 with the e axes of 5.5.3 would call the error along the Earth's axis vertical."""
    H = np.column_stack([-positioning.sight(SEEN, HERE)[1], np.ones(len(SEEN))])
    printed = np.diag(np.linalg.inv(H.T @ H))
    found = positioning.dilution(SEEN, HERE)
    assert np.sqrt(printed[:3].sum()) == pytest.approx(found.pdop)
    assert abs(np.sqrt(printed[2]) - found.vdop) > 0.2 * found.vdop


@examples
@given(turn=st.floats(-3.1, 3.1))
def test_dilutions_do_not_care_where_on_a_parallel(turn):
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    here, there = positioning.dilution(SEEN, HERE), positioning.dilution(SEEN @ R.T, R @ HERE)
    assert (there.hdop, there.vdop, there.tdop) == pytest.approx((here.hdop, here.vdop, here.tdop), rel=1e-9)


def test_more_satellites_never_dilute():
    fewer, more = positioning.dilution(SEEN[:-1], HERE), positioning.dilution(SEEN, HERE)
    assert more.gdop <= fewer.gdop
    assert more.hdop <= fewer.hdop


def test_the_sky_turns_while_the_signal_travels():
    """Satellites given at emission, without the turn, move the position tens of metres east."""
    delay = ranges(SEEN, HERE) / LIGHT
    turn = RATE * delay
    sent = np.stack(
        (
            np.cos(turn) * SEEN[:, 0] - np.sin(turn) * SEEN[:, 1],
            np.sin(turn) * SEEN[:, 0] + np.cos(turn) * SEEN[:, 1],
            SEEN[:, 2],
        ),
        axis=-1,
    )
    measured = ranges(SEEN, HERE)
    arrived = positioning.at_reception(sent, measured)
    assert arrived == pytest.approx(SEEN, abs=1e-6)
    fix = positioning.single_point(sent, measured, np.ones(len(SEEN)))
    east = (fix.r_e - HERE) @ tangent_axes(LAT, LON)[:, 1]
    assert 15.0 < east < 45.0


def test_elevation_and_azimuth():
    axes = tangent_axes(LAT, LON)
    for local, elevation, azimuth in (
        ([1.0, 0.0, 0.0], 0.0, 0.0),
        ([0.0, 1.0, 0.0], 0.0, np.pi / 2.0),
        ([0.0, -1.0, -1.0], np.pi / 4.0, -np.pi / 2.0),
    ):
        found = positioning.elevation_azimuth(HERE + 2e7 * axes @ np.array(local), HERE)
        assert found == pytest.approx((elevation, azimuth), abs=1e-6)


# Relative -----------------------------------------------------------------------------------------------------

BASE = HERE
ROVER = HERE + tangent_axes(LAT, LON) @ np.array([1200.0, -800.0, 15.0])


def test_differencing_takes_shared_errors_away():
    rng = np.random.default_rng(3)
    shared = 15.0 * rng.standard_normal(len(SEEN))
    base = ranges(SEEN, BASE, 300.0) + shared
    rover = ranges(SEEN, ROVER, -50.0) + shared
    fix = positioning.differential_code(BASE, SEEN, base, rover, np.ones(len(SEEN)))
    alone = positioning.single_point(SEEN, rover, np.ones(len(SEEN)))
    assert np.linalg.norm(fix.r_e - ROVER) < 1e-3
    assert fix.clock == pytest.approx(-350.0, abs=1e-3)
    assert np.linalg.norm(alone.r_e - ROVER) > 5.0


def session(seed: int, *, sigma: float = 0.003, epochs: int = 40, period: float = 30.0):
    """Phases of base and rover, with clocks, ambiguities and satellite clocks; the ambiguities' double differences."""
    rng = np.random.default_rng(seed)
    index = np.flatnonzero(positioning.elevation_azimuth(sky(0.5 * epochs * period), HERE)[0] > np.radians(20.0))
    satellites = np.array([sky(period * k)[index] for k in range(epochs)])
    n = index.size
    whole = rng.integers(-1_000_000, 1_000_000, (2, n))
    phases = []
    for receiver, position in enumerate((BASE, ROVER)):
        clock = 1e4 * rng.standard_normal((epochs, 1))
        phases.append(
            ranges(satellites, position)
            + clock
            + WAVELENGTH * whole[receiver]
            + sigma * rng.standard_normal((epochs, n))
        )
    satellite_clock = 1e5 * rng.standard_normal((epochs, n))
    reference = int(np.argmax(positioning.elevation_azimuth(satellites[epochs // 2], HERE)[0]))
    single = positioning.single_difference(phases[0] + satellite_clock, phases[1] + satellite_clock)
    double = positioning.double_difference(single, reference)
    truth = positioning.double_difference((whole[1] - whole[0]).astype(float), reference)
    return satellites, double, reference, truth


START = ROVER + np.array([1.5, -1.0, 2.0])
"""The rover as code differences know it."""


def test_double_differences_are_free_of_clocks_and_triple_ones_of_ambiguities():
    satellites, double, reference, truth = session(1, sigma=0.0)
    expected, _ = positioning.double_ranges(satellites, BASE, ROVER, reference)
    assert double - expected == pytest.approx(np.broadcast_to(WAVELENGTH * truth, double.shape), abs=1e-5)
    triple = positioning.triple_difference(double)
    assert triple == pytest.approx(positioning.triple_difference(expected), abs=1e-5)


def test_the_derivative_by_the_rover():
    satellites, _, reference, _ = session(1, epochs=1)
    _, H = positioning.double_ranges(satellites[0], BASE, ROVER, reference)
    numeric = kalman.jacobian(
        lambda offset: positioning.double_ranges(satellites[0], BASE, ROVER + offset, reference)[0],
        np.zeros(3),
        step=10.0,
    )
    assert pytest.approx(numeric, abs=1e-6) == H


def test_the_covariance_of_double_differences():
    rng = np.random.default_rng(4)
    noise = 0.5 * rng.standard_normal((2, 200_000, 4))
    double = positioning.double_difference(positioning.single_difference(noise[0], noise[1]), 2)
    assert np.cov(double.T) == pytest.approx(positioning.double_difference_covariance(3, 0.5), rel=0.03)


def test_cycle_slips_are_found_by_their_peaks_and_repaired():
    satellites, clean, reference, _ = session(2)
    slipped = clean.copy()
    slipped[12:, 1] += 7 * WAVELENGTH
    slipped[25:, 0] -= 1 * WAVELENGTH
    slipped[3, 2] = np.nan
    slips = positioning.find_slips(slipped, satellites, BASE, START, reference=reference, wavelength=WAVELENGTH)
    assert slips.epoch.tolist() == [12, 25]
    assert slips.pair.tolist() == [1, 0]
    assert slips.cycles.tolist() == [7, -1]
    mended = positioning.repaired(slipped, slips, WAVELENGTH)
    mended[3, 2] = clean[3, 2]
    assert mended == pytest.approx(clean, abs=1e-6)


def test_triple_differences_approximate_without_ambiguities():
    satellites, double, reference, _ = session(3)
    double[20:, 0] += 50 * WAVELENGTH
    keep = np.ones((double.shape[0] - 1, double.shape[1]), dtype=bool)
    with_slip = positioning.triple_baseline(
        double, satellites, BASE, START, reference=reference, sigma=0.003, keep=keep
    )
    keep[19, 0] = False
    without = positioning.triple_baseline(double, satellites, BASE, START, reference=reference, sigma=0.003, keep=keep)
    assert np.linalg.norm(without.rover - ROVER) < 0.5
    assert np.linalg.norm(with_slip.rover - ROVER) > 1.0
    assert without.ambiguities is None


def baseline(seed: int, **options):
    satellites, double, reference, truth = session(seed, **options)
    found = positioning.double_baseline(
        double, satellites, BASE, START, reference=reference, sigma=0.003, wavelength=WAVELENGTH
    )
    return found, truth


def test_double_differences_fix_to_millimetres_after_half_an_hour():
    errors = []
    for seed in range(20):
        found, truth = baseline(seed, epochs=60)
        assert found.fixed
        assert found.ambiguities == pytest.approx(truth)
        errors.append(kalman.normalised(found.rover - ROVER, found.covariance))
        assert np.linalg.norm(found.rover - ROVER) < 0.01
    lower, upper = kalman.mean_band(3, 20, 0.999)
    assert lower < np.mean(errors) < upper


def test_a_short_session_stays_float_with_an_honest_error():
    squares = []
    for seed in range(60):
        found, truth = baseline(seed, epochs=4, period=15.0)
        assert not found.fixed
        assert found.ambiguity_sigma is not None
        assert found.ambiguities is not None
        assert found.ambiguity_sigma.max() > 0.1
        squares.append(kalman.normalised(found.rover - ROVER, found.covariance))
    lower, upper = kalman.mean_band(3, 60, 0.999)
    assert lower < np.mean(squares) < upper
    assert truth.size == found.ambiguities.size


# Atmosphere ---------------------------------------------------------------------------------------------------


@examples
@given(delay=st.floats(0.0, 50.0), distance=st.floats(2.0e7, 2.6e7))
def test_two_frequencies_see_through_the_ionosphere(delay, distance):
    """000 eqs. 5.8.2, 5.8.3."""
    first = np.array([distance + delay])
    second = np.array([distance + delay * (positioning.L1 / positioning.L2) ** 2])
    assert positioning.ionosphere_free(first, second) == pytest.approx(distance, abs=1e-6)
    assert -positioning.ionospheric_advance(first, second) == pytest.approx(delay, abs=1e-6)
    printed = (second * positioning.L2**2 - first * positioning.L1**2) / (positioning.L2**2 - positioning.L1**2)
    assert printed == pytest.approx(distance, abs=1e-6)


def test_the_price_is_three_times_the_noise():
    rng = np.random.default_rng(5)
    first, second = rng.standard_normal((2, 100_000))
    gain = positioning.ionosphere_free_gain()
    assert gain == pytest.approx(2.98, abs=0.01)
    assert np.std(positioning.ionosphere_free(first, second)) == pytest.approx(gain, rel=0.01)


def zenith(height: float, humidity: float) -> float:
    air = positioning.standard_air(height, humidity)
    return float(positioning.saastamoinen(np.array(np.pi / 2.0), lat=LAT, height=height, air=air))


def test_the_troposphere_delays_by_two_metres_and_some():
    """Dry zenith delay at sea level 2.31 m, wet some 0.1 m; ten times that near the horizon."""
    assert zenith(0.0, 0.0) == pytest.approx(0.002277 * 1013.25, rel=1e-3)
    assert 0.05 < zenith(0.0, 0.5) - zenith(0.0, 0.0) < 0.15
    assert zenith(2000.0, 0.5) < 0.82 * zenith(0.0, 0.5)
    air = positioning.standard_air(0.0)
    low = positioning.saastamoinen(np.radians([10.0, 30.0, 90.0]), lat=LAT, height=0.0, air=air)
    assert low[1] == pytest.approx(2.0 * low[2], rel=0.01)
    assert 5.4 < low[0] / low[2] < 5.76


def test_the_printed_saastamoinen_is_off_by_metres():
    """5.8.4 as printed: P (1255/T + 0.005) e - B tan."""
    air = positioning.standard_air(0.0)
    printed = 0.002277 * (air.pressure / 100.0 * (1255.0 / air.temperature + 0.005) * air.vapour / 100.0)
    assert printed > 10.0 * zenith(0.0, 0.5)
    low, plain = np.radians(12.0), 2.24
    correct = positioning.saastamoinen(np.array(low), lat=LAT, height=0.0, air=air)
    with_tan = correct + 0.002277 / np.sin(low) * 1.156 * (1.0 / np.tan(low) ** 2 - 1.0 / np.tan(low))
    assert with_tan - correct > 0.1
    assert correct > plain


def test_standard_air():
    assert positioning.standard_air(0.0).pressure == pytest.approx(101_325.0)
    assert positioning.standard_air(5000.0).pressure == pytest.approx(54_020.0, rel=1e-3)
    assert positioning.standard_air(0.0, 1.0).vapour == pytest.approx(1704.0, rel=0.01)


# Budget and integrity -----------------------------------------------------------------------------------------


def test_the_budgets_are_root_sums_without_n():
    """000 table 5.1: 45 m, not 45 / sqrt(7); table 5.2's last column adds up to 3.5 m."""
    single = positioning.range_error(positioning.SINGLE_BUDGET)
    assert round(single) == 45
    assert single / np.sqrt(7.0) < 20.0
    assert positioning.range_error(positioning.DIFFERENTIAL_BUDGET) == pytest.approx(3.50, abs=0.01)


def test_protection_levels_hold_the_share_of_errors_they_state():
    """With the factors replaced by 2, 4.55 % of the errors lie beyond along each axis."""
    rng = np.random.default_rng(6)
    elevation, _ = positioning.elevation_azimuth(SEEN, HERE)
    n = len(SEEN)
    sigma = positioning.sbas_sigma(
        elevation, corrections=np.full(n, 0.6), ionosphere=np.full(n, 0.5), receiver=np.full(n, 0.4)
    )
    levels = positioning.protection_levels(SEEN, HERE, sigma, k_horizontal=2.0)
    axes = tangent_axes(LAT, LON)
    errors = []
    for _ in range(3000):
        fix = positioning.single_point(SEEN, ranges(SEEN, HERE) + sigma * rng.standard_normal(n), sigma, start=HERE)
        errors.append((fix.r_e - HERE) @ axes)
    errors = np.array(errors)
    values, vectors = np.linalg.eigh(np.cov(errors[:, :2].T))
    assert np.sqrt(values[-1]) == pytest.approx(levels.sigma_major, rel=0.05)
    assert np.mean(abs(errors[:, :2] @ vectors[:, -1]) > levels.horizontal) == pytest.approx(0.0455, abs=0.012)
    assert np.mean(abs(errors[:, 2]) > 2.0 * levels.sigma_vertical) == pytest.approx(0.0455, abs=0.012)
    assert levels.vertical == pytest.approx(5.33 * levels.sigma_vertical)
    assert np.hypot(*errors[:, :2].T).max() < 3.0 * levels.horizontal


def test_low_satellites_count_for_less():
    elevation = np.radians([90.0, 30.0, 6.0])
    factor = positioning.obliquity(elevation)
    assert factor == pytest.approx([1.0, 1.75, 2.95], abs=0.05)
    sigma = positioning.sbas_sigma(elevation, corrections=np.zeros(3), ionosphere=np.zeros(3), receiver=np.zeros(3))
    assert sigma[0] == pytest.approx(0.12, abs=1e-3)
    assert (np.diff(sigma) > 0.0).all()


WILD = ranges(SEEN[:4], HERE) + 1e6 * np.random.default_rng(4).standard_normal(4)
"""Ranges that no point fulfils."""

# Refusals -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "error"),
    [
        (lambda: positioning.single_point(SEEN[:3], np.ones(3), np.ones(3)), TooLittleDataError),
        (lambda: positioning.single_point(SEEN, np.ones(3), np.ones(len(SEEN))), ShapeError),
        (lambda: positioning.single_point(SEEN, ranges(SEEN, HERE), np.zeros(len(SEEN))), RangeError),
        (
            lambda: positioning.single_point(SEEN[[0, 0, 1, 1]], ranges(SEEN[[0, 0, 1, 1]], HERE), np.ones(4)),
            GeometryError,
        ),
        (lambda: positioning.single_point(SEEN[:4], WILD, np.ones(4)), ConvergenceError),
        (lambda: positioning.dilution(SEEN[None], HERE), ShapeError),
        (lambda: positioning.dilution(np.repeat(SEEN[:1], 5, axis=0), HERE), GeometryError),
        (lambda: positioning.double_difference(np.zeros(4), 4), RangeError),
        (lambda: positioning.ionosphere_free(np.ones(1), np.ones(1), 1e9, 1e9), RangeError),
        (lambda: positioning.standard_air(2e4), RangeError),
        (lambda: positioning.standard_air(0.0, 2.0), RangeError),
        (lambda: zenith(6000.0, 0.5), RangeError),
        (
            lambda: positioning.saastamoinen(np.array(0.1), lat=LAT, height=0.0, air=positioning.standard_air(0.0)),
            RangeError,
        ),
        (lambda: positioning.protection_levels(SEEN, HERE, np.ones(2)), ShapeError),
        (
            lambda: positioning.sbas_sigma(
                np.array([0.01]), corrections=np.ones(1), ionosphere=np.ones(1), receiver=np.ones(1)
            ),
            RangeError,
        ),
    ],
)
def test_what_has_no_meaning_is_refused(wrong, error):
    with pytest.raises(error):
        wrong()


def test_phase_solutions_refuse_what_does_not_fit():
    satellites, double, reference, _ = session(1, epochs=3)
    keep = np.ones((2, double.shape[1]), dtype=bool)
    options = {"reference": reference, "sigma": 0.003}
    with pytest.raises(ShapeError):
        positioning.find_slips(double[:2], satellites, BASE, START, reference=reference, wavelength=WAVELENGTH)
    with pytest.raises(ShapeError):
        positioning.triple_baseline(double, satellites, BASE, START, keep=keep[:1], **options)
    with pytest.raises(GeometryError):
        positioning.triple_baseline(double, satellites, BASE, START, keep=~keep, **options)
    with pytest.raises(TooLittleDataError):
        positioning.double_baseline(double[:1], satellites[:1], BASE, START, wavelength=WAVELENGTH, **options)
    with pytest.raises(ShapeError):
        positioning.double_baseline(double, satellites[:2], BASE, START, wavelength=WAVELENGTH, **options)
    assert ecef_to_geodetic(BASE)[2] == pytest.approx(60.0)
