"""A box that is turned during the drive, and boxes that only seem to be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nav_core.mounting import estimate_mounting
from nav_core.mounting.fixes import usable_fixes
from nav_core.mounting.model import Noise
from nav_core.mounting.moved import _rejoined
from nav_core.mounting.solution import between, solve
from nav_core.mounting.stretch import prepare
from nav_core.rotation import angle_between
from nav_core.signal import decimate
from nav_core.simulate import Move, Scenario, simulate
from nav_core.simulate.days import DECIMATED, Warmth, before_start, day

MILLI_G = 9.80665e-3


def _axis(seed: int) -> np.ndarray:
    axis = np.random.default_rng(seed).normal(size=3)
    return axis / np.linalg.norm(axis)


@pytest.mark.parametrize(("angle_deg", "seed"), [(15.0, 3), (90.0, 2), (180.0, 4)])
def test_a_turned_box_is_found_with_its_moment(angle_deg: float, seed: int):
    when = float(np.random.default_rng(seed).uniform(90.0, 200.0))
    move = Move(t=when, turn=tuple(np.radians(angle_deg) * _axis(seed)))
    drive, truth = simulate(Scenario(duration=300.0, moves=(move,)), seed=seed)
    found = estimate_mounting(drive)
    (change,) = found.changes
    assert change.t == pytest.approx(when, abs=15.0)
    assert np.degrees(change.angle) == pytest.approx(angle_deg, abs=4.0)
    assert found.R_va is not None
    assert np.degrees(angle_between(found.R_va, truth.R_va)) < 4.0


def test_a_change_of_heading_alone_is_found():
    base = Scenario(duration=300.0)
    _, before = simulate(base, seed=5)
    turn = np.radians(20.0) * before.R_va.T @ np.array([0.0, 0.0, 1.0])
    drive, truth = simulate(Scenario(duration=300.0, moves=(Move(t=140.0, turn=tuple(turn)),)), seed=5)
    found = estimate_mounting(drive)
    (change,) = found.changes
    assert change.t == pytest.approx(140.0, abs=30.0)
    assert found.R_va is not None
    assert np.degrees(angle_between(found.R_va, truth.R_va)) < 4.0


@pytest.mark.parametrize("seed", range(4))
def test_a_box_turned_just_before_the_end_is_not_called_ready(seed: int):
    """There is too little after it to tell the new mounting by, and the old one no longer holds."""
    move = Move(t=280.0, turn=tuple(np.radians(20.0) * _axis(seed)))
    drive, truth = simulate(Scenario(duration=300.0, accel_rate=50.0, moves=(move,)), seed=40 + seed)
    found = estimate_mounting(drive)
    assert found.status != "ready" or np.degrees(angle_between(found.R_va, truth.R_va)) < 4.0  # type: ignore[arg-type]
    if found.status == "settling":
        assert "startled" in {reason.code for reason in found.reasons}
    stayed, _ = simulate(Scenario(duration=300.0, accel_rate=50.0), seed=40 + seed)
    assert estimate_mounting(stayed).status == "ready"


@pytest.mark.parametrize("outage", [(200.0, 400.0), (230.0, 380.0), (200.0, 365.0)])
def test_a_box_that_is_turned_in_a_tunnel(outage: tuple[float, float]):
    """The change of tilt shows at a moment that no fix is near."""
    move = Move(t=300.0, turn=(0.4, 0.0, 0.0))
    scenario = Scenario(route="urban", duration=600.0, accel_rate=50.0, outages=(outage,), moves=(move,))
    drive, truth = simulate(scenario, seed=3)
    found = estimate_mounting(drive)
    (change,) = found.changes
    assert outage[0] < change.t < outage[1] + 5.0
    assert change.angle == pytest.approx(0.4, abs=np.radians(4.0))
    assert found.R_va is not None
    assert np.degrees(angle_between(found.R_va, truth.R_va)) < 4.0


@pytest.mark.parametrize(
    ("axis", "degrees", "after"),
    [(0, 10.0, 300.0), (2, 10.0, 300.0), (0, 5.0, 300.0), (1, 5.0, 300.0), (2, 5.0, 900.0)],
)
@pytest.mark.parametrize("parked", [False, True], ids=["driving", "parked"])
def test_small_turns_are_found_in_time(axis: int, degrees: float, after: float, parked: bool):
    """The bars, one drive each; `make bench-moved` counts."""
    seed = 100 * axis + int(degrees)
    R_va = np.eye(3)[:, [1, 2, 0]]
    turn = np.radians(degrees) * R_va.T[:, axis]
    base = replace(DECIMATED, R_va=R_va, gnss_rate=4.0)
    if parked:
        made = day(
            [replace(base, duration=600.0), replace(base, duration=after, moves=(before_start(turn),))], seed=seed
        )
    else:
        move = Move(t=600.0, turn=tuple(turn))
        made = day([replace(base, duration=600.0 + after, moves=(move,))], seed=seed)
    moved_at, R_after = made.mountings[-1]
    (change,) = estimate_mounting(made.drive).changes
    assert np.degrees(change.angle) == pytest.approx(degrees, abs=2.0)
    assert change.t == pytest.approx(moved_at, abs=45.0 if axis == 2 else 15.0)
    assert change.before is not None
    assert change.after is not None
    assert np.degrees(angle_between(change.before, R_va)) < 4.0
    assert np.degrees(angle_between(change.after, R_after)) < 4.0
    assert angle_between(change.before, change.after) == pytest.approx(change.angle)


def test_days_in_heat_and_cold_raise_no_alarm():
    """Trips between which the bias steps by twice what is usual, on changing roads."""
    warmth = Warmth(parked=24.0, warming=25.0)
    for seed, routes in enumerate(
        (("urban", "highway"), ("gentle", "urban"), ("highway", "gentle"), ("urban", "urban"))
    ):
        trips = [replace(DECIMATED, route=route, duration=900.0, accel_bias=30.0 * MILLI_G) for route in routes]
        assert estimate_mounting(day(trips, seed=seed, warmth=warmth).drive).changes == ()


def test_a_day_is_what_its_trips_are():
    turn = np.array([0.3, 0.0, 0.0])
    trips = [
        replace(DECIMATED, duration=60.0, R_va=np.eye(3)),
        replace(DECIMATED, duration=60.0, moves=(before_start(turn),)),
    ]
    made = day(trips, seed=1, pause=100.0)
    assert [since for since, _ in made.mountings] == [0.0, 160.0]
    assert angle_between(made.mountings[0][1], made.mountings[1][1]) == pytest.approx(0.3)
    gap = np.diff(made.drive.inertial.t).max()
    assert gap == pytest.approx(100.0, abs=0.1)
    assert abs(np.median(made.drive.inertial.f[:1200, 2]) + 9.8) < 0.5


def test_two_moves():
    moves = (Move(t=150.0, turn=(0.7, 0.0, 0.3)), Move(t=330.0, turn=(0.0, -0.9, 0.0)))
    drive, truth = simulate(Scenario(duration=480.0, moves=moves), seed=7)
    found = estimate_mounting(drive)
    assert [change.t for change in found.changes] == pytest.approx([150.0, 330.0], abs=15.0)
    assert found.R_va is not None
    assert np.degrees(angle_between(found.R_va, truth.R_va)) < 4.0


@pytest.mark.parametrize(("seed", "gap"), [(11, 45.0), (15, 30.0), (16, 45.0), (17, 30.0)])
def test_two_moves_within_a_minute_stay_two(seed: int, gap: float):
    """Between them there is too little to tell a heading by, and no reason to take it for either neighbour."""
    base = Scenario(duration=420.0, accel_rate=50.0)
    _, still = simulate(base, seed=seed)
    tilt = np.radians(7.0) * still.R_va[0]
    yaw = np.radians(35.0) * (still.R_va @ Rotation.from_rotvec(tilt).as_matrix())[2]
    moves = (Move(t=200.0, turn=tuple(tilt)), Move(t=200.0 + gap, turn=tuple(yaw)))
    drive, truth = simulate(replace(base, moves=moves), seed=seed)
    found = estimate_mounting(drive)
    assert found.status == "ready"
    assert len(found.changes) == 2
    assert np.degrees(angle_between(found.R_va, truth.R_va)) < 4.0


@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_a_cut_in_the_wrong_place_is_mended(turn: float):
    """Where the pieces on either side of it agree."""
    move = Move(t=150.0, turn=(0.0, turn, 0.0))
    drive, _ = simulate(Scenario(duration=300.0, accel_rate=50.0, moves=(move,) if turn else ()), seed=8)
    record = prepare(decimate(drive.inertial), usable_fixes(drive.gnss))
    sides = [between(record, 0.0, 150.0), between(record, 150.1, 300.0)]
    pieces = _rejoined(record, *([solve(side, Noise())] for side in sides), Noise())
    assert [piece.record.fixes.t[-1] > 299.0 for piece in pieces] == ([False, True] if turn else [True])


def test_a_box_that_keeps_turning_is_not_fixed():
    moves = tuple(Move(t=t, turn=tuple(_axis(int(t)))) for t in (40.0, 90.0, 140.0, 190.0, 240.0))
    found = estimate_mounting(simulate(Scenario(duration=290.0, moves=moves), seed=3)[0])
    assert found.status == "not_fixed"
    assert [reason.code for reason in found.reasons] == ["loose"]


@pytest.mark.parametrize(
    "scenario",
    [
        Scenario(duration=300.0, accel_bias_drift=30.0 * MILLI_G),
        Scenario(duration=300.0, slope=0.08),
        Scenario(route="highway", duration=300.0, slope=0.05, accel_bias_drift=30.0 * MILLI_G),
        Scenario(route="gentle", duration=300.0, accel_bias=30.0 * MILLI_G),
        Scenario(route="roundabout", duration=120.0, gnss_rate=1.0),
    ],
    ids=["drift", "hills", "drifting in the hills", "poor accelerometer", "roundabouts"],
)
def test_no_false_alarm(scenario: Scenario):
    for seed in range(2):
        assert estimate_mounting(simulate(scenario, seed=700 + seed)[0]).changes == ()


@pytest.mark.slow
def test_no_false_alarm_in_a_hundred_drives():
    for seed in range(100):
        scenario = Scenario(
            route=("urban", "gentle", "straight", "highway")[seed % 4],
            duration=240.0,
            gnss_rate=(1.0, 4.0, 10.0)[seed % 3],
            slope=0.06 if seed % 2 else 0.03,
            accel_bias_drift=30.0 * MILLI_G,
        )
        assert estimate_mounting(simulate(scenario, seed=20_000 + seed)[0]).changes == (), seed


@pytest.mark.parametrize("seed", [502_088, 502_136])
def test_the_last_bends_of_a_roundabout_are_no_move(seed: int):
    """Half a minute of circling can be fitted standing on its head; the mean force says that nothing tilted."""
    drive, truth = simulate(Scenario(route="roundabout", duration=120.0, gnss_rate=4.0), seed=seed)
    found = estimate_mounting(drive)
    assert found.status == "ready"
    assert found.changes == ()
    assert np.degrees(angle_between(found.R_va, truth.R_va)) < 2.0
