"""A motion over the Earth that is known in closed form, and what perfect sensors read on it."""

from __future__ import annotations

import numpy as np
from scipy.special import roots_legendre

from nav_core import earth
from nav_core.rotation import euler_to_matrix
from nav_core.strapdown import Navigation

PLACE = (np.radians(45.07), np.radians(7.69), 240.0)
_NODES, _WEIGHTS = roots_legendre(5)


def place(t):
    """Latitude, longitude and height: 20 m/s and swaying; `t` may be complex."""
    lat = PLACE[0] + 3e-6 * t + 1e-6 * np.sin(1.1 * t)
    lon = PLACE[1] - 2e-6 * t + 2e-6 * np.sin(0.7 * t + 0.4)
    return lat, lon, PLACE[2] + 2.0 * np.sin(0.5 * t)


def angles(t):
    """Roll, pitch and yaw."""
    return 0.3 * np.sin(2.0 * t), 0.2 * np.sin(1.7 * t + 1.0), 1.0 + 0.8 * t + 0.3 * np.sin(1.3 * t)


def rate_of(function, t):
    """Derivative by a complex step: exact to rounding."""
    return [np.imag(value) * 1e20 for value in function(t + 1e-20j)]


def velocity(t):
    """North, east and down, m/s."""
    lat, _, height = place(t)
    # The derivative of the place has closed form too, because its own derivative is wanted.
    lat_rate = 3e-6 + 1.1e-6 * np.cos(1.1 * t)
    lon_rate = -2e-6 + 1.4e-6 * np.cos(0.7 * t + 0.4)
    meridian, normal = earth.radii(lat)
    return (meridian + height) * lat_rate, (normal + height) * np.cos(lat) * lon_rate, -np.cos(0.5 * t)


def state(t) -> Navigation:
    """The motion at one moment."""
    return Navigation(*map(float, place(t)), np.array(velocity(t)), euler_to_matrix(*angles(t)))


def readings(t):
    """Angular rate against i and specific force, b axes, each (n, 3)."""
    lat, _, height = place(t)
    v = np.stack(velocity(t), axis=-1)
    roll, pitch, _ = angles(t)
    roll_rate, pitch_rate, yaw_rate = rate_of(angles, t)
    R = euler_to_matrix(*angles(t))
    spin, transport = earth.earth_rate(lat), earth.transport_rate(lat, height, v)
    felt = np.stack(rate_of(velocity, t), axis=-1) + np.cross(2.0 * spin + transport, v)
    felt[..., 2] -= earth.gravity(lat, height)
    w_nb = np.stack(
        (
            roll_rate - yaw_rate * np.sin(pitch),
            pitch_rate * np.cos(roll) + yaw_rate * np.sin(roll) * np.cos(pitch),
            yaw_rate * np.cos(roll) * np.cos(pitch) - pitch_rate * np.sin(roll),
        ),
        axis=-1,
    )
    return w_nb + np.einsum("...ji,...j->...i", R, spin + transport), np.einsum("...ji,...j->...i", R, felt)


def integrals(t):
    """Integrals of the readings between successive moments, each (n, 3)."""
    half = 0.5 * np.diff(t)[:, None]
    w, f = readings(0.5 * (t[:-1] + t[1:])[:, None] + half * _NODES)
    return half * np.einsum("k,nki->ni", _WEIGHTS, w), half * np.einsum("k,nki->ni", _WEIGHTS, f)
