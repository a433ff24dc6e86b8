"""Boxes, receivers and vehicles that are in trouble: named, and handled or refused."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nav_core.mounting import estimate_mounting
from nav_core.mounting.clocks import clock_jumps
from nav_core.mounting.fusion import joined
from nav_core.mounting.model import Noise
from nav_core.mounting.online import advance, begin
from nav_core.mounting.online_stream import chunks_of, fixes_where
from nav_core.mounting.online_verdict import assess
from nav_core.mounting.receiver import NO_CHORDS, Repeats, chords, followed_on, frozen, repeats_on, wrong_gps_unit
from nav_core.mounting.reversing import reversals
from nav_core.mounting.stuck import stuck_axis
from nav_core.mounting.trips import told_of
from nav_core.mounting.trouble import sampling_rate
from nav_core.records import Drive, Gnss, Inertial, MountingEstimate, Reason
from nav_core.rotation import angle_between, error_between
from nav_core.signal import decimate
from nav_core.simulate import Move, Scenario, Truth, simulate
from nav_core.simulate import faults as fault
from nav_core.simulate.days import DECIMATED, day
from nav_core.typing import Floats

G = 9.80665
INVERTED = -np.eye(3)
LEFT_HANDED = np.diag([1.0, -1.0, 1.0])
ROUTES = (("urban", 300.0), ("gentle", 300.0), ("highway", 600.0), ("roundabout", 120.0))


def _drive(route: str = "urban", duration: float = 300.0, seed: int = 1, **more: object) -> tuple[Drive, Truth]:
    return simulate(Scenario(**{"route": route, "duration": duration, "accel_rate": 50.0, **more}), seed=seed)  # type: ignore[arg-type]


def _codes(found: MountingEstimate) -> set[str]:
    assert all(reason.text for reason in found.reasons)
    return {reason.code for reason in found.reasons}


def _error_deg(found: MountingEstimate, R_va: np.ndarray) -> float:
    assert found.R_va is not None
    return float(np.degrees(angle_between(found.R_va, R_va)))


def _standing(truth: Truth, begin: float = 40.0) -> float:
    """Middle of the first stand after `begin`, s."""
    still = (np.abs(truth.v) < 0.01) & (truth.t > begin)
    first = int(np.argmax(still))
    assert still[first]
    moving_again = first + int(np.argmin(still[first:]))
    return float(0.5 * (truth.t[first] + truth.t[moving_again]))


# What the accelerometer sends.


@pytest.mark.parametrize(
    ("factor", "named"), [(1.0, " g "), (100.0, "percent"), (1e3, "thousandths"), (16384.0, "1700")]
)
@pytest.mark.parametrize("route", ["urban", "highway"])
def test_a_wrong_unit_is_refused_by_name(route: str, factor: float, named: str):
    drive, _ = _drive(route, 120.0)
    found = estimate_mounting(fault.logged_as(drive, factor / G * np.eye(3)))
    assert found.status == "insufficient"
    (reason,) = found.reasons
    assert reason.code == "wrong_unit"
    assert named in reason.text


def test_acceleration_without_gravity_and_zeros_are_refused_by_name():
    drive, truth = _drive(duration=120.0)
    without = replace(drive.inertial, f=drive.inertial.f - np.array([0.0, 0.0, -G]) @ truth.R_va)
    assert _codes(estimate_mounting(replace(drive, inertial=without))) == {"no_gravity"}
    assert _codes(estimate_mounting(fault.logged_as(drive, np.zeros((3, 3))))) == {"dead_accelerometer"}


@pytest.mark.parametrize(("route", "duration"), ROUTES)
@pytest.mark.parametrize("M", [INVERTED, LEFT_HANDED], ids=["inverted", "left-handed"])
def test_an_improper_triad_is_refused_by_name(route: str, duration: float, M: np.ndarray):
    for seed in range(40, 43):
        drive, _ = _drive(route, duration, seed, gnss_rate=(1.0, 4.0, 10.0)[seed % 3])
        found = estimate_mounting(fault.logged_as(drive, M))
        assert found.status == "insufficient"
        assert "mirrored" in _codes(found)
        assert found.R_va is None


def test_two_wrong_signs_are_just_another_mounting():
    drive, truth = _drive(seed=44)
    M = np.diag([-1.0, -1.0, 1.0])
    found = estimate_mounting(fault.logged_as(drive, M))
    assert found.status == "ready"
    assert found.reasons == ()
    assert _error_deg(found, truth.R_va @ M.T) < 3.0


def test_a_minute_never_makes_an_inverted_box_ready():
    """However few bends a minute has."""
    for seed in range(60, 80):
        route = ("urban", "straight", "gentle", "highway")[seed % 4]
        drive, _ = _drive(route, 60.0, seed)
        assert estimate_mounting(fault.logged_as(drive, INVERTED)).status != "ready"


def test_on_a_straight_road_the_signs_are_taken_on_trust_and_that_is_said():
    drive, truth = _drive("straight", 300.0, seed=5)
    found = estimate_mounting(drive)
    assert found.status == "ready"
    assert _codes(found) == {"handedness_trusted"}
    assert _error_deg(found, truth.R_va) < 4.0


def test_without_a_course_the_mounting_is_known_but_for_the_signs():
    """What turns cannot be seen turning is felt turning; into the bend or out of it, only a course tells."""
    for seed in (5, 6, 7):
        drive, truth = _drive(seed=seed)
        blind = replace(drive, gnss=replace(drive.gnss, course=np.full(drive.gnss.t.size, np.nan)))
        found = estimate_mounting(blind)
        assert found.status == "settling"
        assert _codes(found) == {"no_course"}
        assert found.sigma is not None
        assert np.all(np.abs(error_between(found.R_va, truth.R_va)) < 3.0 * found.sigma)
        assert estimate_mounting(fault.logged_as(blind, INVERTED)).status != "ready"


# How the box is fixed.


@pytest.mark.parametrize("route", ["urban", "straight"])
@pytest.mark.parametrize(
    "loosen",
    [
        lambda drive, seed: fault.swaying(drive, np.radians(5.0), 2.0, seed),
        lambda drive, seed: fault.swaying(drive, np.radians(10.0), 20.0, seed),
        lambda drive, seed: fault.swaying(drive, np.radians(7.0), 60.0, seed),
        lambda drive, seed: fault.slipping(drive, np.radians(1.0), seed),
        lambda drive, seed: fault.tumbling(drive, 15.0, np.radians(15.0), seed),
        lambda drive, seed: fault.tumbling(drive, 40.0, np.radians(30.0), seed),
    ],
    ids=["rattles", "sways", "swings slowly", "slips", "is thrown 15°", "is thrown 30°"],
)
def test_a_loose_box_is_never_ready(route: str, loosen: object):
    for seed in (50, 51):
        drive, _ = _drive(route, 300.0, seed)
        found = estimate_mounting(loosen(drive, seed))  # type: ignore[operator]
        assert found.status != "ready"
        assert found.reasons


def _slipping_drive(R_va: Floats | None, axis: int, degrees: float) -> tuple[Drive, Floats]:
    """A quarter of an hour in town, the box turning steadily by so much, and the mounting at its end."""
    drive, truth = simulate(replace(DECIMATED, R_va=R_va, duration=900.0, gnss_rate=1.0), seed=40)
    t = drive.inertial.t
    way = np.zeros((t.size, 3))
    way[:, axis] = np.radians(degrees) * t / t[-1]
    turns = Rotation.from_rotvec(way)
    slipped = turns.apply(drive.inertial.f @ truth.R_va.T) @ truth.R_va
    return replace(drive, inertial=Inertial(t=t, f=slipped)), turns[-1].inv().as_matrix() @ truth.R_va


@pytest.mark.parametrize(("axis", "degrees"), [(0, 3.0), (0, 6.0), (2, 3.0)])
def test_a_box_that_slips_slowly_is_named_and_in_the_sigma(axis: int, degrees: float):
    """The estimate is that of the middle of the drive, the box has gone on."""
    drive, at_the_end = _slipping_drive(None, axis, degrees)
    found = estimate_mounting(drive)
    assert "slipping" in _codes(found)
    assert found.R_va is not None
    assert found.sigma is not None
    assert np.all(np.abs(error_between(found.R_va, at_the_end)) < 2.0 * found.sigma)


@pytest.mark.parametrize("axis", [0, 2])
def test_a_box_that_slips_after_trips_in_which_it_sat_firmly_has_that_in_the_sigma_too(axis: int):
    trip, truth = simulate(replace(DECIMATED, duration=600.0, gnss_rate=1.0), seed=41)
    past = told_of(decimate(trip.inertial), trip.gnss, None, Noise()).own
    assert past is not None
    drive, at_the_end = _slipping_drive(truth.R_va, axis, 3.0)
    found = told_of(decimate(drive.inertial), drive.gnss, joined([past, past]), Noise()).estimate
    assert "slipping" in _codes(found)
    assert found.R_va is not None
    assert found.sigma is not None
    assert np.all(np.abs(error_between(found.R_va, at_the_end)) < 2.0 * found.sigma)


# The receiver and the clocks.


@pytest.mark.parametrize("gnss_rate", [1.0, 4.0])
def test_a_frozen_receiver_is_named_and_costs_little(gnss_rate: float):
    for seed in (20, 21):
        drive, truth = _drive(seed=seed, gnss_rate=gnss_rate, frozen=((60.0, 75.0), (150.0, 180.0)))
        found = estimate_mounting(drive)
        assert found.status == "ready"
        assert "gps_frozen" in _codes(found)
        assert "utc_jump" not in _codes(found)
        assert _error_deg(found, truth.R_va) < 4.0


@pytest.mark.parametrize("gnss_rate", [1.0, 10.0])
@pytest.mark.parametrize("dated", [True, False])
def test_a_frozen_receiver_is_named_online_while_it_is(gnss_rate: float, *, dated: bool):
    drive, truth = _drive(seed=20, gnss_rate=gnss_rate, frozen=((88.0, 103.0), (240.0, 270.0)))
    drive = drive if dated else replace(drive, gnss=replace(drive.gnss, utc=None))
    state, said = begin(), []
    for chunk in chunks_of(drive, 1.0):
        state = advance(state, chunk)
        said.append([_seconds(each) for each in assess(state).reasons if each.code == "gps_frozen"])
    assert said[87] == []
    assert said[150] == pytest.approx([15.0], abs=1.5)
    assert said[150] < said[255] < said[269]
    assert said[-1] == pytest.approx([45.0], abs=3.0)
    whole = frozen(repeats_on(Repeats(), drive.gnss))
    assert whole is not None
    assert said[-1] == [_seconds(whole)]
    found = assess(state)
    assert found.status == "ready"
    assert _error_deg(found, truth.R_va) < 4.0


def test_a_time_that_stands_still_accuses_no_parked_receiver():
    """A minute in the parking place, then off; the receiver's date was never set."""
    drive, _ = _drive(duration=180.0, seed=20, gnss_rate=1.0)
    gnss = drive.gnss
    t = np.concatenate([gnss.t[0] + np.arange(60.0), gnss.t + 60.0])
    parked = {
        name: np.concatenate([np.full(60, getattr(gnss, name)[0]), getattr(gnss, name)])
        for name in ("lat", "lon", "alt", "course", "fix")
    }
    speed = np.concatenate([np.zeros(60), gnss.speed])
    made = Gnss(t=t, speed=speed, utc=np.full(t.size, 1.6e9), **parked)
    told = Repeats()
    for second in range(4, t.size):
        told = repeats_on(told, fixes_where(made, (t >= t[max(second - 8, 0)]) & (t <= t[second])))
    assert frozen(told) is None
    assert frozen(repeats_on(Repeats(), made)) is None


