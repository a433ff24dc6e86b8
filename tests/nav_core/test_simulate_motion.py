"""The simulator's motion: self-consistent, signed as the glossary says, and driven within limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from nav_core.errors import TooLittleDataError
from nav_core.rotation import wrap
from nav_core.simulate import Scenario, simulate
from nav_core.simulate.spline import Spline
from nav_core.typing import Floats

G = 9.80665
GRAVITY = np.array([0.0, 0.0, G])
ROUTES = ["static", "straight", "urban", "gentle", "highway", "roundabout"]
PLAIN = Scenario(
    slope=0.0, crown=0.0, bank=0.0, body_pitch=0.0, body_roll=0.0, lever_arm=(0.0, 0.0, 0.0), duration=120.0
).faultless()


def integrated(rates: Floats, t: Floats) -> Floats:
    steps = 0.5 * (rates[1:] + rates[:-1]) * np.diff(t)[:, None]
    return np.vstack((np.zeros(3), np.cumsum(steps, axis=0)))


@pytest.mark.parametrize("route", ROUTES)
def test_integrating_the_specific_force_gives_velocity_and_position(route: str) -> None:
    _, truth = simulate(Scenario(route=route, duration=150.0), seed=5)
    acceleration = np.einsum("nij,nj->ni", truth.R_tv, truth.f_v) + GRAVITY
    velocity = truth.velocity[0] + integrated(acceleration, truth.t)
    position = truth.position[0] + integrated(truth.velocity, truth.t)
    assert np.abs(velocity - truth.velocity).max() < 2e-4
    assert np.abs(position - truth.position).max() < 1e-4


@pytest.mark.parametrize("route", ["urban", "roundabout"])
def test_the_angular_rate_turns_the_attitude(route: str) -> None:
    _, truth = simulate(Scenario(route=route, duration=60.0), seed=6)
    R = truth.R_tv
    steps = Rotation.from_matrix(np.swapaxes(R[:-1], 1, 2) @ R[1:]).as_rotvec() * 200.0
    middle = 0.5 * (truth.w_v[1:] + truth.w_v[:-1])
    assert np.abs(steps - middle).max() < 2e-4


@pytest.mark.parametrize("route", ["urban", "highway"])
def test_perfect_fixes_tell_the_same_trajectory(route: str) -> None:
    drive, truth = simulate(Scenario(route=route, duration=100.0).faultless(), seed=7)
    gnss = drive.gnss
    velocity = np.column_stack([np.interp(gnss.t, truth.t, truth.velocity[:, k]) for k in range(3)])
    position = np.column_stack([np.interp(gnss.t, truth.t, truth.position[:, k]) for k in range(3)])
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    moving = speed > 1.0
    assert np.abs(gnss.speed - speed).max() < 1e-4
    assert np.abs(wrap(gnss.course - np.arctan2(velocity[:, 1], velocity[:, 0])))[moving].max() < 1e-4
    assert np.abs(240.0 - gnss.alt - position[:, 2]).max() < 1e-3
    # Independent of the radii used inside: metres per radian by the usual series, to 0.1 %.
    lat = np.radians(45.07)
    north = (111_132.954 - 559.822 * np.cos(2 * lat) + 1.175 * np.cos(4 * lat)) * np.degrees(1.0)
    east = (111_412.84 * np.cos(lat) - 93.5 * np.cos(3 * lat)) * np.degrees(1.0)
    reach = np.abs(position[:, :2]).max()
    assert np.abs((gnss.lat - lat) * north - position[:, 0]).max() < 1e-3 * reach
    assert np.abs((gnss.lon - np.radians(7.69)) * east - position[:, 1]).max() < 1e-3 * reach


def test_a_right_turn_has_positive_turn_rate_and_lateral_force() -> None:
    _, truth = simulate(replace(PLAIN, route="urban"), seed=1)
    right, left = truth.w_z > 0.1, truth.w_z < -0.1
    assert right.any()
    assert left.any()
    assert truth.f_v[right, 1].min() > 0.0
    assert truth.f_v[left, 1].max() < 0.0
    assert np.allclose(truth.f_v[:, 1], truth.v * truth.w_z, atol=1e-9)
    assert np.allclose(truth.f_v[:, 0], truth.a_x, atol=1e-9)
    assert np.allclose(truth.f_v[:, 2], -G)
    course = np.unwrap(truth.yaw)
    assert np.allclose(np.gradient(course, truth.t)[1:-1], truth.w_z[1:-1], atol=1e-3)


def test_braking_pushes_forward_and_acceleration_back() -> None:
    _, truth = simulate(replace(PLAIN, route="straight"), seed=2)
    braking, accelerating = truth.a_x < -0.5, truth.a_x > 0.5
    assert truth.f_v[braking, 0].max() < -0.5
    assert truth.f_v[accelerating, 0].min() > 0.5
    assert np.ptp(truth.yaw) == 0.0


def test_a_hill_pulls_back_and_a_crest_lifts() -> None:
    _, truth = simulate(replace(PLAIN, route="highway", slope=0.03), seed=3)
    assert np.allclose(truth.f_v[:, 0] - truth.a_x, G * np.sin(truth.slope), atol=1e-9)
    rate = np.gradient(truth.slope, truth.t)
    assert np.allclose(truth.f_v[:, 2] + G * np.cos(truth.slope), -truth.v * rate, atol=2e-3)
    crest, dip = rate < -1e-3, rate > 1e-3
    assert truth.f_v[crest, 2].min() > -G
    assert truth.f_v[dip, 2].max() < -G * np.cos(truth.slope).min()
    climb = -truth.velocity[:, 2]
    assert np.allclose(climb, truth.v * np.sin(truth.slope), atol=1e-9)


def test_a_bank_with_the_right_side_down_pulls_left() -> None:
    _, truth = simulate(replace(PLAIN, route="static", crown=np.radians(1.0)), seed=4)
    assert np.allclose(truth.f_v, [0.0, -G * np.sin(np.radians(1.0)), -G * np.cos(np.radians(1.0))])


def test_the_body_lifts_its_nose_and_leans_outward() -> None:
    scenario = replace(PLAIN, body_pitch=np.radians(2.5) / G, body_roll=np.radians(4.0) / G, duration=300.0)
    _, truth = simulate(replace(scenario, route="urban"), seed=5)
    pitch, roll = truth.pitch - truth.slope, truth.roll - truth.bank
    lateral = truth.v * truth.w_z
    gains = [
        np.degrees(np.polyfit(truth.a_x, pitch, 1)[0]) * G,
        np.degrees(np.polyfit(lateral, roll, 1)[0]) * G,
    ]
    # The tilt lags, so the regression on the simultaneous acceleration falls a little short.
    assert gains[0] == pytest.approx(2.5, rel=0.1)
    assert gains[1] == pytest.approx(-4.0, rel=0.1)


@pytest.mark.parametrize("dive", [0.5, 1.0, 1.5])
def test_a_nose_may_dive_otherwise_than_it_squats(dive: float) -> None:
    scenario = replace(PLAIN, body_pitch=np.radians(2.5) / G, duration=300.0, route="urban", dive=dive)
    _, truth = simulate(scenario, seed=5)
    pitch = np.degrees(truth.pitch - truth.slope)
    for hard, gain in ((truth.a_x > 1.0, 2.5), (truth.a_x < -1.0, 2.5 * dive)):
        assert (pitch[hard] @ truth.a_x[hard]) / (truth.a_x[hard] @ truth.a_x[hard]) * G == pytest.approx(
            gain, rel=0.05
        )


def test_the_lever_arm_feels_the_turn() -> None:
    there = 2.0
    _, box = simulate(replace(PLAIN, route="roundabout", lever_arm=(there, 0.0, 0.0)), seed=6)
    _, centre = simulate(replace(PLAIN, route="roundabout"), seed=6)
    extra = box.f_v - centre.f_v
    assert np.allclose(extra[:, 0], -there * box.w_z**2, atol=1e-9)
    rate = np.gradient(box.w_z, box.t)
    assert np.allclose(extra[1:-1, 1], there * rate[1:-1], atol=0.02)
    assert np.allclose(extra[:, 1].sum() / 200.0, there * (box.w_z[-1] - box.w_z[0]), atol=0.01)


@pytest.mark.parametrize(
    ("route", "fastest", "lateral", "strongest", "hardest"),
    [
        ("straight", 20.1, 0.05, 2.8, -4.0),
        ("urban", 14.0, 4.0, 2.8, -4.0),
        ("gentle", 13.0, 1.2, 1.0, -1.3),
        ("highway", 36.0, 2.1, 1.0, -1.4),
        ("roundabout", 12.0, 4.0, 2.8, -4.0),
    ],
)
def test_drivers_keep_within_their_limits(
    route: str, fastest: float, lateral: float, strongest: float, hardest: float
) -> None:
    travelled = []
    for seed in range(6):
        _, truth = simulate(Scenario(route=route, duration=200.0, accel_rate=20.0), seed=seed)
        assert truth.v.min() > -1e-12
        assert truth.v.max() <= fastest
        assert np.abs(truth.v * truth.w_z).max() <= lateral
        assert hardest <= truth.a_x.min()
        assert truth.a_x.max() <= strongest
        still = truth.v[1:] + truth.v[:-1] == 0.0
        assert np.abs(np.diff(truth.yaw)[still]).max(initial=0.0) == 0.0
        travelled.append(truth.v.mean())
    assert min(travelled) > 2.0


def test_routes_are_what_their_names_say() -> None:
    urban = [simulate(Scenario(route="urban", accel_rate=10.0), seed=seed)[1] for seed in range(12)]
    assert all((truth.v < 0.01).any() for truth in urban)
    for truth in urban:
        turned = truth.yaw[10 * 10 :] - truth.yaw[: -10 * 10]
        assert turned.max() > np.radians(60.0)
        assert turned.min() < -np.radians(60.0)
    _, highway = simulate(Scenario(route="highway", accel_rate=10.0), seed=0)
    assert highway.v.min() > 20.0
    _, roundabout = simulate(Scenario(route="roundabout", duration=120.0, accel_rate=10.0), seed=0)
    assert np.ptp(roundabout.yaw) > 2.0 * np.pi
    _, static = simulate(Scenario(route="static", accel_rate=10.0), seed=0)
    assert not static.velocity.any()


def test_roads_have_the_slopes_and_banks_asked_for() -> None:
    slopes, banks, crowns = [], [], []
    for seed in range(24):
        _, truth = simulate(Scenario(route="highway", duration=600.0, accel_rate=10.0), seed=seed)
        slopes.append(np.mean(np.tan(truth.slope) ** 2))
        banks.append(np.mean((truth.bank - truth.crown) ** 2))
        crowns.append(np.degrees(truth.crown))
    assert np.sqrt(np.mean(slopes)) == pytest.approx(0.03, rel=0.1)
    assert np.degrees(np.sqrt(np.mean(banks))) == pytest.approx(0.8, rel=0.1)
    assert np.abs(crowns).min() >= 0.3
    assert np.abs(crowns).max() <= 1.2
    assert len(set(np.sign(crowns))) == 2


@given(
    polygon=st.lists(st.floats(-5.0, 5.0), min_size=4, max_size=12),
    start=st.floats(-10.0, 10.0),
    step=st.floats(0.05, 3.0),
)
@settings(max_examples=50, deadline=None)
def test_a_splines_derivatives_and_integral_agree(polygon: list[float], start: float, step: float) -> None:
    spline = Spline(start, step, np.array(polygon))
    cells = len(polygon) - 3
    x = start + step * np.linspace(0.0, cells, 40 * cells + 1)
    value, first, second = spline.jet(x)
    assert value.min() >= min(polygon) - 1e-9
    assert value.max() <= max(polygon) + 1e-9
    h = x[1] - x[0]
    assert np.allclose(np.diff(value) / h, 0.5 * (first[1:] + first[:-1]), atol=0.05 / step)
    assert np.allclose(np.diff(first) / h, 0.5 * (second[1:] + second[:-1]), atol=1e-6 / step**2)
    # Simpson's rule is exact for the cubic within a cell, and 40 intervals end on its border.
    simpson = (h / 3.0) * (value[:-2:2] + 4.0 * value[1:-1:2] + value[2::2])
    assert np.allclose(np.cumsum(simpson), spline.integral(x)[2::2], atol=1e-9)
    assert spline.integral(x[:1])[0] == pytest.approx(0.0, abs=1e-9)


def test_a_spline_needs_four_coefficients() -> None:
    with pytest.raises(TooLittleDataError):
        Spline(0.0, 1.0, np.zeros(3))
