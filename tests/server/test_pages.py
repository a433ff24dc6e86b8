"""The pages as documents; what they look like is shown in tests/browser."""

from __future__ import annotations

import datetime as dt
import re

import numpy as np
import pytest
import sqlalchemy as sa

from server.models import Device, DeviceState, Installation, Organisation, Trip, Vehicle
from server.pages.fleet import Wanted, whole
from server.pages.fleet import fleet as fleet_list
from server.pages.templating import duration, moment, number
from server.pages.words import angle_to_reference, largest_sigma, standing

KNOWN = {"R_va": np.eye(3).tolist(), "sigma_deg": {"x": 0.2, "y": 0.7, "z": 0.4}, "reasons": []}
UNKNOWN = {"R_va": None, "sigma_deg": None, "reasons": ["Make two turns."]}


@pytest.mark.parametrize(
    ("status", "result", "progress", "moved", "state", "headline", "percent"),
    [
        ("ready", KNOWN, 1.0, False, "good", "Ready", 100),
        ("settling", KNOWN, 0.629, False, "attention", "Calibrating", 62),
        ("settling", KNOWN, 0.999, True, "attention", "Moved, calibrating again", 99),
        ("insufficient", UNKNOWN, 0.2, False, "unknown", "Not calibrated yet", 20),
        ("insufficient", UNKNOWN, 0.0, True, "attention", "Moved, not calibrated yet", 0),
        ("not_fixed", UNKNOWN, 0.4, False, "alarm", "Box is not fixed", 40),
        (None, {}, 0.0, False, "unknown", "Not calibrated yet", 0),
    ],
)
def test_words_for_every_status(status, result, progress, moved, state, headline, percent):
    found = standing(status, result, progress=progress, moved=moved)
    assert (found.state, found.headline, found.percent) == (state, headline, percent)
    assert found.sigma_deg == (0.7 if result is KNOWN else None)
    assert found.calibrated == (status == "ready")


def test_angle_to_the_latest_known_mounting():
    turned = [[np.cos(0.1), -np.sin(0.1), 0.0], [np.sin(0.1), np.cos(0.1), 0.0], [0.0, 0.0, 1.0]]
    references = [{"R_va": (-np.eye(3)).tolist()}, {"R_va": turned}]
    assert angle_to_reference(KNOWN, references) == pytest.approx(np.degrees(0.1))
    assert angle_to_reference(UNKNOWN, references) is None
    assert angle_to_reference(KNOWN, []) is None
    assert largest_sigma(UNKNOWN) is None


def test_numbers_times_and_durations_as_people_write_them():
    assert number(-20.04, 1, sign=True) == "\N{MINUS SIGN}20.0"
    assert number(20.0, 1, sign=True) == "+20.0"
    assert number(-0.04, 1, sign=True) == "0.0"
    assert number(12345.6) == "12\N{NARROW NO-BREAK SPACE}346"
    assert duration(59.6) == "1 min 00 s"
    assert duration(3725.0) == "1 h 02 min"
    local = dt.datetime(2026, 3, 1, 14, 0, 0, tzinfo=dt.timezone(dt.timedelta(hours=2)))
    assert 'datetime="2026-03-01T12:00:00.000Z"' in moment(local)


@pytest.fixture
def fleet(organisation, database, clock):
    """Two vehicles with boxes, the first of which holds markup in its name, and one without."""
    with database.transaction() as session:
        for number_, name in enumerate(("<script>alert(1)</script>", "Panda")):
            vehicle = Vehicle(organisation_id=organisation.id, name=name, created_at=clock())
            session.add(vehicle)
            session.flush()
            device = Device(
                organisation_id=organisation.id,
                name=f"SC-{number_}",
                token_hash=f"{number_:064d}",
                created_at=clock(),
                vehicle_id=vehicle.id,
                last_seen_at=clock(),
            )
            session.add(device)
            session.flush()
            session.add(
                Installation(
                    device_id=device.id,
                    vehicle_id=vehicle.id,
                    began_at=clock(),
                    beginning="first",
                    updated_at=clock(),
                    status="ready",
                    progress=1.0,
                    result=KNOWN,
                    algorithm="test/1",
                    input_sha256="0" * 64,
                )
            )
        session.add(Vehicle(organisation_id=organisation.id, name="Empty", created_at=clock()))
    return organisation


