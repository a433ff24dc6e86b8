"""The thesis' small rotations, compiled: quaternions, Rodrigues vectors and their derivatives (001 ch. 4, C)."""

from __future__ import annotations

import numpy as np

from nav_core.mounting.thesis_model import N_STATES, Errata
from nav_core.typing import Floats, kernel


@kernel
def rotation_of(q: Floats, R: Floats) -> None:
    """Write the matrix of a unit quaternion (x, y, z, w) into `R` (001 eq. C.3).

    Parameters
    ----------
    q : ndarray, shape (4,)
        Of length 1.
    R : ndarray, shape (3, 3)
        Overwritten.
    """
    x, y, z, w = q[0], q[1], q[2], q[3]
    R[0, 0] = w * w + x * x - y * y - z * z
    R[0, 1] = 2.0 * (x * y - z * w)
    R[0, 2] = 2.0 * (y * w + z * x)
    R[1, 0] = 2.0 * (z * w + x * y)
    R[1, 1] = w * w - x * x + y * y - z * z
    R[1, 2] = 2.0 * (y * z - x * w)
    R[2, 0] = 2.0 * (x * z - y * w)
    R[2, 1] = 2.0 * (x * w + y * z)
    R[2, 2] = w * w - x * x - y * y + z * z


@kernel
def small_rotation(a: Floats, v: Floats, out: Floats, J: Floats) -> None:
    """Write ``R(dq(a)) v`` into `out` and its derivative with respect to `a` into `J` (001 eq. 4.26).

    With ``s = 4 / (4 + |a|²)`` the rotation is ``v + s (a x v + a x (a x v) / 2)``; its transpose is that of ``-a``.

    Parameters
    ----------
    a : ndarray, shape (3,)
        Rodrigues vector ``2 tan(angle/2)``, rad for small angles.
    v : ndarray, shape (3,)
        In any unit.
    out : ndarray, shape (3,)
        In that unit; overwritten.
    J : ndarray, shape (3, 3)
        Overwritten.
    """
    n = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
    s = 4.0 / (4.0 + n)
    dot = a[0] * v[0] + a[1] * v[1] + a[2] * v[2]
    half = 0.5 * s
    J[0, 0], J[0, 1], J[0, 2] = 0.0, v[2], -v[1]
    J[1, 0], J[1, 1], J[1, 2] = -v[2], 0.0, v[0]
    J[2, 0], J[2, 1], J[2, 2] = v[1], -v[0], 0.0
    for i in range(3):
        cross = J[i, 0] * a[0] + J[i, 1] * a[1] + J[i, 2] * a[2]
        turned = cross + 0.5 * (a[i] * dot - v[i] * n)
        out[i] = v[i] + s * turned
        for j in range(3):
            J[i, j] = s * J[i, j] + half * (a[i] * v[j] - 2.0 * v[i] * a[j] - s * turned * a[j])
        J[i, i] += half * dot


@kernel
def turn_reference(a: Floats, q: Floats) -> None:
    """Replace the reference `q` by ``dq(a) q`` (001 eqs. 4.26, 4.29, 4.30).

    Parameters
    ----------
    a : ndarray, shape (3,)
        Rodrigues vector, rad.
    q : ndarray, shape (4,)
        Order (x, y, z, w); overwritten.
    """
    x = a[0] * q[3] + 2.0 * q[0] + a[1] * q[2] - a[2] * q[1]
    y = a[1] * q[3] + 2.0 * q[1] + a[2] * q[0] - a[0] * q[2]
    z = a[2] * q[3] + 2.0 * q[2] + a[0] * q[1] - a[1] * q[0]
    w = 2.0 * q[3] - a[0] * q[0] - a[1] * q[1] - a[2] * q[2]
    norm = np.sqrt(x * x + y * y + z * z + w * w)
    q[0], q[1], q[2], q[3] = x / norm, y / norm, z / norm, w / norm


@kernel
def transport(a: Floats, first: int, P: Floats) -> None:
    """Carry three states of `P` over to the reference moved by `a`: ``M = s (I + [a]x / 2)``.

    `M` is the derivative at ``a`` of the Rodrigues vector of ``dq(.) dq(a)^-1``.

    Parameters
    ----------
    a : ndarray, shape (3,)
        Rodrigues vector, rad.
    first : int
        Index of the first of the three states.
    P : ndarray, shape (9, 9)
        Overwritten.
    """
    s = 4.0 / (4.0 + a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    h0, h1, h2 = 0.5 * a[0], 0.5 * a[1], 0.5 * a[2]
    i, j, k = first, first + 1, first + 2
    for c in range(N_STATES):
        x, y, z = P[i, c], P[j, c], P[k, c]
        P[i, c] = s * (x - h2 * y + h1 * z)
        P[j, c] = s * (h2 * x + y - h0 * z)
        P[k, c] = s * (-h1 * x + h0 * y + z)
    for c in range(N_STATES):
        x, y, z = P[c, i], P[c, j], P[c, k]
        P[c, i] = s * (x - h2 * y + h1 * z)
        P[c, j] = s * (h2 * x + y - h0 * z)
        P[c, k] = s * (-h1 * x + h0 * y + z)


@kernel
def move_references(x: Floats, P: Floats, q_V: Floats, q_A: Floats, errata: Errata) -> None:
    """Put `a_V` and `a_A` into the reference quaternions and zero them (001 eqs. 4.29, 4.30).

    Parameters
    ----------
    x : ndarray, shape (9,)
        Overwritten.
    P : ndarray, shape (9, 9)
        Overwritten.
    q_V, q_A : ndarray, shape (4,)
        Order (x, y, z, w); overwritten.
    errata : Errata
        Which corrections hold.
    """
    turn_reference(x[3:6], q_V)
    turn_reference(x[6:9], q_A)
    if errata.reset:
        transport(x[3:6], 3, P)
        transport(x[6:9], 6, P)
    x[3:9] = 0.0
