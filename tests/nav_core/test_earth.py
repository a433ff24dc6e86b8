"""The Earth: coordinates there and back, gravity, rates, and the magnetic field against its official test values."""

import threading

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from nav_core import earth
from nav_core.errors import RangeError, ShapeError
from tests.oracles import earth as peer
from tests.oracles import transform
from tests.recordings import folder

POLE = np.pi / 2.0

latitudes = st.one_of(st.floats(-POLE, POLE), st.sampled_from([POLE, -POLE, 0.0, POLE - 1e-9, -POLE + 1e-12, 1e-15]))
longitudes = st.one_of(st.floats(-np.pi, np.pi), st.sampled_from([np.pi, -np.pi, 0.0, np.pi / 2.0]))
heights = st.one_of(st.floats(-1.2e4, 1e5), st.floats(1e5, 5e7), st.just(0.0))


# --- coordinates -----------------------------------------------------------------------------------------------


@given(latitudes, longitudes, heights)
@example(POLE, 1.0, 0.0)
@example(0.0, np.pi, -5.3e6)
def test_geodetic_coordinates_come_back(lat, lon, height):
    r = earth.geodetic_to_ecef(lat, lon, height)
    back_lat, back_lon, back_height = earth.ecef_to_geodetic(r)
    size = earth.SEMI_MAJOR + abs(height)
    assert abs(back_lat - lat) < 1e-15
    assert abs(back_height - height) < 1e-15 * size
    assert np.linalg.norm(earth.geodetic_to_ecef(back_lat, back_lon, back_height) - r) < 1e-15 * size


@given(latitudes, longitudes, st.floats(-1e4, 1e5))
def test_coordinates_agree_with_the_peer(lat, lon, height):
    lla = [np.degrees(lat), np.degrees(lon), height]
    assert np.allclose(earth.geodetic_to_ecef(lat, lon, height), transform.lla_to_ecef(lla), atol=2e-8)
    assert np.allclose(earth.tangent_axes(lat, lon), transform.mat_en_from_ll(*lla[:2]), atol=1e-15)


@given(latitudes, longitudes)
def test_tangent_axes_are_a_right_handed_frame_and_down_is_down(lat, lon):
    R = earth.tangent_axes(lat, lon)
    assert np.allclose(R.T @ R, np.eye(3), atol=1e-15)
    assert np.linalg.det(R) == pytest.approx(1.0)
    step = earth.geodetic_to_ecef(lat, lon, 0.0) - earth.geodetic_to_ecef(lat, lon, 1000.0)
    assert np.allclose(step / 1000.0, R[:, 2], atol=1e-11)


@given(st.floats(-1.5, 1.5), longitudes, st.floats(-1e3, 1e4), st.tuples(*[st.floats(-1e6, 1e6)] * 3))
def test_the_tangent_plane_goes_there_and_back(lat, lon, height, offset):
    origin = (lat, lon, height)
    away = earth.tangent_to_geodetic(np.array(offset), origin)
    assert np.allclose(earth.geodetic_to_tangent(*away, origin), offset, atol=1e-8)
    assert np.allclose(earth.geodetic_to_tangent(*origin, origin), 0.0)


@given(st.floats(-1.5, 1.5), longitudes, st.floats(0.0, 5e3))
def test_radii_turn_metres_into_radians(lat, lon, height):
    meridian, normal = earth.radii(lat)
    origin, step = (lat, lon, height), 1e-6
    north = earth.geodetic_to_tangent(lat + step, lon, height, origin)
    east = earth.geodetic_to_tangent(lat, lon + step, height, origin)
    assert north[0] == pytest.approx(step * (meridian + height), rel=1e-7)
    assert east[1] == pytest.approx(step * (normal + height) * np.cos(lat), rel=1e-7)


