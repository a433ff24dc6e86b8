"""Fences: what is inside, how far out, and which wanderings are passages."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from server.alerts.geometry import (
    MAX_REACH_M,
    METRES_PER_DEGREE,
    Circle,
    FenceError,
    Polygon,
    margin_m,
    passages,
)

latitudes = st.floats(-79.0, 79.0)
longitudes = st.floats(-180.0, 180.0)
angles = st.floats(0.0, 2.0 * math.pi, exclude_max=True)


def place(lat: float, lon: float, bearing: float, metres: float) -> tuple[float, float]:
    """Where one comes to on the sphere, by vectors: another way than the fences'."""
    f, l = math.radians(lat), math.radians(lon)
    up = np.array([math.cos(f) * math.cos(l), math.cos(f) * math.sin(l), math.sin(f)])
    north = np.array([-math.sin(f) * math.cos(l), -math.sin(f) * math.sin(l), math.cos(f)])
    east = np.array([-math.sin(l), math.cos(l), 0.0])
    angle = metres / 6371008.8
    x, y, z = math.cos(angle) * up + math.sin(angle) * (math.cos(bearing) * north + math.sin(bearing) * east)
    return math.degrees(math.asin(z)), math.degrees(math.atan2(y, x))


def outside(fence, *places) -> np.ndarray:
    return fence.outside_m(*np.array(places, dtype=float).reshape(-1, 2).T)


@given(latitudes, longitudes, st.floats(1.0, MAX_REACH_M), angles, st.floats(0.0, 3.0))
def test_a_circle_tells_the_distance_to_its_edge(lat, lon, radius, bearing, share):
    (found,) = outside(Circle(lat, lon, radius), place(lat, lon, bearing, share * radius))
    assert found == pytest.approx((share - 1.0) * radius, abs=1e-3 + 1e-6 * radius)


def star(lat, lon, radii, size_m, turn):
    """A polygon that sees its middle from everywhere: simple by construction."""
    step = 2.0 * math.pi / len(radii)
    scale = size_m / METRES_PER_DEGREE
    corners = []
    for k, radius in enumerate(radii):
        angle = turn + k * step
        east = scale * radius * math.sin(angle) / math.cos(math.radians(lat))
        corners.append((lat + scale * radius * math.cos(angle), (lon + east + 180.0) % 360.0 - 180.0))
    return corners


stars = st.builds(
    star,
    st.floats(-70.0, 70.0),
    longitudes,
    st.lists(st.floats(0.3, 1.0), min_size=5, max_size=12),
    st.floats(20.0, 20_000.0),
    angles,
)


@given(stars, st.floats(-1.4, 1.4), st.floats(-1.4, 1.4))
def test_a_polygon_agrees_with_winding_numbers(corners, u, v):
    """Which side: by the angles under which the corners are seen, whatever the fence computes."""
    fence = Polygon(corners)
    lat, lon = np.array(corners).T
    lon = lon[0] + (lon - lon[0] + 180.0) % 360.0 - 180.0
    at = lat.mean() + u * np.ptp(lat), lon.mean() + v * np.ptp(lon)
    (found,) = outside(fence, at)
    assume(abs(found) > 1e-3)
    seen = np.unwrap(np.append(bearings := np.arctan2(lon - at[1], lat - at[0]), bearings[0]))
    winding = round((seen[-1] - seen[0]) / (2.0 * math.pi))
    assert (found < 0.0) == (winding != 0)


@given(stars, st.integers(0, 11), st.floats(0.0, 1.0))
def test_the_line_itself_is_the_edge(corners, side, along):
    fence = Polygon(corners)
    k = side % len(corners)
    (lat0, lon0), (lat1, lon1) = corners[k], corners[(k + 1) % len(corners)]
    lon1 = lon0 + (lon1 - lon0 + 180.0) % 360.0 - 180.0
    (found,) = outside(fence, (lat0 + along * (lat1 - lat0), lon0 + along * (lon1 - lon0)))
    assert abs(found) < 1e-4 * max(1.0, fence.size_m * 1e-3)


@given(stars, st.integers(1, 11), st.booleans(), longitudes)
def test_order_direction_and_date_line_do_not_matter(corners, first, back, shift):
    turned = corners[first % len(corners) :] + corners[: first % len(corners)]
    moved = [(lat, (lon + shift + 180.0) % 360.0 - 180.0) for lat, lon in (reversed(turned) if back else turned)]
    places = [(lat + 1e-3, lon - 2e-3) for lat, lon in corners]
    there = [(lat, (lon + shift + 180.0) % 360.0 - 180.0) for lat, lon in places]
    np.testing.assert_allclose(
        outside(Polygon(moved), *there), outside(Polygon(corners), *places), rtol=1e-6, atol=1e-3
    )


@pytest.mark.parametrize(
    "corners",
    [
        [],
        [(45.0, 7.0), (45.1, 7.0)],
        [(45.0, 7.0), (45.1, 7.0), (45.0, 7.0), (45.1, 7.0)],
        [(45.0, 7.0), (45.1, 7.1), (45.1, 7.0), (45.0, 7.1)],  # a bow tie
        [(45.0, 7.0), (45.1, 7.0), (45.2, 7.0)],  # a line
        [(45.0, 7.0), (45.0, 9.0), (48.0, 7.0)],  # too far
        [(79.9, 0.0), (80.1, 0.0), (80.0, 0.5)],
        [(0.0, 0.0), (0.0, 1e-6), (1e-6, 0.0)],
    ],
)
def test_what_encloses_nothing_is_refused(corners):
    with pytest.raises(FenceError):
        Polygon(corners)


@pytest.mark.parametrize(("lat", "radius"), [(81.0, 10.0), (45.0, 0.0), (45.0, -1.0), (45.0, 2e5), (45.0, math.nan)])
def test_impossible_circles_are_refused(lat, radius):
    with pytest.raises(FenceError):
        Circle(lat, 7.0, radius)


def test_the_last_corner_may_repeat_the_first():
    open_line = [(45.0, 7.0), (45.1, 7.0), (45.0, 7.1)]
    assert outside(Polygon([*open_line, open_line[0]]), (45.02, 7.02)) == outside(Polygon(open_line), (45.02, 7.02))


@given(st.lists(st.floats(-100.0, 100.0), max_size=50), st.floats(0.0, 50.0), st.sampled_from([None, True, False]))
def test_passages_alternate_and_end_where_the_track_is(way, margin, inside):
    found, end = passages(np.array(way), margin, inside)
    states = [entered for _, entered in found]
    assert all(a != b for a, b in pairwise(states))
    if inside is not None and states:
        assert states[0] != inside
    clear = [value < 0.0 for value in way if abs(value) > margin]
    assert end == (clear[-1] if clear else inside)
    for row, entered in found:
        assert (way[row] < 0.0) == entered
        assert abs(way[row]) > margin


def test_a_parked_vehicle_whose_fixes_wander_passes_nothing():
    rng = np.random.default_rng(3)
    way = rng.normal(0.0, 5.0, 10_000)
    assert passages(way, 25.0, True) == ([], True)
    assert len(passages(way, 0.0, True)[0]) > 1000


def test_a_small_fence_still_has_an_inside():
    fence = Circle(45.0, 7.0, 20.0)
    assert margin_m(fence, 25.0) == 5.0
    assert outside(fence, (45.0, 7.0))[0] < -margin_m(fence, 25.0)
