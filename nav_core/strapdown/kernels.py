"""One step of each strapdown mechanisation of 000 §2.5, and the loops over them, compiled.

Every step takes a rotation vector and a velocity change of the body (`nav_core.strapdown.increments`) and advances its
state in place, accurate to second order in the period `T`: rates, Coriolis term and gravity are those of the middle
of the step, predicted from its start.  The rotation of b is exact for its rotation vector, that of the frame for
a constant rate.

``hold`` keeps the height: the vertical velocity is put to zero after each step, because height on inertial
sensors alone runs away within minutes.
"""

from __future__ import annotations

import numpy as np

from nav_core import earth
from nav_core.attitude.kernels import Vector, cross, total, turn
from nav_core.typing import Floats, kernel

gravity_at = kernel(earth.gravity_at)
meridian_of = kernel(earth.meridian_of)

RATE = earth.RATE
ECCENTRICITY2 = earth.ECCENTRICITY2


@kernel
def resolved(C: Floats, velocity: Floats, frame: Vector) -> Vector:
    """A velocity change of the body in the axes of a frame that turns by `frame`, rad, meanwhile.

    ``(I - [frame]x / 2) C velocity``: in the mean over the step the frame has turned by half.

    Parameters
    ----------
    C : ndarray, shape (3, 3)
        From b to the frame, at the start of the step.
    velocity : ndarray, shape (3,)
        b axes, m/s.
    frame : tuple of 3 floats
        Frame axes, rad.

    Returns
    -------
    tuple of 3 floats
        Frame axes, m/s.
    """
    x, y, z = velocity[0], velocity[1], velocity[2]
    change = (
        C[0, 0] * x + C[0, 1] * y + C[0, 2] * z,
        C[1, 0] * x + C[1, 1] * y + C[1, 2] * z,
        C[2, 0] * x + C[2, 1] * y + C[2, 2] * z,
    )
    return total(change, -0.5, cross(frame, change))


@kernel
def curvatures(sin_lat: float, height: float) -> tuple[float, float]:
    """One over the radii of curvature along and across the meridian at a height, 1/m (as `earth.radii`).

    Parameters
    ----------
    sin_lat : float
        Sine of the geodetic latitude.
    height : float
        m.

    Returns
    -------
    along : float
        1/m.
    across : float
        1/m.
    """
    bulge = 1.0 - ECCENTRICITY2 * sin_lat * sin_lat
    normal = earth.SEMI_MAJOR / np.sqrt(bulge)
    return 1.0 / (normal * (1.0 - ECCENTRICITY2) / bulge + height), 1.0 / (normal + height)


@kernel
def transport_of(along: float, across: float, tan_lat: float, v: Vector) -> Vector:
    """Transport rate in T axes, rad/s (000 eq. 2.5.23), at curvatures `along` and `across` the meridian.

    Parameters
    ----------
    along, across : float
        1/m.
    tan_lat : float
        Tangent of the geodetic latitude.
    v : tuple of 3 floats
        T axes, m/s.

    Returns
    -------
    tuple of 3 floats
        T axes, rad/s.
    """
    return v[1] * across, -v[0] * along, -v[1] * across * tan_lat


@kernel
def gained(C: Floats, velocity: Floats, spin: Vector, transport: Vector, v: Vector, down: float, T: float) -> Vector:
    """Change of the velocity `v` over a step in T or w: 000 eqs. 2.5.19 and 2.5.24, integrated.

    `velocity` is that of the body, `down` gravity, m/s²; the rates are those of the middle of the step.

    Parameters
    ----------
    C : ndarray, shape (3, 3)
        From b to the frame, at the start of the step.
    velocity : ndarray, shape (3,)
        Velocity change of the body, b axes, m/s.
    spin, transport : tuple of 3 floats
        Rate of the Earth, and of the frame against it, frame axes, rad/s.
    v : tuple of 3 floats
        Frame axes, m/s.
    down : float
        m/s².
    T : float
        s.

    Returns
    -------
    tuple of 3 floats
        Frame axes, m/s.
    """
    change = resolved(C, velocity, total((T * spin[0], T * spin[1], T * spin[2]), T, transport))
    change = total(change, -T, cross(total(transport, 2.0, spin), v))
    return change[0], change[1], change[2] + T * down


