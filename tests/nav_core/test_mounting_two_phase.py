"""The two-phase baseline: exact where its assumptions hold, honest where they do not."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from nav_core.mounting import estimate_mounting
from nav_core.mounting.fixes import usable_fixes
from nav_core.mounting.two_phase import Road, estimate
from nav_core.records import Drive, Gnss, Inertial
from nav_core.rotation import error_between, rotvec_to_matrix
from nav_core.simulate import Scenario, random_rotation, simulate


@lru_cache(maxsize=8)
def drive_of(route: str, duration: float, seed: int):
    return simulate(Scenario(route=route, duration=duration, accel_rate=100.0), seed=seed)  # type: ignore[arg-type]


def ideal(R_va: np.ndarray, slope: float = 0.0, bank: float = 0.0) -> Drive:
    """Stands, speeds up, keeps its speed and brakes, straight on, on a road of one slope and bank."""
    t = np.arange(0.0, 60.0, 0.02)

    def speed(when: np.ndarray) -> np.ndarray:
        return np.interp(when, [0.0, 10.0, 20.0, 35.0, 45.0, 60.0], [0.0, 0.0, 15.0, 15.0, 1.0, 1.0])

    def push(when: np.ndarray) -> np.ndarray:
        return np.select([(when > 10.0) & (when < 20.0), (when > 35.0) & (when < 45.0)], [1.5, -1.4], 0.0)

    g = 9.80665
    rest = g * np.array([np.sin(slope), np.sin(bank) * np.cos(slope), -np.cos(bank) * np.cos(slope)])
    f_v = rest + np.outer(push(t), [1.0, 0.0, 0.0])
    fixes = np.arange(0.25, 60.0, 0.25)
    flat = np.zeros(fixes.size)
    way = 1e-7 * np.cumsum(speed(fixes - 0.3))
    gnss = Gnss(fixes, way, flat, flat, speed(fixes - 0.3), flat + 1.0, np.ones(fixes.size, dtype=bool))
    return Drive(Inertial(t, f_v @ R_va), gnss)


@pytest.mark.parametrize("seed", range(8))
def test_exact_on_a_level_road_in_any_orientation(seed: int):
    R_va = random_rotation(np.random.default_rng(seed))
    found = estimate(ideal(R_va))
    assert found.R_va is not None
    np.testing.assert_allclose(np.degrees(error_between(found.R_va, R_va)), 0.0, atol=0.1)


def test_a_slope_is_taken_for_tilt_unless_it_is_known():
    R_va = rotvec_to_matrix(np.array([0.3, -2.0, 0.7]))
    slope, bank = 0.05, -0.02
    drive = ideal(R_va, slope, bank)
    level = error_between(estimate(drive).R_va, R_va)
    np.testing.assert_allclose(np.degrees(level[:2]), np.degrees([-bank, slope]), atol=0.15)
    count = usable_fixes(drive.gnss).t.size
    known = estimate(drive, Road(np.full(count, slope), np.full(count, bank)))
    np.testing.assert_allclose(np.degrees(error_between(known.R_va, R_va)), 0.0, atol=0.1)
    assert known.sigma[0] < estimate(drive).sigma[0]


def test_on_simulated_roads_its_sigma_covers_its_error():
    scaled, statuses = [], []
    for seed in range(100, 112):
        drive, truth = drive_of("straight", 300.0, seed)
        found = estimate(drive)
        statuses.append(found.status)
        scaled.append(error_between(found.R_va, truth.R_va) / found.sigma)
    assert np.abs(scaled).max() < 3.0
    assert "ready" in statuses
    assert "insufficient" not in statuses


def test_curves_without_a_straight_push_leave_it_doubtful():
    drive, _ = drive_of("roundabout", 120.0, 5)
    found = estimate(drive)
    assert found.status != "ready"
    assert "few_events" in {reason.code for reason in found.reasons}


def test_standing_levels_and_does_not_point():
    drive, _ = drive_of("static", 60.0, 1)
    found = estimate_mounting(drive, method="two-phase")
    assert found.status == "insufficient"
    assert found.method == "two-phase"
    assert [reason.code for reason in found.reasons] == ["few_events"]


def test_without_one_of_the_streams():
    drive, _ = drive_of("straight", 300.0, 100)
    deaf = Drive(Inertial(drive.inertial.t[:0], drive.inertial.f[:0]), drive.gnss)
    assert estimate(deaf).reasons[0].code == "no_accelerometer"
    columns = [getattr(drive.gnss, name)[:0] for name in ("t", "lat", "lon", "alt", "speed", "course", "fix")]
    assert estimate(Drive(drive.inertial, Gnss(*columns))).reasons[0].code == "no_fix"


def test_converged_after_is_when_sigma_stays_small():
    drive, _ = drive_of("straight", 300.0, 101)
    found = estimate(drive)
    assert found.status == "ready"
    assert 5.0 <= found.converged_after <= 300.0