def test_a_receiver_that_freezes_at_a_stand_is_named_online_and_left_out():
    """The vehicle drives off, the fixes go on saying that it stands."""
    drive, truth = _drive(seed=20, gnss_rate=1.0, frozen=((66.0, 100.0),))
    assert np.abs(truth.v[(truth.t > 65.0) & (truth.t < 67.0)]).max() < 0.1
    assert np.abs(truth.v[(truth.t > 90.0) & (truth.t < 100.0)]).min() > 5.0
    state = begin()
    for chunk in chunks_of(drive, 1.0):
        state = advance(state, chunk)
    found = assess(state)
    assert [_seconds(each) for each in found.reasons if each.code == "gps_frozen"] == pytest.approx([34.0], abs=1.5)
    assert found.status == "ready"
    assert _error_deg(found, truth.R_va) < 4.0


def _seconds(told: Reason) -> float:
    number = re.search(r"(\d+) s;", told.text)
    assert number is not None
    return float(number[1])


def test_without_utc_a_frozen_receiver_is_seen_by_its_content():
    drive, truth = _drive(seed=20, frozen=((150.0, 180.0),))
    found = estimate_mounting(replace(drive, gnss=replace(drive.gnss, utc=None)))
    assert _error_deg(found, truth.R_va) < 4.0


