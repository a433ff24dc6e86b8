"""From a scenario and a seed to a recording and the truth behind it."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from nav_core.records import Drive, Inertial
from nav_core.simulate.instruments import (
    draw_biases,
    draw_lags,
    receive,
    sampling_times,
    sense_force,
    sense_rate,
    vibration,
)
from nav_core.simulate.scenario import Move, Scenario, TrueEvent, Truth
from nav_core.simulate.vehicle import Vehicle, build
from nav_core.typing import Floats

_ROAD, _MOUNTING, _SENSORS, _VIBRATION, _RECEIVER = range(5)


def simulate(scenario: Scenario, *, seed: int) -> tuple[Drive, Truth]:
    """Simulate a drive.

    Parameters
    ----------
    scenario : Scenario
    seed : int
        Not negative.  Road and driver, mounting, sensors, vibration and receiver draw from separate
        streams of it, so a change to one leaves the others alone.

    Returns
    -------
    Drive
        What the box recorded.
    Truth
        What happened.

    Notes
    -----
    The specific force is ``f_v = R_tv^T (a_t - g_t)`` at the box, ``f_a = R_va^T f_v``; fixes
    and specific force come from the same analytic trajectory, so integrating `Truth.f_v` with
    `Truth.R_tv` gives `Truth.velocity`.
    """
    vehicle = build(scenario, _stream(seed, _ROAD))
    mountings = _mountings(scenario, _stream(seed, _MOUNTING))
    sensors, receiver = _stream(seed, _SENSORS), _stream(seed, _RECEIVER)
    biases = draw_biases(scenario, sensors)
    lags = draw_lags(scenario, receiver)

    t, stamps = sampling_times(scenario, sensors)
    motion = vehicle.at(t)
    f_v = motion.specific_force(scenario.gravity)
    shaken = f_v + vibration(t, motion.v, scenario, _stream(seed, _VIBRATION))
    f_a = sense_force(_mounted(shaken, t, mountings), t, biases, scenario, sensors)
    w_a = sense_rate(_mounted(motion.w, t, mountings), biases, scenario, sensors) if scenario.with_gyro else None
    drive = Drive(Inertial(t=stamps, f=f_a, w=w_a), receive(vehicle, scenario, lags, receiver))
    truth = Truth(
        t=t,
        position=vehicle.position(t),
        velocity=motion.velocity,
        v=motion.v,
        a_x=motion.a_x,
        slope=motion.slope,
        bank=motion.bank,
        yaw=motion.yaw,
        pitch=motion.pitch,
        roll=motion.roll,
        f_v=f_v,
        w_v=motion.w,
        mountings=mountings,
        accel_bias=biases.accel,
        accel_bias_drift=biases.accel_drift,
        gyro_bias=biases.gyro,
        speed_lag=lags[0],
        course_lag=lags[1],
        crown=vehicle.crown,
        events=_events(vehicle),
    )
    return drive, truth


def random_rotation(rng: np.random.Generator) -> Floats:
    """A rotation matrix drawn uniformly over all rotations, shape (3, 3).

    A quaternion of four independent normals points uniformly over the sphere (Shoemake 1992).

    Parameters
    ----------
    rng : Generator
        Advanced.

    Returns
    -------
    ndarray, shape (3, 3)
        Determinant 1.
    """
    return Rotation.from_quat(rng.standard_normal(4)).as_matrix()


def _stream(seed: int, purpose: int) -> np.random.Generator:
    return np.random.default_rng((seed, purpose))


def _mountings(scenario: Scenario, rng: np.random.Generator) -> tuple[tuple[float, Floats], ...]:
    drawn = random_rotation(rng)
    R_va = drawn if scenario.R_va is None else np.asarray(scenario.R_va, dtype=np.float64)
    mountings = [(-np.inf, R_va)]
    for move in scenario.moves:
        mountings.append((move.t, _moved(mountings[-1][1], move)))
    return tuple(mountings)


def _moved(R_va: Floats, move: Move) -> Floats:
    if move.R_va is not None:
        return np.asarray(move.R_va, dtype=np.float64)
    return R_va @ Rotation.from_rotvec(move.turn).as_matrix()


def _mounted(vectors: Floats, t: Floats, mountings: tuple[tuple[float, Floats], ...]) -> Floats:
    """Vectors in A of vectors in V, shape (n, 3), with the mounting of each moment."""
    edges = np.searchsorted(t, [since for since, _ in mountings]).tolist()
    seen = np.empty_like(vectors)
    for (_, R_va), begin, end in zip(mountings, edges, [*edges[1:], t.size], strict=True):
        seen[begin:end] = vectors[begin:end] @ R_va  # row by row, R_va^T v
    return seen


def _events(vehicle: Vehicle) -> tuple[TrueEvent, ...]:
    events: list[TrueEvent] = []
    for k, shock in enumerate(vehicle.shocks):
        times = np.array([shock.t0, shock.t0 + shock.duration])
        motion = vehicle.at(times)
        # A later blow finds the vehicle turned and sliding; of the first the road's millimetres a second are left out.
        x, y = ((motion.velocity[1] - motion.velocity[0]) @ motion.R_tv[0])[:2].tolist()
        if k == 0:
            x, y = shock.forward + _braked(vehicle, times), shock.sideways
        events.append(
            TrueEvent(
                t0=shock.t0,
                t_end=shock.t0 + shock.duration,
                longitudinal=x,
                lateral=y,
                resultant=float(np.hypot(x, y)),
                pdof=float(np.arctan2(-y + 0.0, -x + 0.0)),
                speed=float(motion.v[0]),
                yaw_rate_change=shock.turn_rate,
            )
        )
    return tuple(events)


def _braked(vehicle: Vehicle, times: Floats) -> float:
    """What the driver's brakes did meanwhile, m/s."""
    before, after = vehicle.speed.value(times).tolist()
    return after - before
