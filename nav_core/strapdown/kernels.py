"""One step of each strapdown mechanisation of 000 §2.5, and the loops over them, compiled.

Every step takes a rotation vector and a velocity change of the body (`nav_core.strapdown.increments`) and advances its
state in place, accurate to second order in the period `T`: rates, Coriolis term and gravity are those of the middle of the step,
predicted from its start.  The rotation of b is exact for its rotation vector, that of the frame for a constant rate.

``hold`` keeps the height: the vertical velocity is put to zero after each step, because height on inertial
sensors alone runs away within minutes.
"""

from __future__ import annotations

import numpy as np

from nav_core import earth
from nav_core.attitude.kernels import chain, matrix_of
from nav_core.typing import Floats, kernel

radii = kernel(earth.radii)
gravity = kernel(earth.gravity)
meridian_of = kernel(earth.meridian_of)

RATE = earth.RATE
ECCENTRICITY2 = earth.ECCENTRICITY2


@kernel
def turn(C: Floats, frame: Floats, body: Floats) -> None:
    """Replace the attitude `C` by ``exp(-[frame]x) C exp([body]x)``; both are rotation vectors, rad."""
    left, right, half = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    matrix_of(-frame, left)
    matrix_of(body, right)
    chain(C, right, half)
    chain(left, half, C)


@kernel
def resolved(C: Floats, velocity: Floats, frame: Floats, out: Floats) -> None:
    """Write into `out` a velocity change of the body in the axes of a frame that turns by `frame`, rad, meanwhile.

    ``(I - [frame]x / 2) C velocity``: in the mean over the step the frame has turned by half.
    """
    x = C[0, 0] * velocity[0] + C[0, 1] * velocity[1] + C[0, 2] * velocity[2]
    y = C[1, 0] * velocity[0] + C[1, 1] * velocity[1] + C[1, 2] * velocity[2]
    z = C[2, 0] * velocity[0] + C[2, 1] * velocity[1] + C[2, 2] * velocity[2]
    out[0] = x - 0.5 * (frame[1] * z - frame[2] * y)
    out[1] = y - 0.5 * (frame[2] * x - frame[0] * z)
    out[2] = z - 0.5 * (frame[0] * y - frame[1] * x)


@kernel
def local_rates(lat: float, height: float, v: Floats, spin: Floats, transport: Floats) -> None:
    """Write Earth rate and transport rate in T axes, rad/s (000 eqs. 2.4.5, 2.5.23)."""
    meridian, normal = radii(lat)
    spin[0], spin[1], spin[2] = RATE * np.cos(lat), 0.0, -RATE * np.sin(lat)
    transport[0] = v[1] / (normal + height)
    transport[1] = -v[0] / (meridian + height)
    transport[2] = -transport[0] * np.tan(lat)


@kernel
def coriolis(spin: Floats, transport: Floats, v: Floats, out: Floats) -> None:
    """Write ``-(2 spin + transport) x v``, m/s², into `out` (000 eq. 2.5.19)."""
    x, y, z = 2.0 * spin[0] + transport[0], 2.0 * spin[1] + transport[1], 2.0 * spin[2] + transport[2]
    out[0] = z * v[1] - y * v[2]
    out[1] = x * v[2] - z * v[0]
    out[2] = y * v[0] - x * v[1]


@kernel
def step_local(place: Floats, v: Floats, C: Floats, rotation: Floats, velocity: Floats, T: float, hold: bool) -> None:
    """Advance in T (000 §2.5.3).

    `place` is latitude, longitude (rad) and height (m); `v` (3,) north, east, down, m/s; `C` (3, 3) turns b into T.
    """
    spin, transport, acceleration = np.empty(3), np.empty(3), np.empty(3)
    gain, middle = np.empty(3), np.empty(3)
    lat, height = place[0], place[2]
    local_rates(lat, height, v, spin, transport)
    coriolis(spin, transport, v, acceleration)
    resolved(C, velocity, T * (spin + transport), gain)
    acceleration[2] += gravity(lat, height)
    for i in range(3):
        middle[i] = v[i] + 0.5 * (gain[i] + T * acceleration[i])
    if hold:
        middle[2] = 0.0
    meridian, normal = radii(lat)
    lat += 0.25 * T * (v[0] + middle[0]) / (meridian + height)
    height -= 0.25 * T * (v[2] + middle[2])

    local_rates(lat, height, middle, spin, transport)
    coriolis(spin, transport, middle, acceleration)
    resolved(C, velocity, T * (spin + transport), gain)
    acceleration[2] += gravity(lat, height)
    for i in range(3):
        middle[i] = 0.5 * v[i]
        v[i] += gain[i] + T * acceleration[i]
    if hold:
        v[2] = 0.0
    for i in range(3):
        middle[i] += 0.5 * v[i]
    meridian, normal = radii(lat)
    place[0] += T * middle[0] / (meridian + height)
    place[1] += T * middle[1] / ((normal + height) * np.cos(lat))
    place[2] -= T * middle[2]
    local_rates(lat, height, middle, spin, transport)
    turn(C, T * (spin + transport), rotation)


@kernel
def step_up(place: Floats, v: Floats, C: Floats, rotation: Floats, velocity: Floats, T: float, hold: bool) -> None:
    """Advance in north, east, up (000 §2.3 c); otherwise as `step_local`.

    The axes are left-handed and `C`, from the right-handed b, has the determinant -1: cross products with
    rates change sign, which is what working in the mirror image does.
    """
    v[2] = -v[2]
    for j in range(3):
        C[2, j] = -C[2, j]
    step_local(place, v, C, rotation, velocity, T, hold)
    v[2] = -v[2]
    for j in range(3):
        C[2, j] = -C[2, j]