@pytest.mark.parametrize(("speed_lag", "course_lag"), [(2.0, 2.0), (1.8, 0.9), (1.5, 0.3)])
def test_a_late_receiver_is_named_and_costs_little(speed_lag: float, course_lag: float):
    for route, duration in (("urban", 300.0), ("highway", 600.0)):
        drive, truth = _drive(route, duration, 22, speed_lag=speed_lag, course_lag=course_lag)
        found = estimate_mounting(drive)
        assert found.status == "ready"
        assert "gps_late" in _codes(found)
        assert _error_deg(found, truth.R_va) < 4.0


def test_slow_streams_are_named():
    for rates, code in (({"gnss_rate": 1.0}, "slow_gps"), ({"accel_rate": 10.0}, "slow_accelerometer")):
        drive, truth = _drive(seed=23, **rates)
        found = estimate_mounting(drive)
        assert found.status == "ready"
        assert _codes(found) == {code}
        assert _error_deg(found, truth.R_va) < 4.0


METHODS = ("whole-drive", "online", "mekf", "two-phase")


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("mangle", "code"),
    [
        (lambda f: 0.0 * f, "dead_accelerometer"),
        (lambda f: f / 9.80665, "wrong_unit"),
        (lambda f: 2.0 * f, "wrong_unit"),
        (lambda f: f - f.mean(axis=0), "no_gravity"),
    ],
)
def test_every_method_refuses_what_is_no_specific_force(mangle, code: str, method: str):
    drive, _ = _drive(duration=120.0, accel_rate=50.0)
    found = estimate_mounting(Drive(Inertial(drive.inertial.t, mangle(drive.inertial.f)), drive.gnss), method=method)
    assert found.status == "insufficient"
    assert _codes(found) == {code}
    assert (
        found.reasons
        == estimate_mounting(Drive(Inertial(drive.inertial.t, mangle(drive.inertial.f)), drive.gnss)).reasons
    )