def test_without_signing_in_a_page_leads_to_the_form(client):
    for path in ("/", "/vehicles", "/vehicles/x", "/devices/x"):
        answer = client.get(path)
        assert answer.status_code == 303
        assert answer.headers["location"].startswith("/login?next=")


def test_pages_are_escaped_and_have_no_inline_code(fleet, admin, database):
    del fleet
    with database.reading() as session:
        ids = session.scalars(sa.select(Vehicle.id)).all()
    for path in ("/", "/vehicles", *(f"/vehicles/{vehicle_id}" for vehicle_id in ids)):
        answer = admin.get(path, headers={"Accept": "text/html"})
        assert answer.status_code == 200, path
        assert "<script>alert" not in answer.text
        assert not re.search(r"<script(?![^>]*\bsrc=)", answer.text)
        assert not re.search(r"\s(style|on\w+)=", answer.text)
    assert "&lt;script&gt;alert(1)" in admin.get("/").text


def test_silence_and_moves_need_attention(fleet, database, clock):
    def attention() -> dict[str, int]:
        with database.reading() as session:
            found = fleet_list(session, fleet.id, Wanted(), now=clock())
        return {tile.heading: len(tile.rows) for tile in found.tiles}

    assert attention() == {"Crash": 0, "Alerts": 0, "Not fixed": 0, "Moved": 0, "Silent": 0, "Not calibrated": 0}
    clock.advance(hours=25)
    assert attention()["Silent"] == 2
    with database.transaction() as session:
        installation = session.scalars(sa.select(Installation)).first()
        installation.beginning, installation.updated_at = "moved", clock()
    assert attention()["Moved"] == 1
    clock.advance(days=8)
    assert attention()["Moved"] == 0


@pytest.mark.parametrize(
    ("fix_age_s", "heard_age_s", "shown"), [(119, 119, True), (120, 0, False), (0, 120, False), (9000, 9000, False)]
)
def test_a_speed_is_shown_only_while_it_is_one_of_now(fleet, admin, database, clock, fix_age_s, heard_age_s, shown):
    with database.transaction() as session:
        device = session.scalars(sa.select(Device).where(Device.name == "SC-1")).one()
        device.last_seen_at = clock() - dt.timedelta(seconds=heard_age_s)
        fix_at = clock() - dt.timedelta(seconds=fix_age_s)
        session.add(DeviceState(device_id=device.id, updated_at=clock(), position_at=fix_at, speed_mps=20.0))
    with database.reading() as session:
        rows = fleet_list(session, fleet.id, Wanted(), now=clock()).rows
        row = next(row for row in rows if row.device_name == "SC-1")
    assert row.speed_mps == (20.0 if shown else None)
    page = admin.get("/").text
    assert ('<span class="num">72</span>' in page) == shown
    assert ('title="72 km/h at the last fix"' in page) == (not shown)


