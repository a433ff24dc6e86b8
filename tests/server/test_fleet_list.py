"""The list of the fleet: filters, order, pages, the file, the map's places, and what a reader keeps."""

from __future__ import annotations

import csv
import datetime as dt
import io

import httpx
import pytest
import sqlalchemy as sa

from server.accounts.service import ensure_organisation, open_session
from server.models import Device, DeviceState, Installation, Organisation, Trip, Vehicle, WebSession
from server.pages import lists
from server.pages.fleet import Wanted, fleet, places, whole

KNOWN = {"R_va": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "sigma_deg": {"x": 0.2, "y": 0.7, "z": 0.4}, "reasons": []}


def add(session, organisation_id, name, now, *, plate=None, status="ready", seen_ago_s=5.0, lat=45.0, **trip):
    vehicle = Vehicle(organisation_id=organisation_id, name=name, plate=plate, created_at=now)
    session.add(vehicle)
    session.flush()
    seen = None if seen_ago_s is None else now - dt.timedelta(seconds=seen_ago_s)
    device = Device(
        organisation_id=organisation_id, name=f"SC-{name}", token_hash=name.ljust(64, "x"), created_at=now,
        vehicle_id=vehicle.id, last_seen_at=seen,
    )  # fmt: skip
    session.add(device)
    session.flush()
    if seen is not None:
        session.add(
            DeviceState(
                device_id=device.id, updated_at=seen, position_at=seen, lat_deg=lat, lon_deg=9.0, speed_mps=10.0
            )
        )
    session.add(
        Installation(
            device_id=device.id, vehicle_id=vehicle.id, began_at=now, beginning="first", updated_at=now, status=status,
            progress=0.5, result=KNOWN, algorithm="test/1", input_sha256="0" * 64,
        )
    )  # fmt: skip
    if trip:
        began = now - dt.timedelta(days=trip["days_ago"])
        session.add(
            Trip(
                organisation_id=organisation_id, device_id=device.id, vehicle_id=vehicle.id, boot="b", t_first_s=0.0,
                t_last_s=1.0, began_at=began, ended_at=began, under_way=False, distance_m=trip["metres"],
                position_distance_m=0.0, moving_s=60.0, max_speed_mps=1.0, algorithm="test/1", input_sha256="0" * 64,
            )
        )  # fmt: skip
    return device


@pytest.fixture
def cars(organisation, database, clock):
    now = clock()
    with database.transaction() as session:
        add(session, organisation.id, "Alfa", now, plate="GA 101 ZZ", metres=5000.0, days_ago=3)
        add(
            session,
            organisation.id,
            "=cmd()",
            now,
            status="not_fixed",
            seen_ago_s=100_000.0,
            metres=90_000.0,
            days_ago=20,
        )
        add(session, organisation.id, "Citroen", now, status="settling", seen_ago_s=None)
        session.add(Vehicle(organisation_id=organisation.id, name="Bare", created_at=now))
    return organisation


def names(database, organisation, clock, **wanted) -> list[str]:
    with database.reading() as session:
        return [row.name for row in fleet(session, organisation.id, Wanted(**wanted), now=clock()).rows]


@pytest.mark.parametrize(
    ("wanted", "expected"),
    [
        ({}, ["=cmd()", "Alfa", "Bare", "Citroen"]),
        ({"down": True}, ["Citroen", "Bare", "Alfa", "=cmd()"]),
        ({"q": "ga101"}, ["Alfa"]),
        ({"q": "sc- CITRO"}, ["Citroen"]),
        ({"q": "nobody"}, []),
        ({"show": "silent"}, ["=cmd()", "Citroen"]),
        ({"show": "loose"}, ["=cmd()"]),
        ({"show": "empty"}, ["Bare"]),
        ({"show": "waiting"}, ["Citroen"]),
        ({"sort": "seen", "down": True}, ["Alfa", "=cmd()", "Bare", "Citroen"]),
        ({"sort": "distance", "down": True}, ["=cmd()", "Alfa", "Bare", "Citroen"]),
        ({"sort": "distance", "down": True, "days": 7}, ["Alfa", "=cmd()", "Bare", "Citroen"]),
        ({"sort": "speed", "down": True}, ["Alfa", "=cmd()", "Bare", "Citroen"]),
        ({"page": 99}, ["=cmd()", "Alfa", "Bare", "Citroen"]),
    ],
)
def test_filters_and_order(cars, database, clock, wanted, expected):
    assert names(database, cars, clock, **wanted) == expected


def test_a_page_at_a_time(cars, database, clock, monkeypatch):
    monkeypatch.setattr(lists, "PAGE", 3)
    assert names(database, cars, clock, page=1) == ["=cmd()", "Alfa", "Bare"]
    assert names(database, cars, clock, page=2) == ["Citroen"]


def test_the_address_says_what_is_not_usual():
    assert Wanted().query() == ""
    assert Wanted(q="a b", show="moved").query(days=7) == "q=a+b&show=moved&days=7"
    assert Wanted().toggled("distance") == "sort=distance&down=1"
    assert Wanted(sort="distance", down=True).toggled("distance") == "sort=distance"


def test_distance_and_driving_of_a_period(cars, database, clock):
    with database.reading() as session:
        month = {row.name: (row.distance_m, row.moving_s) for row in whole(session, cars.id, Wanted(), now=clock())}
        week = {row.name: row.distance_m for row in whole(session, cars.id, Wanted(days=7), now=clock())}
    assert month["=cmd()"] == (90_000.0, 60.0)
    assert week["=cmd()"] == 0.0
    assert week["Alfa"] == 5000.0


