"""Navigation over the Earth from strapdown increments, in any of the frames of 000 §2.5.

All frames describe the same motion, and each has its place: "ned" and "neu" speak the user's language and fail at the
poles, "w" (wander azimuth) is the same without a pole, "e" is simplest to couple with satellites, "i" is the one
in which nothing turns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from nav_core import earth
from nav_core.errors import RangeError
from nav_core.strapdown.cartesian_kernels import run_cartesian
from nav_core.strapdown.increments import Increments
from nav_core.strapdown.kernels import run_local
from nav_core.strapdown.wander_kernels import run_wander
from nav_core.typing import Floats, trailing

Frame = Literal["i", "e", "ned", "neu", "w"]

HIGHEST_LATITUDE = np.radians(89.9)
"""Where "ned" and "neu" end, rad: 11 km from the pole, north turns by a tenth of a degree every 20 m."""


@dataclass(frozen=True, slots=True)
class Navigation:
    """Position, velocity and attitude at one moment.

    Attributes
    ----------
    lat, lon, height : float
        WGS84, rad and m above the ellipsoid.
    velocity : ndarray, shape (3,)
        Against the Earth: north, east, down, m/s.
    R_tb : ndarray, shape (3, 3)
        Attitude: turns b into T.
    """

    lat: float
    lon: float
    height: float
    velocity: Floats
    R_tb: Floats

    def __post_init__(self) -> None:
        trailing("velocity", self.velocity, 3)
        trailing("R_tb", self.R_tb, 3, 3)


@dataclass(frozen=True, slots=True)
class Track:
    """Position, velocity and attitude at n moments.

    Attributes
    ----------
    t : ndarray, shape (n,)
        s.
    lat, lon, height : ndarray, shape (n,)
        WGS84, rad and m above the ellipsoid.
    velocity : ndarray, shape (n, 3)
        Against the Earth: north, east, down, m/s.
    R_tb : ndarray, shape (n, 3, 3)
        Attitudes: turn b into T.
    """

    t: Floats
    lat: Floats
    lon: Floats
    height: Floats
    velocity: Floats
    R_tb: Floats

    @property
    def R_et(self) -> Floats:
        """North, east and down in e axes at each moment, shape (n, 3, 3)."""
        return earth.tangent_axes(self.lat, self.lon)

    @property
    def r_e(self) -> Floats:
        """Positions in e, m, shape (n, 3)."""
        return earth.geodetic_to_ecef(self.lat, self.lon, self.height)

    @property
    def v_e(self) -> Floats:
        """Velocities against the Earth in e axes, m/s, shape (n, 3); without a seam at the poles."""
        return _turned(self.R_et, self.velocity)

    @property
    def R_eb(self) -> Floats:
        """Attitudes against the Earth, shape (n, 3, 3); without a seam at the poles."""
        return self.R_et @ self.R_tb


def mechanise(start: Navigation, increments: Increments, *, frame: Frame = "ned", hold_height: bool = False) -> Track:
    """Navigate by increments alone.

    Parameters
    ----------
    start : Navigation
        At ``increments.t[0]``.
    increments : Increments
        n intervals.
    frame : {"ned", "neu", "w", "e", "i"}
        In which the equations are integrated.  The result is in the same terms for all.
    hold_height : bool
        Keep the height of the start and a horizontal velocity.  Without, errors of the height double every
        400 s or so.

    Returns
    -------
    Track
        n + 1 moments, the start first.

    Raises
    ------
    RangeError
        When "ned" or "neu" come within 0.1° of a pole.

    Notes
    -----
    000 eqs. 2.5.9 (i), 2.5.13 (e), 2.5.19 and 2.5.22 (n), 2.5.24 (w), with gravity from `nav_core.earth.gravity` for
    all.  Second-order accurate in the period, given exact increments.
    """
    match frame:
        case "ned" | "neu":
            return _local(start, increments, hold=hold_height, up=frame == "neu")
        case "w":
            return _wander(start, increments, hold=hold_height)
        case "e" | "i":
            return _cartesian(start, increments, hold=hold_height, inertial=frame == "i")


def _local(start: Navigation, increments: Increments, *, hold: bool, up: bool) -> Track:
    mirror = np.array([1.0, 1.0, -1.0 if up else 1.0])
    places, v, C = run_local(
        np.array([start.lat, start.lon, start.height]),
        mirror * _start_velocity(start, hold=hold),
        mirror[:, None] * start.R_tb,
        increments.rotation,
        increments.velocity,
        increments.periods,
        hold,
        up,
    )
    highest = float(np.max(np.abs(places[:, 0])))
    if not highest < HIGHEST_LATITUDE:
        raise RangeError("latitude in rad", highest, f"< {HIGHEST_LATITUDE:.4f} in this frame; use w, e or i")
    lon = np.pi - np.mod(np.pi - places[:, 1], 2.0 * np.pi)
    return Track(increments.t, places[:, 0], lon, places[:, 2], mirror * v, mirror[:, None] * C)


def _wander(start: Navigation, increments: Increments, *, hold: bool) -> Track:
    R_ew, height, v, C = run_wander(
        earth.tangent_axes(start.lat, start.lon),
        start.height,
        _start_velocity(start, hold=hold),
        np.array(start.R_tb, dtype=np.float64),
        increments.rotation,
        increments.velocity,
        increments.periods,
        hold,
    )
    down = R_ew[:, :, 2]
    lat = np.arctan2(-down[:, 2], np.hypot(down[:, 0], down[:, 1]))
    lon = np.arctan2(-down[:, 1], -down[:, 0])
    R_tw = np.swapaxes(earth.tangent_axes(lat, lon), 1, 2) @ R_ew
    return Track(increments.t, lat, lon, height, _turned(R_tw, v), R_tw @ C)


def _cartesian(start: Navigation, increments: Increments, *, hold: bool, inertial: bool) -> Track:
    R_et = earth.tangent_axes(start.lat, start.lon)
    places, speeds, attitudes = run_cartesian(
        earth.geodetic_to_ecef(start.lat, start.lon, start.height),
        R_et @ _start_velocity(start, hold=hold),
        R_et @ start.R_tb,
        increments.rotation,
        increments.velocity,
        increments.periods,
        hold,
        inertial,
    )
    if inertial:
        # i is the e of the start.
        angle = earth.RATE * (increments.t - increments.t[0])
        R_ei = np.zeros((angle.size, 3, 3))
        R_ei[:, 0, 0] = R_ei[:, 1, 1] = np.cos(angle)
        R_ei[:, 0, 1] = np.sin(angle)
        R_ei[:, 1, 0] = -R_ei[:, 0, 1]
        R_ei[:, 2, 2] = 1.0
        places, speeds, attitudes = _turned(R_ei, places), _turned(R_ei, speeds), R_ei @ attitudes
    lat, lon, height = earth.ecef_to_geodetic(places)
    R_te = np.swapaxes(earth.tangent_axes(lat, lon), 1, 2)
    return Track(increments.t, lat, lon, height, _turned(R_te, speeds), R_te @ attitudes)


def _start_velocity(start: Navigation, *, hold: bool) -> Floats:
    return start.velocity * np.array([1.0, 1.0, 0.0 if hold else 1.0])


def _turned(R: Floats, v: Floats) -> Floats:
    return np.einsum("nij,nj->ni", R, v)
