"""python-ins' `run_feedback_filter` on a record of the 15-state filter, with its start, noises and positions."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from nav_core.navigation import Receiver, Vehicle, inertial_gnss
from nav_core.navigation.inertial_gnss import Record
from nav_core.navigation.solution import Solution
from nav_core.rotation import matrix_to_euler, rotvec_to_matrix
from tests.nav_core.drives_on_the_globe import World, world
from tests.oracles import filters, inertial_sensor, measurements

VEHICLE = Vehicle(
    sideways=1e6,
    downwards=1e6,
    accel_walk=3e-4,
    gyro_walk=3e-5,
    accel_bias=0.05,
    gyro_bias=np.radians(0.1),
    tilt=np.radians(0.5),
)
"""No constraint of wheels, which the peer does not know; little uncertainty, as far off both linearise differently."""
RECEIVER = Receiver(position=0.05, height=0.05, position_share=0.0, velocity_share=0.0)
"""White noise, all that the peer knows."""


class Track(NamedTuple):
    """Positions (degrees, degrees, m), velocities, attitudes, biases, (n, 15), and their sigmas (with m, rad)."""

    values: np.ndarray
    sigma: np.ndarray


def comparable_world(seed: int, **given) -> World:
    """A drive whose fixes have the white noise of `RECEIVER`."""
    sigma = RECEIVER.position
    return world(
        seed,
        gnss_position_noise=sigma,
        gnss_height_noise=sigma,
        gnss_correlation=1e-3,
        accel_bias=VEHICLE.accel_bias,
        gyro_bias=VEHICLE.gyro_bias,
        **given,
    )


def comparable(seen: World) -> Record:
    """A record of positions alone, each at a sample, every one taken, no rest or slip told, from a known start."""
    record = inertial_gnss.prepare(seen.drive, seen.truth.R_va, receiver=RECEIVER, vehicle=VEHICLE, **seen.lags)
    z = record.epochs.z.copy()
    z[:, 3:] = np.nan
    epochs = record.epochs._replace(
        z=z, late=np.zeros_like(record.epochs.late), still=np.zeros_like(record.epochs.still)
    )
    at = np.searchsorted(seen.globe.t, record.t[0] - 1e-9)
    astray = rotvec_to_matrix(VEHICLE.tilt * np.random.default_rng(1).standard_normal(3))
    start = record.start._replace(v=seen.globe.velocity[at], C=astray @ seen.globe.R_tv[at])
    P = np.zeros_like(record.start.P)
    P[range(3), range(3)] = RECEIVER.position**2
    for first, sigma in ((3, 0.5), (6, VEHICLE.tilt), (9, VEHICLE.accel_bias), (12, VEHICLE.gyro_bias)):
        P[range(first, first + 3), range(first, first + 3)] = sigma**2
    P[range(15, 20), range(15, 20)] = 1.0
    return record._replace(epochs=epochs, start=start._replace(P=P), weights=record.weights._replace(gate=np.inf))


def run_ours(record: Record) -> Track:
    """The kernel's track."""
    place, v, C, slow, _, P, *_ = inertial_gnss.forward(record)
    solution = Solution(
        "inertial-gnss",
        False,
        record.t[record.epochs.sample],
        *place.T,
        v,
        C,
        P[:, :15, :15],
        slow[:, :6],
        record.epochs.still,
        record.fixes,
        0,
    )
    degrees = np.degrees(place[:, :2])
    sigma = np.column_stack((solution.sigma[:, :6], solution.euler_sigma, solution.sigma[:, 9:]))
    return Track(np.column_stack((degrees, place[:, 2], v, solution.euler, solution.bias)), sigma)


def peer(record: Record) -> Callable[[], Any]:
    """The call of `run_feedback_filter`, its tables made beforehand."""
    start, increments = record.start, record.increments
    rows = np.column_stack((increments.periods, increments.rotation, increments.velocity))
    columns = ["dt", "theta_x", "theta_y", "theta_z", "dv_x", "dv_y", "dv_z"]
    table = pd.DataFrame(rows, index=record.t[1:], columns=columns)
    fixed = np.isfinite(record.epochs.z[:, 0])
    lat, lon, height = record.epochs.z[fixed, :3].T
    places = pd.DataFrame(
        {"lat": np.degrees(lat), "lon": np.degrees(lon), "alt": height}, index=record.t[record.epochs.sample[fixed]]
    )
    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    values = [*np.degrees(start.place[:2]), start.place[2], *start.v, *np.degrees(matrix_to_euler(start.C))]
    pva = pd.Series(values, index=names, name=record.t[0])
    tilt = float(np.degrees(VEHICLE.tilt))

    def run() -> Any:
        gyro = inertial_sensor.EstimationModel(
            bias_sd=VEHICLE.gyro_bias, noise=VEHICLE.rate_noise, bias_walk=VEHICLE.gyro_walk
        )
        accel = inertial_sensor.EstimationModel(
            bias_sd=VEHICLE.accel_bias, noise=VEHICLE.force_noise, bias_walk=VEHICLE.accel_walk
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return filters.run_feedback_filter(
                pva,
                RECEIVER.position,
                0.5,
                tilt,
                tilt,
                table,
                gyro,
                accel,
                measurements=[measurements.Position(places, RECEIVER.position)],
                time_step=0.1,
            )

    return run


def read(found: Any, t: np.ndarray) -> Track:
    """Its result at moments of its samples; its sigmas stand at the moments of its steps."""
    at = np.abs(found.trajectory.index.to_numpy()[:, None] - t).argmin(axis=0)
    step = np.abs(found.trajectory_sd.index.to_numpy()[:, None] - t).argmin(axis=0)
    track, sigma = found.trajectory.to_numpy()[at], found.trajectory_sd.to_numpy()[step]
    return Track(
        np.column_stack(
            (track[:, :6], np.radians(track[:, 6:9]), found.accel.to_numpy()[step], found.gyro.to_numpy()[step])
        ),
        np.column_stack(
            (sigma[:, :6], np.radians(sigma[:, 6:]), found.accel_sd.to_numpy()[step], found.gyro_sd.to_numpy()[step])
        ),
    )
