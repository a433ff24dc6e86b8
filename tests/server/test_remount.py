"""Mountings of another version: asked for, estimated anew from what is kept, compared; again goes on."""

from __future__ import annotations

import dataclasses
import json
import math

import pytest
import sqlalchemy as sa
from fleet_world import Leg, World, cut, drive_of, gravity_estimator

from nav_core.mounting.trips import Told
from nav_core.rotation import thesis_to_matrix
from server.cli.main import main
from server.installations.service import ALGORITHM
from server.jobs import mountings, remount
from server.jobs.due import due_devices
from server.models import AuditEntry, DeviceState, Installation, MountingRevision

NEXT = "whole-drive/next"
TURN_DEG = 2.0


@pytest.fixture
def world(database, settings, clock, organisation) -> World:
    world = World(database, settings, clock, organisation)
    for k, batch in enumerate(cut(drive_of(Leg(200, 12.0)), seconds=20.0)):
        world.put(batch, k)
    world.settle()
    return world


@pytest.fixture
def next_version(world, monkeypatch) -> None:
    del world  # estimated by this version first
    for module in (mountings, remount):
        monkeypatch.setattr(module, "ALGORITHM", NEXT)


def turned(ticks, gnss, past, noise) -> Told:
    """What the version before said, turned about the vertical."""
    told = gravity_estimator(ticks, gnss, past, noise)
    if told.estimate.R_va is None:
        return told
    R_va = thesis_to_matrix(0.0, math.radians(TURN_DEG), 0.0) @ told.estimate.R_va
    return Told(dataclasses.replace(told.estimate, R_va=R_va), None, 1.0)


def report(world, **of) -> remount.MountingReport:
    with world.database.reading() as session:
        return remount.report(session, **of)


def due(world) -> list[str]:
    with world.database.reading() as session:
        return due_devices(session, 10, now=world.clock())


def test_what_waits_is_estimated_at_once():
    assert remount.WAITS_S >= mountings.STANDING_S


@pytest.mark.both_databases
@pytest.mark.usefixtures("next_version")
def test_a_mounting_of_another_version_is_estimated_anew_and_compared(world, clock):
    before = world.one(Installation)
    assert (before.algorithm, before.status) == (ALGORITHM, "ready")
    revisions = len(world.rows(MountingRevision))
    assert (report(world).outdated, report(world).waiting, report(world).done) == (1, 0, 0)
    assert due(world) == []
    # Begun, stopped before anything was done, begun again.
    for _ in range(2):
        assert remount.ask(world.database, now=clock()) == [world.device_id]
        assert (report(world).outdated, report(world).waiting) == (0, 1)
    assert due(world) == [world.device_id]
    world.estimator = turned
    world.bring_up()
    after = world.one(Installation)
    assert (after.algorithm, after.status, after.unestimated_s) == (NEXT, "ready", 0.0)
    assert after.input_sha256 == before.input_sha256
    found = report(world, organisation_id=world.organisation.id)
    assert (found.outdated, found.waiting, found.done) == (0, 0, 1)
    assert found.before_algorithms == {ALGORITHM: 1}
    assert found.statuses == {"ready -> ready": 1}
    assert found.turned.median == found.turned.worst == pytest.approx(TURN_DEG)
    assert found.turned.worst_installation_id == after.id
    assert found.sigma_ratio == pytest.approx(1.0)
    # What was said before is still there.
    kept = world.rows(MountingRevision, MountingRevision.created_at)
    assert len(kept) == revisions + 1
    assert {row.algorithm for row in kept[:-1]} == {ALGORITHM}
    assert kept[-1].algorithm == NEXT
    assert remount.ask(world.database, now=clock()) == []
    assert report(world, organisation_id="0" * 32).done == 0


@pytest.mark.both_databases
@pytest.mark.usefixtures("next_version")
def test_a_round_that_is_under_way_does_not_lose_the_wish(world, clock):
    estimated = []

    def slow(*given):
        if not estimated:
            remount.ask(world.database, now=clock())  # somebody begins while this one computes
        estimated.append(1)
        return turned(*given)

    world.estimator = slow
    world.put(cut(drive_of(Leg(80, 12.0), start=400.0), seconds=80.0)[0], 99)
    world.bring_up()
    assert world.one(Installation).algorithm == NEXT
    assert len(estimated) == 2


@pytest.mark.both_databases
@pytest.mark.usefixtures("next_version")
@pytest.mark.parametrize("why", [{"raw_erased_at": "now"}, {"algorithm": "manual/1"}, {"input_sha256": ""}])
def test_what_cannot_be_estimated_again_stays(world, clock, why):
    values = {name: clock() if value == "now" else value for name, value in why.items()}
    with world.database.transaction() as session:
        session.execute(sa.update(Installation).values(values))
    assert remount.ask(world.database, now=clock()) == []
    assert report(world).waiting == report(world).outdated == 0
    assert world.one(DeviceState).review_at is None


@pytest.mark.both_databases
@pytest.mark.usefixtures("next_version")
def test_over_http(admin, world):
    asked = admin.post("/api/v1/reruns/mountings", json={"device_id": world.device_id})
    assert (asked.status_code, asked.json()["waiting"]) == (202, 1)
    world.estimator = turned
    world.bring_up()
    told = admin.get("/api/v1/reruns/mountings").json()
    assert (told["algorithm"], told["done"], told["waiting"]) == (NEXT, 1, 0)
    assert told["turned"]["worst"] == pytest.approx(TURN_DEG)
    assert admin.get("/api/v1/reruns/mountings", params={"device": "x"}).json()["done"] == 0
    assert admin.post("/api/v1/reruns/mountings", json={"device_id": "x"}).status_code == 404
    assert [entry.action for entry in world.rows(AuditEntry)] == ["rerun.mountings"]


@pytest.mark.usefixtures("next_version")
def test_at_the_command_line(world, settings, monkeypatch, capsys):
    monkeypatch.setenv("SCATOLA_DATA_DIR", str(settings.data_dir))
    assert main(["reprocess", "--mountings", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["mountings"]
    assert (told["waiting"], told["outdated"], told["done"]) == (0, 0, 1)
    assert world.one(Installation).algorithm == NEXT
    assert main(["reprocess", "--mountings"]) == 0
    assert "1 of another version before, 0 wait" in capsys.readouterr().out


@pytest.mark.usefixtures("next_version")
def test_on_the_page(admin, world):
    page = admin.get("/admin/versions").text
    assert "1 mounting rests on an older version." in page
    begun = admin.post("/admin/versions", data={"what": "mountings"})
    assert (begun.status_code, begun.headers["location"]) == (303, "/admin/versions")
    assert "1 of them wait to be estimated." in admin.get("/admin/versions").text
    world.estimator = turned
    world.bring_up()
    page = admin.get("/admin/versions").text
    assert "All mountings rest on this version." in page
    assert "half by less than 2.00°" in page
    assert admin.post("/admin/versions", data={"what": "mountings", "device_id": "x"}).status_code == 404
