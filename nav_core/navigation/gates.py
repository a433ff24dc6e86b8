"""What the 15-state filter refuses, compiled: single residuals, whole fixes, and rest that is none."""

from __future__ import annotations

import numpy as np

from nav_core.attitude.kernels import Vector
from nav_core.kalman.kernels import Room, project
from nav_core.navigation.states import VEHICLE, Weights
from nav_core.typing import Floats, kernel


@kernel
def speeds_up(force: Vector, Phi: Floats, P: Floats, T: float, noise: float, weights: Weights) -> bool:
    """Whether the horizontal specific force is more than tilt, biases and rest explain: the vehicle is not at rest.

    Calm sensors alone do not tell rest from smooth braking at walking pace.  `noise` is the density of the force.

    Parameters
    ----------
    force : tuple of 3 floats
        Mean specific force, T axes, m/s².
    Phi : ndarray, shape (20, 20)
        Of the time between the epochs.
    P : ndarray, shape (20, 20)
        Covariance of the errors.
    T : float
        s.
    noise : float
        (m/s²)²s.
    weights : Weights
        Of `Vehicle.weights`.

    Returns
    -------
    bool
        Whether it is on either axis.
    """
    for i in range(2):
        variance = noise / T + weights.rest_push**2
        for j in range(6, VEHICLE):
            for k in range(6, VEHICLE):
                variance += Phi[3 + i, j] * P[j, k] * Phi[3 + i, k] / (T * T)
        if force[i] * force[i] > weights.gate * variance:
            return True
    return False


@kernel
def strike(P: Floats, e: Floats, H: Floats, s: Floats, gate: float, room: Room) -> None:
    """Strike out residuals beyond the gate, each judged alone and before any update.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance of the errors.
    e : ndarray, shape (m,)
        NaN where not measured; what is struck out becomes NaN.
    H : ndarray, shape (m, n)
        Measurement rows.
    s : ndarray, shape (m,)
        Variances of the noise.
    gate : float
        On the squared normalised residual.
    room : Room
        Of `kalman.kernels.room_for`; overwritten.
    """
    Ph = room.spread
    for i in range(e.size):
        if np.isnan(e[i]):
            continue
        project(P, H[i], Ph)
        variance = s[i] + H[i] @ Ph
        if e[i] * e[i] > gate * variance:
            e[i] = np.nan


@kernel
def strike_fix(P: Floats, e: Floats, H: Floats, s: Floats, weights: Weights, since: float, room: Room) -> bool:
    """Gate a fix, `since` s after the first of those left out without a break; returns whether it was left out.

    A position with one bad coordinate is bad as a whole.  When nothing else came for long, it is the filter that has
    lost its way: then the position counts, and `P` grows by what it says.

    Parameters
    ----------
    P : ndarray, shape (20, 20)
        Overwritten where the filter relents.
    e : ndarray, shape (5,)
        m and m/s; what is struck out becomes NaN.
    H : ndarray, shape (5, 20)
        Measurement rows.
    s : ndarray, shape (5,)
        Variances for the gate.
    weights : Weights
        Of `Vehicle.weights`.
    since : float
        s.
    room : Room
        Of `kalman.kernels.room_for`; overwritten.

    Returns
    -------
    bool
        Whether the position was out of the gate.
    """
    seen = (e[0], e[1], e[2])
    strike(P, e, H, s, weights.gate, room)
    bad = False
    for i in range(3):
        bad = bad or (np.isnan(e[i]) and not np.isnan(seen[i]))
    if not bad:
        return False
    for i in range(3):
        e[i] = np.nan
        if since > weights.relent:
            e[i] = seen[i]
            P[i, i] += 0.0 if np.isnan(seen[i]) else seen[i] ** 2
    return True
