"""A trip with the trips before it: what counts, what contradicts, and what a known side of the traffic is worth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nav_core.mounting import estimate_mounting
from nav_core.mounting.fusion import joined, weakened
from nav_core.mounting.model import Noise, roads_of
from nav_core.mounting.trips import Told, told_of
from nav_core.records import Inertial
from nav_core.rotation import angle_between, error_between
from nav_core.signal import decimate
from nav_core.simulate import Move, Scenario, random_rotation, simulate

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
    assert both.past_share == 1.0
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
    assert told.past_share == 0.0
    (change,) = told.estimate.changes
    assert change.t < 20.0
    assert np.degrees(change.angle) == pytest.approx(8.0, abs=1.5)
    assert np.degrees(angle_between(told.estimate.R_va, moved)) < 2.0
    assert np.degrees(angle_between(change.before, R_VA)) < 1.5


@pytest.mark.parametrize("seed", [8, 9])
def test_a_box_pitched_at_the_end_of_a_trip_is_not_ready_by_what_was_known_before(past, seed: int):
    move = Move(t=222.0, turn=tuple(0.5 * R_VA[1]))
    told = _trip(replace(CITY, moves=(move,)), seed, past)
    assert told.estimate.status == "settling"
    assert "startled" in {reason.code for reason in told.estimate.reasons}


@pytest.mark.parametrize(("time", "duration", "seed", "low_pass"), [(1.0, 120.0, 31, True), (0.5, 60.0, 43, False)])
def test_trips_with_a_receiver_that_smooths_agree(time: float, duration: float, seed: int, low_pass: bool):
    """The receiver's low-pass, told in the first trip, is told in the second one or taken for lag: no contradiction."""
    smoothing = replace(CITY, gnss_smoothing=time, speed_lag=0.2, course_lag=0.3)
    first = _trip(smoothing, seed)
    assert first.estimate.speed_lag > first.own.speed_lag + 0.2
    second = _trip(replace(smoothing, duration=duration), seed + 1, first.own)
    assert (second.estimate.speed_lag > second.own.speed_lag) is low_pass
    assert second.past_share == 1.0
    assert second.estimate.changes == ()
    error = np.abs(error_between(second.estimate.R_va, R_VA))
    assert np.all(error < 3.0 * second.estimate.sigma)


@pytest.mark.parametrize("scale", [1.0 / 9.80665, 0.0, -1.0])
def test_refused_data_stay_refused_whatever_was_known(past, scale):
    """In g, dead, and inverted: the past cannot make them right."""
    drive, _ = simulate(CITY, seed=7)
    ticks = decimate(Inertial(drive.inertial.t, scale * drive.inertial.f))
    told = told_of(ticks, drive.gnss, past, Noise())
    assert told.estimate.status == "insufficient"
    assert told.estimate.R_va is None
    assert told.own is None
    assert told.past_share == float(scale >= 0.0)


def test_a_past_that_was_read_left_handed_is_dropped_with_the_first_bends():
    """An inverted box on a straight road cannot be told; in town it is, and what was believed goes."""
    drive, _ = simulate(replace(CITY, route="straight"), seed=8)
    inverted = decimate(Inertial(drive.inertial.t, -drive.inertial.f))
    straight = told_of(inverted, drive.gnss, None, Noise())
    drive, _ = simulate(CITY, seed=9)
    inverted = decimate(Inertial(drive.inertial.t, -drive.inertial.f))
    town = told_of(inverted, drive.gnss, straight.own, Noise())
    assert town.estimate.status == "insufficient"
    assert town.past_share == 0.0


def test_a_box_nudged_by_a_little_is_believed_in_the_end(past):
    """Too little for a move: the disagreement is said, stated in sigma, and outlived."""
    from scipy.spatial.transform import Rotation

    nudged = Rotation.from_rotvec([0.0, np.radians(2.5), 0.0]).as_matrix() @ R_VA
    evidence, statuses = past, []
    for seed in range(20, 28):
        told = _trip(replace(CITY, R_va=nudged), seed, evidence)
        statuses.append(told.estimate.status)
        error = np.abs(error_between(told.estimate.R_va, nudged))
        assert np.all(error < 3.0 * told.estimate.sigma + np.radians(0.1))
        evidence = joined([weakened(evidence, told.past_share), told.own])
    assert statuses[0] == "settling"
    assert statuses[-1] == "ready"


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