def _received(drive: Drive, **columns: Floats) -> Drive:
    return replace(drive, gnss=replace(drive.gnss, **columns))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("unit", "many"), [("km/h", 3.6), ("knots", 1.943844), ("miles an hour", 2.236936)])
def test_a_speed_in_another_unit_is_refused_by_name(unit: str, many: float, method: str):
    for route, seed, rate, lag in (
        ("urban", 71, 1.0, 0.3),
        ("highway", 50071, 4.0, 2.0),
        ("straight", 50072, 10.0, 0.0),
    ):
        drive, _ = _drive(route, 120.0, seed, gnss_rate=rate, speed_lag=lag)
        found = estimate_mounting(_received(drive, speed=many * drive.gnss.speed), method=method)
        assert found.status == "insufficient"
        assert found.reasons[0].code == "gps_speed_unit"
        assert f" {unit} " in found.reasons[0].text
        assert _codes(found) <= {"gps_speed_unit", "gps_late"}


@pytest.mark.parametrize("method", METHODS)
def test_a_course_in_degrees_is_refused_by_name(method: str):
    for route, seed, rate in (("urban", 71, 1.0), ("highway", 50071, 4.0), ("roundabout", 50072, 10.0)):
        drive, _ = _drive(route, 120.0, seed, gnss_rate=rate)
        found = estimate_mounting(_received(drive, course=np.degrees(drive.gnss.course)), method=method)
        assert found.status == "insufficient"
        (why,) = found.reasons
        assert why.code == "gps_course_unit"
        assert "in degrees" in why.text


