"""Attitude from gravity and the Earth's magnetic field: master and slave, and Gauss-Newton (000 section 7.6).

Gravity in the A axes is the negative of the specific force at rest; in motion it is what `f` is once the vehicle's
acceleration has been taken off it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.alignment.directions import Attitude, triad
from nav_core.alignment.levelling import tilt
from nav_core.errors import RangeError
from nav_core.rotation import euler_to_matrix, rotvec_to_matrix, skew
from nav_core.typing import Floats, trailing


def master_slave(f: Floats, m: Floats, *, declination: float, sigma_f: float, sigma_m: float) -> Attitude:
    """Roll and pitch from gravity, then yaw from the levelled magnetic field.

    Parameters
    ----------
    f : ndarray, shape (3,)
        Specific force at rest, A-frame, m/s².
    m : ndarray, shape (3,)
        Magnetic field, A-frame, any unit.
    declination : float
        Of the horizontal field from true north, clockwise, rad (`earth.MagneticField.declination`).
    sigma_f, sigma_m : float
        1-sigma of each component, in the units of `f` and `m`.

    Returns
    -------
    Attitude

    Raises
    ------
    ShapeError
    RangeError
        The field is vertical: no heading.

    Notes
    -----
    000 eqs. 7.6.10-7.6.16 with arc tangents in place of the offsets of tables 7.1 and 7.2.  Strength and inclination of
    the field do not enter, so hard iron that only changes those does no harm.
    """
    f, m = trailing("f", f, 3), trailing("m", m, 3)
    roll, pitch = tilt(f)
    flat = euler_to_matrix(roll, pitch, 0.0) @ m
    yaw = np.arctan2(-flat[1], flat[0]) + declination
    field = euler_to_matrix(0.0, 0.0, yaw) @ flat
    strength, g = float(np.linalg.norm(m)), float(np.linalg.norm(f))
    if not strength > 0.0:
        raise RangeError("magnetic field", strength, "more than 0")
    down = np.array([0.0, 0.0, 1.0])
    fix = triad(-f, m, down, field, sigma_master=sigma_f / g, sigma_slave=sigma_m / strength)
    return Attitude(euler_to_matrix(roll, pitch, yaw), fix.covariance)


@dataclass(frozen=True, slots=True)
class GaussNewtonFit:
    """Attitude by iterated least squares.

    Attributes
    ----------
    attitude : Attitude
    converged : bool
        Whether the last step was smaller than the tolerance.
    rounds : int
    chi2 : float
        Sum of squared normalised residuals; three degrees of freedom.
    residual_f, residual_m : ndarray, shape (3,)
        Measured less expected, A-frame.
    """

    attitude: Attitude
    converged: bool
    rounds: int
    chi2: float
    residual_f: Floats
    residual_m: Floats


def gauss_newton(
    f: Floats,
    m: Floats,
    *,
    gravity: float,
    field: Floats,
    sigma_f: float,
    sigma_m: float,
    start: Floats | None = None,
    tolerance: float = 1e-9,
    most_rounds: int = 30,
) -> GaussNewtonFit:
    """Attitude that fits gravity and magnetic field together, each by its weight.

    Parameters
    ----------
    f : ndarray, shape (3,)
        Specific force at rest, A-frame, m/s².
    m : ndarray, shape (3,)
        Magnetic field, A-frame, µT.
    gravity : float
        m/s².
    field : ndarray, shape (3,)
        The field in T, µT (`earth.MagneticField.vector`).
    sigma_f, sigma_m : float
        1-sigma of each component, m/s² and µT.
    start : ndarray, shape (3, 3), optional
        ``R_ta`` to begin with; by default `master_slave`'s, which is always near enough.
    tolerance : float
        Size of the last step, rad.
    most_rounds : int

    Returns
    -------
    GaussNewtonFit
        From a far `start` it may not converge, or to a stationary point with a huge `chi2` (000 section 7.6.3).

    Raises
    ------
    ShapeError
    RangeError
        Gravity and field are parallel: no heading.

    Notes
    -----
    000 eqs. 7.6.2-7.6.9.  The print solves for four quaternion components in T to A axes with body-to-navigation
    equations (2.6.42), unweighted, and leaves the vertical gravity component out.  Here: a small rotation about the T
    axes, which has no superfluous component, residuals over their sigma, all six of them; same minimum, and the
    inverse of the normal matrix is the covariance.
    """
    f, m, field = trailing("f", f, 3), trailing("m", m, 3), trailing("field", field, 3)
    down = np.array([0.0, 0.0, 1.0])
    if start is None:
        declination = float(np.arctan2(field[1], field[0]))
        start = master_slave(f, m, declination=declination, sigma_f=sigma_f, sigma_m=sigma_m).R_ta
    expected = np.concatenate([-gravity * down / sigma_f, field / sigma_m])
    design = -np.vstack([skew(expected[:3]), skew(expected[3:])])
    normal = design.T @ design
    weakest = float(np.linalg.eigvalsh(normal)[0])
    if weakest < 1e-12 * float(np.trace(normal)):
        raise RangeError("information on the weakest axis", weakest, "more than 0: gravity and field are parallel")
    spread = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    R_ta, step, rounds = trailing("start", start, 3, 3), np.inf, 0
    while step > tolerance and rounds < most_rounds:
        residual = np.concatenate([R_ta @ f / sigma_f, R_ta @ m / sigma_m]) - expected
        error = spread @ design.T @ residual
        R_ta = rotvec_to_matrix(-error) @ R_ta
        step, rounds = float(np.linalg.norm(error)), rounds + 1
    left = f + R_ta.T @ down * gravity, m - R_ta.T @ field
    chi2 = float(left[0] @ left[0]) / sigma_f**2 + float(left[1] @ left[1]) / sigma_m**2
    return GaussNewtonFit(Attitude(R_ta, spread), step <= tolerance, rounds, chi2, *left)
