"""Alignment at rest by the box's own inertial sensors: levelling, and gyrocompassing where the gyros allow it (004)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from nav_core.alignment.directions import Attitude, triad
from nav_core.earth import RATE, earth_rate
from nav_core.errors import RangeError
from nav_core.kalman import gate
from nav_core.records import Reason
from nav_core.rotation import euler_to_matrix
from nav_core.typing import Floats, trailing

AT_REST = 0.1
"""How far the measured magnitude may be from gravity, in parts of it, before nobody would call that rest."""

DISTURBED = 0.999
"""Probability with which a box at rest stays under the threshold of `gyrocompass`'s check of the rate."""

GyrocompassStatus = Literal["observable", "unobservable", "disturbed"]


@dataclass(frozen=True, slots=True)
class Levelling:
    """Tilt of a box at rest.

    Attributes
    ----------
    roll, pitch : float
        rad; yaw is not observable and left at 0.
    R_ta : ndarray, shape (3, 3)
        ``Ry(pitch) @ Rx(roll)``: from A to the local level.
    sigma : float
        1-sigma of the tilt about every horizontal axis, rad.
    excess : float
        Magnitude of the measured specific force less gravity, m/s².
    """

    roll: float
    pitch: float
    R_ta: Floats
    sigma: float
    excess: float


def tilt(f: Floats) -> tuple[Floats, Floats]:
    """Roll and pitch from the specific force at rest.

    Parameters
    ----------
    f : ndarray, shape (..., 3)
        A-frame, m/s².

    Returns
    -------
    roll, pitch : ndarray, shape (...)
        rad, in [-pi, pi] and [-pi/2, pi/2].

    Raises
    ------
    ShapeError

    Notes
    -----
    004 eq. 21, 000 eqs. 7.6.10-7.6.12; the arc tangents put the box upright, on its side or upside down by themselves,
    where table 7.1 of 000 corrects an arc sine afterwards (by the sign of g_z; the print heads that column g_x).
    """
    f = trailing("f", f, 3)
    return np.arctan2(-f[..., 1], -f[..., 2]), np.arctan2(f[..., 0], np.hypot(f[..., 1], f[..., 2]))


def level(f: Floats, *, gravity: float, sigma: float) -> Levelling:
    """Tilt of a box at rest (004, levelling).

    Parameters
    ----------
    f : ndarray, shape (3,)
        Mean specific force, A-frame, m/s².
    gravity : float
        Magnitude of gravity at the place, m/s².
    sigma : float
        1-sigma of each component of `f`, biases included, m/s².

    Returns
    -------
    Levelling

    Raises
    ------
    ShapeError
    RangeError
        The magnitude differs from gravity by more than `AT_REST` of it.
    """
    f = trailing("f", f, 3)
    magnitude = float(np.linalg.norm(f))
    if not abs(magnitude - gravity) <= AT_REST * gravity:
        raise RangeError("specific force", magnitude, f"{gravity:.2f} ± {AT_REST:.0%} m/s² at rest")
    roll, pitch = tilt(f)
    return Levelling(float(roll), float(pitch), euler_to_matrix(roll, pitch, 0.0), sigma / gravity, magnitude - gravity)


def mean_sigma(bias: float, density: float, duration: float) -> float:
    """1-sigma of a mean over `duration` s: what of the bias is unknown, and white noise of `density` per root Hz.

    Parameters
    ----------
    bias : float
        1-sigma of the bias, in any unit.
    density : float
        Of the white noise, that unit per root Hz.
    duration : float
        s.

    Returns
    -------
    float
        In the unit of `bias`.

    Raises
    ------
    RangeError
    """
    if not duration > 0.0:
        raise RangeError("duration", duration, "more than 0 s")
    return float(np.hypot(bias, density / np.sqrt(duration)))