def test_a_course_counted_the_other_way_is_refused_by_name():
    drive, _ = _drive("roundabout", 120.0, 50073)
    for name, course in (("east", 0.5 * np.pi - drive.gnss.course), ("north", -drive.gnss.course)):
        (why,) = estimate_mounting(_received(drive, course=course)).reasons
        assert why.code == "gps_course_unit"
        assert f"counter-clockwise from {name}" in why.text


def test_a_receiver_that_fits_its_positions_or_has_none_has_no_wrong_unit():
    for seed, (route, rate) in enumerate([("urban", 1.0), ("roundabout", 4.0), ("highway", 10.0), ("straight", 1.0)]):
        for lags in ((2.0, 0.3), (0.3, 2.0)):
            drive, _ = _drive(route, 120.0, 50080 + seed, gnss_rate=rate, speed_lag=lags[0], course_lag=lags[1])
            gnss = drive.gnss
            assert wrong_gps_unit(chords(gnss)) is None
            assert wrong_gps_unit(chords(replace(gnss, course=gnss.course + 4.0 * np.pi))) is None
            assert wrong_gps_unit(chords(replace(gnss, course=np.full(gnss.t.size, 1.0)))) is None
            assert wrong_gps_unit(chords(replace(gnss, lat=0.0 * gnss.lat, lon=0.0 * gnss.lon))) is None


def test_the_chords_of_a_stream_are_those_of_the_drive():
    drive, _ = _drive("urban", 120.0, 71, gnss_rate=1.0)
    whole, told = chords(drive.gnss), NO_CHORDS
    for end in np.arange(7.0, 127.0, 7.0):
        since = (drive.gnss.t > end - 14.0) & (drive.gnss.t < end)
        told = followed_on(told, fixes_where(drive.gnss, since))
    for one, other in zip(whole, told, strict=True):
        np.testing.assert_allclose(one[: other.size], other)
    assert told.t.size >= whole.t.size - 1


@pytest.mark.parametrize("number", [0.0, 1.7])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_axis_that_always_sends_the_same_number_is_refused_by_name(axis: int, number: float):
    drive, _ = _drive(duration=120.0)
    f = drive.inertial.f.copy()
    f[:, axis] = number
    for method in METHODS:
        found = estimate_mounting(Drive(Inertial(drive.inertial.t, f), drive.gnss), method=method)
        assert found.status == "insufficient"
        assert _codes(found) == {"dead_axis"}


@pytest.mark.parametrize("seed", range(3))
def test_an_axis_that_sticks_on_the_way_is_named_and_left_out(seed: int):
    drive, truth = _drive(seed=seed)
    f = drive.inertial.f.copy()
    stuck = (drive.inertial.t > 200.0) & (drive.inertial.t < 280.0)
    f[stuck, seed % 3] = f[np.argmax(stuck), seed % 3]
    found = estimate_mounting(Drive(Inertial(drive.inertial.t, f), drive.gnss))
    assert "stuck_axis" in _codes(found)
    assert found.status == "ready"
    assert _error_deg(found, truth.R_va) < 4.0
    assert not stuck_axis(decimate(drive.inertial))


