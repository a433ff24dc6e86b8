"""Simple vehicle bodies, made by code: lofts through a few cross-sections, and wheels.

Everything is in the V-frame with its origin on the ground under the middle of the vehicle:
x forward, y right, z down, so what stands above the ground has negative z.  Metres.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from nav_core.typing import Floats, Integers


@dataclass(frozen=True, slots=True)
class Section:
    """A cross-section at `x`: from `low` to `high` above the ground, so wide (half) below and above."""

    x: float
    low: float
    high: float
    half_low: float
    half_high: float


@dataclass(frozen=True, slots=True)
class Loft:
    """A closed shell through sections, front to back; glass is drawn lighter than metal."""

    sections: tuple[Section, ...]
    glass: bool = False


@dataclass(frozen=True, slots=True)
class Wheel:
    """A wheel: the middle of its hub and its size."""

    x: float
    y: float
    radius: float
    width: float


@dataclass(frozen=True, slots=True)
class Body:
    """A vehicle as drawn, and where its box sits in the drawing."""

    lofts: tuple[Loft, ...]
    wheels: tuple[Wheel, ...]
    box: tuple[float, float, float]
    box_scale: float
    length: float
    width: float
    height: float


def _axles(xs: tuple[float, ...], track: float, radius: float, width: float) -> tuple[Wheel, ...]:
    return tuple(Wheel(x, side * track / 2, radius, width) for x in xs for side in (-1.0, 1.0))


_CAR = Body(
    lofts=(
        Loft(
            (
                Section(2.20, 0.36, 0.56, 0.64, 0.58),
                Section(2.08, 0.26, 0.66, 0.78, 0.72),
                Section(1.55, 0.20, 0.79, 0.88, 0.80),
                Section(0.85, 0.18, 0.90, 0.90, 0.84),
                Section(-1.30, 0.18, 0.96, 0.90, 0.84),
                Section(-1.85, 0.24, 0.97, 0.88, 0.80),
                Section(-2.12, 0.30, 0.92, 0.80, 0.74),
                Section(-2.20, 0.40, 0.80, 0.72, 0.68),
            )
        ),
        Loft(
            (
                Section(0.92, 0.89, 0.91, 0.78, 0.76),
                Section(0.14, 0.91, 1.38, 0.83, 0.62),
                Section(-0.35, 0.93, 1.45, 0.83, 0.63),
                Section(-1.05, 0.95, 1.42, 0.83, 0.61),
                Section(-1.88, 0.96, 0.98, 0.76, 0.72),
            ),
            glass=True,
        ),
    ),
    wheels=_axles((1.36, -1.32), 1.56, 0.32, 0.21),
    box=(0.15, 0.0, -0.98),
    box_scale=1.0,
    length=4.4,
    width=1.8,
    height=1.45,
)

_VAN = Body(
    lofts=(
        Loft(
            (
                Section(2.75, 0.40, 0.75, 0.74, 0.68),
                Section(2.60, 0.30, 0.98, 0.90, 0.82),
                Section(1.95, 0.25, 1.25, 0.97, 0.90),
                Section(1.10, 0.25, 1.35, 1.00, 0.96),
                Section(-2.60, 0.25, 1.35, 1.00, 0.96),
                Section(-2.75, 0.35, 1.30, 0.98, 0.94),
            )
        ),
        Loft(
            (
                Section(1.98, 1.24, 1.27, 0.90, 0.86),
                Section(1.10, 1.34, 2.20, 0.96, 0.82),
                Section(0.60, 1.35, 2.32, 0.96, 0.84),
                Section(-2.60, 1.35, 2.32, 0.96, 0.84),
                Section(-2.72, 1.33, 2.20, 0.94, 0.82),
            ),
            glass=True,
        ),
    ),
    wheels=_axles((1.75, -1.70), 1.72, 0.35, 0.24),
    box=(0.9, 0.0, -1.45),
    box_scale=1.15,
    length=5.5,
    width=2.0,
    height=2.3,
)

_TRUCK = Body(
    lofts=(
        Loft(
            (
                Section(4.00, 0.45, 1.40, 1.12, 1.12),
                Section(3.90, 0.40, 2.75, 1.22, 1.14),
                Section(3.40, 0.40, 2.95, 1.24, 1.16),
                Section(2.00, 0.50, 2.95, 1.24, 1.16),
            )
        ),
        Loft((Section(1.75, 1.10, 3.50, 1.25, 1.25), Section(-4.00, 1.10, 3.50, 1.25, 1.25)), glass=True),
        Loft((Section(2.00, 0.70, 1.05, 0.50, 0.50), Section(-3.90, 0.70, 1.05, 0.50, 0.50))),
    ),
    wheels=_axles((2.75, -2.30), 2.05, 0.50, 0.36),
    box=(2.7, 0.0, -1.90),
    box_scale=1.5,
    length=8.0,
    width=2.5,
    height=3.5,
)

_BUS = Body(
    lofts=(
        Loft(
            (
                Section(5.00, 0.35, 1.25, 1.16, 1.16),
                Section(4.85, 0.30, 1.30, 1.25, 1.25),
                Section(-4.90, 0.30, 1.30, 1.25, 1.25),
                Section(-5.00, 0.40, 1.28, 1.22, 1.22),
            )
        ),
        Loft(
            (
                Section(4.98, 1.26, 2.60, 1.16, 1.05),
                Section(4.75, 1.30, 2.98, 1.25, 1.14),
                Section(-4.85, 1.30, 2.98, 1.25, 1.14),
                Section(-5.00, 1.28, 2.80, 1.22, 1.10),
            ),
            glass=True,
        ),
    ),
    wheels=_axles((2.60, -3.00), 2.10, 0.48, 0.32),
    box=(3.6, 0.0, -1.60),
    box_scale=1.5,
    length=10.0,
    width=2.5,
    height=3.0,
)

_MOTORCYCLE = Body(
    lofts=(
        Loft(
            (
                Section(0.62, 0.62, 0.86, 0.06, 0.05),
                Section(0.40, 0.40, 1.02, 0.16, 0.12),
                Section(0.00, 0.30, 0.96, 0.19, 0.15),
                Section(-0.35, 0.40, 0.80, 0.17, 0.15),
                Section(-0.95, 0.72, 0.86, 0.10, 0.10),
            )
        ),
        Loft((Section(0.72, 0.90, 1.12, 0.10, 0.05), Section(0.48, 0.98, 1.28, 0.20, 0.10)), glass=True),
    ),
    wheels=(Wheel(0.72, 0.0, 0.31, 0.12), Wheel(-0.70, 0.0, 0.31, 0.16)),
    box=(-0.25, 0.0, -1.05),
    box_scale=0.6,
    length=2.1,
    width=0.8,
    height=1.25,
)

BODIES = {"car": _CAR, "van": _VAN, "truck": _TRUCK, "bus": _BUS, "motorcycle": _MOTORCYCLE}


def ring(section: Section) -> Floats:
    """The outline of a section with bevelled corners, shape (12, 3), once around seen from the front."""
    height = section.high - section.low
    bevel = min(0.10, 0.3 * height)
    inset = min(0.10, 0.3 * section.half_high)
    low, high, wide, narrow = section.low, section.high, section.half_low, section.half_high
    waist = low + 0.45 * height
    right = [
        (wide - inset, low),
        (wide - 0.3 * inset, low + bevel),
        (wide, waist),
        (narrow + 0.25 * (wide - narrow), high - bevel),
        (narrow, high - 0.5 * bevel),
        (narrow - inset, high),
    ]
    left = [(-y, up) for y, up in reversed(right)]
    return np.array([(section.x, y, -up) for y, up in right + left])


def shell(loft: Loft) -> tuple[Floats, Integers]:
    """Vertices and triangles of the closed loft, outward normals."""
    rings = [ring(section) for section in loft.sections]
    size = rings[0].shape[0]
    vertices = np.concatenate([*rings, rings[0].mean(axis=0, keepdims=True), rings[-1].mean(axis=0, keepdims=True)])
    nose, tail = len(rings) * size, len(rings) * size + 1
    here = np.arange(size)
    following = np.roll(here, -1)
    faces = [
        np.stack([np.full(size, nose), following, here], axis=1),
        np.stack([np.full(size, tail), (len(rings) - 1) * size + here, (len(rings) - 1) * size + following], axis=1),
    ]
    for index in range(len(rings) - 1):
        a, b = index * size, (index + 1) * size
        faces.append(np.stack([a + here, a + following, b + here], axis=1))
        faces.append(np.stack([a + following, b + following, b + here], axis=1))
    return vertices, np.concatenate(faces).astype(np.int64)


def creases(loft: Loft) -> Floats:
    """The lines that give the shell its form: each section, and the edges along it; shape (n, 2, 3)."""
    rings = [ring(section) for section in loft.sections]
    around = [
        np.stack([outline, np.roll(outline, -1, axis=0)], axis=1)
        for index, outline in enumerate(rings)
        if index in (0, len(rings) - 1)
    ]
    lengthwise = [
        np.stack([front[[2, 4, 7, 9]], back[[2, 4, 7, 9]]], axis=1) for front, back in itertools.pairwise(rings)
    ]
    return np.concatenate([*around, *lengthwise])
