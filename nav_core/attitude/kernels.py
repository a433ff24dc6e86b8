"""Rotations inside compiled loops: single quaternions and matrices, written into arrays of the caller.

What `nav_core.rotation` says of arrays, one at a time and without allocation.  Quaternions are Hamilton's in the
order (x, y, z, w).
"""

from __future__ import annotations

import numpy as np

from nav_core.typing import Floats, kernel

SMALL_ANGLE2 = 1e-4
"""Squared angle, rad², below which sine and cosine are summed as series; what they omit is below rounding."""


@kernel
def multiply(q: Floats, p: Floats, out: Floats) -> None:
    """Write the Hamilton product ``q p`` into `out`, which may be either of them (000 eq. 2.6.27)."""
    x = q[3] * p[0] + q[0] * p[3] + q[1] * p[2] - q[2] * p[1]
    y = q[3] * p[1] - q[0] * p[2] + q[1] * p[3] + q[2] * p[0]
    z = q[3] * p[2] + q[0] * p[1] - q[1] * p[0] + q[2] * p[3]
    w = q[3] * p[3] - q[0] * p[0] - q[1] * p[1] - q[2] * p[2]
    out[0], out[1], out[2], out[3] = x, y, z, w


@kernel
def normalise(q: Floats) -> None:
    """Scale a quaternion to unit length, in place."""
    scale = 1.0 / np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for i in range(4):
        q[i] *= scale


@kernel
def quaternion_of(v: Floats, q: Floats) -> None:
    """Write the quaternion of the rotation vector `v`, rad, into `q` (000 eq. 2.6.38)."""
    square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    if square < SMALL_ANGLE2:
        scale = 0.5 - square / 48.0 + square * square / 3840.0
        q[3] = 1.0 - square / 8.0 + square * square / 384.0
    else:
        angle = np.sqrt(square)
        scale = np.sin(0.5 * angle) / angle
        q[3] = np.cos(0.5 * angle)
    q[0], q[1], q[2] = scale * v[0], scale * v[1], scale * v[2]


@kernel
def matrix_of(v: Floats, R: Floats) -> None:
    """Write ``exp([v]x)`` of the rotation vector `v`, rad, into `R` (Rodrigues; Groves 2013 eq. 5.73)."""
    x, y, z = v[0], v[1], v[2]
    square = x * x + y * y + z * z
    if square < SMALL_ANGLE2:
        s = 1.0 - square / 6.0 * (1.0 - square / 20.0)
        c = 0.5 - square / 24.0 * (1.0 - square / 30.0)
    else:
        angle = np.sqrt(square)
        s = np.sin(angle) / angle
        half = np.sin(0.5 * angle)
        c = 2.0 * half * half / square
    R[0, 0] = 1.0 - c * (y * y + z * z)
    R[0, 1] = c * x * y - s * z
    R[0, 2] = c * x * z + s * y
    R[1, 0] = c * x * y + s * z
    R[1, 1] = 1.0 - c * (x * x + z * z)
    R[1, 2] = c * y * z - s * x
    R[2, 0] = c * x * z - s * y
    R[2, 1] = c * y * z + s * x
    R[2, 2] = 1.0 - c * (x * x + y * y)


@kernel
def chain(A: Floats, B: Floats, out: Floats) -> None:
    """Write ``A @ B`` of 3 x 3 matrices into `out`, which is neither of them."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