@pytest.mark.parametrize("resolution", [0.16, 0.6])
def test_coarse_numbers_of_a_quiet_drive_are_no_stuck_axis(resolution: float):
    drive, _ = _drive("highway", 300.0, seed=5, accel_resolution=resolution, accel_noise=0.0, vibration=0.3)
    assert not stuck_axis(decimate(drive.inertial))


@pytest.mark.parametrize("method", METHODS)
def test_a_dead_still_accelerometer_is_never_ready(method: str):
    drive, _ = _drive(duration=240.0, accel_rate=50.0, seed=21)
    still = np.tile([0.0, 0.0, -9.8], (drive.inertial.t.size, 1))
    found = estimate_mounting(Drive(Inertial(drive.inertial.t, still), drive.gnss), method=method)
    assert found.status != "ready"
    if method == "two-phase":
        assert _codes(found) == {"mismatch"}


@pytest.mark.parametrize("rate", [1.0, 0.2])
@pytest.mark.parametrize("method", METHODS)
def test_an_accelerometer_that_is_too_slow_is_not_called_a_mismatch(rate: float, method: str):
    drive, _ = _drive(duration=240.0, accel_rate=50.0, seed=21)
    t = drive.inertial.t
    kept = np.searchsorted(t, np.arange(t[0], t[-1], 1.0 / rate))
    found = estimate_mounting(Drive(Inertial(t[kept], drive.inertial.f[kept]), drive.gnss), method=method)
    assert found.status != "ready"
    assert "mismatch" not in _codes(found)
    if method in ("whole-drive", "two-phase"):
        assert found.reasons[0].code == "slow_accelerometer"
        assert f"only {rate:g} samples" in found.reasons[0].text


@pytest.mark.parametrize("rate", [0.2, 1.0, 10.0, 50.0, 200.0])
def test_the_ticks_know_the_sampling_rate(rate: float):
    drive, _ = _drive(duration=60.0, accel_rate=rate)
    assert sampling_rate(decimate(drive.inertial)) == pytest.approx(rate, rel=0.1)


@pytest.mark.parametrize(
    ("by", "code"), [(30.0, "clock_jump"), (2.0, "clock_jump"), (-20.1, "clock_torn"), (-20.0, "clock_torn")]
)
def test_a_box_clock_that_jumps_is_named_and_costs_little(by: float, code: str):
    for route, duration, seed in (("urban", 300.0, 3100), ("urban", 300.0, 3101), ("highway", 600.0, 3100)):
        drive, truth = _drive(route, duration, seed)
        found = estimate_mounting(fault.clock_jumped(drive, 150.0, by))
        assert code in _codes(found)
        assert found.status == "ready"
        assert _error_deg(found, truth.R_va) < 4.0


@pytest.mark.parametrize("by", [3600.0, -18.0])
def test_utc_that_jumps_is_named_and_costs_nothing(by: float):
    drive, truth = _drive(seed=24)
    plain, jumped = estimate_mounting(drive), estimate_mounting(fault.utc_jumped(drive, 150.0, by))
    assert _codes(jumped) == {"utc_jump"}
    assert jumped.status == plain.status
    assert plain.R_va is not None
    assert _error_deg(jumped, plain.R_va) < 0.1
    assert _error_deg(jumped, truth.R_va) < 4.0


def test_utc_in_whole_seconds_or_none_at_all_loses_no_fixes():
    drive, truth = _drive(seed=24)
    assert drive.gnss.utc is not None
    for utc in (np.floor(drive.gnss.utc), np.zeros(drive.gnss.t.size)):
        found = estimate_mounting(replace(drive, gnss=replace(drive.gnss, utc=utc)))
        assert found.status == "ready"
        assert "gps_frozen" not in _codes(found)
        assert _error_deg(found, truth.R_va) < 4.0


