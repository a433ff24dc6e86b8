"""Disturbances that are no crash: they happen where they can, and the fixes see what they should."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nav_core.simulate import Scenario, simulate
from nav_core.simulate.shocks import Rates, shaken

G = 9.80665
NONE = Rates(pothole=0.0, speed_bump=0.0, kerb=0.0, door_slam=0.0, drop=0.0, emergency_braking=0.0, swerve=0.0)


@pytest.fixture(scope="module")
def drive():
    return simulate(Scenario(duration=600.0, accel_rate=100.0, accel_full_scale=16.0 * G), seed=6)


def test_without_any_the_drive_is_as_it_was(drive):
    recording, truth = drive
    same, shocks = shaken(recording, truth, full_scale=16.0 * G, rates=NONE, rng=np.random.default_rng(0))
    assert shocks == ()
    assert np.array_equal(same.inertial.f, recording.inertial.f)


def test_they_happen_where_they_can_and_within_the_range(drive):
    recording, truth = drive
    rough, shocks = shaken(recording, truth, full_scale=8.0 * G, rng=np.random.default_rng(2))
    speed = {shock: np.interp(shock.t, truth.t, truth.v) for shock in shocks}
    assert {"pothole", "emergency_braking"} <= {shock.name for shock in shocks}
    for shock, v in speed.items():
        assert v < 0.05 if shock.name in ("door_slam", "drop") else v > 1.0
    assert np.abs(rough.inertial.f).max() <= 8.0 * G
    assert np.isfinite(rough.inertial.f).all()
    assert (rough.gnss.speed[np.isfinite(rough.gnss.speed)] >= 0.0).all()


def test_braking_shows_alike_in_forces_and_fixes(drive):
    recording, truth = drive
    rates = Rates(pothole=0.0, speed_bump=0.0, kerb=0.0, door_slam=0.0, drop=0.0, emergency_braking=60.0, swerve=0.0)
    rough, shocks = shaken(recording, truth, full_scale=16.0 * G, rates=rates, rng=np.random.default_rng(3))
    assert shocks
    added = (rough.inertial.f - recording.inertial.f) @ truth.R_va.T
    gained = np.cumsum(added[:, 0]) / 100.0
    seen = rough.gnss.speed - recording.gnss.speed
    expected = np.interp(rough.gnss.t - truth.speed_lag, recording.inertial.t, gained)
    assert np.abs(seen - expected).max() < 3.0
    assert added[:, 0].min() < -0.4 * G
    assert added[:, 0].min() > -1.6 * G


def test_a_standing_box_gets_doors_and_drops_and_a_moving_one_kerbs_and_swerves():
    standing, still = simulate(Scenario(route="static", duration=240.0, accel_rate=100.0), seed=8)
    often = replace(NONE, door_slam=60.0, drop=60.0)
    rough, shocks = shaken(standing, still, full_scale=8.0 * G, rates=often, rng=np.random.default_rng(4))
    assert {shock.name for shock in shocks} == {"door_slam", "drop"}
    size = np.linalg.norm(rough.inertial.f, axis=1)
    for drop in (shock.t for shock in shocks if shock.name == "drop"):
        # It falls freely for a while, and gets up again as it was.
        falling = (standing.inertial.t > drop) & (standing.inertial.t < drop + 4.0)
        assert size[falling].min() < 0.25 * G
        assert size[falling].max() > 2.0 * G
    calm = np.ones(size.size, dtype=bool)
    for shock in shocks:
        calm &= (standing.inertial.t < shock.t) | (standing.inertial.t > shock.t + 30.0)
    assert np.array_equal(rough.inertial.f[calm], standing.inertial.f[calm])

    moving, driven = simulate(Scenario(route="urban", duration=240.0, accel_rate=100.0), seed=8)
    often = replace(NONE, kerb=60.0, swerve=60.0, speed_bump=60.0)
    rough, shocks = shaken(moving, driven, full_scale=8.0 * G, rates=often, rng=np.random.default_rng(4))
    assert {shock.name for shock in shocks} == {"kerb", "swerve", "speed_bump"}
    assert np.abs(rough.inertial.f - moving.inertial.f).max() > G
