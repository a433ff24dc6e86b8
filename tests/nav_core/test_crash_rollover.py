"""Vehicles that roll over, made by formula: on their side, roof or wheels, with and without fixes and gyro; and boxes
that were only turned."""

from __future__ import annotations

import numpy as np
import pytest

from nav_core.crash import reconstruct_drive
from nav_core.records import Drive, Gnss, Inertial, MountingEstimate
from nav_core.simulate import random_rotation
from tests.nav_core.test_crash_impact import NO_GNSS, codes

G, T0, RATE, SPEED = 9.80665, 25.0, 100.0, 18.0


def sine(t, begin, length):
    u = (t - begin) / length
    return np.where((u > 0.0) & (u < 1.0), np.sin(np.pi * np.clip(u, 0.0, 1.0)), 0.0)


def rolling(degrees, *, airborne=0.0, hits=(50.0, 25.0, 15.0), lasting=None, seed=1):
    """Time, force and turn rate in V axes, speed, of a vehicle that is tripped sideways, rolls and slides to rest."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 40.0, 1.0 / RATE)
    lasting = lasting or 0.9 * abs(degrees) / 180.0 + 0.4
    x = np.clip((t - T0) / lasting, 0.0, 1.0)
    roll = np.radians(degrees) * (x - np.sin(2.0 * np.pi * x) / (2.0 * np.pi))
    side = np.sign(degrees)
    a = np.zeros((t.size, 3))
    a[:, 1] -= 8.0 * side * sine(t, T0 - 0.3, 0.45)
    a[:, 2] += G * ((t >= T0 + 0.2) & (t < T0 + 0.2 + airborne))
    for size, later, length in zip(hits, (0.2, 0.5, 0.9), (0.08, 0.07, 0.06), strict=True):
        a -= size * sine(t, T0 + later + airborne, length)[:, None] * [0.5, 0.6 * side, 0.5]
    speed = np.empty(t.size)
    left = SPEED
    for k, now in enumerate(t):
        a[k, 0] -= min(5.0, left * RATE) * (now > T0 + 0.3)
        left = max(left + a[k, 0] / RATE, 0.0)
        speed[k] = left
    f = a - [0.0, 0.0, G]
    c, s = np.cos(roll), np.sin(roll)
    f = np.column_stack([f[:, 0], c * f[:, 1] + s * f[:, 2], c * f[:, 2] - s * f[:, 1]])
    f += rng.normal(0.0, 0.4, f.shape) * np.clip(speed / 5.0, 0.05, 1.0)[:, None]
    w = np.column_stack([np.gradient(roll, t), np.zeros((t.size, 2))]) + rng.normal(0.0, 0.01, f.shape)
    return t, f, w, speed


def fixes(t, speed, until=np.inf):
    at = np.arange(0.3, min(39.0, until), 0.5)
    v = np.interp(at - 0.2, t, speed)
    zero = np.zeros(at.size)
    lat = 0.8 + np.interp(at - 0.2, t, np.cumsum(speed) / RATE) / 6.37e6
    return Gnss(at, lat, zero + 0.1, zero, v, zero, fix=np.ones(at.size, dtype=bool))


def told(t, f, w, gnss, *, seed=3):
    """Severe events of a box that sits anyhow."""
    R_va = random_rotation(np.random.default_rng(seed))
    mounting = MountingEstimate(
        "ready", "whole-drive", R_va=R_va, covariance=1e-4 * np.eye(3), speed_lag=0.2, course_lag=0.2
    )
    drive = Drive(Inertial(t, f @ R_va, None if w is None else w @ R_va), gnss)
    return [each for each in reconstruct_drive(drive, mounting) if each.severe]


@pytest.mark.parametrize("degrees", [-90.0, 180.0, -270.0, 360.0, 720.0])
@pytest.mark.parametrize("airborne", [0.0, 0.3])
@pytest.mark.parametrize("lost", [False, True])
def test_a_vehicle_that_rolls_is_said_to_have_rolled_and_how_far(degrees, airborne, lost):
    t, f, w, speed = rolling(degrees, airborne=airborne)
    (event,) = told(t, f, w, fixes(t, speed, T0 + 0.1 if lost else np.inf))
    assert event.kind == "rollover"
    assert event.begins == pytest.approx(T0, abs=1.2)
    assert event.rollover_angle.low <= np.radians(degrees) <= event.rollover_angle.high


@pytest.mark.parametrize("degrees", [90.0, -180.0])
@pytest.mark.parametrize("lost", [False, True])
def test_without_a_gyro_it_is_told_by_how_it_lies(degrees, lost):
    t, f, _, speed = rolling(degrees, airborne=0.25 * lost)
    (event,) = told(t, f, None, fixes(t, speed, T0 + 0.1 if lost else np.inf))
    assert event.kind == "rollover"


def test_one_without_any_fix_that_was_not_in_the_air():
    t, f, w, _ = rolling(180.0)
    assert [each.kind for each in told(t, f, w, NO_GNSS)] == ["rollover"]
    assert [each.kind for each in told(t, f, None, NO_GNSS)] == ["rollover"]


def test_a_soft_roll_back_onto_the_wheels_needs_the_gyro():
    t, f, w, speed = rolling(360.0, hits=(4.0, 3.0, 3.0), lasting=3.0)
    (event,) = told(t, f, w, fixes(t, speed))
    assert event.kind == "rollover"
    assert "turned_over" in codes(event)
    assert "ends_in_event" not in codes(event)


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.7, 0.7, 0.0)])
@pytest.mark.parametrize("drives", [True, False])
def test_a_box_that_is_turned_by_hand_is_no_vehicle_that_rolls(axis, drives):
    """Also about the vehicle's own axis: of a vehicle that drives on, or that stood."""
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 60.0, 1.0 / RATE)
    x = np.clip((t - 30.0) / 1.5, 0.0, 1.0)
    angle = 1.8 * (x - np.sin(2.0 * np.pi * x) / (2.0 * np.pi))
    u = np.array(axis) / np.linalg.norm(axis)
    g = np.array([0.0, 0.0, -G])
    c, s = np.cos(angle)[:, None], -np.sin(angle)[:, None]
    f = c * g + s * np.cross(u, g) + (1.0 - c) * (u @ g) * u  # Rodrigues, the inverse turn
    f += rng.normal(0.0, 1.0, f.shape) * sine(t, 29.8, 2.0)[:, None] + rng.normal(0.0, 0.4 if drives else 0.05, f.shape)
    w = np.gradient(angle, t)[:, None] * u
    speed = np.full(t.size, SPEED if drives else 0.0)
    at = np.arange(0.3, 59.0, 0.5)
    zero = np.zeros(at.size)
    lat = 0.8 + np.interp(at, t, np.cumsum(speed) / RATE) / 6.37e6 + 1e-9 * rng.normal(size=at.size)
    gnss = Gnss(at, lat, zero + 0.1, zero, np.interp(at, t, speed), zero, fix=np.ones(at.size, dtype=bool))
    for turn in (w, None):
        assert told(t, f, turn, gnss) == []
