"""Rotations as matrices, quaternions, rotation vectors and angles, and the ways between them.

Rotations are Hamilton quaternions in scipy's order (x, y, z, w) and appear publicly as 3x3
matrices or `scipy.spatial.transform.Rotation`.  Kernels use plain arrays.  scipy is imported
where it is needed and not above, so that the API process can convert angles without loading it.

Everything named ``a_to_b`` accepts any leading axes and is defined for every rotation; what it does where `b` is not
unique stands in its docstring.  Roll, pitch and yaw are those of ``R_nb = Rz(yaw) @ Ry(pitch) @ Rx(roll)``,
the sequence ZYX (000 eqs. 2.6.13-2.6.18); the thesis' angles are the sequence YZX.  A quaternion and its negative
are the same rotation; the functions return the one with ``w >= 0`` unless they multiply.
"""

from __future__ import annotations

import numpy as np

from nav_core.errors import RangeError, ShapeError
from nav_core.typing import Floats, trailing

GIMBAL_LOCK = 1e-9
"""Cosine of the middle angle below which the outer two are no longer told apart."""


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
    001 C.10-C.13 with theta and phi exchanged back: ``phi = asin R21``, ``theta = atan2(-R31, R11)``,
    ``psi = atan2(-R23, R22)`` (indices from 1); theta is taken from ``R Rx(psi)'``, where it is the same angle.
    """
    R = np.asarray(R_va, dtype=np.float64)
    if R.shape != (3, 3):
        raise ShapeError("R_va", R.shape, "(3, 3)")
    level = np.hypot(R[0, 0], R[2, 0])
    phi = np.arctan2(R[1, 0], level)
    psi = 0.0 if level < GIMBAL_LOCK else np.arctan2(-R[1, 2], R[1, 1])
    # Theta of what is left without psi: near the singularity both are noise, and yet fit together.
    cp, sp = np.cos(psi), np.sin(psi)
    theta = np.arctan2(sp * R[0, 1] + cp * R[0, 2], sp * R[2, 1] + cp * R[2, 2])
    return np.array([theta, phi, psi])


def euler_to_matrix(roll: Floats | float, pitch: Floats | float, yaw: Floats | float) -> Floats:
    """Attitude matrix of roll, pitch and yaw.

    Parameters
    ----------
    roll, pitch, yaw : float or ndarray, shape (...)
        rad; broadcast against each other.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        ``R_nb = Rz(yaw) @ Ry(pitch) @ Rx(roll)``, from b to n.

    Notes
    -----
    000 eq. 2.6.47.  The matrix printed in 2.6.18 errs in two elements (docs/equations.md).
    """
    roll, pitch, yaw = np.broadcast_arrays(roll, pitch, yaw)
    cr, sr = np.cos(roll), np.sin(roll)
    cp, sp = np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    R = np.empty((*roll.shape, 3, 3))
    R[..., 0, 0], R[..., 0, 1], R[..., 0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    R[..., 1, 0], R[..., 1, 1], R[..., 1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    R[..., 2, 0], R[..., 2, 1], R[..., 2, 2] = -sp, cp * sr, cp * cr
    return R


def matrix_to_euler(R_nb: Floats) -> Floats:
    """Roll, pitch and yaw of an attitude matrix.

    Parameters
    ----------
    R_nb : ndarray, shape (..., 3, 3)

    Returns
    -------
    ndarray, shape (..., 3)
        Roll in [-pi, pi], pitch in [-pi/2, pi/2], yaw in [-pi, pi], rad.  At pitch = ±pi/2 only yaw ∓ roll is
        determined; roll is then set to 0.  `nav_core.attitude.euler_rates` holds another roll there.

    Notes
    -----
    000 eq. 2.6.70 with the arc sine of its second line, written as an arc tangent that keeps its precision near ±pi/2,
    and yaw from ``R Rx(roll)'``, where it is the same angle.
    """
    R = trailing("R_nb", R_nb, 3, 3)
    level = np.hypot(R[..., 0, 0], R[..., 1, 0])
    pitch = np.arctan2(-R[..., 2, 0], level)
    roll = np.where(level < GIMBAL_LOCK, 0.0, np.arctan2(R[..., 2, 1], R[..., 2, 2]))
    # Yaw of what is left without roll: near gimbal lock both are noise, and yet fit together.
    cr, sr = np.cos(roll), np.sin(roll)
    yaw = np.arctan2(sr * R[..., 0, 2] - cr * R[..., 0, 1], cr * R[..., 1, 1] - sr * R[..., 1, 2])
    return np.stack((roll, pitch, yaw), axis=-1)


def euler_to_quaternion(roll: Floats | float, pitch: Floats | float, yaw: Floats | float) -> Floats:
    """Quaternion of roll, pitch and yaw, shape (..., 4) with ``w >= 0``; angles in rad, broadcast (000 eq. 2.6.69).

    The last line of 2.6.69 as printed lacks a minus (docs/equations.md).

    Parameters
    ----------
    roll, pitch, yaw : ndarray or float, shape (...)
        From b to n, rad.

    Returns
    -------
    ndarray, shape (..., 4)
        Order (x, y, z, w).
    """
    roll, pitch, yaw = np.broadcast_arrays(roll, pitch, yaw)
    cr, sr = np.cos(0.5 * roll), np.sin(0.5 * roll)
    cp, sp = np.cos(0.5 * pitch), np.sin(0.5 * pitch)
    cy, sy = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    x = sr * cp * cy - cr * sp * sy
    y = cr * sp * cy + sr * cp * sy
    z = cr * cp * sy - sr * sp * cy
    return _positive(np.stack((x, y, z, cr * cp * cy + sr * sp * sy), axis=-1))


def quaternion_to_euler(q_nb: Floats) -> Floats:
    """Roll, pitch and yaw of a quaternion, shape (..., 3), rad; at pitch = ±pi/2 as `matrix_to_euler`.

    000 eq. 2.6.71, whose printed numerator of yaw is 2 (ac + bc) where 2 (ad + bc) is meant.

    Parameters
    ----------
    q_nb : ndarray, shape (..., 4)
        From b to n, order (x, y, z, w).

    Returns
    -------
    ndarray, shape (..., 3)
        rad.

    Raises
    ------
    ShapeError, RangeError
        As `quaternion_to_matrix`.
    """
    return matrix_to_euler(quaternion_to_matrix(q_nb))


def quaternion_to_matrix(q: Floats) -> Floats:
    """Matrix of a quaternion.

    Parameters
    ----------
    q : ndarray, shape (..., 4)
        (x, y, z, w) of any length but zero.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        ``R`` with ``R @ v = q v q*`` (000 eqs. 2.6.40, 2.6.42; 001 C.3).
    """
    x, y, z, w = np.moveaxis(normalised(q), -1, 0)
    R = np.empty((*x.shape, 3, 3))
    R[..., 0, 0], R[..., 0, 1], R[..., 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    R[..., 1, 0], R[..., 1, 1], R[..., 1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    R[..., 2, 0], R[..., 2, 1], R[..., 2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
    return R


def matrix_to_quaternion(R: Floats) -> Floats:
    """Quaternion of a rotation matrix.

    Parameters
    ----------
    R : ndarray, shape (..., 3, 3)
        Orthonormal to rounding; see `nav_core.attitude.orthonormal` for others.

    Returns
    -------
    ndarray, shape (..., 4)
        Unit (x, y, z, w) with ``w >= 0``.  Turns by pi have two; either is returned.

    Notes
    -----
    000 eq. 2.6.68 and 001 C.21-C.24 divide by w and fail at turns by pi.  This is Shepperd's choice of the largest
    component (Shepperd 1978): of the matrix ``4 q q'``, written with elements of `R`, the row with the
    largest diagonal.
    """
    given = trailing("R", R, 3, 3)
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = np.moveaxis(given.reshape((*given.shape[:-2], 9)), -1, 0)
    products = np.stack(
        (
            np.stack((1.0 + m00 - m11 - m22, m01 + m10, m02 + m20, m21 - m12), axis=-1),
            np.stack((m01 + m10, 1.0 - m00 + m11 - m22, m12 + m21, m02 - m20), axis=-1),
            np.stack((m02 + m20, m12 + m21, 1.0 - m00 - m11 + m22, m10 - m01), axis=-1),
            np.stack((m21 - m12, m02 - m20, m10 - m01, 1.0 + m00 + m11 + m22), axis=-1),
        ),
        axis=-2,
    )
    largest = np.argmax(np.diagonal(products, axis1=-2, axis2=-1), axis=-1)
    row = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    return _positive(normalised(row))


def rotvec_to_quaternion(v: Floats) -> Floats:
    """Quaternion, shape (..., 4) with ``w >= 0``, of the rotation by ``|v|`` rad about `v` (000 eq. 2.6.38).

    Parameters
    ----------
    v : ndarray, shape (..., 3)
        rad.

    Returns
    -------
    ndarray, shape (..., 4)
        Order (x, y, z, w).

    Raises
    ------
    ShapeError
    """
    v = trailing("v", v, 3)
    half = 0.5 * np.linalg.norm(v, axis=-1, keepdims=True)
    return _positive(np.concatenate((0.5 * np.sinc(half / np.pi) * v, np.cos(half)), axis=-1))


def quaternion_to_rotvec(q: Floats) -> Floats:
    """Rotation vector of a quaternion.

    Parameters
    ----------
    q : ndarray, shape (..., 4)
        Of any length but zero.

    Returns
    -------
    ndarray, shape (..., 3)
        rad, of length 0 to pi.  Of the two vectors of a turn by pi, one is returned.
    """
    q = _positive(normalised(q))
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    # Below 1e-9 the sine is the half angle to the last digit, and the quotient's limit is 2.
    tiny = sine < 1e-9
    factor = np.where(tiny, 2.0, 2.0 * np.arctan2(sine, q[..., 3:]) / np.where(tiny, 1.0, sine))
    return factor * q[..., :3]


def rotvec_to_matrix(v: Floats) -> Floats:
    """Matrix ``exp([v]x)``, shape (..., 3, 3), of a rotation vector in rad, shape (..., 3).

    Parameters
    ----------
    v : ndarray, shape (..., 3)
        rad.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        A rotation.

    Raises
    ------
    ShapeError
    """
    return quaternion_to_matrix(rotvec_to_quaternion(v))


def matrix_to_rotvec(R: Floats) -> Floats:
    """Rotation vector, shape (..., 3), rad, of length 0 to pi, of a rotation matrix, shape (..., 3, 3).

    Parameters
    ----------
    R : ndarray, shape (..., 3, 3)
        A rotation.

    Returns
    -------
    ndarray, shape (..., 3)
        rad.

    Raises
    ------
    ShapeError
    """
    return quaternion_to_rotvec(matrix_to_quaternion(R))


def product(q: Floats, p: Floats) -> Floats:
    """Hamilton product ``q p``, shape (..., 4): first the rotation `p`, then `q` (000 eqs. 2.6.25-2.6.27).

    ``quaternion_to_matrix(product(q, p)) = quaternion_to_matrix(q) @ quaternion_to_matrix(p)``.

    Parameters
    ----------
    q, p : ndarray, shape (..., 4)
        Order (x, y, z, w).

    Returns
    -------
    ndarray, shape (..., 4)
        As long as both lengths multiplied.

    Raises
    ------
    ShapeError
    """
    x, y, z, w = np.moveaxis(trailing("q", q, 4), -1, 0)
    X, Y, Z, W = np.moveaxis(trailing("p", p, 4), -1, 0)
    return np.stack(
        (
            w * X + x * W + y * Z - z * Y,
            w * Y - x * Z + y * W + z * X,
            w * Z + x * Y - y * X + z * W,
            w * W - x * X - y * Y - z * Z,
        ),
        axis=-1,
    )


def conjugate(q: Floats) -> Floats:
    """The inverse of a unit quaternion, shape (..., 4) (000 eqs. 2.6.31, 2.6.32).

    Parameters
    ----------
    q : ndarray, shape (..., 4)
        Of length 1, order (x, y, z, w).

    Returns
    -------
    ndarray, shape (..., 4)
        Order (x, y, z, w).

    Raises
    ------
    ShapeError
    """
    return trailing("q", q, 4) * np.array([-1.0, -1.0, -1.0, 1.0])


def normalised(q: Floats) -> Floats:
    """Quaternion of unit length, shape (..., 4); raises `RangeError` for a zero quaternion.

    Parameters
    ----------
    q : ndarray, shape (..., 4)
        Order (x, y, z, w).

    Returns
    -------
    ndarray, shape (..., 4)
        Of the same sign.

    Raises
    ------
    ShapeError, RangeError
        For a zero quaternion.
    """
    q = trailing("q", q, 4)
    # Divided by the largest component first: squares of the smallest floats vanish.
    scale = np.max(np.abs(q), axis=-1, keepdims=True, initial=0.0)
    if np.any(scale == 0.0):
        raise RangeError("norm of q", 0.0, "> 0")
    q = q / scale
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


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
    """Angle of the rotation that separates two mountings, rad, in [0, pi].

    Parameters
    ----------
    a, b : ndarray, shape (3, 3)
        Rotations.

    Returns
    -------
    float
        rad.
    """
    return float(np.linalg.norm(error_between(a, b)))


def skew(v: Floats) -> Floats:
    """Cross-product matrix ``[v]x`` with ``[v]x @ u = v x u``, shape (..., 3) to (..., 3, 3).

    Parameters
    ----------
    v : ndarray, shape (..., 3)
        In any unit.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        In that unit.

    Raises
    ------
    ShapeError
    """
    v = trailing("v", v, 3)
    S = np.zeros((*v.shape, 3))
    S[..., 2, 1], S[..., 0, 2], S[..., 1, 0] = v[..., 0], v[..., 1], v[..., 2]
    return S - np.swapaxes(S, -1, -2)


def wrap(angle: Floats) -> Floats:
    """Angle(s) wrapped to (-pi, pi].

    Parameters
    ----------
    angle : ndarray, shape (...)
        rad.

    Returns
    -------
    ndarray, shape (...)
        rad.
    """
    return np.pi - np.mod(np.pi - np.asarray(angle, dtype=np.float64), 2.0 * np.pi)


def xyzw_to_wxyz(quaternion: Floats) -> Floats:
    """From scipy's scalar-last order to viser's scalar-first order, shape (..., 4).

    Parameters
    ----------
    quaternion : ndarray, shape (..., 4)
        Order (x, y, z, w).

    Returns
    -------
    ndarray, shape (..., 4)
        Order (w, x, y, z).
    """
    return np.roll(np.asarray(quaternion, dtype=np.float64), 1, axis=-1)


def _positive(q: Floats) -> Floats:
    return np.where(q[..., 3:] < 0.0, -q, q)
