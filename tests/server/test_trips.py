from __future__ import annotations

import datetime as dt
import json
import math
from itertools import pairwise

import numpy as np
import pytest
from fleet_world import Leg, World, cut, drive_of
from hypothesis import given, settings
from hypothesis import strategies as st

from nav_core.records import Gnss
from server.formats.drive import to_drive
from server.models import TrackPoint, Trip
from server.trips.track import REST_S, Track, TrackState, distance, seconds

HASH = "0" * 64


def fold(gnss: Gnss, cuts=()) -> Track:
    """Fold fixes cut into batches at these box times, the state going through JSON in between."""
    state, pieces = TrackState(), []
    for sequence, (low, high) in enumerate(pairwise([-math.inf, *cuts, math.inf])):
        track = Track(TrackState.from_json(json.loads(json.dumps(state.to_json()))))
        track.add(sequence, HASH, between(gnss, low, high))
        for piece in track.pieces:
            if piece.continued:
                piece.points[:0] = pieces.pop().points
            pieces.append(piece)
        state = track.state
    track.pieces[:] = pieces
    return track


def between(gnss: Gnss, low: float, high: float) -> Gnss:
    return chosen(gnss, (gnss.t >= low) & (gnss.t < high))


def chosen(gnss: Gnss, keep) -> Gnss:
    return Gnss(*(getattr(gnss, name)[keep] for name in ("t", "lat", "lon", "alt", "speed", "course", "fix")))


def test_a_trip_begins_with_movement_and_ends_where_the_vehicle_stopped():
    gnss = drive_of(Leg(30, 0.0), Leg(100, 10.0), Leg(300, 0.0)).gnss
    (trip,) = fold(gnss).pieces
    assert trip.over
    assert trip.totals.t_first == 30.0
    assert trip.totals.t_last == 130.0
    assert trip.totals.distance_m == pytest.approx(1000.0, rel=0.01)
    assert trip.totals.position_distance_m == pytest.approx(1000.0, rel=0.06)
    assert trip.totals.moving_s == pytest.approx(100.0, abs=1.5)
    assert trip.totals.max_speed == 10.0
    assert [math.floor(p.t) for p in trip.points] == list(range(30, 131))


def test_a_light_does_not_end_a_trip_and_a_rest_does():
    light = fold(drive_of(Leg(60, 10.0), Leg(200, 0.0), Leg(60, 10.0)).gnss)
    assert len(light.pieces) == 1
    assert not light.pieces[0].over
    assert len(light.pieces[0].points) == pytest.approx(120, abs=2)
    rest = fold(drive_of(Leg(60, 10.0), Leg(250, 0.0), Leg(60, 10.0)).gnss)
    assert [piece.over for piece in rest.pieces] == [True, False]
    assert rest.pieces[1].totals.t_first == 310.0


def test_a_gap_as_long_as_a_rest_ends_a_trip_and_a_shorter_one_is_bridged_by_position():
    gnss = drive_of(Leg(400, 10.0)).gnss

    def without(low, high):
        return chosen(gnss, (gnss.t < low) | (gnss.t >= high))

    (tunnel,) = fold(without(100.0, 160.0)).pieces
    assert tunnel.totals.distance_m == pytest.approx(3990.0, rel=0.01)
    garage = fold(without(50.0, 50.0 + REST_S + 2.0)).pieces
    assert [piece.totals.t_first for piece in garage] == [0.0, 50.0 + REST_S + 2.0]


def test_a_standing_receiver_makes_no_trip_and_no_way():
    rng = np.random.default_rng(2)
    drive = drive_of(Leg(600, 0.0))
    noise = np.abs(rng.normal(0.0, 0.3, drive.gnss.t.size))
    noise[500] = 4.0
    gnss = Gnss(drive.gnss.t, drive.gnss.lat, drive.gnss.lon, drive.gnss.alt, noise, drive.gnss.course, drive.gnss.fix)
    assert fold(gnss).pieces == []


def test_speed_from_positions_where_the_fix_has_none():
    gnss = drive_of(Leg(100, 10.0)).gnss
    bare = Gnss(gnss.t, gnss.lat, gnss.lon, gnss.alt, np.full(gnss.t.size, np.nan), gnss.course, gnss.fix)
    (trip,) = fold(bare).pieces
    assert trip.totals.distance_m == pytest.approx(1000.0, rel=0.03)


def test_no_fix_is_no_point():
    gnss = drive_of(Leg(10, 10.0)).gnss
    lost = Gnss(gnss.t, gnss.lat, gnss.lon, gnss.alt, gnss.speed, gnss.course, np.zeros(gnss.t.size, dtype=bool))
    assert list(seconds(lost, None)) == []
    assert [math.floor(p.t) for p in seconds(gnss, 6)] == [7, 8, 9]


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.tuples(st.integers(5, 300), st.sampled_from([0.0, 1.0, 5.0, 20.0])), min_size=1, max_size=5),
    st.lists(st.floats(0.0, 900.0), max_size=5),
)
def test_batch_by_batch_is_the_same_as_at_once(legs, cuts):
    gnss = drive_of(*(Leg(float(s), v) for s, v in legs), gnss_rate=1.0).gnss
    whole, parts = fold(gnss), fold(gnss, sorted(cuts))
    assert len(whole.pieces) == len(parts.pieces)
    for one, other in zip(whole.pieces, parts.pieces, strict=True):
        assert one.points == other.points
        assert one.over == other.over
        mine, others = one.totals, other.totals
        mine.input_sha256 = others.input_sha256 = ""  # how many batches there were, it must tell
        assert mine == others