@kernel
def step_local(place: Floats, v: Floats, C: Floats, rotation: Floats, velocity: Floats, T: float, hold: bool) -> None:
    """Advance in T (000 §2.5.3).

    `place` is latitude, longitude (rad) and height (m); `v` (3,) north, east, down, m/s; `C` (3, 3) turns b into T.

    Parameters
    ----------
    place : ndarray, shape (3,)
        Overwritten.
    v : ndarray, shape (3,)
        Overwritten.
    C : ndarray, shape (3, 3)
        Overwritten.
    rotation : ndarray, shape (3,)
        Of the body over the step, b axes, rad.
    velocity : ndarray, shape (3,)
        Its velocity change, b axes, m/s.
    T : float
        s.
    hold : bool
        Whether the height is held.
    """
    now = (v[0], v[1], v[2])
    free = 0.0 if hold else 1.0
    along, across = curvatures(np.sin(place[0]), place[2])
    lat = place[0] + 0.5 * T * now[0] * along
    height = place[2] - 0.5 * T * now[2]
    sin_lat, cos_lat = np.sin(lat), np.cos(lat)
    tan_lat, down = sin_lat / cos_lat, float(gravity_at(sin_lat * sin_lat, height))
    along, across = curvatures(sin_lat, height)
    spin = (RATE * cos_lat, 0.0, -RATE * sin_lat)

    transport = transport_of(along, across, tan_lat, now)
    middle = total(now, 0.5, gained(C, velocity, spin, transport, now, down, T))
    middle = (middle[0], middle[1], free * middle[2])
    transport = transport_of(along, across, tan_lat, middle)
    after = total(now, 1.0, gained(C, velocity, spin, transport, middle, down, T))
    v[0], v[1], v[2] = after[0], after[1], free * after[2]

    middle = (0.5 * (now[0] + v[0]), 0.5 * (now[1] + v[1]), 0.5 * (now[2] + v[2]))
    place[0] += T * middle[0] * along
    place[1] += T * middle[1] * across / cos_lat
    place[2] -= T * middle[2]
    transport = transport_of(along, across, tan_lat, middle)
    turn(C, total((T * spin[0], T * spin[1], T * spin[2]), T, transport), (rotation[0], rotation[1], rotation[2]))


@kernel
def step_up(place: Floats, v: Floats, C: Floats, rotation: Floats, velocity: Floats, T: float, hold: bool) -> None:
    """Advance in north, east, up (000 §2.3 c); otherwise as `step_local`.

    The axes are left-handed and `C`, from the right-handed b, has the determinant -1: cross products with
    rates change sign, which is what working in the mirror image does.

    Parameters
    ----------
    place : ndarray, shape (3,)
        Latitude, longitude, rad, and height, m; overwritten.
    v : ndarray, shape (3,)
        North, east, up, m/s; overwritten.
    C : ndarray, shape (3, 3)
        From b to north, east, up; overwritten.
    rotation : ndarray, shape (3,)
        Of the body over the step, b axes, rad.
    velocity : ndarray, shape (3,)
        Its velocity change, b axes, m/s.
    T : float
        s.
    hold : bool
        Whether the height is held.
    """
    v[2] = -v[2]
    for j in range(3):
        C[2, j] = -C[2, j]
    step_local(place, v, C, rotation, velocity, T, hold)
    v[2] = -v[2]
    for j in range(3):
        C[2, j] = -C[2, j]


@kernel
def run_local(
    place: Floats,
    v: Floats,
    C: Floats,
    rotation: Floats,
    velocity: Floats,
    periods: Floats,
    hold: bool,
    up: bool,
) -> tuple[Floats, Floats, Floats]:
    """Places (n + 1, 3), velocities (n + 1, 3) and attitudes (n + 1, 3, 3) of `step_local` or, with `up`, `step_up`.

    Parameters
    ----------
    place : ndarray, shape (3,)
        Latitude, longitude, rad, and height, m, at the start.
    v : ndarray, shape (3,)
        T axes, m/s.
    C : ndarray, shape (3, 3)
        From b to T.
    rotation : ndarray, shape (n, 3)
        Of the body over each step, b axes, rad.
    velocity : ndarray, shape (n, 3)
        Its velocity changes, b axes, m/s.
    periods : ndarray, shape (n,)
        s.
    hold : bool
        Whether the height is held.
    up : bool
        Whether the third axis of T points up.

    Returns
    -------
    places : ndarray, shape (n + 1, 3)
        rad, rad, m.
    velocities : ndarray, shape (n + 1, 3)
        m/s.
    attitudes : ndarray, shape (n + 1, 3, 3)
        From b to T.
    """
    n = periods.size
    places, speeds, attitudes = np.empty((n + 1, 3)), np.empty((n + 1, 3)), np.empty((n + 1, 3, 3))
    places[0], speeds[0], attitudes[0] = place, v, C
    for k in range(n):
        places[k + 1], speeds[k + 1], attitudes[k + 1] = places[k], speeds[k], attitudes[k]
        if up:
            step_up(places[k + 1], speeds[k + 1], attitudes[k + 1], rotation[k], velocity[k], periods[k], hold)
        else:
            step_local(places[k + 1], speeds[k + 1], attitudes[k + 1], rotation[k], velocity[k], periods[k], hold)
    return places, speeds, attitudes
