"""What fixes, wheels and rest say to the 15-state filter, compiled: residuals, derivatives and variances by row."""

from __future__ import annotations

import numpy as np

from nav_core.attitude.kernels import Vector, cross
from nav_core.navigation.states import SLOWEST, VEHICLE, Weights
from nav_core.strapdown.kernels import curvatures
from nav_core.typing import Floats, kernel


@kernel
def rotate_back(C: Floats, v: Vector) -> Vector:
    """``C' v``.

    Parameters
    ----------
    C : ndarray, shape (3, 3)
        From V to T.
    v : tuple of 3 floats
        T axes.

    Returns
    -------
    tuple of 3 floats
        V axes, in the unit of `v`.
    """
    return (
        C[0, 0] * v[0] + C[1, 0] * v[1] + C[2, 0] * v[2],
        C[0, 1] * v[0] + C[1, 1] * v[1] + C[2, 1] * v[2],
        C[0, 2] * v[0] + C[1, 2] * v[1] + C[2, 2] * v[2],
    )


@kernel
def fix_rows(
    place: Floats,
    v: Floats,
    slow: Floats,
    z: Floats,
    late: Floats,
    noise: Floats,
    e: Floats,
    H: Floats,
    s: Floats,
    r: Floats,
) -> None:
    """Rows 0-4: position, speed and course of a fix `z` (lat, lon, height, speed, course; NaN where not measured).

    `late` (2,) is by how much position and speed, and course, are younger than the epoch, s; `noise` (5, 2) their
    variances, as a whole and of the white part.  Course counts as metres per second across the track.  The gate
    judges by the whole: another satellite may begin a new common error at any fix.

    Parameters
    ----------
    place : ndarray, shape (3,)
        Latitude, longitude, rad, and height, m.
    v : ndarray, shape (3,)
        T axes, m/s.
    slow : ndarray, shape (11,)
        Biases and the receiver's errors.
    z : ndarray, shape (5,)
        rad, rad, m, m/s, rad.
    late : ndarray, shape (2,)
        s.
    noise : ndarray, shape (5, 2)
        m² and (m/s)².
    e : ndarray, shape (13,)
        Measured less expected, m and m/s; overwritten.
    H : ndarray, shape (13, 20)
        Overwritten.
    s : ndarray, shape (13,)
        Variances for the gate; overwritten.
    r : ndarray, shape (13,)
        Variances for the update; overwritten.
    """
    along, across = curvatures(np.sin(place[0]), place[2])
    e[0] = (z[0] - place[0]) / along - v[0] * late[0]
    e[1] = (z[1] - place[1]) * np.cos(place[0]) / across - v[1] * late[0]
    e[2] = place[2] - z[2] - v[2] * late[0]
    for i in range(3):
        H[i, i] = 1.0
    speed = np.hypot(v[0], v[1])
    if speed >= SLOWEST:
        north, east = v[0] / speed, v[1] / speed
        e[3] = z[3] - speed
        H[3, 3], H[3, 4] = north, east
        off = z[4] - np.arctan2(v[1], v[0])
        e[4] = speed * np.arctan2(np.sin(off), np.cos(off))
        H[4, 3], H[4, 4] = -east, north
    for i in range(5):
        s[i], r[i] = noise[i, 0], noise[i, 1]
        H[i, VEHICLE + i] = np.sqrt(noise[i, 0] - noise[i, 1])
        e[i] -= H[i, VEHICLE + i] * slow[6 + i]


@kernel
def slip_rows(
    v: Floats, C: Floats, spin: Vector, arm: Floats, weights: Weights, e: Floats, H: Floats, s: Floats, r: Floats
) -> None:
    """Rows 5-6: a wheeled vehicle moves neither sideways nor up at its slip-free point, `arm` (3,) m from the box.

    Parameters
    ----------
    v : ndarray, shape (3,)
        T axes, m/s.
    C : ndarray, shape (3, 3)
        From V to T.
    spin : tuple of 3 floats
        Angular rate, V axes, rad/s.
    arm : ndarray, shape (3,)
        V axes, m.
    weights : Weights
        Of `Vehicle.weights`.
    e : ndarray, shape (13,)
        m/s; overwritten.
    H : ndarray, shape (13, 20)
        Overwritten.
    s : ndarray, shape (13,)
        Variances for the gate; overwritten.
    r : ndarray, shape (13,)
        Variances for the update; overwritten.
    """
    now = (v[0], v[1], v[2])
    body = rotate_back(C, now)
    swing = cross(spin, (arm[0], arm[1], arm[2]))
    swung = weights.arm_sigma**2 * (spin[0] ** 2 + spin[1] ** 2 + spin[2] ** 2)
    tilted = (weights.mount * body[0]) ** 2
    for i in range(1, 3):
        row = 4 + i
        e[row] = -body[i] - swing[i]
        lever = cross((C[0, i], C[1, i], C[2, i]), now)
        for j in range(3):
            H[row, 3 + j] = C[j, i]
            H[row, 6 + j] = lever[j]
        slip = (weights.sideways if i == 1 else weights.downwards) ** 2 + swung
        s[row] = slip + tilted
        r[row] = slip * weights.slip_repeat + tilted * weights.mount_repeat


@kernel
def rest_rows(
    v: Floats,
    spin: Vector,
    T: float,
    gyro_noise: float,
    weights: Weights,
    e: Floats,
    H: Floats,
    s: Floats,
    r: Floats,
) -> None:
    """Rows 7-12: at rest the velocity is zero, and what the gyro says beyond the Earth's turning is its bias.

    Parameters
    ----------
    v : ndarray, shape (3,)
        T axes, m/s.
    spin : tuple of 3 floats
        Angular rate less the estimated bias, V axes, rad/s.
    T : float
        s.
    gyro_noise : float
        (rad/s)²s.
    weights : Weights
        Of `Vehicle.weights`.
    e : ndarray, shape (13,)
        m/s and rad/s; overwritten.
    H : ndarray, shape (13, 20)
        Overwritten.
    s : ndarray, shape (13,)
        Variances for the gate; overwritten.
    r : ndarray, shape (13,)
        Variances for the update; overwritten.
    """
    for i in range(3):
        e[7 + i] = -v[i]
        H[7 + i, 3 + i] = 1.0
        s[7 + i], r[7 + i] = weights.rest**2, weights.rest**2 * weights.rest_repeat
        e[10 + i] = spin[i]
        H[10 + i, 12 + i] = 1.0
        s[10 + i] = r[10 + i] = gyro_noise / T + weights.rest_rate**2
