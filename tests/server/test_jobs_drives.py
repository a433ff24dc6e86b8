"""The whole way with the real estimator on simulated drives."""

from __future__ import annotations

import numpy as np
import pytest
from fleet_world import World, cut

from nav_core.mounting import whole_drive
from nav_core.mounting.trips import told_of
from nav_core.rotation import angle_between
from nav_core.signal import decimate
from nav_core.simulate import Move, Scenario, simulate
from server.models import Change, Installation, Trip


@pytest.fixture
def world(database, settings, clock, organisation) -> World:
    world = World(database, settings, clock, organisation)
    world.estimator = told_of
    return world


def error_deg(installation, R_va) -> float:
    return float(np.degrees(angle_between(np.array(installation.result["R_va"]), R_va)))


def test_a_box_moved_on_the_way_has_two_installations(world, clock):
    scenario = Scenario(duration=420.0, accel_rate=100.0, moves=(Move(t=200.0, turn=(0.0, 0.0, np.radians(40.0))),))
    drive, truth = simulate(scenario, seed=5)
    told_at = None
    for k, batch in enumerate(cut(drive, seconds=20.0)):
        world.put(batch, k)
        clock.advance(seconds=20.0)
        world.bring_up()
        if told_at is None and "moved" in world.kinds():
            told_at = 20.0 * (k + 1)
    world.settle()
    before, after = world.rows(Installation, Installation.began_at)
    assert (before.beginning, after.beginning) == ("first", "moved")
    assert before.ended_at == after.began_at
    assert after.began_at.timestamp() - scenario.start_utc == pytest.approx(200.0, abs=5.0)
    assert np.degrees(after.moved_angle_rad) == pytest.approx(40.0, abs=5.0)
    assert error_deg(before, truth.mountings[0][1]) < 4.0
    assert error_deg(after, truth.mountings[1][1]) < 4.0
    assert told_at is not None
    assert told_at <= 330.0
    (moved,) = [change for change in world.rows(Change) if change.kind == "moved"]
    assert moved.data["installation_id"] == after.id


def test_a_standing_box_stays_insufficient(world):
    drive, _ = simulate(Scenario(route="static", duration=180.0, accel_rate=50.0), seed=3)
    for k, batch in enumerate(cut(drive, seconds=30.0)):
        world.put(batch, k)
        world.bring_up()
    world.settle()
    installation = world.one(Installation)
    assert installation.status == "insufficient"
    assert installation.result["R_va"] is None
    assert installation.result["reasons"]
    assert not world.rows(Trip)


def test_shuffled_batches_give_the_same_mounting_to_the_last_bit(world):
    drive, truth = simulate(Scenario(duration=240.0, accel_rate=50.0), seed=8)
    batches = cut(drive, seconds=30.0)
    results = []
    for order in (range(len(batches)), [5, 0, 7, 2, 6, 1, 4, 3]):
        device_id = world.device_id = world.new_device()
        for k in order:
            world.put(batches[k], k)
            world.bring_up()
        world.settle()
        results.append(next(row for row in world.rows(Installation) if row.device_id == device_id))
    one, other = results
    assert one.status == "ready"
    assert one.result == other.result
    assert one.input_sha256 == other.input_sha256
    assert error_deg(one, truth.mountings[0][1]) < 4.0
    direct = whole_drive.estimate(decimate(drive.inertial), drive.gnss)
    assert np.allclose(direct.R_va, one.result["R_va"], atol=1e-6)