def test_kilometres_are_those_of_the_vehicle_that_heads_the_row(fleet, database, clock):
    def add_trip(device, vehicle_id, metres):
        trip = {"organisation_id": fleet.id, "boot": "b", "t_first_s": 0.0, "t_last_s": 1.0, "under_way": False}
        trip |= {"began_at": clock(), "ended_at": clock(), "position_distance_m": 0.0, "moving_s": 0.0}
        trip |= {"max_speed_mps": 0.0, "algorithm": "test/1", "input_sha256": "0" * 64}
        session.add(Trip(device_id=device.id, vehicle_id=vehicle_id, distance_m=metres, **trip))

    def shown() -> dict[str, float]:
        with database.reading() as session:
            rows = fleet_list(session, fleet.id, Wanted(), now=clock()).rows
            assert rows == [row for row in whole(session, fleet.id, Wanted(), now=clock()) if row in rows]
            return {row.device_name: row.distance_m for row in rows if row.device_id}

    with database.transaction() as session:
        first, second = session.scalars(sa.select(Device).order_by(Device.name)).all()
        old, new = first.vehicle_id, second.vehicle_id
        add_trip(first, old, 1000.0)
        add_trip(second, new, 200.0)
        add_trip(second, None, 30.0)
    assert shown() == {"SC-0": 1000.0, "SC-1": 200.0}
    with database.transaction() as session:  # swapped, and driven on
        session.get_one(Device, first.id).vehicle_id = new
        session.get_one(Device, second.id).vehicle_id = None
        add_trip(first, new, 4.0)
    assert shown() == {"SC-0": 204.0, "SC-1": 230.0}
    with database.transaction() as session:  # two boxes in one vehicle drive the same way
        session.get_one(Device, second.id).vehicle_id = new
    assert shown() == {"SC-0": 4.0, "SC-1": 200.0}
    with database.transaction() as session:  # a box that broke leaves its kilometres with the vehicle
        session.get_one(Device, second.id).revoked_at = clock()
    assert shown() == {"SC-0": 204.0}


def test_a_vehicle_without_a_trip_tells_the_map_where_it_stands(fleet, admin, database, clock):
    del fleet
    with database.transaction() as session:
        device = session.scalars(sa.select(Device).where(Device.name == "SC-1")).one()
        state = DeviceState(device_id=device.id, updated_at=clock(), position_at=clock(), lat_deg=45.5, lon_deg=-7.25)
        session.add(state)
    assert 'data-lat="45.5" data-lon="-7.25"' in admin.get(f"/vehicles/{device.vehicle_id}").text


def test_statements_do_not_grow_with_the_fleet(fleet, database, clock):
    counted = []
    sa.event.listen(database.engine, "before_cursor_execute", lambda *_: counted.append(1))

    def statements() -> int:
        counted.clear()
        with database.reading() as session:
            fleet_list(session, fleet.id, Wanted(), now=clock())
        return len(counted)

    before = statements()
    with database.transaction() as session:
        for number_ in range(20):
            vehicle = Vehicle(organisation_id=fleet.id, name=f"V{number_}", created_at=clock())
            session.add(vehicle)
            session.flush()
            session.add(
                Device(
                    organisation_id=fleet.id,
                    name=f"B{number_}",
                    token_hash=f"b{number_:063d}",
                    created_at=clock(),
                    vehicle_id=vehicle.id,
                )
            )
    assert statements() == before <= 7  # with the one that begins


def test_another_organisations_vehicle_is_not_found(fleet, admin, database, clock):
    with database.transaction() as session:
        # Later than the default organisation, which is the first.
        other = Organisation(name="other", created_at=clock() + dt.timedelta(days=1))
        session.add(other)
        session.flush()
        foreign = Vehicle(organisation_id=other.id, name="Foreign", created_at=clock())
        session.add(foreign)
        session.flush()
        foreign_id = foreign.id
        assert fleet_list(session, other.id, Wanted(), now=clock()).boxes == 0
    answer = admin.get(f"/vehicles/{foreign_id}", headers={"Accept": "text/html"})
    assert answer.status_code == 404
    assert answer.headers["content-type"].startswith("text/html")
    assert "Foreign" not in answer.text
    assert "Foreign" not in admin.get("/vehicles").text
    assert fleet.id != other.id
    assert admin.get("/vehicles?q=Foreign").status_code == 200


def test_pages_are_not_part_of_the_api(admin):
    paths = admin.get("/openapi.json").json()["paths"]
    assert all(path.startswith("/api/") for path in paths)
    assert "/api/v1/devices/{device_id}/signals" in paths
