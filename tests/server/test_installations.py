from __future__ import annotations

import datetime as dt
import json
import math
import subprocess
import sys

import numpy as np
import pytest
from fleet_world import Leg, World, cut, drive_of

from nav_core.records import MountingChange, MountingEstimate, Reason, SelfTest
from nav_core.rotation import thesis_to_matrix
from server.installations.result import mount_json
from server.jobs.mountings import ALGORITHM
from server.models import Installation

KEYS = {
    "status", "method", "R_va", "euler_deg", "sigma_deg", "observability", "stable", "reliable", "self_test",
    "converged_after_s", "gps_lag_s", "changes", "reasons", "reason_codes", "percent",
}  # fmt: skip


@pytest.fixture
def world(database, settings, clock, organisation) -> World:
    return World(database, settings, clock, organisation)


def moved_box(world) -> None:
    for k, batch in enumerate(cut(drive_of(Leg(120, 10.0), Leg(120, 10.0, down=-1.0)), seconds=60.0)):
        world.put(batch, k)
        world.bring_up()
    world.settle()


def test_the_mount_json_has_every_key_and_plain_values():
    estimate = MountingEstimate(
        "ready",
        "whole-drive",
        R_va=thesis_to_matrix(*np.radians([20.0, -35.0, 110.0])),
        covariance=np.diag(np.radians([0.5, 0.4, 0.3]) ** 2),
        progress=0.666,
        observability=0.97,
        stable=True,
        reliable=True,
        self_test=SelfTest(passed=True, drift=0.8, duration=40.0),
        converged_after=64.0,
        speed_lag=0.2,
        course_lag=0.3,
        changes=(MountingChange(812.0, math.radians(35.0)),),
        reasons=(Reason("no_turns", "Make two turns."),),
    )
    document = json.loads(json.dumps(mount_json(estimate)))
    assert set(document) == KEYS
    assert document["euler_deg"] == {
        "theta": pytest.approx(20.0),
        "phi": pytest.approx(-35.0),
        "psi": pytest.approx(110.0),
    }
    assert document["sigma_deg"] == {"x": pytest.approx(0.5), "y": pytest.approx(0.4), "z": pytest.approx(0.3)}
    assert document["self_test"] == {"passed": True, "drift_mps": 0.8, "duration_s": 40.0}
    assert document["gps_lag_s"] == {"speed": 0.2, "course": 0.3}
    assert document["changes"] == [{"t_s": 812.0, "angle_deg": pytest.approx(35.0)}]
    assert (document["reasons"], document["reason_codes"]) == (["Make two turns."], ["no_turns"])
    assert document["percent"] == 67


def test_an_unknown_mounting_is_null():
    document = mount_json(MountingEstimate("insufficient", "whole-drive"))
    assert set(document) == KEYS
    assert document["R_va"] is document["euler_deg"] is document["sigma_deg"] is document["self_test"] is None


def test_before_any_data_it_is_insufficient(admin, make_device):
    device_id, _ = make_device()
    answer = admin.get(f"/api/v1/devices/{device_id}/installation")
    assert answer.status_code == 200
    document = answer.json()
    assert set(document) >= KEYS | {"updated_at", "algorithm"}
    assert (document["status"], document["R_va"], document["updated_at"]) == ("insufficient", None, None)
    assert admin.get(f"/api/v1/devices/{device_id}/installations").json() == {"items": []}


@pytest.mark.both_databases
def test_the_present_installation_and_the_history(world, admin):
    moved_box(world)
    now = admin.get(f"/api/v1/devices/{world.device_id}/installation").json()
    assert (now["status"], now["beginning"], now["ended_at"]) == ("ready", "moved", None)
    assert now["R_va"] == [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]
    assert now["algorithm"] == ALGORITHM
    assert now["moved_angle_rad"] == pytest.approx(math.pi)
    items = admin.get(f"/api/v1/devices/{world.device_id}/installations").json()["items"]
    assert [item["beginning"] for item in items] == ["moved", "first"]
    assert items[1]["ended_at"] == items[0]["began_at"]
    assert items[0]["revisions"] is None
    items = admin.get(f"/api/v1/devices/{world.device_id}/installations", params={"revisions": 1}).json()["items"]
    for item in items:
        assert item["revisions"]
        moments = [revision["data_at"] for revision in item["revisions"]]
        assert moments == sorted(moments)


def test_a_measured_mounting_by_angles_or_matrix(world, admin, clock):
    url = f"/api/v1/devices/{world.device_id}/installation"
    answer = admin.put(url, json={"euler_deg": {"theta": 20, "phi": -35, "psi": 110}, "reason": "protractor"})
    assert answer.status_code == 200, answer.text
    document = answer.json()
    assert (document["status"], document["method"], document["beginning"]) == ("ready", "manual", "manual")
    assert document["manual_reason"] == "protractor"
    assert document["R_va"][0][0] == pytest.approx(0.769751, abs=1e-6)
    assert document["sigma_deg"] is None
    clock.advance(seconds=60)
    turned = {"R_va": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], "sigma_deg": {"x": 1, "y": 1, "z": 2}, "reason": "again"}
    assert admin.put(url, json=turned).status_code == 200
    assert admin.get(url).json()["sigma_deg"]["z"] == 2.0
    first, second = world.rows(Installation, Installation.began_at)
    assert first.ended_at == second.began_at == clock()


@pytest.mark.parametrize(
    "body",
    [
        {"reason": "neither"},
        {"R_va": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "euler_deg": {"theta": 0, "phi": 0, "psi": 0}, "reason": "both"},
        {"R_va": [[1, 0, 0], [0, 1, 0], [0, 0, -1]], "reason": "a mirror"},
        {"R_va": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "reason": " "},
        {"R_va": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "reason": "x", "from": "2031-01-01T00:00:00Z"},
        {"R_va": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "reason": "x", "more": 1},
    ],
)
def test_what_is_no_mounting_is_refused(world, admin, body):
    answer = admin.put(f"/api/v1/devices/{world.device_id}/installation", json=body)
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert not world.rows(Installation)


def test_a_measured_mounting_does_not_rewrite_what_came_after(world, admin, clock):
    moved_box(world)
    clock.now = dt.datetime.fromtimestamp(1_772_366_400.0 + 3600.0, dt.UTC)
    body = {
        "R_va": np.eye(3).tolist(),
        "reason": "x",
        "from": dt.datetime.fromtimestamp(1_772_366_460.0, dt.UTC).isoformat(),
    }
    answer = admin.put(f"/api/v1/devices/{world.device_id}/installation", json=body)
    assert answer.json()["code"] == "superseded"


def test_strangers_see_nothing(world, client, admin, make_device):
    _, token = make_device()
    url = f"/api/v1/devices/{world.device_id}/installation"
    assert client.get(url).status_code == 401
    assert client.get(url, headers={"Authorization": f"Bearer {token}"}).status_code == 403
    assert admin.get(f"/api/v1/devices/{'0' * 32}/installation").status_code == 404
    assert admin.get(f"/api/v1/devices/{'0' * 32}/installations").status_code == 404


def test_the_routes_load_no_numerics():
    code = (
        "import sys, server.installations.routes, server.trips.routes, server.live.routes;"
        "bad = {'scipy', 'numba'} & set(sys.modules); assert not bad, bad"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