def test_arrays_keep_their_shape():
    lat, lon = np.linspace(-1.0, 1.0, 6).reshape(2, 3), np.linspace(-3.0, 3.0, 3)
    r = earth.geodetic_to_ecef(lat, lon, 100.0)
    assert r.shape == (2, 3, 3)
    assert earth.ecef_to_geodetic(r)[0].shape == (2, 3)
    assert earth.tangent_axes(lat, lon).shape == (2, 3, 3, 3)
    assert earth.transport_rate(lat, 0.0, np.ones((2, 3, 3))).shape == (2, 3, 3)
    assert earth.ecef_to_geodetic(np.empty((0, 3)))[0].shape == (0,)
    with pytest.raises(ShapeError):
        earth.ecef_to_geodetic(np.zeros(2))


def test_the_middle_of_the_earth_has_no_latitude():
    with pytest.raises(RangeError):
        earth.ecef_to_geodetic(np.array([[earth.SEMI_MAJOR, 0.0, 0.0], [0.0, 0.0, 1e5]]))
    with pytest.raises(RangeError):
        earth.ecef_to_geodetic(np.full(3, np.nan))


# --- gravity and rates -----------------------------------------------------------------------------------------


@given(latitudes)
def test_gravity_on_the_ellipsoid_agrees_with_the_peer(lat):
    assert earth.gravity(lat, 0.0) == pytest.approx(peer.gravity(np.degrees(lat), 0.0), rel=1e-12)


def test_gravity_falls_with_height_as_the_field_does():
    assert earth.gravity(0.0, 0.0) == pytest.approx(earth.GRAVITY_EQUATOR)
    assert earth.gravity(POLE, 0.0) == pytest.approx(earth.GRAVITY_POLE)
    # Free-air gradient at 45°, 3.086e-6 /s², and the exact field on the axis: gravitation of the ellipsoid's mass with
    # its second harmonic.
    gradient = earth.gravity(np.pi / 4.0, 0.5) - earth.gravity(np.pi / 4.0, -0.5)
    assert gradient == pytest.approx(-3.086e-6, rel=1e-3)
    J2, J4 = 1.082_629_821e-3, -2.370_911e-6
    for height in (1e3, 1e4):
        r = earth.SEMI_MINOR + height
        q = (earth.SEMI_MAJOR / r) ** 2
        exact = earth.GRAVITATION / r**2 * (1.0 - 3.0 * J2 * q - 5.0 * J4 * q * q)
        assert earth.gravity(POLE, height) == pytest.approx(exact, abs=2e-6)


@given(st.floats(-1.5, 1.5), st.floats(0.0, 1e4), st.tuples(*[st.floats(-100.0, 100.0)] * 3).map(np.array))
def test_rates_are_those_of_the_axes(lat, height, v):
    meridian, normal = earth.radii(lat)
    step = 1e-3
    lat_rate, lon_rate = v[0] / (meridian + height), v[1] / ((normal + height) * np.cos(lat))
    before = earth.tangent_axes(lat - step * lat_rate, -step * lon_rate)
    after = earth.tangent_axes(lat + step * lat_rate, step * lon_rate)
    turning = earth.tangent_axes(lat, 0.0).T @ (after - before) / (2.0 * step)
    rate = np.array([turning[2, 1], turning[0, 2], turning[1, 0]])
    assert np.allclose(earth.transport_rate(lat, height, v), rate, atol=1e-9)
    assert np.allclose(earth.transport_rate(lat, height, v)[:2], rate[:2], atol=1e-12)
    spin = earth.tangent_axes(lat, 0.3).T @ np.array([0.0, 0.0, earth.RATE])
    assert np.allclose(earth.earth_rate(lat), spin, atol=1e-18)


def test_the_printed_2523_takes_the_earth_for_a_sphere():
    lat, v = 0.8, np.array([20.0, 15.0, 0.0])
    printed = np.array([v[1], -v[0], -v[1] * np.tan(lat)]) / earth.SEMI_MAJOR
    ours = earth.transport_rate(lat, 0.0, v)
    assert np.allclose(printed, ours, rtol=0.01)
    assert np.abs(printed / ours - 1.0).max() > 1e-3


