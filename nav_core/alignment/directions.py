"""Attitude from directions that are known in two frames: TRIAD (master and slave), Wahba's problem.

Covariances are those of the small rotation about the T axes that separates estimate and truth:
``R_estimate = exp([e]x) @ R_true``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.errors import RangeError, ShapeError, TooLittleDataError
from nav_core.rotation import matrix_to_euler
from nav_core.typing import Floats, trailing

PARALLEL = 1e-6
"""Sine of the angle between two directions under which they are taken for one."""


@dataclass(frozen=True, slots=True)
class Attitude:
    """Attitude of the box at rest or in an instant.

    Attributes
    ----------
    R_ta : ndarray, shape (3, 3)
        ``vec_t = R_ta @ vec_a``.
    covariance : ndarray, shape (3, 3)
        Of the small rotation about north, east and down that separates estimate and truth, rad².
    """

    R_ta: Floats
    covariance: Floats

    @property
    def sigma(self) -> Floats:
        """1-sigma of the rotation about north, east and down, rad, shape (3,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def euler(self) -> Floats:
        """Roll, pitch, yaw, rad, shape (3,)."""
        return matrix_to_euler(self.R_ta)


def unit(name: str, v: Floats) -> Floats:
    """Direction of each vector, shape (..., 3).

    Parameters
    ----------
    name : str
        What the vectors are, for the error.
    v : ndarray, shape (..., 3)
        In any frame and unit.

    Returns
    -------
    ndarray, shape (..., 3)
        Of length 1, in the frame of `v`.

    Raises
    ------
    ShapeError, RangeError
    """
    v = trailing(name, v, 3)
    norm = np.linalg.norm(v, axis=-1, keepdims=True)
    if not norm.min(initial=1.0) > 0.0:
        raise RangeError(f"length of {name}", float(norm.min()), "more than 0")
    return v / norm


def _frame(first: Floats, second: Floats) -> Floats:
    """Right-handed axes: along the first, in the plane of both, across; as columns."""
    across = np.cross(first, second)
    sine = float(np.linalg.norm(across))
    if sine < PARALLEL:
        raise RangeError("sine of the angle between the directions", sine, f"at least {PARALLEL:g}")
    across = across / sine
    return np.column_stack([first, np.cross(across, first), across])


def triad(
    master_a: Floats, slave_a: Floats, master_t: Floats, slave_t: Floats, *, sigma_master: float, sigma_slave: float
) -> Attitude:
    """Attitude that fits the master direction exactly and the slave's only in its angle around the master.

    Parameters
    ----------
    master_a, slave_a : ndarray, shape (3,)
        Two vectors measured in A; only their directions count.
    master_t, slave_t : ndarray, shape (3,)
        The same vectors in T.
    sigma_master, sigma_slave : float
        1-sigma of each measured direction, about every axis across it, rad.

    Returns
    -------
    Attitude

    Raises
    ------
    ShapeError, RangeError
        A vector vanishes, or the two are parallel.

    Notes
    -----
    Black 1964; 000 section 7.6.2 calls it master and slave.  With ``c, s`` cosine and sine of the angle between the
    directions, the rotation about the master has variance ``(c sigma_master / s)² + (sigma_slave / s)²``.
    """
    u, v = unit("master_t", master_t), unit("slave_t", slave_t)
    axes = _frame(u, v)
    R_ta = axes @ _frame(unit("master_a", master_a), unit("slave_a", slave_a)).T
    cosine, sine = u @ v, float(np.linalg.norm(np.cross(u, v)))
    # Rotations about the master, in the plane of both, across it, out of three independent direction errors.
    errors = np.array([[cosine / sine * sigma_master, 0.0, sigma_slave / sine], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    errors[1:, :2] *= sigma_master
    return Attitude(R_ta, axes @ errors @ errors.T @ axes.T)


@dataclass(frozen=True, slots=True)
class WahbaFit:
    """Solution of Wahba's problem.

    Attributes
    ----------
    attitude : Attitude
    chi2 : float
        Sum of the squared direction errors over their variances.
    freedom : int
        Its degrees of freedom: two a direction, less three.
    """

    attitude: Attitude
    chi2: float
    freedom: int


def wahba(vectors_a: Floats, vectors_t: Floats, sigmas: Floats) -> WahbaFit:
    """Attitude that fits two or more directions best.

    Parameters
    ----------
    vectors_a, vectors_t : ndarray, shape (n, 3)
        Vectors measured in A and known in T; only their directions count.
    sigmas : ndarray, shape (n,)
        1-sigma of each measured direction, about every axis across it, rad.

    Returns
    -------
    WahbaFit

    Raises
    ------
    ShapeError, TooLittleDataError, RangeError
        Fewer than two directions, or all of them parallel.

    Notes
    -----
    Minimises ``sum |t_i - R a_i|² / sigma_i²`` (Wahba 1965) by the singular value decomposition (Markley 1988);
    covariance ``(sum (I - t t') / sigma²)^-1`` (Shuster and Oh 1981).
    """
    a, t = unit("vectors_a", vectors_a), unit("vectors_t", vectors_t)
    if a.ndim != 2 or a.shape != t.shape:
        raise ShapeError("vectors_t", t.shape, str(a.shape))
    if sigmas.shape != (a.shape[0],):
        raise ShapeError("sigmas", sigmas.shape, f"({a.shape[0]},)")
    if a.shape[0] < 2:
        raise TooLittleDataError("directions", a.shape[0], 2)
    weights = 1.0 / sigmas**2
    spread = np.linalg.svd(t - t[0] * (t @ t[0])[:, None], compute_uv=False)[0]
    if spread < PARALLEL:
        raise RangeError("spread of the directions", float(spread), f"at least {PARALLEL:g}")
    U, _, Vt = np.linalg.svd((t * weights[:, None]).T @ a)
    R_ta = U @ np.diag([1.0, 1.0, np.linalg.det(U) * np.linalg.det(Vt)]) @ Vt
    information = weights.sum() * np.eye(3) - (t * weights[:, None]).T @ t
    chi2 = float(weights @ np.sum((t - a @ R_ta.T) ** 2, axis=1))
    return WahbaFit(Attitude(R_ta, np.linalg.inv(information)), chi2, 2 * a.shape[0] - 3)
