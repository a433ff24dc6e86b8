"""Installation by hand (001 §3.2): one axis of the box upright, then a choice among the four orientations that remain.

The way of the boxes before the mounting was estimated: what the product falls back on where nobody drives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.errors import RangeError
from nav_core.rotation import skew
from nav_core.typing import Floats, trailing

TOLERANCE = 0.05
"""Share of gravity by which the upright axis may miss it (001 §3.2)."""


@dataclass(frozen=True, slots=True)
class LevelCheck:
    """Whether a box at rest stands on one of its axes.

    Attributes
    ----------
    axis : int
        The axis nearest to the vertical: 0, 1, 2 for x, y, z of the A-frame.
    sign : int
        +1 where this axis points up, -1 where it points down.
    reading : float
        Magnitude of the specific force along it, in parts of gravity.
    angle : float
        Between this axis and the vertical, rad, from the direction of the whole specific force.
    axis_error, cross_error : float
        What an angle of this size takes from the upright axis and adds to the others, in parts of gravity
        (`tilt_errors`).
    ok : bool
        Whether `reading` is within the tolerance of 1, and so is the whole specific force: the box is at rest.
    """

    axis: int
    sign: int
    reading: float
    angle: float
    axis_error: float
    cross_error: float
    ok: bool


def tilt_errors(angle: Floats | float) -> tuple[Floats, Floats]:
    """Errors of a tilted box, in parts of gravity: on the axis meant to be upright, and on those meant to be level.

    Parameters
    ----------
    angle : ndarray or float, shape (...)
        rad.

    Returns
    -------
    axis_error, cross_error : ndarray
        ``1 - cos(angle)`` and ``sin(angle)`` (001 eqs. 3.1, 3.2); 0.05 and 0.312 at 18.19°.
    """
    angle = np.asarray(angle, dtype=np.float64)
    return 1.0 - np.cos(angle), np.sin(angle)


def largest_tilt(tolerance: float = TOLERANCE) -> float:
    """Largest tilt that a tolerance of the upright axis lets through, rad: 18.19° at 5 % (001 §3.2).

    Parameters
    ----------
    tolerance : float
        Share of gravity that the upright axis may miss, between 0 and 1.

    Returns
    -------
    float
        rad, between 0 and pi/2.

    Raises
    ------
    RangeError
    """
    if not 0.0 < tolerance < 1.0:
        raise RangeError("tolerance", tolerance, "between 0 and 1")
    return float(np.arccos(1.0 - tolerance))


def check_level(f: Floats, *, gravity: float, tolerance: float = TOLERANCE) -> LevelCheck:
    """Say whether a box at rest stands on one of its axes (001 §3.2).

    Parameters
    ----------
    f : ndarray, shape (3,)
        Mean specific force at rest, A-frame, m/s².
    gravity : float
        Local, m/s².
    tolerance : float
        Share of gravity.

    Returns
    -------
    LevelCheck

    Raises
    ------
    ShapeError, RangeError
    """
    f = trailing("f", f, 3)
    largest_tilt(tolerance)
    if not gravity > 0.0:
        raise RangeError("gravity", gravity, "> 0 m/s²")
    size = float(np.linalg.norm(f))
    if not size > 0.0:
        raise RangeError("specific force", size, "> 0 m/s²")
    axis = int(np.argmax(np.abs(f)))
    angle = float(np.arctan2(np.linalg.norm(np.delete(f, axis)), abs(f[axis])))
    axis_error, cross_error = (float(error) for error in tilt_errors(angle))
    reading = float(abs(f[axis])) / gravity
    ok = abs(reading - 1.0) <= tolerance and abs(size / gravity - 1.0) <= tolerance
    # At rest the specific force points up: an axis along it points up.
    return LevelCheck(axis, 1 if f[axis] > 0.0 else -1, reading, angle, axis_error, cross_error, ok)


def orientations(axis: int, sign: int) -> Floats:
    """The four mountings that remain once an axis of the box is upright (001 §3.2, the figures to choose from).

    Parameters
    ----------
    axis : {0, 1, 2}
    sign : {1, -1}
        Of `LevelCheck`: the axis points up or down.

    Returns
    -------
    ndarray, shape (4, 3, 3)
        `R_va`; each the one before, turned clockwise by 90° about the V-frame's z.  In the first the next axis of the
        box (y after x, z after y, x after z) points forward.

    Raises
    ------
    RangeError
    """
    if axis not in (0, 1, 2):
        raise RangeError("axis", float(axis), "0, 1 or 2")
    if sign not in (1, -1):
        raise RangeError("sign", float(sign), "1 or -1")
    down, forward = np.zeros(3), np.zeros(3)
    down[axis], forward[(axis + 1) % 3] = -sign, 1.0
    first = np.stack((forward, np.cross(down, forward), down))
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    # A zero with a minus would make 180° of an angle -180°.
    return np.stack([np.linalg.matrix_power(quarter, k) @ first for k in range(4)]) + 0.0


def levelled(R_va: Floats, f: Floats) -> Floats:
    """An orientation of `orientations`, turned by the smallest rotation that stands the measured vertical upright.

    What the tolerance lets through, up to 18°, is thus measured rather than left in the mounting (001 §3.2 leaves it);
    what remains is how level the vehicle stood.

    Parameters
    ----------
    R_va : ndarray, shape (3, 3)
    f : ndarray, shape (3,)
        Mean specific force at rest, A-frame, m/s².

    Returns
    -------
    ndarray, shape (3, 3)
        A rotation with ``R @ f = (0, 0, -|f|)``.

    Raises
    ------
    ShapeError, RangeError
        Also when `R_va` stands the box upside down against `f`.
    """
    f = trailing("f", f, 3)
    size = float(np.linalg.norm(f))
    if not size > 0.0:
        raise RangeError("specific force", size, "> 0 m/s²")
    up, wanted = R_va @ f / size, np.array([0.0, 0.0, -1.0])
    cosine = float(up @ wanted)
    if not cosine > 0.0:
        raise RangeError("upward share of the specific force", cosine, "> 0")
    # Rodrigues for the rotation from `up` to `wanted`; their cross product is sin(angle) times its axis.
    cross = skew(np.cross(up, wanted))
    return (np.eye(3) + cross + cross @ cross / (1.0 + cosine)) @ R_va
