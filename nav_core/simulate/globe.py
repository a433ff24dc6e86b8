"""A simulated drive set on the turning ellipsoid: what perfect inertial sensors read there.

The simulator's world is flat and at rest, which is all that a box needs whose gyro cannot feel the Earth.  Navigation
can: here the drive's velocity and attitude are against north, east and down of wherever the vehicle is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core import earth
from nav_core.simulate.scenario import Truth
from nav_core.typing import Floats


@dataclass(frozen=True, slots=True)
class GlobalDrive:
    """A drive over the Earth, at n moments.

    Attributes
    ----------
    t : ndarray, shape (n,)
        s.
    lat, lon, height : ndarray, shape (n,)
        WGS84, rad and m above the ellipsoid.
    velocity : ndarray, shape (n, 3)
        North, east, down, m/s.
    R_tv : ndarray, shape (n, 3, 3)
        Attitude.
    f_v : ndarray, shape (n, 3)
        Specific force, V axes, m/s².
    w_v : ndarray, shape (n, 3)
        Angular rate against i, V axes, rad/s.
    """

    t: Floats
    lat: Floats
    lon: Floats
    height: Floats
    velocity: Floats
    R_tv: Floats
    f_v: Floats
    w_v: Floats


def on_the_globe(
    truth: Truth,
    start: tuple[float, float, float],
    *,
    level: bool = False,
    flat_gravity: float = earth.STANDARD_GRAVITY,
) -> GlobalDrive:
    """Set a simulated drive on the Earth.

    Parameters
    ----------
    truth : Truth
        Of `nav_core.simulate.simulate`.
    start : tuple of float
        Latitude, longitude (rad) and height (m) at the first moment; away from the poles.
    level : bool
        Drive at the height of the start: vertical motion is left out, and what it does to the specific force.
    flat_gravity : float
        Gravity of the scenario, m/s².

    Returns
    -------
    GlobalDrive

    Notes
    -----
    ``f = R' (a + (2 w_ie + w_et) x v - g)`` and ``w = w_tv + R' (w_ie + w_et)``: 000 eqs. 2.5.19 and 2.5.22 solved for
    what is measured.  Latitude and longitude are integrals of the velocity by the trapezoidal rule, so the path differs
    from the drive's own by some 1e-4 m at 100 Hz; force and rate belong exactly to the path returned but for this.
    """
    keep = np.array([1.0, 1.0, 0.0 if level else 1.0])
    velocity = keep * truth.velocity
    R_tv = truth.R_tv
    acceleration = keep * (np.einsum("nij,nj->ni", R_tv, truth.f_v) + np.array([0.0, 0.0, flat_gravity]))
    height = start[2] - _integral(truth.t, velocity[:, 2])
    meridian, normal = earth.radii(start[0])
    lat = np.full(truth.t.size, start[0])
    for _ in range(2):
        # The radius hardly changes with latitude: the second round is exact to rounding.
        lat = start[0] + _integral(truth.t, velocity[:, 0] / (meridian + height))
        meridian, normal = earth.radii(lat)
    lon = start[1] + _integral(truth.t, velocity[:, 1] / ((normal + height) * np.cos(lat)))

    spin, transport = earth.earth_rate(lat), earth.transport_rate(lat, height, velocity)
    felt = acceleration + np.cross(2.0 * spin + transport, velocity)
    felt[:, 2] -= earth.gravity(lat, height)
    f_v = np.einsum("nji,nj->ni", R_tv, felt)
    w_v = truth.w_v + np.einsum("nji,nj->ni", R_tv, spin + transport)
    return GlobalDrive(truth.t, lat, lon, height, velocity, R_tv, f_v, w_v)


def _integral(t: Floats, rate: Floats) -> Floats:
    steps = 0.5 * np.diff(t) * (rate[1:] + rate[:-1])
    return np.concatenate(([0.0], np.cumsum(steps)))
