"""Boxes and vehicles over HTTP, on both databases."""

from __future__ import annotations

import datetime as dt
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import sqlalchemy as sa

from server.accounts.secrets import hash_of
from server.models import Assignment, Change, Device, Organisation, Vehicle

TURNED = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]


@pytest.fixture
def vehicle(admin) -> str:
    return admin.post("/api/v1/vehicles", json={"name": "Van 1"}).json()["id"]


@pytest.fixture
def stranger(database, clock) -> tuple[str, str]:
    """A device and a vehicle of another organisation."""
    with database.transaction() as session:
        # Later than the default organisation, which is the first.
        other = Organisation(name="other", created_at=clock() + dt.timedelta(days=1))
        session.add(other)
        session.flush()
        device = Device(organisation_id=other.id, name="theirs", token_hash="x" * 64, created_at=clock())
        vehicle = Vehicle(organisation_id=other.id, name="theirs", created_at=clock())
        session.add_all([device, vehicle])
        session.flush()
        return device.id, vehicle.id


@pytest.mark.both_databases
def test_a_box_is_registered_and_its_token_shown_once(admin, database, vehicle):
    answer = admin.post("/api/v1/devices", json={"name": "Box 1", "vehicle_id": vehicle})
    assert answer.status_code == 201
    assert set(answer.json()) == {"id", "token"}
    device_id, token = answer.json()["id"], answer.json()["token"]
    shown = admin.get(f"/api/v1/devices/{device_id}")
    assert token not in shown.text
    assert shown.json() | {"created_at": None} == {
        "id": device_id,
        "name": "Box 1",
        "vehicle_id": vehicle,
        "created_at": None,
        "revoked_at": None,
        "last_seen_at": None,
        "signed_only": False,
        "bytes_per_day": None,
        "configuration": None,
        "configuration_version": 0,
        "configuration_seen": None,
        "chain": {"length": 0, "head": ""},
        "reference_mountings": [],
    }
    with database.reading() as session:
        row = session.get_one(Device, device_id)
        assert row.token_hash == hash_of(token)
        assert session.scalars(sa.select(Change.kind)).all() == ["vehicle", "device"]


@pytest.mark.both_databases
def test_an_idempotency_key_gives_the_same_box_without_its_token(admin):
    headers = {"Idempotency-Key": "order 17"}
    first = admin.post("/api/v1/devices", json={"name": "a"}, headers=headers)
    again = admin.post("/api/v1/devices", json={"name": "a"}, headers=headers)
    assert (first.status_code, again.status_code) == (201, 200)
    assert again.json() == {"id": first.json()["id"], "token": None}
    other = admin.post("/api/v1/devices", json={"name": "a"}, headers={"Idempotency-Key": "order 18"})
    assert other.json()["id"] != first.json()["id"]
    with ThreadPoolExecutor(6) as pool:
        answers = list(
            pool.map(
                lambda _: admin.post("/api/v1/devices", json={"name": "b"}, headers={"Idempotency-Key": "at once"}),
                range(6),
            )
        )
    assert sorted(answer.status_code for answer in answers) == [200] * 5 + [201]
    assert len({answer.json()["id"] for answer in answers}) == 1


@pytest.mark.both_databases
def test_an_idempotency_key_does_not_serve_for_another_box(admin, vehicle):
    headers = {"Idempotency-Key": "order 17"}
    first = admin.post("/api/v1/devices", json={"name": "a", "vehicle_id": vehicle}, headers=headers).json()
    refused = admin.post("/api/v1/devices", json={"name": "b"}, headers=headers)
    assert (refused.status_code, refused.json()["code"]) == (409, "idempotency_key_reused")
    assert refused.json()["device_id"] == first["id"]
    assert len(admin.get("/api/v1/devices").json()["items"]) == 1
    # the box may have been put into another vehicle since
    admin.put(f"/api/v1/devices/{first['id']}/vehicle", json={"vehicle_id": None})
    again = admin.post("/api/v1/devices", json={"name": "a", "vehicle_id": vehicle}, headers=headers)
    assert (again.status_code, again.json()["id"]) == (200, first["id"])


@pytest.mark.parametrize(
    "body",
    [{}, {"name": ""}, {"name": "  "}, {"name": "a" * 201}, {"name": "a", "colour": "red"}, {"name": 1}, [], "a"],
)
def test_what_is_no_box_is_refused(admin, body):
    assert admin.post("/api/v1/devices", json=body).status_code == 422


@pytest.mark.both_databases
def test_boxes_are_listed_in_pages(admin, make_device):
    ids = sorted(make_device(name=f"box {index}")[0] for index in range(5))
    first = admin.get("/api/v1/devices", params={"limit": 3}).json()
    assert [item["id"] for item in first["items"]] == ids[:3]
    second = admin.get("/api/v1/devices", params={"limit": 3, "after": first["next"]}).json()
    assert [item["id"] for item in second["items"]] == ids[3:]
    assert second["next"] is None