def test_distance_on_the_sphere():
    assert distance(0.0, 0.0, 0.0, math.radians(1.0)) == pytest.approx(111_195.0, rel=1e-4)
    assert distance(0.3, 1.0, 0.3, 1.0) == 0.0


@pytest.fixture
def world(database, settings, clock, organisation) -> World:
    return World(database, settings, clock, organisation)


def drive_two_trips(world) -> list[Trip]:
    for k, batch in enumerate(cut(drive_of(Leg(60, 10.0), Leg(300, 0.0), Leg(60, 20.0)), seconds=60.0)):
        world.put(batch, k)
    world.settle()
    return world.rows(Trip, Trip.began_at)


@pytest.mark.both_databases
def test_trips_over_http(world, admin):
    first, second = drive_two_trips(world)
    answer = admin.get("/api/v1/trips").json()
    assert [trip["id"] for trip in answer["items"]] == [second.id, first.id]
    assert answer["next"] is None
    shown = admin.get(f"/api/v1/trips/{second.id}").json()
    assert shown["max_speed_kmh"] == pytest.approx(72.0)
    assert shown["under_way"] is False
    assert shown["algorithm"] == "trips/1"
    page = admin.get("/api/v1/trips", params={"limit": 1}).json()
    assert [trip["id"] for trip in page["items"]] == [second.id]
    rest = admin.get("/api/v1/trips", params={"limit": 1, "before": page["next"]}).json()
    assert [trip["id"] for trip in rest["items"]] == [first.id]
    assert rest["next"] is None


def test_trips_are_chosen_by_box_vehicle_and_time(world, admin):
    first, second = drive_two_trips(world)

    def ids(**params):
        return [trip["id"] for trip in admin.get("/api/v1/trips", params=params).json()["items"]]

    assert ids(device=world.device_id) == [second.id, first.id]
    assert ids(device="0" * 32) == []
    assert ids(vehicle="0" * 32) == []
    assert ids(to=second.began_at.isoformat()) == [first.id]
    assert ids(**{"from": second.began_at.isoformat()}) == [second.id]
    assert admin.get("/api/v1/trips", params={"from": "yesterday"}).status_code == 422
    assert admin.get("/api/v1/trips", params={"from": "2026-01-01T00:00:00"}).status_code == 422
    for before in ("x", "0001-01-01T00:00:00+10:00~x", "9999-12-31T23:59:59-10:00~x"):
        assert admin.get("/api/v1/trips", params={"before": before}).json()["code"] == "before"
    for name in ("from", "to"):
        for moment in ("0001-01-01T00:00:00+10:00", "9999-12-31T23:59:59-10:00"):
            assert admin.get("/api/v1/trips", params={name: moment}).status_code == 422


def test_a_track_is_geojson(world, admin):
    _, second = drive_two_trips(world)
    answer = admin.get(f"/api/v1/trips/{second.id}/track").json()
    points = [point for point in world.rows(TrackPoint, TrackPoint.t_s) if point.trip_id == second.id]
    assert answer["type"] == "Feature"
    assert answer["geometry"]["type"] == "LineString"
    assert len(answer["geometry"]["coordinates"]) == len(points) == len(answer["properties"]["at"])
    lon, lat = answer["geometry"]["coordinates"][0]
    assert (lon, lat) == (pytest.approx(7.6), pytest.approx(45.0, abs=0.1))
    assert answer["properties"]["course_deg"][0] == 0.0


def test_other_peoples_trips_are_not_found(world, admin, client):
    first, _ = drive_two_trips(world)
    assert client.get(f"/api/v1/trips/{first.id}").status_code == 401
    assert admin.get(f"/api/v1/trips/{'0' * 32}").status_code == 404
    with world.database.transaction() as session:
        from server.models import Organisation

        other = Organisation(name="other", created_at=world.clock() + dt.timedelta(days=1))
        session.add(other)
        session.flush()
        session.get_one(Trip, first.id).organisation_id = other.id
    assert admin.get(f"/api/v1/trips/{first.id}").status_code == 404
    assert admin.get(f"/api/v1/trips/{first.id}/track").status_code == 404
    assert len(admin.get("/api/v1/trips").json()["items"]) == 1


def test_the_drive_files_fixes_give_the_same_trip():
    drive = drive_of(Leg(100, 10.0))
    from server.formats.drive import from_drive

    assert fold(to_drive(from_drive(drive)).gnss).pieces[0].totals.distance_m == pytest.approx(990.0, rel=0.01)