def test_an_ordinary_drive_is_in_no_trouble():
    for route, duration in ROUTES:
        drive, _ = _drive(route, duration, 30, clock_drift=4e-5)
        assert clock_jumps(drive.gnss) == ((), [])
        assert reversals(drive.gnss) == ()
        assert frozen(repeats_on(Repeats(), drive.gnss)) is None
        assert estimate_mounting(drive).reasons == ()


# Where the vehicle goes.


@pytest.mark.parametrize("times", [1, 4])
def test_reversing_is_named_and_left_out(times: int):
    for seed in (25, 26, 27):
        drive, truth = _drive(seed=seed)
        at = _standing(truth)
        backed = drive
        for k in range(times):
            backed = fault.backing_up(backed, truth.R_va, at, seed=seed + k, pace=4.0, lasting=20.0)
        spans = reversals(backed.gnss)
        assert len(spans) >= 1
        assert all(at - 12.0 < span.begin and span.end < at + 30.0 * times + 25.0 for span in spans)
        found = estimate_mounting(backed)
        assert found.status == "ready"
        assert _codes(found) == {"reversing"}
        assert _error_deg(found, truth.R_va) < 4.0


@pytest.mark.parametrize("sea", [0.0, 0.3, 1.0, 2.0])
def test_a_ferry_is_never_ready(sea: float):
    for seed, duration in ((1, 300.0), (2, 900.0), (3, 2400.0)):
        found = estimate_mounting(fault.sailing(duration, seed, sea=sea))
        assert found.status != "ready"
        assert found.reasons


def _then(first: Drive, second: Drive) -> Drive:
    """One recording after the other, half a minute later."""
    later = float(np.ceil(first.inertial.t[-1])) + 30.0
    inertial = Inertial(
        t=np.concatenate([first.inertial.t, second.inertial.t + later]),
        f=np.concatenate([first.inertial.f, second.inertial.f]),
    )
    a, b = first.gnss, second.gnss
    names = ("lat", "lon", "alt", "speed", "course", "fix")
    columns = {name: np.concatenate([getattr(a, name), getattr(b, name)]) for name in names}
    return Drive(inertial, Gnss(t=np.concatenate([a.t, b.t + later]), **columns))


@pytest.mark.parametrize("sea", [0.0, 0.5])
def test_a_crossing_between_two_drives_is_named_and_left_out(sea: float):
    # The same car, box and receiver before and after: one bias, one pair of lags, one country's roads.
    same = {"accel_bias": 0.0, "speed_lag": 0.2, "course_lag": 0.3, "crown": 0.01}
    for seed in (61, 63):
        first, truth = _drive(seed=seed, **same)
        aboard = fault.sailing(600.0, seed, sea=sea, R_va=truth.R_va)
        second, _ = _drive(seed=seed + 100, R_va=truth.R_va, **same)
        found = estimate_mounting(_then(_then(first, aboard), second))
        assert found.status == "ready"
        assert "aboard" in _codes(found)
        assert _error_deg(found, truth.R_va) < 4.0


def test_a_vehicle_on_a_tow_truck_is_named_when_it_is_back_on_its_wheels():
    """Nose up 9° on the bed of the truck, which drives like any car."""
    base = replace(DECIMATED, duration=400.0)
    up = (0.0, np.radians(9.0), 0.0)
    whole = [
        base,
        replace(base, moves=(Move(t=-1.0, turn=up),)),
        replace(base, moves=(Move(t=-1.0, turn=(0.0, -up[1], 0.0)),)),
    ]
    for seed in (1, 2):
        made = day(whole, seed=seed)
        found = estimate_mounting(made.drive)
        assert [np.degrees(change.angle) for change in found.changes] == pytest.approx([9.0, 9.0], abs=1.5)
        assert "carried" in _codes(found)
        assert _error_deg(found, made.mountings[-1][1]) < 4.0
