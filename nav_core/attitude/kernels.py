"""Rotations inside compiled loops: single vectors, quaternions and matrices, without allocation.

What `nav_core.rotation` says of arrays, one at a time: vectors are tuples, quaternions (Hamilton's, x, y, z, w) and
matrices are written into arrays of the caller.
"""

from __future__ import annotations

import numpy as np

from nav_core.typing import Floats, kernel

Vector = tuple[float, float, float]
"""Three components in registers: in a loop an array of its own costs more than the arithmetic done with it."""

SMALL_ANGLE2 = 1e-4
"""Squared angle, rad², below which sine and cosine are summed as series; what they omit is below rounding."""


@kernel
def multiply(q: Floats, p: Floats, out: Floats) -> None:
    """Write the Hamilton product ``q p`` into `out`, which may be either of them (000 eq. 2.6.27).

    Parameters
    ----------
    q, p : ndarray, shape (4,)
        Order (x, y, z, w).
    out : ndarray, shape (4,)
        Overwritten.
    """
    x = q[3] * p[0] + q[0] * p[3] + q[1] * p[2] - q[2] * p[1]
    y = q[3] * p[1] - q[0] * p[2] + q[1] * p[3] + q[2] * p[0]
    z = q[3] * p[2] + q[0] * p[1] - q[1] * p[0] + q[2] * p[3]
    w = q[3] * p[3] - q[0] * p[0] - q[1] * p[1] - q[2] * p[2]
    out[0], out[1], out[2], out[3] = x, y, z, w


@kernel
def normalise(q: Floats) -> None:
    """Scale a quaternion to unit length, in place.

    Parameters
    ----------
    q : ndarray, shape (4,)
        Not zero; overwritten.
    """
    scale = 1.0 / np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for i in range(4):
        q[i] *= scale


@kernel
def quaternion_of(v: Floats, q: Floats) -> None:
    """Write the quaternion of the rotation vector `v`, rad, into `q` (000 eq. 2.6.38).

    Parameters
    ----------
    v : ndarray, shape (3,)
        rad.
    q : ndarray, shape (4,)
        Order (x, y, z, w); overwritten.
    """
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
def cross(a: Vector, b: Vector) -> Vector:
    """``a x b``.

    Parameters
    ----------
    a, b : tuple of 3 floats
        In the same axes.

    Returns
    -------
    tuple of 3 floats
        In these axes.
    """
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def total(a: Vector, scale: float, b: Vector) -> Vector:
    """``a + scale b``.

    Parameters
    ----------
    a, b : tuple of 3 floats
        In the same axes and unit.
    scale : float
        Factor on `b`.

    Returns
    -------
    tuple of 3 floats
        In these axes.
    """
    return a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]


@kernel
def rodrigues(v: Vector) -> tuple[float, float]:
    """Factors s and c of ``exp([v]x) = I + s [v]x + c [v]x [v]x``, `v` in rad (Groves 2013 eq. 5.73).

    Parameters
    ----------
    v : tuple of 3 floats
        rad.

    Returns
    -------
    tuple of float
        ``sin(|v|) / |v|`` and ``(1 - cos(|v|)) / |v|²``.
    """
    square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    if square < SMALL_ANGLE2:
        return 1.0 - square / 6.0 * (1.0 - square / 20.0), 0.5 - square / 24.0 * (1.0 - square / 30.0)
    angle = np.sqrt(square)
    half = np.sin(0.5 * angle)
    return np.sin(angle) / angle, 2.0 * half * half / square


@kernel
def turn(C: Floats, frame: Vector, body: Vector) -> None:
    """Replace the attitude `C` by ``exp(-[frame]x) C exp([body]x)``; both are rotation vectors, rad.

    Row by row and column by column, so that no matrix is made.

    Parameters
    ----------
    C : ndarray, shape (3, 3)
        From b to a frame; overwritten.
    frame : tuple of 3 floats
        By which the frame has turned, rad, frame axes.
    body : tuple of 3 floats
        By which b has turned, rad, b axes.
    """
    s, c = rodrigues(body)
    for i in range(3):
        row = (C[i, 0], C[i, 1], C[i, 2])
        once = cross(row, body)
        row = total(total(row, s, once), c, cross(once, body))
        C[i, 0], C[i, 1], C[i, 2] = row[0], row[1], row[2]
    s, c = rodrigues(frame)
    for j in range(3):
        column = (C[0, j], C[1, j], C[2, j])
        once = cross(column, frame)
        column = total(total(column, s, once), c, cross(once, frame))
        C[0, j], C[1, j], C[2, j] = column[0], column[1], column[2]