@dataclass(frozen=True, slots=True)
class Gyrocompass:
    """Heading from the Earth's turning, or why there is none.

    Attributes
    ----------
    status : {"observable", "unobservable", "disturbed"}
    attitude : Attitude, optional
        Only when observable.
    sigma_yaw : float
        1-sigma the heading has or would have, rad; without a meaning as an angle beyond about 1.
    horizontal_rate : float
        The part of the Earth's rate that points north, rad/s.
    sigma_rate : float
        1-sigma of the measured mean rate, rad/s.
    needed_rate : float
        The 1-sigma of the rate that would just reach the limit, rad/s; 0 if the tilt alone spoils it.
    chi2 : float
        Measured rate against the Earth's in magnitude and elevation; two degrees of freedom.
    reasons : tuple of Reason
    """

    status: GyrocompassStatus
    attitude: Attitude | None
    sigma_yaw: float
    horizontal_rate: float
    sigma_rate: float
    needed_rate: float
    chi2: float
    reasons: tuple[Reason, ...]


def gyrocompass(
    f: Floats, w: Floats, *, lat: float, gravity: float, sigma_f: float, sigma_w: float, limit: float
) -> Gyrocompass:
    """Attitude of a box at rest from gravity and the Earth's turning (004, azimuth orientation).

    Parameters
    ----------
    f : ndarray, shape (3,)
        Mean specific force, A-frame, m/s².
    w : ndarray, shape (3,)
        Mean angular rate, A-frame, rad/s.
    lat : float
        rad.
    gravity : float
        m/s².
    sigma_f, sigma_w : float
        1-sigma of each component of the means, biases included, m/s² and rad/s (`mean_sigma`).
    limit : float
        Largest 1-sigma of the heading that is of use, rad.

    Returns
    -------
    Gyrocompass
        Without attitude where the heading would be worse than `limit`, or the box turned by more than the Earth.

    Raises
    ------
    ShapeError, RangeError

    Notes
    -----
    Gravity is the master, the Earth's rate the slave: the 004 formulas for C_11 .. C_33, made orthonormal.  A tilt
    error takes the vertical part of the Earth's rate for a horizontal one: ``tan(lat)`` times the tilt enters the
    heading besides ``sigma_w / (W cos(lat))``.  A consumer gyro, with its bias of degrees an hour, has no heading;
    with one of 15 degrees an hour, the Earth's own rate, the heading is a draw.
    """
    levelled = level(f, gravity=gravity, sigma=sigma_f)
    rate, w = earth_rate(lat), trailing("w", w, 3)
    north = float(rate[0])
    from_tilt = abs(np.tan(lat)) * levelled.sigma
    sigma_yaw = float(np.hypot(sigma_w / north, from_tilt))
    needed = north * float(np.sqrt(max(limit**2 - from_tilt**2, 0.0)))
    flat = levelled.R_ta @ w
    misfit = np.array([np.hypot(flat[0], flat[1]) - north, flat[2] - rate[2]])
    # The tilt also leaks the horizontal part into the vertical one and back.
    spread = float(np.hypot(sigma_w, RATE * levelled.sigma))
    statistic = float(misfit @ misfit) / spread**2
    per_hour = np.degrees(3600.0)
    if sigma_yaw > limit:
        status: GyrocompassStatus = "unobservable"
        text = (
            f"The Earth turns the box by {north * per_hour:.1f} °/h about north; the gyros' mean is only known to "
            f"{sigma_w * per_hour:.1f} °/h. A heading to {np.degrees(limit):.1f}° needs {needed * per_hour:.2g} °/h."
        )
        reasons = (Reason("heading_unobservable", text),)
    elif statistic > gate(2, DISTURBED):
        status = "disturbed"
        measured = float(np.linalg.norm(w)) * per_hour
        text = (
            f"The gyros' mean is {measured:.1f} °/h where the Earth gives {RATE * per_hour:.1f} °/h: "
            "the box turned, or its gyros are worse than stated."
        )
        reasons = (Reason("rate_is_not_the_earths", text),)
    else:
        down = np.array([0.0, 0.0, 1.0])
        fix = triad(-f, w, down, rate, sigma_master=levelled.sigma, sigma_slave=sigma_w / RATE)
        return Gyrocompass("observable", fix, float(fix.sigma[2]), north, sigma_w, needed, statistic, ())
    return Gyrocompass(status, None, sigma_yaw, north, sigma_w, needed, statistic, reasons)
