"""Simulated impacts: exact delta-V, signs of the direction of force, and the way to rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nav_core.errors import RangeError
from nav_core.rotation import wrap
from nav_core.simulate import Impact, Scenario, Truth, simulate
from nav_core.simulate.impact import SLIDE_DECELERATION, pulse, slide_time

G = 9.80665
GRAVITY = np.array([0.0, 0.0, G])
SHAPES = ["haversine", "half_sine", "triangle"]


def crash(impact: Impact, rate: float = 1000.0, **fields: object) -> Truth:
    return simulate(Scenario(duration=impact.t + 20.0, accel_rate=rate, impacts=(impact,), **fields), seed=1)[1]


def delta_v(truth: Truth) -> np.ndarray:
    """Specific force less gravity, integrated over the pulse in the V axes held at its start."""
    event = truth.events[0]
    during = (truth.t >= event.t0 - 1e-9) & (truth.t <= event.t_end + 1e-9)
    R = truth.R_tv[during]
    acceleration = np.einsum("nij,nj->ni", R, truth.f_v[during]) + GRAVITY
    return R[0].T @ np.trapezoid(acceleration, truth.t[during], axis=0)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_pulse_is_the_derivative_of_a_unit_step(shape: str) -> None:
    x = np.linspace(0.0, 1.0, 2001)
    travel, step, rate = pulse(shape, x)
    assert (travel[0], step[0]) == (0.0, 0.0)
    assert step[-1] == pytest.approx(1.0)
    assert travel[-1] == pytest.approx(0.5)
    assert rate.min() >= 0.0
    h = x[1] - x[0]
    assert np.allclose(np.diff(step) / h, 0.5 * (rate[1:] + rate[:-1]), atol=1e-5)
    assert np.allclose(np.diff(travel) / h, 0.5 * (step[1:] + step[:-1]), atol=1e-6)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("degrees", [0.0, 30.0, 90.0, 150.0, 180.0, -60.0, -90.0])
def test_delta_v_and_direction_of_force(shape: str, degrees: float) -> None:
    impact = Impact(t=30.0, delta_v=9.0, pdof=np.radians(degrees), shape=shape, speed=12.0)
    truth = crash(impact)
    event = truth.events[0]
    expected = -9.0 * np.array([np.cos(impact.pdof), np.sin(impact.pdof)])
    seen = delta_v(truth)
    assert [event.longitudinal, event.lateral] == pytest.approx(expected, abs=1e-12)
    assert seen[:2] == pytest.approx(expected, abs=5e-3)
    assert abs(seen[2]) < 0.05
    assert event.resultant == pytest.approx(9.0)
    assert wrap(event.pdof - impact.pdof) == pytest.approx(0.0, abs=1e-9)
    assert event.speed == pytest.approx(12.0, abs=1e-6)


def test_frontal_brakes_and_a_blow_from_the_right_pushes_left() -> None:
    frontal = crash(Impact(t=25.0, delta_v=10.0, pdof=0.0, speed=14.0)).events[0]
    assert frontal.longitudinal == -10.0
    assert frontal.pdof == 0.0
    right = crash(Impact(t=25.0, delta_v=6.0, pdof=np.pi / 2, speed=14.0)).events[0]
    assert right.lateral == -6.0
    assert right.pdof == pytest.approx(np.pi / 2)


def test_the_delta_v_of_the_box_does_not_depend_on_the_spin() -> None:
    impact = Impact(t=30.0, delta_v=8.0, pdof=np.radians(75.0), speed=10.0, yaw_rate_change=2.5)
    truth = crash(impact, with_gyro=True)
    expected = -8.0 * np.array([np.cos(impact.pdof), np.sin(impact.pdof)])
    assert delta_v(truth)[:2] == pytest.approx(expected, abs=5e-3)
    end = np.searchsorted(truth.t, truth.events[0].t_end)
    assert truth.w_z[end] == pytest.approx(2.5, abs=0.02)
    assert truth.events[0].yaw_rate_change == 2.5


@pytest.mark.parametrize("degrees", [0.0, 90.0, 180.0, -135.0])
def test_the_vehicle_comes_to_rest_within_seconds(degrees: float) -> None:
    truth = crash(Impact(t=30.0, delta_v=7.0, pdof=np.radians(degrees), speed=13.0, yaw_rate_change=1.0), rate=200.0)
    rest = truth.t > 30.1 + slide_time(20.0)
    assert np.abs(truth.velocity[rest]).max() < 1e-9
    assert np.abs(truth.w_v[rest]).max() < 1e-3
    after = truth.t > 30.2
    acceleration = np.einsum("nij,nj->ni", truth.R_tv, truth.f_v) + GRAVITY
    assert np.linalg.norm(acceleration[after], axis=1).max() < 1.2 * SLIDE_DECELERATION


def test_the_trajectory_stays_consistent_through_an_impact() -> None:
    impact = Impact(t=25.0, delta_v=11.0, pdof=np.radians(40.0), speed=15.0, yaw_rate_change=-2.0)
    truth = crash(impact, rate=1000.0)
    acceleration = np.einsum("nij,nj->ni", truth.R_tv, truth.f_v) + GRAVITY
    step = np.diff(truth.t)[:, None]
    velocity = truth.velocity[0] + np.cumsum(0.5 * (acceleration[1:] + acceleration[:-1]) * step, axis=0)
    position = truth.position[0] + np.cumsum(0.5 * (truth.velocity[1:] + truth.velocity[:-1]) * step, axis=0)
    assert np.abs(velocity - truth.velocity[1:]).max() < 2e-3
    assert np.abs(position - truth.position[1:]).max() < 2e-3


def test_the_receiver_shows_the_impact() -> None:
    impact = Impact(t=40.0, delta_v=9.0, speed=14.0)
    scenario = Scenario(duration=60.0, impacts=(impact,), speed_lag=0.2, course_lag=0.2)
    drive, _ = simulate(scenario, seed=2)
    gnss = drive.gnss
    before, soon, late = gnss.t < 40.2, (gnss.t > 40.3) & (gnss.t < 40.5), gnss.t > 45.0
    assert gnss.speed[before][-1] == pytest.approx(14.0, abs=0.4)
    assert gnss.speed[soon].max() < 5.6
    assert gnss.speed[late].max() < 0.4


def test_a_hard_impact_clips() -> None:
    impact = Impact(t=20.0, delta_v=14.0, speed=20.0)
    scenario = Scenario(route="straight", duration=30.0, R_va=np.eye(3), impacts=(impact,))
    drive, truth = simulate(scenario, seed=3)
    assert np.abs(truth.f_v).max() > 20.0 * G
    assert drive.inertial.f.min() == pytest.approx(-11.0 * G)
    assert (drive.inertial.f[:, 0] == drive.inertial.f.min()).sum() >= 5


def test_a_parked_vehicle_is_pushed_and_stops_again() -> None:
    truth = crash(Impact(t=10.0, delta_v=2.0, pdof=np.pi, yaw_rate_change=0.3), route="static")
    event = truth.events[0]
    assert event.speed == 0.0
    assert event.longitudinal == pytest.approx(2.0)
    assert delta_v(truth)[:2] == pytest.approx([2.0, 0.0], abs=2e-3)
    assert truth.v[truth.t < 10.0].max() == 0.0
    assert truth.v.max() == pytest.approx(2.0, abs=1e-6)
    assert abs(truth.v[-1]) < 1e-9


def test_impacts_follow_one_another() -> None:
    impacts = (Impact(t=30.0, delta_v=6.0, pdof=0.5, speed=15.0), Impact(t=31.0, delta_v=4.0, pdof=-2.0, duration=0.08))
    _, truth = simulate(Scenario(duration=50.0, impacts=impacts), seed=4)
    first, second = truth.events
    assert (first.t0, second.t0) == (30.0, 31.0)
    assert second.speed < 15.0 - 6.0 * np.cos(0.5)
    # The blow's, with what friction after the first does within its 80 ms.
    assert second.resultant == pytest.approx(4.0, abs=6.5 * 0.08)
    at, until = np.searchsorted(truth.t, [31.0, 31.08])
    seen = (truth.velocity[until] - truth.velocity[at]) @ truth.R_tv[at]
    assert [second.longitudinal, second.lateral] == pytest.approx(seen[:2], abs=1e-3)
    assert np.abs(truth.velocity[-1]).max() < 1e-9


@pytest.mark.parametrize(("braking", "seconds"), [(3.0, 0.5), (9.0, 3.0)])
def test_the_driver_brakes_for_an_impact(braking: float, seconds: float) -> None:
    impact = Impact(t=40.0, delta_v=5.0, speed=8.0, braking=braking, braking_time=seconds)
    _, truth = simulate(Scenario(duration=60.0, impacts=(impact,)), seed=4)
    (event,) = truth.events
    at = np.interp([40.0 - seconds - 0.3, 40.0 - seconds / 2.0, 40.0, 59.0], truth.t, truth.v)
    assert at[0] == pytest.approx(8.0 + braking * seconds, abs=0.2)
    assert np.interp(40.0 - seconds / 2.0, truth.t, truth.a_x) == pytest.approx(-braking, rel=0.15)
    assert event.speed == pytest.approx(at[2])
    assert at[2] == pytest.approx(8.0, abs=0.1 * braking)
    assert at[3] == pytest.approx(0.0, abs=1e-9)
    # What the brakes do until they let go is of the change, too.
    assert event.longitudinal == pytest.approx(-5.0, abs=0.15 * braking)
    # The box, above the axle the body pitches about, sways a little on top.
    assert event.longitudinal == pytest.approx(delta_v(truth)[0], abs=0.01 * braking)


def test_the_road_before_an_impact_is_the_same_without_it() -> None:
    impact = Impact(t=60.0, delta_v=5.0)
    scenario = Scenario(duration=80.0)
    _, struck = simulate(replace(scenario, impacts=(impact,)), seed=5)
    _, spared = simulate(scenario, seed=5)
    before = struck.t < 57.0
    assert np.allclose(struck.v[before], spared.v[before])


@pytest.mark.parametrize("fields", [{"duration": 0.0}, {"delta_v": -1.0}, {"speed": -2.0}, {"braking": 3.0}])
def test_impacts_without_a_meaning_are_refused(fields: dict[str, float]) -> None:
    with pytest.raises(RangeError):
        Impact(**{"t": 1.0, "delta_v": 1.0, **fields})
