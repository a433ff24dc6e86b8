"""The filter of `kernels` in matrices, to read and to test against: joint updates, no loops over elements."""

from __future__ import annotations

import numpy as np

from nav_core import earth
from nav_core.kalman import predict, update
from nav_core.navigation.inertial_gnss import Record, moved
from nav_core.navigation.states import ROWS, SLOW, SLOWEST, STATES, VEHICLE, Weights
from nav_core.processes.transition import transition_series
from nav_core.rotation import skew
from nav_core.strapdown.increments import Increments
from nav_core.strapdown.mechanisation import Navigation, mechanise
from nav_core.typing import Flags, Floats

Rows = tuple[Floats, Floats, Floats, Floats]
"""Residuals (13,), NaN where not measured; matrix (13, 20); variances for the gate and for the filter (13,)."""


def run_reference(record: Record) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
    """Places (m, 3), velocities, attitudes, slow states (m, 11), covariances (m, 20, 20), corrections (m, 20).

    000 eqs. 3.6.21-3.6.25 and 3.11.24 on the error states; `record` as for `kernels.run`, whose docstrings hold.

    Parameters
    ----------
    record : Record
        Of `inertial_gnss.prepare`.

    Returns
    -------
    places : ndarray, shape (m, 3)
        Latitude, longitude, rad, and height, m.
    v : ndarray, shape (m, 3)
        T axes, m/s.
    C : ndarray, shape (m, 3, 3)
        From V to T.
    slow : ndarray, shape (m, 11)
        Biases and the receiver's errors.
    P : ndarray, shape (m, 20, 20)
        Covariance of the errors.
    dx : ndarray, shape (m, 20)
        What each update put into the track.
    """
    start, epochs, weights = record.start, record.epochs, record.weights
    place, v, attitude, covariance, slow = start.place, start.v, start.C, start.P, np.zeros(SLOW)
    since = np.inf
    found: list[tuple[Floats, ...]] = []
    for j, sample in enumerate(epochs.sample):
        rows = (np.full(ROWS, np.nan), np.zeros((ROWS, STATES)), np.ones(ROWS), np.ones(ROWS))
        if j > 0:
            part = slice(epochs.sample[j - 1], sample)
            period = float(record.t[sample] - record.t[part.start])
            place, v, attitude, covariance, spin, pushed = _advance(
                record, part, j, place, v, attitude, slow[:6], covariance
            )
            slow = np.concatenate((slow[:6], np.exp(-period / weights.correlation) * slow[6:]))
            if epochs.still[j] > 0.0 and not pushed:
                _rest(rows, v, spin, epochs.density[j, 1] / period, weights)
            else:
                _slip(rows, v, attitude, spin, record.arm, weights)
        _fix(rows, place, v, slow, epochs.z[j], epochs.late[j], epochs.noise[j])
        covariance, since = _gate(rows, covariance, weights, float(record.t[sample]), since)
        e, H, _, r = rows
        used = ~np.isnan(e)
        outcome = update(np.zeros(STATES), covariance, e[used], H[used], np.diag(r[used]))
        covariance = outcome.P
        place, v, attitude, slow = (
            values[0] for values in moved(place[None], v[None], attitude[None], slow[None], outcome.x[None])
        )
        found.append((place, v, attitude, slow, covariance, outcome.x))
    places, speeds, attitudes, slows, covariances, corrections = (
        np.array(column) for column in zip(*found, strict=True)
    )
    return places, speeds, attitudes, slows, covariances, corrections


