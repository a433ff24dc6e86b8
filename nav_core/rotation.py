"""Rotations at the public edge: the thesis' angles, small rotations, quaternion order.

Rotations are Hamilton quaternions in scipy's order (x, y, z, w) and appear publicly as 3x3
matrices or `scipy.spatial.transform.Rotation`.  Kernels use plain arrays.  scipy is imported
where it is needed and not above, so that the API process can convert angles without loading it.
"""

from __future__ import annotations

import numpy as np

from nav_core.errors import ShapeError
from nav_core.typing import Floats


def thesis_to_matrix(theta: float, phi: float, psi: float) -> Floats:
    """Mounting matrix from the thesis' angles.

    Parameters
    ----------
    theta, phi, psi : float
        rad.

    Returns
    -------
    ndarray, shape (3, 3)
        ``R_va = Ry(theta) @ Rz(phi) @ Rx(psi)``.

    Notes
    -----
    The product of 001 eqs. 3.6-3.8.  The matrix printed in 3.9 exchanges theta and phi and is
    not followed (docs/equations.md).
    """
    ct, st, cf, sf, cp, sp = (trig(angle) for angle in (theta, phi, psi) for trig in (np.cos, np.sin))
    Ry = np.array([[ct, 0.0, st], [0.0, 1.0, 0.0], [-st, 0.0, ct]])
    Rz = np.array([[cf, -sf, 0.0], [sf, cf, 0.0], [0.0, 0.0, 1.0]])
    Rx = np.array([[1.0, 0.0, 0.0], [0.0, cp, -sp], [0.0, sp, cp]])
    return Ry @ Rz @ Rx


def matrix_to_thesis(R_va: Floats) -> Floats:
    """Thesis angles of a mounting matrix.

    Parameters
    ----------
    R_va : ndarray, shape (3, 3)

    Returns
    -------
    ndarray, shape (3,)
        theta in (-pi, pi], phi in [-pi/2, pi/2], psi in (-pi, pi], rad.  At phi = ±pi/2 only
        ``theta ∓ psi`` is determined; psi is then set to 0.

    Notes
    -----
    001 C.10-C.13 with theta and phi exchanged back: ``phi = asin R21``,
    ``theta = atan2(-R31, R11)``, ``psi = atan2(-R23, R22)`` (indices from 1).
    """
    R = np.asarray(R_va, dtype=np.float64)
    if R.shape != (3, 3):
        raise ShapeError("R_va", R.shape, "(3, 3)")
    phi = np.arctan2(R[1, 0], np.hypot(R[0, 0], R[2, 0]))
    if np.hypot(R[0, 0], R[2, 0]) < 1e-9:
        theta, psi = np.arctan2(R[0, 2], R[2, 2]), 0.0
    else:
        theta, psi = np.arctan2(-R[2, 0], R[0, 0]), np.arctan2(-R[1, 2], R[1, 1])
    return np.array([theta, phi, psi])


def error_between(estimate: Floats, truth: Floats) -> Floats:
    """Small rotation, about the V axes, that separates an estimated mounting from the true one.

    Parameters
    ----------
    estimate, truth : ndarray, shape (3, 3)
        Mounting matrices ``R_va``.

    Returns
    -------
    ndarray, shape (3,)
        Rotation vector `e` in rad with ``estimate = exp([e]x) @ truth``.
    """
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(estimate @ truth.T).as_rotvec()


def angle_between(a: Floats, b: Floats) -> float:
    """Angle of the rotation that separates two mountings, rad, in [0, pi]."""
    return float(np.linalg.norm(error_between(a, b)))


def skew(v: Floats) -> Floats:
    """Cross-product matrix ``[v]x`` with ``[v]x @ u = v x u``, shape (3, 3)."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def wrap(angle: Floats) -> Floats:
    """Angle(s) wrapped to (-pi, pi]."""
    return np.pi - np.mod(np.pi - np.asarray(angle, dtype=np.float64), 2.0 * np.pi)


def xyzw_to_wxyz(quaternion: Floats) -> Floats:
    """From scipy's scalar-last order to viser's scalar-first order, shape (..., 4)."""
    return np.roll(np.asarray(quaternion, dtype=np.float64), 1, axis=-1)
