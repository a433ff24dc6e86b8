"""Simulated drives over the turning Earth with their exact truth, for the tests of navigation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core import earth
from nav_core.navigation import Solution
from nav_core.records import Drive, Inertial
from nav_core.rotation import matrix_to_rotvec
from nav_core.simulate import Scenario, Truth, simulate
from nav_core.simulate.globe import GlobalDrive, on_the_globe


class World(NamedTuple):
    drive: Drive
    truth: Truth
    globe: GlobalDrive

    @property
    def lags(self):
        return {"speed_lag": self.truth.speed_lag, "course_lag": self.truth.course_lag}


def world(seed: int, *, faultless: bool = False, **given) -> World:
    """A town drive of a box with a gyro that feels the Earth turn."""
    scenario = Scenario(**{"duration": 185.0, "accel_rate": 100.0, "with_gyro": True, **given})
    if faultless:
        scenario = scenario.faultless()
    drive, truth = simulate(scenario, seed=seed)
    origin = (scenario.start_lat, scenario.start_lon, scenario.start_alt)
    lat, lon, height = (float(value) for value in earth.tangent_to_geodetic(truth.position[0], origin))
    globe = on_the_globe(truth, (lat, lon, height), flat_gravity=scenario.gravity)
    inertial = drive.inertial
    assert inertial.w is not None
    felt = inertial.f + (globe.f_v - truth.f_v) @ truth.R_va
    turned = inertial.w + (globe.w_v - truth.w_v) @ truth.R_va
    return World(Drive(Inertial(t=inertial.t, f=felt, w=turned), drive.gnss), truth, globe)


class Errors(NamedTuple):
    """Truth minus estimate in T axes, each (n, 3): m, m/s, rad."""

    position: np.ndarray
    velocity: np.ndarray
    attitude: np.ndarray


def errors(solution: Solution, globe: GlobalDrive) -> Errors:
    at = np.searchsorted(globe.t, solution.t - 1e-9)
    meridian, normal = earth.radii(solution.lat)
    position = np.stack(
        (
            (globe.lat[at] - solution.lat) * (meridian + solution.height),
            (globe.lon[at] - solution.lon) * (normal + solution.height) * np.cos(solution.lat),
            solution.height - globe.height[at],
        ),
        axis=1,
    )
    attitude = matrix_to_rotvec(globe.R_tv[at] @ np.swapaxes(solution.R_tv, 1, 2))
    return Errors(position, globe.velocity[at] - solution.velocity, attitude)
