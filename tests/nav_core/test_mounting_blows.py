"""Crashes are no evidence about how a box sits; what is driven before and after them is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nav_core.mounting import estimate_mounting
from nav_core.mounting.blows import AFTER, BEFORE, Blow, blows, cut_out
from nav_core.mounting.fixes import usable_fixes
from nav_core.mounting.stretch import prepare
from nav_core.records import Drive, Gnss, Inertial
from nav_core.rotation import angle_between
from nav_core.signal import decimate
from nav_core.simulate import Impact, Move, Scenario, Truth, simulate

G = 9.80665
TURN = (0.5, -0.6, 0.4)
TURN_DEG = float(np.degrees(np.linalg.norm(TURN)))
COLUMNS = ("t", "lat", "lon", "alt", "speed", "course", "fix")


def _impact(t: float) -> Impact:
    return Impact(t=t, delta_v=32.0 / 3.6, pdof=np.radians(-20.0), duration=0.11)


def _blows(drive: Drive) -> tuple[Blow, ...]:
    return blows(decimate(drive.inertial), usable_fixes(drive.gnss))


def _with_force(drive: Drive, added: np.ndarray) -> Drive:
    return Drive(Inertial(t=drive.inertial.t, f=drive.inertial.f + added), drive.gnss)


def _error_deg(R_va: np.ndarray | None, truth: Truth) -> float:
    assert R_va is not None
    return float(np.degrees(angle_between(R_va, truth.R_va)))


@pytest.mark.parametrize("seed", range(5, 10))
def test_a_crash_does_not_spoil_the_mounting(seed: int):
    drive, truth = simulate(Scenario(duration=300.0, impacts=(_impact(200.0),)), seed=seed)
    found = estimate_mounting(drive)
    assert found.status == "ready"
    assert found.changes == ()
    assert _error_deg(found.R_va, truth) < 3.0


@pytest.mark.parametrize("seed", range(5, 10))
def test_a_move_before_a_crash_is_the_only_change(seed: int):
    move = Move(t=100.0, turn=TURN)
    drive, truth = simulate(Scenario(duration=300.0, impacts=(_impact(200.0),), moves=(move,)), seed=seed)
    found = estimate_mounting(drive)
    assert found.status == "ready"
    (change,) = found.changes
    assert change.t == pytest.approx(100.0, abs=5.0)
    assert np.degrees(change.angle) == pytest.approx(TURN_DEG, abs=4.0)
    assert _error_deg(found.R_va, truth) < 3.0


def test_no_false_change_in_twenty_crash_drives():
    """From a bump to a wreck, from all sides, seen by good and by poor boxes."""
    boxes = (
        Scenario(duration=160.0),
        Scenario(duration=160.0, accel_full_scale=2.0 * G),
        Scenario(duration=160.0, accel_rate=20.0),
        Scenario(duration=160.0, gnss_rate=1.0),
    )
    rng = np.random.default_rng(1)
    errors = []
    for seed in range(100, 120):
        impact = Impact(
            t=rng.uniform(90.0, 130.0),
            delta_v=rng.uniform(5.0, 60.0) / 3.6,
            pdof=rng.uniform(-np.pi, np.pi),
            duration=rng.uniform(0.06, 0.16),
            yaw_rate_change=rng.uniform(-2.0, 2.0),
        )
        drive, truth = simulate(replace(boxes[seed % 4], impacts=(impact,)), seed=seed)
        found = estimate_mounting(drive)
        assert found.changes == (), seed
        assert found.status in ("ready", "settling"), seed
        errors.append(_error_deg(found.R_va, truth))
    assert np.median(errors) < 1.5
    assert max(errors) < 4.0


def _driven_on(seed: int, turn: tuple[float, float, float]) -> tuple[Drive, Truth]:
    """A drive with a crash at 120 s, and from 150 s on another with the box turned."""
    first, wreck = simulate(Scenario(duration=150.0, impacts=(_impact(120.0),)), seed=seed)
    scenario = Scenario(
        duration=150.0,
        R_va=wreck.R_va @ Rotation.from_rotvec(turn).as_matrix(),
        start_alt=240.0 - float(wreck.position[-1, 2]),
    )
    second, truth = simulate(scenario, seed=seed + 50)
    later = 150.5
    inertial = Inertial(
        t=np.concatenate([first.inertial.t, second.inertial.t + later]),
        f=np.concatenate([first.inertial.f, second.inertial.f]),
    )
    a, b = first.gnss, second.gnss
    gnss = Gnss(*(np.concatenate([getattr(a, n), getattr(b, n) + (later if n == "t" else 0)]) for n in COLUMNS))
    return Drive(inertial, gnss), truth


@pytest.mark.parametrize("seed", [5, 8])
def test_a_box_turned_by_the_crash_is_found_from_the_driving_after_it(seed: int):
    drive, truth = _driven_on(seed, TURN)
    found = estimate_mounting(drive)
    (change,) = found.changes
    assert change.t == pytest.approx(120.0, abs=0.5)
    assert np.degrees(change.angle) == pytest.approx(TURN_DEG, abs=4.0)
    assert _error_deg(found.R_va, truth) < 3.0


@pytest.mark.parametrize("seed", [5, 8])
def test_a_box_that_withstood_the_crash_is_not_moved(seed: int):
    drive, truth = _driven_on(seed, (0.0, 0.0, 0.0))
    found = estimate_mounting(drive)
    assert found.status == "ready"
    assert found.changes == ()
    assert _error_deg(found.R_va, truth) < 3.0


def test_a_vehicle_that_rests_in_the_ditch_is_no_moved_box():
    drive, truth = simulate(Scenario(duration=300.0, impacts=(_impact(150.0),)), seed=6)
    t, f = drive.inertial.t, drive.inertial.f.copy()
    after = t > 153.0
    f[after] = f[after] @ Rotation.from_rotvec([0.5, 0.2, 0.0]).as_matrix()
    found = estimate_mounting(Drive(Inertial(t=t, f=f), drive.gnss))
    assert found.status == "ready"
    assert found.changes == ()
    assert _error_deg(found.R_va, truth) < 3.0
    (blow,) = _blows(drive)
    assert blow.t == pytest.approx(150.0, abs=0.3)
    assert blow.end == np.inf


def test_while_the_crash_is_still_going_on_the_estimate_stands():
    drive, truth = simulate(Scenario(duration=300.0, impacts=(_impact(150.0),)), seed=9)
    for until in (150.3, 152.0, 160.0):
        inertial, gnss = drive.inertial.t < until, drive.gnss.t < until
        part = Drive(
            Inertial(t=drive.inertial.t[inertial], f=drive.inertial.f[inertial]),
            Gnss(*(getattr(drive.gnss, name)[gnss] for name in COLUMNS)),
        )
        found = estimate_mounting(part)
        assert found.changes == ()
        assert _error_deg(found.R_va, truth) < 3.0


def test_ordinary_driving_holds_no_blow():
    for seed, route in enumerate(("urban", "highway", "roundabout", "gentle")):
        assert _blows(simulate(Scenario(route=route, duration=120.0), seed=seed)[0]) == ()


@pytest.mark.parametrize("angle", [0.5, 1.0])
def test_a_moved_box_alone_is_no_blow(angle: float):
    drive, _ = simulate(Scenario(duration=120.0, moves=(Move(t=60.0, turn=(np.pi * angle, 0.0, 0.0)),)), seed=2)
    assert _blows(drive) == ()


@pytest.mark.parametrize(("every", "peak"), [(20.0, 3.0), (10.0, 6.0), (5.0, 6.0), (2.0, 3.0)])
def test_potholes_cost_little(every: float, peak: float):
    """A wheel that drops into a hole and comes out again: hard, but no velocity is lost over it."""
    drive, truth = simulate(Scenario(duration=300.0), seed=5)
    since = drive.inertial.t % every
    shock = peak * G * np.where(since < 0.08, np.sin(2.0 * np.pi * since / 0.08), 0.0)
    shaken = _with_force(drive, np.outer(shock, truth.R_va.T @ np.array([-0.3, 0.0, -1.0])))
    assert _blows(shaken) == ()
    found = estimate_mounting(shaken)
    assert found.status == "ready"
    assert _error_deg(found.R_va, truth) < 3.0


def test_what_would_take_most_of_the_driving_is_a_way_of_life():
    drive, truth = simulate(Scenario(duration=200.0), seed=5)
    backward = truth.R_va.T @ np.array([-1.0, 0.0, 0.0])
    often, once = (np.where((drive.inertial.t - 9.0) % every < 0.1, 6.0 * G, 0.0) for every in (15.0, 1e3))
    assert _blows(_with_force(drive, np.outer(often, backward))) == ()
    assert len(_blows(_with_force(drive, np.outer(once, backward)))) == 1


def test_a_rough_ride_is_no_row_of_crashes():
    drive, _ = simulate(Scenario(duration=60.0), seed=5)
    shaking = np.random.default_rng(1).normal(0.0, 1.5 * G, drive.inertial.f.shape)
    assert _blows(_with_force(drive, shaking)) == ()


def test_a_parked_vehicle_that_is_hit_has_not_been_driven():
    drive, _ = simulate(Scenario(route="static", duration=60.0, impacts=(_impact(1.0),)), seed=1)
    found = estimate_mounting(drive)
    assert [reason.code for reason in found.reasons] == ["not_driven"]


def test_nothing_recorded_holds_no_blow():
    nothing = np.zeros(0)
    empty = Gnss(nothing, nothing, nothing, nothing, nothing, nothing, nothing.astype(bool))
    assert _blows(Drive(Inertial(t=nothing, f=np.zeros((0, 3))), empty)) == ()


def test_a_cut_is_a_gap_in_ticks_and_fixes():
    drive, _ = _driven_on(5, (0.0, 0.0, 0.0))
    ticks, fixes = decimate(drive.inertial), usable_fixes(drive.gnss)
    record = prepare(ticks, fixes)
    found = blows(ticks, fixes)
    (blow,) = found
    assert blow.begin == blow.t - BEFORE
    assert blow.end >= blow.t + AFTER
    left = cut_out(record, found)
    for t in (left.t, left.fixes.t):
        assert not ((t >= blow.begin) & (t < blow.end)).any()
    first = int(np.argmax(left.t >= blow.end))
    assert left.step[first] == 0.0
    whole = record.t < blow.begin
    np.testing.assert_array_equal(left.step[:first], record.step[whole])
    assert cut_out(record, ()) is record
