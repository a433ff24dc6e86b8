"""A vehicle and its box drawn in parallel projection: where a picture must do without WebGL, on a phone or on paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nav_core.typing import Floats
from server.view3d.bodywork import BODIES, creases

Points = tuple[tuple[float, float], ...]
_AZIMUTH, _ELEVATION = np.radians(38.0), np.radians(24.0)
_BOX = np.array([0.60, 0.40, 0.20])
_MAGNIFIED = 2.1
"""The box is the subject: drawn to scale it would be a dot in the car."""


@dataclass(frozen=True, slots=True)
class Stroke:
    """A line or a face; `kind` gives it its colour: car, wheel, face0 to face2 (lit to shaded), x, y, z."""

    kind: str
    points: Points
    closed: bool = False


@dataclass(frozen=True, slots=True)
class Drawing:
    """Strokes from back to front, in units of about a metre, x to the right and y down; letters at the axes' ends."""

    strokes: tuple[Stroke, ...]
    letters: tuple[tuple[str, float, float], ...]
    left: float
    top: float
    width: float
    height: float

    @property
    def view_box(self) -> str:
        """For an SVG."""
        return f"{self.left:.2f} {self.top:.2f} {self.width:.2f} {self.height:.2f}"


def projection() -> Floats:
    """V-frame to picture, shape (3, 3): right, down, and towards the eye, which is ahead on the right, above."""
    eye = np.array([np.cos(_ELEVATION) * np.cos(_AZIMUTH), np.cos(_ELEVATION) * np.sin(_AZIMUTH), -np.sin(_ELEVATION)])
    down = np.array([0.0, 0.0, 1.0]) - (np.array([0.0, 0.0, 1.0]) @ eye) * eye
    down /= np.linalg.norm(down)
    # Right, down and away from the eye are right-handed; `eye` points the other way.
    return np.stack((np.cross(eye, down), down, eye))


def drawing(vehicle_class: str, R_va: Sequence[Sequence[float]] | Floats) -> Drawing:
    """The vehicle's edges, the box in it and the box's axes."""
    body = BODIES.get(vehicle_class, BODIES["car"])
    P, R = projection(), np.asarray(R_va, dtype=np.float64)
    centre = np.array(body.box)
    strokes = [Stroke("car", _flat(P, line)) for loft in body.lofts for line in creases(loft)]
    turn = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    for wheel in body.wheels:
        rim = np.stack(
            [wheel.x + wheel.radius * np.cos(turn), np.full(24, wheel.y), -wheel.radius * (1 + np.sin(turn))]
        )
        strokes.append(Stroke("wheel", _flat(P, rim.T), closed=True))
    size = _MAGNIFIED * body.box_scale * _BOX
    axes, letters = _axes(P, R, centre, 1.55 * float(size.max()))
    behind, before = [s for s, towards in axes if not towards], [s for s, towards in axes if towards]
    strokes += [*behind, *_faces(P, R, centre, size), *before]
    every = np.array([point for stroke in strokes for point in stroke.points] + [(x, y) for _, x, y in letters])
    low, high = every.min(axis=0) - 0.25, every.max(axis=0) + 0.25
    width, height = high - low
    return Drawing(tuple(strokes), tuple(letters), float(low[0]), float(low[1]), float(width), float(height))


def _flat(P: Floats, points: Floats) -> Points:
    return tuple((round(float(x), 3), round(float(y), 3)) for x, y in points @ P[:2].T)


def _axes(
    P: Floats, R: Floats, centre: Floats, length: float
) -> tuple[list[tuple[Stroke, bool]], list[tuple[str, float, float]]]:
    lines: list[tuple[Stroke, bool]] = []
    letters: list[tuple[str, float, float]] = []
    for axis, name in enumerate("xyz"):
        tip = centre + length * R[:, axis]
        lines.append((Stroke(name, _flat(P, np.stack([centre, tip]))), bool(P[2] @ R[:, axis] > 0.0)))
        ((x, y),) = _flat(P, (centre + 1.16 * length * R[:, axis])[None])
        letters.append((name, x, y))
    return lines, letters


def _faces(P: Floats, R: Floats, centre: Floats, size: Floats) -> list[Stroke]:
    """The three faces that the eye sees, the one that looks up most lit most."""
    found: list[tuple[float, Points]] = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal = sign * R[:, axis]
            if P[2] @ normal <= 1e-9:
                continue
            u, v = (axis + 1) % 3, (axis + 2) % 3
            corners = np.zeros((4, 3))
            corners[:, axis] = sign
            corners[:, u], corners[:, v] = (-1, 1, 1, -1), (-1, -1, 1, 1)
            lit = float(-normal[2] + 0.4 * normal[0])
            found.append((lit, _flat(P, centre + (0.5 * size * corners) @ R.T)))
    found.sort(key=lambda face: -face[0])
    return [Stroke(f"face{k}", points, closed=True) for k, (_, points) in enumerate(found)]