def _advance(
    record: Record, part: slice, j: int, place: Floats, v: Floats, attitude: Floats, bias: Floats, covariance: Floats
) -> tuple[Floats, Floats, Floats, Floats, Floats, bool]:
    t = record.t[part.start : part.stop + 1]
    periods = np.diff(t)[:, None]
    increments = Increments(
        t,
        record.increments.rotation[part] - periods * bias[3:],
        record.increments.velocity[part] - periods * bias[:3],
    )
    track = mechanise(Navigation(place[0], place[1], place[2], v, attitude), increments)
    period = float(t[-1] - t[0])
    force = np.einsum("nij,nj->i", track.R_tb[:-1], increments.velocity) / period
    middle = 0.5 * (attitude + track.R_tb[-1])
    F = np.zeros((STATES, STATES))
    F[0:3, 3:6] = np.eye(3)
    F[3:6, 6:9], F[3:6, 9:12] = -skew(force), -middle
    F[6:9, 12:15] = -middle
    w = record.weights
    density = [0.0, *record.epochs.density[j], w.accel_walk, w.gyro_walk]
    keep = np.exp(-period / w.correlation)
    common = np.full(STATES - VEHICLE, (1.0 - keep**2) / (1.0 + keep**2))
    half = np.diag(np.concatenate((np.repeat(0.5 * period * np.array(density), 3), common)))
    Phi = transition_series(F, period, 2)
    Phi[range(VEHICLE, STATES), range(VEHICLE, STATES)] = keep
    predicted = predict(np.zeros(STATES), covariance + half, Phi, half)
    place = np.array([track.lat[-1], track.lon[-1], track.height[-1]])
    spin = increments.rotation.sum(axis=0) / period
    slope = Phi[3:5, 6:VEHICLE] / period
    expected = np.einsum("ij,jk,ik->i", slope, predicted.P[6:VEHICLE, 6:VEHICLE], slope)
    expected += record.epochs.density[j, 0] / period + w.rest_push**2
    pushed = bool(np.any(force[:2] ** 2 > w.gate * expected))
    return place, track.velocity[-1], track.R_tb[-1], predicted.P, spin, pushed


def _fix(rows: Rows, place: Floats, v: Floats, slow: Floats, z: Floats, late: Floats, noise: Floats) -> None:
    e, H, s, r = rows
    meridian, normal = earth.radii(place[0])
    scale = np.array([meridian + place[2], (normal + place[2]) * np.cos(place[0]), -1.0])
    e[:3], H[:3, :3] = scale * (z[:3] - place) - v * np.array([late[0]] * 3), np.eye(3)
    s[:5], r[:5] = noise.T
    speed = float(np.hypot(v[0], v[1]))
    if speed >= SLOWEST:
        ahead = v[:2] / speed
        e[3], H[3, 3:5] = z[3] - speed, ahead
        off = z[4] - np.arctan2(v[1], v[0])
        e[4], H[4, 3:5] = speed * np.arctan2(np.sin(off), np.cos(off)), [-ahead[1], ahead[0]]
    H[range(5), range(VEHICLE, STATES)] = np.sqrt(noise[:, 0] - noise[:, 1])
    e[:5] -= H[:5, VEHICLE:] @ slow[6:]


def _slip(rows: Rows, v: Floats, attitude: Floats, spin: Floats, arm: Floats, w: Weights) -> None:
    e, H, s, r = rows
    body = attitude.T @ v
    e[5:7] = -(body + np.cross(spin, arm))[1:]
    H[5:7, 3:6], H[5:7, 6:9] = attitude.T[1:], (attitude.T @ skew(v))[1:]
    slip = np.array([w.sideways, w.downwards]) ** 2 + w.arm_sigma**2 * spin @ spin
    tilted = (w.mount * body[0]) ** 2
    s[5:7], r[5:7] = slip + tilted, slip * w.slip_repeat + tilted * w.mount_repeat


def _rest(rows: Rows, v: Floats, spin: Floats, rate_variance: float, w: Weights) -> None:
    e, H, s, r = rows
    e[7:10], H[7:10, 3:6] = -v, np.eye(3)
    s[7:10], r[7:10] = w.rest**2, w.rest**2 * w.rest_repeat
    e[10:13], H[10:13, 12:15] = spin, np.eye(3)
    s[10:13] = r[10:13] = rate_variance + w.rest_rate**2


def _beyond(rows: Rows, covariance: Floats, gate: float) -> Flags:
    e, H, s, _ = rows
    return e**2 > gate * (np.einsum("ij,jk,ik->i", H, covariance, H) + s)


def _gate(rows: Rows, covariance: Floats, w: Weights, now: float, since: float) -> tuple[Floats, float]:
    e = rows[0]
    beyond = _beyond(rows, covariance, w.gate)
    seen = e[:3].copy()
    e[beyond] = np.nan
    if np.isnan(seen[0]):
        return covariance, since
    if not beyond[:3].any():
        return covariance, np.inf
    e[:3] = np.nan
    if now - since > w.relent:
        e[:3] = seen
        grown = np.concatenate((np.nan_to_num(seen) ** 2, np.zeros(STATES - 3)))
        return covariance + np.diag(grown), min(since, now)
    return covariance, min(since, now)
