"""The online estimator with gyros that lie and receivers that are late: named, and gone on without, or matched."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from nav_core.mounting.online import advance, begin
from nav_core.mounting.online_hearing import LAGS, TRUSTED, Hearing, Products, gyro_since, lag_of
from nav_core.mounting.online_stream import chunks_of
from nav_core.mounting.online_verdict import assess
from nav_core.mounting.reasons import reason
from nav_core.records import Drive, Inertial, MountingEstimate
from nav_core.rotation import angle_between
from nav_core.simulate import Scenario, Truth, simulate
from nav_core.simulate import faults as fault
from nav_core.typing import Floats

RATES = (1.0, 4.0, 10.0)


def driven(route: str, duration: float, seed: int, **more: object) -> tuple[Drive, Truth]:
    return simulate(
        Scenario(
            **{"route": route, "duration": duration, "accel_rate": 50.0, "gnss_rate": RATES[seed % 3], **more}  # type: ignore[arg-type]
        ),
        seed=seed,
    )


def watched(drive: Drive, stride: float = 10.0) -> list[MountingEstimate]:
    state, found = begin(), []
    for chunk in chunks_of(drive, stride):
        state = advance(state, chunk)
        found.append(assess(state))
    return found


def codes(found: MountingEstimate) -> set[str]:
    assert all(each.text for each in found.reasons)
    return {each.code for each in found.reasons}


def error_deg(found: MountingEstimate, truth: Truth) -> float:
    assert found.R_va is not None
    return float(np.degrees(angle_between(found.R_va, truth.R_va)))


def never_ready_and_wrong(found: list[MountingEstimate], truth: Truth) -> None:
    assert all(error_deg(each, truth) < 10.0 for each in found if each.status == "ready")


def with_rate(drive: Drive, change: Callable[[Floats], Floats]) -> Drive:
    assert drive.inertial.w is not None
    return replace(drive, inertial=Inertial(drive.inertial.t, drive.inertial.f, w=change(drive.inertial.w)))


def without_axis(axis: int) -> Callable[[Floats], Floats]:
    return lambda w: w * (np.arange(3) != axis)


def garbage(w: Floats) -> Floats:
    return np.random.default_rng(3).normal(0.0, 1.0, w.shape)


LIES: list[tuple[Callable[[Floats], Floats], str]] = [
    (without_axis(0), "gyro_dead"),
    (without_axis(2), "gyro_dead"),
    (lambda w: 0.0 * w, "gyro_dead"),
    (np.degrees, "gyro_unit"),
    (np.radians, "gyro_wrong"),
    (lambda w: -w, "gyro_wrong"),
    (lambda w: 0.5 * w, "gyro_wrong"),
    (garbage, "gyro_noisy"),
    (lambda w: np.cumsum(0.05 * garbage(w), axis=0), "gyro_noisy"),
]


@pytest.mark.parametrize(
    ("lie", "code"),
    LIES,
    ids=["x dead", "z dead", "all dead", "degrees", "of degrees", "inverted", "half", "noise", "wanders"],
)
@pytest.mark.parametrize(("route", "duration"), [("urban", 200.0), ("roundabout", 120.0)])
def test_a_gyro_that_lies_is_named_and_gone_on_without(
    lie: Callable[[Floats], Floats], code: str, route: str, duration: float
):
    for seed in (7, 50_211, 50_213):
        drive, truth = driven(route, duration, seed, with_gyro=True)
        found = watched(with_rate(drive, lie))
        assert found[-1].status == "ready"
        assert codes(found[-1]) == {code}
        assert error_deg(found[-1], truth) < 4.0
        assert not any("mirrored" in codes(each) for each in found)
        never_ready_and_wrong(found, truth)


@pytest.mark.parametrize("lie", [lie for lie, _ in LIES] + [lambda w: w * [1, -1, 1]])
@pytest.mark.parametrize("route", ["straight", "highway"])
def test_on_roads_with_few_bends_a_gyro_that_lies_does_no_harm(route: str, lie: Callable[[Floats], Floats]):
    """Without bends its scale and sign cannot be told, and do not matter."""
    for seed in (8, 50_215):
        drive, truth = driven(route, 300.0, seed, with_gyro=True)
        found = watched(with_rate(drive, lie), 30.0)
        without = watched(replace(drive, inertial=Inertial(drive.inertial.t, drive.inertial.f)), 30.0)
        assert found[-1].status == without[-1].status
        assert error_deg(found[-1], truth) < max(4.0, error_deg(without[-1], truth) + 0.5)
        never_ready_and_wrong(found, truth)


def test_a_gyro_whose_axes_are_exchanged_is_never_in_a_wrong_ready():
    """On a highway its few bends may take minutes to show."""
    for route, seed in (("urban", 7), ("highway", 8), ("highway", 50_215), ("straight", 50_215)):
        drive, truth = driven(route, 300.0, seed, with_gyro=True)
        found = watched(with_rate(drive, lambda w: w[:, [1, 2, 0]]), 30.0)
        assert all(error_deg(each, truth) < 5.0 for each in found if each.status == "ready")
        assert found[-1].status == "ready" or route == "highway"


def test_a_left_handed_gyro_does_no_harm():
    """The less its turned axis is vertical, the less it shows and the less it matters."""
    for seed in (7, 50_211, 50_212, 50_213):
        drive, truth = driven("urban", 200.0, seed, with_gyro=True)
        found = watched(with_rate(drive, lambda w: w * [1.0, -1.0, 1.0]))
        assert found[-1].status == "ready"
        assert codes(found[-1]) <= {"gyro_wrong"}
        assert error_deg(found[-1], truth) < 4.0
        never_ready_and_wrong(found, truth)


def test_a_gyro_that_breaks_on_the_way_is_left_out_from_then_on():
    for seed in (7, 50_211):
        drive, truth = driven("urban", 300.0, seed, with_gyro=True)
        late = (drive.inertial.t > 120.0)[:, None]
        found = watched(with_rate(drive, lambda w, late=late: np.where(late, -w, w)))
        assert found[-1].status == "ready"
        assert len(codes(found[-1])) == 1
        assert codes(found[-1]) < {"gyro_wrong", "gyro_noisy"}
        assert error_deg(found[-1], truth) < 4.0
        never_ready_and_wrong(found, truth)


@pytest.mark.parametrize("route", ["urban", "roundabout", "straight", "highway", "gentle"])
def test_a_gyro_in_order_is_used(route: str):
    for seed in (7, 50_211, 50_212, 50_213):
        drive, _ = driven(route, 120.0, seed, with_gyro=True)
        state = begin()
        for chunk in chunks_of(drive, 20.0):
            state = advance(state, chunk)
            assert isinstance(state.gyro, str)
        assert state.gyro == TRUSTED
        assert not any(each.code.startswith("gyro") for each in assess(state).reasons)


def test_a_gyro_that_was_wrong_stays_left_out():
    why = reason("gyro_wrong")
    assert gyro_since(why, Hearing()) is why


@pytest.mark.parametrize(("speed_lag", "course_lag"), [(1.0, 1.0), (1.5, 1.5), (2.0, 2.0), (1.8, 0.9), (1.5, 0.3)])
@pytest.mark.parametrize(("route", "duration"), [("urban", 240.0), ("roundabout", 120.0)])
def test_a_late_receiver_is_named_and_matched(route: str, duration: float, speed_lag: float, course_lag: float):
    for seed in (9, 50_221, 50_222):
        drive, truth = driven(route, duration, seed, speed_lag=speed_lag, course_lag=course_lag)
        found = watched(drive)
        assert found[-1].status == "ready"
        assert codes(found[-1]) == {"gps_late"}
        assert error_deg(found[-1], truth) < 4.0
        assert found[-1].speed_lag == pytest.approx(speed_lag, abs=0.15)
        assert found[-1].course_lag == pytest.approx(course_lag, abs=0.15)
        assert not any("mirrored" in codes(each) for each in found)
        never_ready_and_wrong(found, truth)


@pytest.mark.parametrize(("speed_lag", "course_lag"), [(2.0, 2.0), (2.0, 0.5)])
@pytest.mark.parametrize(("route", "duration"), [("highway", 400.0), ("straight", 300.0)])
def test_a_late_receiver_on_roads_with_few_bends(route: str, duration: float, speed_lag: float, course_lag: float):
    for seed in (9, 50_221, 50_222):
        drive, truth = driven(route, duration, seed, speed_lag=speed_lag, course_lag=course_lag)
        found = watched(drive, 20.0)
        assert "gps_late" in codes(found[-1])
        assert all(error_deg(each, truth) < 5.0 for each in found if each.status == "ready")
        assert not any("mirrored" in codes(each) for each in found)
        never_ready_and_wrong(found, truth)


def test_a_course_that_is_still_that_of_the_stand_is_no_lag_and_never_ready_and_wrong():
    """Setting out, the speed is there before the course, which is random at rest and passes for turns."""
    for seed in (50_104, 50_503, 50_507):
        drive, truth = driven("straight", 300.0, seed, gnss_rate=4.0, speed_lag=0.3, course_lag=1.5)
        found = watched(drive, 20.0)
        assert all(error_deg(each, truth) < 6.0 for each in found if each.status == "ready")


def test_a_hand_that_changes_is_not_stable_and_no_error():
    drive, _ = driven("urban", 120.0, 50_221)
    state = begin()
    for chunk in chunks_of(drive, 20.0):
        state = advance(state, chunk)
    trail = state.tally.trail.copy()
    trail[:-1, 1:10] *= -1.0
    assert assess(state).stable
    assert not assess(replace(state, tally=replace(state.tally, trail=trail))).stable


def test_a_late_receiver_does_not_hide_an_inverted_box():
    for seed in (9, 50_221, 50_222):
        drive, _ = driven("urban", 240.0, seed, speed_lag=1.8, course_lag=1.5)
        found = watched(fault.logged_as(drive, -np.eye(3)), 20.0)
        assert all(each.status != "ready" for each in found)
        assert {"mirrored", "gps_late"} <= codes(found[-1])


def test_chunks_may_be_cut_anywhere_in_a_stream_that_begins_anew():
    drive, _ = driven("urban", 120.0, 50_221, speed_lag=1.8, course_lag=1.8)
    states = []
    for stride in (5.0, 7.3, 1.1):
        state = begin()
        for chunk in chunks_of(drive, stride):
            state = advance(state, chunk)
        states.append(state)
    assert states[0].hearing.until == states[2].hearing.until
    for other in states[1:]:
        np.testing.assert_allclose(states[0].hearing.speed.among, other.hearing.speed.among, rtol=1e-6, atol=1e-9)
        first, last = assess(states[0]), assess(other)
        assert first.R_va is not None
        assert last.R_va is not None
        assert angle_between(first.R_va, last.R_va) < np.radians(0.1)


def test_what_the_products_leave_is_what_least_squares_leaves():
    rng = np.random.default_rng(1)
    Y, k = rng.standard_normal((LAGS.size, 40, 3)), np.array([0.3, -0.5, 0.8])
    y = Y[5] @ k + 0.05 * rng.standard_normal(40)
    empty = Products(np.zeros((LAGS.size, 3, 3)), np.zeros((LAGS.size, 3)), 0.0, 0.0, 0.0)
    told = empty.more(Y, y, np.zeros(40))
    for at in range(LAGS.size):
        _, left, _, _ = np.linalg.lstsq(Y[at], y, rcond=None)
        assert told.left()[at] == pytest.approx(left[0], rel=1e-6)
    assert lag_of(told) == LAGS[5]
    assert lag_of(empty.more(Y, rng.standard_normal(40), np.zeros(40))) is None
    assert lag_of(empty) is None
