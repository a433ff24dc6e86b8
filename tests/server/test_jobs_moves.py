"""A box moved while its vehicle was parked, long after its older data became evidence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fleet_world import World, cut
from scipy.spatial.transform import Rotation

from nav_core.mounting.trips import told_of
from nav_core.rotation import angle_between
from nav_core.simulate import Scenario, random_rotation, simulate
from server.models import Installation

R_VA = random_rotation(np.random.default_rng(5))
LONG = Scenario(route="urban", duration=1900.0, R_va=R_VA, accel_rate=20.0, gnss_rate=1.0, accel_bias=0.0, crown=0.01)


@pytest.fixture
def world(database, settings, clock, organisation) -> World:
    world = World(database, settings, clock, organisation)
    world.estimator = told_of
    return world


def _drive(world: World, clock, seed: int, R_va) -> None:
    scenario = replace(LONG, R_va=R_va, start_utc=LONG.start_utc + 4000.0 * seed)
    drive, _ = simulate(scenario, seed=seed)
    for k, batch in enumerate(cut(drive, seconds=150.0)):
        world.put(batch, k, boot=f"boot{seed}")
        clock.advance(seconds=150.0)
        world.bring_up()
    world.settle()


@pytest.mark.parametrize(("axis", "degrees"), [(2, 5.0), (0, 40.0)])
def test_moved_while_parked(world, clock, axis: int, degrees: float):
    turned = Rotation.from_rotvec(np.radians(degrees) * np.eye(3)[axis]).as_matrix() @ R_VA
    _drive(world, clock, 1, R_VA)
    _drive(world, clock, 2, turned)
    rows = world.rows(Installation, Installation.began_at)
    assert [row.beginning for row in rows] == ["first", "moved"]
    assert np.degrees(angle_between(np.array(rows[0].result["R_va"]), R_VA)) < 2.0
    assert np.degrees(angle_between(np.array(rows[1].result["R_va"]), turned)) < 2.0
    assert [row.status for row in rows] == ["ready", "ready"]
    # The boxes' clocks say when: after the first drive and before the second.
    assert LONG.start_utc + 4000.0 + 1899.0 < rows[1].began_at.timestamp() < LONG.start_utc + 8060.0
    assert rows[0].ended_at == rows[1].began_at
    assert rows[1].moved_angle_rad == pytest.approx(np.radians(degrees), abs=np.radians(1.5))