@pytest.mark.both_databases
def test_tokens_are_rotated_and_boxes_revoked(admin, client, make_device):
    device_id, old = make_device()
    fresh = admin.post(f"/api/v1/devices/{device_id}/token").json()
    assert fresh["id"] == device_id
    for token, status in ((old, 401), (fresh["token"], 422)):
        answer = client.post("/api/v1/batches", headers={"Authorization": f"Bearer {token}"})
        assert answer.status_code == status
    for _ in range(2):
        assert admin.post(f"/api/v1/devices/{device_id}/revoke").json()["revoked_at"] is not None
    refused = admin.post(f"/api/v1/devices/{device_id}/token")
    assert (refused.status_code, refused.json()["code"]) == (409, "device_revoked")


@pytest.mark.both_databases
def test_known_mountings_are_kept_in_order(admin, make_device):
    device_id, _ = make_device()
    eye = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    rounded = [[0.8660, -0.5, 0], [0.5, 0.8660, 0], [0, 0, 1]]
    answer = admin.put(
        f"/api/v1/devices/{device_id}/reference",
        json={
            "mountings": [
                {"from": "2026-03-02T10:00:00+02:00", "R_va": TURNED},
                {"from": "2026-03-01T10:00:00Z", "R_va": eye},
                {"from": "2026-03-03T10:00:00Z", "R_va": rounded},
            ]
        },
    )
    assert answer.status_code == 200, answer.text
    kept = answer.json()["reference_mountings"]
    assert [mounting["from"][:19] for mounting in kept] == [
        "2026-03-01T10:00:00",
        "2026-03-02T08:00:00",
        "2026-03-03T10:00:00",
    ]
    assert kept[1]["R_va"] == TURNED
    snapped = np.array(kept[2]["R_va"])  # four digits were sent, a rotation is kept
    np.testing.assert_allclose(snapped @ snapped.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(snapped, rounded, atol=1e-4)
    assert admin.put(f"/api/v1/devices/{device_id}/reference", json={"mountings": []}).status_code == 200


@pytest.mark.parametrize(
    "R_va",
    [
        [[1, 0, 0], [0, 1, 0], [0, 0, -1]],
        [[1, 0, 0], [0, 1, 0], [0, 0, 2]],
        [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]],
        [[0, 0, 0]] * 3,
        [[1, 0], [0, 1]],
        [[1, 0, 0], [0, 1, 0]],
        [[1, 0, 0], [0, 1, 0], [0, 0, "x"]],
        [[1e200, 0, 0], [0, 1, 0], [0, 0, 1]],
        None,
    ],
)
def test_what_is_no_rotation_is_refused(admin, make_device, R_va):
    device_id, _ = make_device()
    body = {"mountings": [{"from": "2026-03-01T10:00:00Z", "R_va": R_va}]}
    assert admin.put(f"/api/v1/devices/{device_id}/reference", json=body).status_code == 422


def test_a_time_without_a_zone_is_refused(admin, make_device):
    device_id, _ = make_device()
    body = {"mountings": [{"from": "2026-03-01T10:00:00", "R_va": TURNED}]}
    assert admin.put(f"/api/v1/devices/{device_id}/reference", json=body).status_code == 422


@pytest.mark.both_databases
def test_changes_of_a_vehicle_stand_in_the_audit_log(admin, vehicle):
    assert admin.patch(f"/api/v1/vehicles/{vehicle}", json={"name": "Van 9"}).status_code == 200
    assert admin.delete(f"/api/v1/vehicles/{vehicle}").status_code == 204
    log = admin.get("/api/v1/audit").json()["items"]
    assert [entry["action"] for entry in log][:3] == ["vehicle.removed", "vehicle.changed", "vehicle.added"]
    assert {entry["subject"] for entry in log[:3]} == {f"vehicle={vehicle}"}
    assert log[1]["detail"] == {"name": "Van 9"}


def test_a_box_is_swapped_between_vehicles(admin, make_device, vehicle, database, clock):
    other = admin.post("/api/v1/vehicles", json={"name": "Van 2"}).json()["id"]
    device_id, _ = make_device(vehicle_id=vehicle)
    began = clock()
    clock.advance(hours=2)
    at = (began + dt.timedelta(hours=1)).isoformat()
    answer = admin.put(f"/api/v1/devices/{device_id}/vehicle", json={"vehicle_id": other, "at": at})
    assert (answer.status_code, answer.json()["vehicle_id"]) == (200, other), answer.text
    same = admin.put(f"/api/v1/devices/{device_id}/vehicle", json={"vehicle_id": other})
    assert same.status_code == 200
    out = admin.put(f"/api/v1/devices/{device_id}/vehicle", json={"vehicle_id": None})
    assert out.json()["vehicle_id"] is None
    with database.reading() as session:
        periods = session.scalars(sa.select(Assignment).order_by(Assignment.began_at)).all()
    assert [(p.vehicle_id, p.began_at, p.ended_at) for p in periods] == [
        (vehicle, began, began + dt.timedelta(hours=1)),
        (other, began + dt.timedelta(hours=1), clock()),
    ]
    boxes = admin.get(f"/api/v1/vehicles/{vehicle}").json()["boxes"]
    assert [(box["device_id"], box["ended_at"] is not None) for box in boxes] == [(device_id, True)]