@pytest.mark.usefixtures("cars")
def test_the_file_has_every_row_and_no_formula(admin):
    answer = admin.get("/fleet.csv?sort=distance&down=1")
    assert answer.headers["content-type"].startswith("text/csv")
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    assert [row["vehicle"] for row in rows] == ["'=cmd()", "Alfa", "Bare", "Citroen"]
    assert rows[1]["distance_km"] == "5.0"
    assert rows[1]["sigma_deg"] == "0.7"
    assert rows[1]["lat_deg"] == "45.0"


def test_the_map_gets_what_the_list_shows(cars, admin, database, clock):
    assert [place[2] for place in admin.get("/fleet/places").json()] == ["=cmd()", "Alfa"]
    (only,) = admin.get("/fleet/places?show=reporting", headers={"Accept-Language": "it"}).json()
    assert only[2:5] == ["Alfa", "good", "Pronta"]
    with database.reading() as session:
        assert places(session, cars.id, Wanted(show="empty"), now=clock()) == []


@pytest.mark.usefixtures("cars")
def test_a_search_that_finds_one_goes_there(admin):
    assert admin.get("/vehicles?q=alfa").headers["location"].startswith("/vehicles/")
    assert admin.get("/vehicles?q=c").status_code == 200


@pytest.fixture
def browser(database, address, clock):
    """A signed-in session without an account, as a browser has it."""
    with database.transaction() as session:
        opened = open_session(session, ensure_organisation(session, now=clock()).id, now=clock())
    with httpx.Client(base_url=address, cookies={"scatola_session": opened.token}) as client:
        client.headers["X-CSRF-Token"] = opened.csrf_token
        yield client


@pytest.mark.usefixtures("cars")
def test_language_units_and_views_are_kept_with_the_session(browser, database):
    assert browser.post("/account/preferences", data={"language": "it", "units": "imperial"}).status_code == 303
    page = browser.get("/", headers={"Accept-Language": "en"}).text
    assert '<html lang="it" data-units="imperial">' in page
    assert "mph" in page
    kept = browser.post("/views", data={"page": "fleet", "name": "Mute", "query": "show=silent"})
    assert kept.headers["location"] == "/?show=silent"
    assert 'href="/?show=silent">Mute</a>' in browser.get("/").text
    assert browser.post("/account/preferences", data={"language": "", "units": "metric"}).status_code == 303
    page = browser.get("/", headers={"Accept-Language": "en"}).text
    assert '<html lang="en" data-units="metric">' in page
    assert ">Mute</a>" in page
    browser.post("/views", data={"page": "fleet", "name": "Mute", "forget": "true"})
    assert ">Mute</a>" not in browser.get("/").text
    assert browser.post("/account/preferences", data={"language": "xx"}).status_code == 422
    with database.reading() as session:
        assert session.scalars(sa.select(WebSession)).one().preferences["units"] == "metric"


@pytest.mark.usefixtures("cars")
def test_a_mounting_by_hand_is_checked(browser, database, clock):
    clock.advance(minutes=1)
    with database.reading() as session:
        device = session.scalars(sa.select(Device).where(Device.name == "SC-Citroen")).one()
    form = {"theta": "10", "phi": "20", "psi": "30", "sigma": "1.5", "reason": "a level", "back": "/"}
    path = f"/devices/{device.id}/installation"
    form["back"] = f"/vehicles/{device.vehicle_id}"
    for wrong in ({"theta": "much"}, {"phi": "nan"}, {"sigma": "0"}, {"reason": " "}):
        answer = browser.post(path, data=form | wrong)
        assert answer.status_code == 422, wrong
        assert "Give three angles" in answer.text
        assert 'value="20"' in answer.text or "phi" in wrong
    assert browser.post(path, data=form | {"back": "//elsewhere"}).status_code == 422
    kept = browser.post(path, data=form)
    assert kept.status_code == 303, kept.text
    assert kept.headers["location"] == f"/vehicles/{device.vehicle_id}#mounting"
    del browser.headers["X-CSRF-Token"]
    assert browser.post(path, data=form).status_code == 403


@pytest.mark.usefixtures("cars")
def test_a_trip_of_another_organisation_is_not_shown(admin, database, clock):
    with database.transaction() as session:
        other = Organisation(name="other", created_at=clock() + dt.timedelta(days=1))
        session.add(other)
        session.flush()
        device = add(session, other.id, "Foreign", clock(), metres=1.0, days_ago=1)
        trip = session.scalars(sa.select(Trip).where(Trip.device_id == device.id)).one()
        vehicle = session.scalars(sa.select(Vehicle).where(Vehicle.name == "Alfa")).one()
    assert admin.get(f"/vehicles/{vehicle.id}?trip={trip.id}").status_code == 404
    assert "Foreign" not in admin.get("/fleet.csv").text


def test_the_operators_map_file_is_served_in_parts(settings, database, serve, tmp_path, clock):
    from server.app import create_app

    del database
    archive = tmp_path / "italy.pmtiles"
    archive.write_bytes(b"PMTiles" + bytes(1000))
    app = create_app(settings.model_copy(update={"map_pmtiles": str(archive)}), clock=clock)
    with httpx.Client(base_url=serve(app), headers={"Authorization": "Bearer test-administrator"}) as client:
        part = client.get("/map/basemap.pmtiles", headers={"Range": "bytes=0-6"})
        assert (part.status_code, part.content) == (206, b"PMTiles")
        assert 'pmtiles="/map/basemap.pmtiles"' in client.get("/").text
        assert httpx.get(f"{client.base_url}/map/basemap.pmtiles").status_code == 303


def test_no_map_file_is_no_page(admin):
    assert admin.get("/map/basemap.pmtiles").status_code == 404