# --- magnetic field --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "columns"),
    [("WMM2025_WMM2025_TEST_VALUES.txt", (4, 5, 6, 9, 10)), ("WMM2020_WMM2020_TEST_VALUES.txt", (7, 8, 9, 5, 4))],
)
def test_the_official_values_of_the_world_magnetic_model(name, columns):
    rows = np.genfromtxt(folder("wmm-test-values") / name, comments="#")
    assert rows.shape[0] >= 12
    for row in rows:
        year, height, lat, lon = row[0], 1e3 * row[1], np.radians(row[2]), np.radians(row[3])
        field = earth.magnetic_field(lat, lon, height, year)
        assert np.abs(1e3 * field.vector - row[list(columns[:3])]).max() < 0.1
        assert np.degrees(field.inclination) == pytest.approx(row[columns[3]], abs=0.006)
        assert np.degrees(field.declination) == pytest.approx(row[columns[4]], abs=0.006)
        assert field.strength == pytest.approx(np.linalg.norm(field.vector))


def test_a_field_is_remembered_per_cell_and_day():
    # From the middle of a cell a third of it on, in every direction, and an hour later.
    cell, place = earth.FIELD_CELL, (500 * earth.FIELD_CELL, 0.0, 240.0)
    first = earth.magnetic_field_near(*place, 2026.5)
    assert earth.magnetic_field_near(place[0] + cell / 3, cell / 3, 400.0, 2026.5001) is first
    assert earth.magnetic_field_near(place[0] - cell / 3, -cell / 3, -400.0, 2026.5001) is first
    assert earth.magnetic_field_near(place[0] + cell, *place[1:], 2026.5) is not first
    assert earth.magnetic_field_near(*place, 2026.51) is not first
    assert earth.magnetic_field_near(place[0], place[1] + 2.0 * np.pi, 240.0, 2026.5) is first


def test_a_cell_is_near_enough():
    rng = np.random.default_rng(7)
    for _ in range(300):
        place = (
            float(np.arcsin(rng.uniform(-0.86, 0.86))),
            float(rng.uniform(-np.pi, np.pi)),
            float(rng.uniform(0, 4e3)),
        )
        exact, near = earth.magnetic_field(*place, 2027.3), earth.magnetic_field_near(*place, 2027.3)
        assert np.linalg.norm(exact.vector - near.vector) < 0.08


def test_the_ends_of_the_models_and_poles_have_a_field():
    for year in (2010.0, 2014.999, 2015.0, 2020.0, 2025.0, 2029.999):
        assert 20.0 < earth.magnetic_field_near(0.8, 0.1, 0.0, year).strength < 70.0
    for lat in (POLE, -POLE):
        assert 50.0 < earth.magnetic_field_near(lat, 2.0, 0.0, 2026.0).strength < 70.0
    for year in (2009.99, 2030.0, np.nan):
        with pytest.raises(RangeError):
            earth.magnetic_field(0.8, 0.1, 0.0, year)
    with pytest.raises(RangeError):
        earth.magnetic_field(0.8, 0.1, 1e6, 2026.0)


def test_threads_get_the_same_field():
    places = [(0.1 * k - 0.7, 0.3 * k, 0.0) for k in range(15)]
    alone = [earth.magnetic_field(*place, 2026.0) for place in places]
    found: dict[int, list[earth.MagneticField]] = {}

    def ask(number: int) -> None:
        found[number] = [earth.magnetic_field(*place, 2026.0) for place in places]

    threads = [threading.Thread(target=ask, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(fields == alone for fields in found.values())
    assert len(found) == 4


@settings(max_examples=50)
@given(st.integers(0, 4_000_000_000))
def test_decimal_years_increase_with_time(utc):
    year = earth.decimal_year(utc)
    assert abs(year - (1970.0 + utc / (365.2425 * 86400.0))) < 0.004
    assert earth.decimal_year(utc + 86400.0) > year


def test_decimal_years_of_known_days():
    assert earth.decimal_year(0.0) == 1970.0
    assert earth.decimal_year(1_735_689_600.0) == 2025.0
    assert earth.decimal_year(1_719_878_400.0) == pytest.approx(2024.5, abs=1e-12)
