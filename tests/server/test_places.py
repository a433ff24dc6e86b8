"""Places as a caller may see them: near, on a fixed grid, and no less than the grid hides."""

from __future__ import annotations

import math

import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.accounts.caller import Caller
from server.accounts.places import CELL_DEG, Place, seen, sight_of
from server.live.routes import _event
from server.models import Change

LAT, LON = st.floats(-90.0, 90.0), st.floats(-180.0, 180.0)
KM_PER_DEG = 111.2


@given(lat=st.floats(-88.9, 88.9), lon=LON)
def test_a_coarse_place_is_within_a_kilometre_and_stays_where_it_is(lat, lon):
    place = seen(lat, lon, "coarse")
    east = math.remainder(place.lon_deg - lon, 360.0) * math.cos(math.radians(place.lat_deg))
    assert abs(place.lat_deg - lat) <= 0.5 * CELL_DEG + 1e-5
    assert abs(east) <= 0.51 * CELL_DEG
    assert math.hypot(place.lat_deg - lat, east) * KM_PER_DEG < 0.81
    assert seen(place.lat_deg, place.lon_deg, "coarse") == place


@given(lat=LAT, lon=LON)
def test_every_place_has_a_cell(lat, lon):
    place = seen(lat, lon, "coarse")
    assert -90.0 <= place.lat_deg <= 90.0
    assert -180.5 <= place.lon_deg <= 180.5


def test_all_places_of_a_cell_look_alike():
    cell = {seen(45.4001 + k * 1e-4, 11.8801, "coarse") for k in range(99)}
    assert len(cell) == 1


def test_exact_and_none():
    assert seen(45.123456, 11.0, "exact") == Place(45.123456, 11.0)
    assert seen(45.1, 11.0, "none") is None
    assert seen(None, 11.0, "exact") is None


@pytest.mark.parametrize(
    ("permissions", "sight"),
    [({"location.read", "location.coarse"}, "exact"), ({"location.coarse"}, "coarse"), ({"fleet.read"}, "none")],
)
def test_the_live_stream_tells_what_may_be_seen(permissions, sight):
    caller = Caller("o", "key", permissions=frozenset(permissions))
    assert sight_of(caller) == sight
    change = Change(
        id=1, kind="position", device_id="d", data={"lat_deg": 45.4064, "lon_deg": 11.8768, "speed_mps": 3.0}
    )
    told = orjson.loads(_event(change, sight_of(caller)).split(b"data: ")[1])
    assert told["speed_mps"] == 3.0
    wanted = {"exact": (45.4064, 11.8768), "coarse": (45.405, seen(45.4064, 11.8768, "coarse").lon_deg), "none": ()}
    assert tuple(told[name] for name in ("lat_deg", "lon_deg") if name in told) == wanted[sight]