@pytest.mark.both_databases
def test_swaps_that_cannot_be(admin, make_device, vehicle, clock):
    other = admin.post("/api/v1/vehicles", json={"name": "Van 2"}).json()["id"]
    device_id, _ = make_device(vehicle_id=vehicle)
    path = f"/api/v1/devices/{device_id}/vehicle"
    future = (clock() + dt.timedelta(seconds=1)).isoformat()
    past = (clock() - dt.timedelta(seconds=1)).isoformat()
    for body in (
        {"vehicle_id": other, "at": future},
        {"vehicle_id": other, "at": past},
        {"vehicle_id": "nope"},
        {"vehicle_id": other, "at": "2026-03-01T10:00:00"},
        {},
    ):
        assert admin.put(path, json=body).status_code == 422
    assert admin.get(f"/api/v1/devices/{device_id}").json()["vehicle_id"] == vehicle


@pytest.mark.both_databases
def test_vehicles_are_made_changed_and_deleted(admin):
    made = admin.post(
        "/api/v1/vehicles",
        json={"name": " Bus 9 ", "plate": "AB 123 CD", "vehicle_class": "bus", "traffic_side": "left"},
    )
    assert made.status_code == 201
    vehicle = made.json()
    assert (vehicle["name"], vehicle["vehicle_class"], vehicle["boxes"]) == ("Bus 9", "bus", [])
    path = f"/api/v1/vehicles/{vehicle['id']}"
    changed = admin.patch(path, json={"plate": None, "vehicle_class": "truck"}).json()
    assert (changed["name"], changed["plate"], changed["vehicle_class"]) == ("Bus 9", None, "truck")
    assert admin.get(path).json() == changed
    for bad in (
        {"name": None},
        {"vehicle_class": "boat"},
        {"traffic_side": "up"},
        {"id": "x"},
        {"vehicle_class": None},
    ):
        assert admin.patch(path, json=bad).status_code == 422
    assert [item["id"] for item in admin.get("/api/v1/vehicles").json()["items"]] == [vehicle["id"]]
    assert admin.delete(path).status_code == 204
    assert admin.get(path).status_code == 404


@pytest.mark.both_databases
def test_a_vehicle_that_had_a_box_is_kept(admin, make_device, vehicle):
    device_id, _ = make_device(vehicle_id=vehicle)
    admin.put(f"/api/v1/devices/{device_id}/vehicle", json={"vehicle_id": None})
    refused = admin.delete(f"/api/v1/vehicles/{vehicle}")
    assert (refused.status_code, refused.json()["code"]) == (409, "vehicle_in_use")


@pytest.mark.both_databases
def test_vehicles_are_listed_in_pages(admin):
    ids = sorted(admin.post("/api/v1/vehicles", json={"name": f"v{n}"}).json()["id"] for n in range(3))
    first = admin.get("/api/v1/vehicles", params={"limit": 2}).json()
    assert ([item["id"] for item in first["items"]], first["next"]) == (ids[:2], ids[1])
    assert admin.get("/api/v1/vehicles", params={"limit": 0}).status_code == 422


@pytest.mark.both_databases
def test_another_organisation_is_not_there(admin, make_device, stranger, vehicle):
    device_id, vehicle_id = stranger
    for path in (f"/api/v1/devices/{device_id}", f"/api/v1/vehicles/{vehicle_id}"):
        assert admin.get(path).status_code == 404
    assert admin.post(f"/api/v1/devices/{device_id}/token").status_code == 404
    assert admin.post(f"/api/v1/devices/{device_id}/revoke").status_code == 404
    assert admin.put(f"/api/v1/devices/{device_id}/vehicle", json={"vehicle_id": vehicle}).status_code == 404
    assert admin.put(f"/api/v1/devices/{device_id}/reference", json={"mountings": []}).status_code == 404
    assert admin.delete(f"/api/v1/vehicles/{vehicle_id}").status_code == 404
    assert admin.patch(f"/api/v1/vehicles/{vehicle_id}", json={"name": "mine"}).status_code == 404
    own, _ = make_device()
    for body in ({"name": "b", "vehicle_id": vehicle_id},):
        assert admin.post("/api/v1/devices", json=body).status_code == 422
    assert admin.put(f"/api/v1/devices/{own}/vehicle", json={"vehicle_id": vehicle_id}).status_code == 422
    assert [item["id"] for item in admin.get("/api/v1/devices").json()["items"]] == [own]
