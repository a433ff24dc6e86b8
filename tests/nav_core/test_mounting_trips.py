"""A trip with the trips before it: what counts, what contradicts, and what a known side of the traffic is worth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nav_core.mounting import estimate_mounting
from nav_core.mounting.fusion import joined
from nav_core.mounting.model import Noise, roads_of
from nav_core.mounting.trips import Told, told_of
from nav_core.rotation import angle_between, error_between
from nav_core.signal import decimate
from nav_core.simulate import Scenario, random_rotation, simulate

R_VA = random_rotation(np.random.default_rng(77))
CITY = Scenario(route="urban", duration=240.0, R_va=R_VA, accel_rate=50.0, accel_bias=0.0, crown=0.012)


def _trip(scenario: Scenario, seed: int, past=None, noise=None) -> Told:
    drive, _ = simulate(scenario, seed=seed)
    return told_of(decimate(drive.inertial), drive.gnss, past, noise or Noise())


@pytest.fixture(scope="module")
def past():
    return joined([_trip(CITY, seed).own for seed in (1, 2, 3)])


def test_a_trip_sharpens_the_past_and_is_sharpened_by_it(past):
    alone, both = _trip(CITY, 4), _trip(CITY, 4, past)
    assert both.with_past
    assert both.estimate.status == "ready"
    assert both.estimate.sigma[2] < 0.8 * alone.estimate.sigma[2]
    assert abs(error_between(both.estimate.R_va, R_VA)[2]) < 3.0 * both.estimate.sigma[2]


def test_standing_says_nothing_and_takes_nothing_away(past):
    told = _trip(replace(CITY, route="static", duration=60.0), 5, past)
    assert told.own is None
    assert told.estimate.status == "ready"
    assert "not_driven" not in {reason.code for reason in told.estimate.reasons}
    assert np.degrees(angle_between(told.estimate.R_va, R_VA)) < 1.5


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_box_turned_between_trips_begins_anew(past, axis):
    turn = np.zeros(3)
    turn[axis] = np.radians(8.0)
    from scipy.spatial.transform import Rotation

    moved = Rotation.from_rotvec(turn).as_matrix() @ R_VA
    told = _trip(replace(CITY, R_va=moved), 6, past)
    assert not told.with_past
    (change,) = told.estimate.changes
    assert change.t < 20.0
    assert np.degrees(change.angle) == pytest.approx(8.0, abs=1.5)
    assert np.degrees(angle_between(told.estimate.R_va, moved)) < 2.0
    assert np.degrees(angle_between(change.before, R_VA)) < 1.5


def test_the_side_of_the_traffic_tells_the_roads_bank():
    errors: dict[str | None, list[float]] = {None: [], "right": []}
    within = 0
    for seed in range(12):
        crown = float(np.radians(np.random.default_rng(seed).uniform(0.3, 1.2)))
        drive, truth = simulate(Scenario(duration=150.0, accel_rate=50.0, crown=crown), seed=600 + seed)
        for side, list_of in errors.items():
            found = estimate_mounting(drive, traffic_side=side)
            error = error_between(found.R_va, truth.R_va)[0]
            list_of.append(float(error))
            within += side == "right" and abs(error) < 1.96 * found.sigma[0]
    unknown, known = (np.sqrt(np.mean(np.square(list_of))) for list_of in errors.values())
    assert known < 0.65 * unknown
    assert within >= 10
    left, right = roads_of("left"), roads_of("right")
    assert left.crown_mean == -right.crown_mean < 0.0
