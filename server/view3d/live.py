"""What moves in a box's 3D view: gravity, the measured specific force, and north."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import viser

from nav_core.earth import STANDARD_GRAVITY
from nav_core.typing import Floats
from server.view3d.bodywork import BODIES
from server.view3d.scene import AXIS_COLOURS
from server.view3d.view import Triad

GRAVITY, FORCE = (0, 140, 155), (210, 30, 140)
_PER_MPS2 = 0.11
"""Length of an arrow in the drawing, m per m/s²: gravity is a little longer than the box."""
_T_LENGTH = 1.0
_DASHES = 7


@dataclass(frozen=True, slots=True)
class Live:
    """What the box feels and where the vehicle heads."""

    f_v: Triad | None
    """Mean specific force of the newest second, V-frame, m/s²; None without mounting or data."""
    course: float | None
    """Clockwise from true north, rad; of the last fix."""


def dashes(tip: Floats, count: int = _DASHES) -> Floats:
    """A dashed line from the origin, shape (count, 2, 3)."""
    ends = np.arange(2 * count) / (2 * count - 1)
    return (ends[:, None] * tip).reshape(count, 2, 3)


def north_east_down(course: float) -> Floats:
    """Axes of the T-frame in the V-frame of a level vehicle, one a row, shape (3, 3)."""
    c, s = float(np.cos(course)), float(np.sin(course))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


class LiveParts:
    """Draws them below ``/vehicle`` and leaves alone what did not change."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._shown: tuple[Live, str] | None = None
        self._root: viser.FrameHandle | None = None

    @property
    def shown(self) -> Live | None:
        """What is drawn now."""
        return None if self._shown is None else self._shown[0]

    def show(self, live: Live, vehicle_class: str) -> None:
        """Bring arrows and north to this."""
        if (live, vehicle_class) == self._shown:
            return
        with self._server.atomic():
            if self._root is not None:
                self._root.remove()
            self._root = self._server.scene.add_frame("/vehicle/live", show_axes=False)
            self._draw_t_frame(live.course, vehicle_class)
            self._draw_arrows(live, vehicle_class)
        self._server.flush()
        self._shown = (live, vehicle_class)

    def _draw_t_frame(self, course: float | None, vehicle_class: str) -> None:
        body = BODIES.get(vehicle_class, BODIES["car"])
        place = (0.30 * min(body.length, 6.0), body.width / 2 + 1.0, -1.0)
        self._server.scene.add_frame("/vehicle/live/t", show_axes=False, position=place)
        axes = north_east_down(course or 0.0)
        for axis, name in enumerate(("N", "E", "D")):
            if course is None and axis < 2:
                continue  # north is not known: down alone is
            self._line(f"/vehicle/live/t/{name}", _T_LENGTH * axes[axis], AXIS_COLOURS[axis], f"{name} T")

    def _line(self, node: str, tip: Floats, colour: tuple[int, int, int], name: str) -> None:
        scene = self._server.scene
        scene.add_line_segments(node, dashes(tip).astype(np.float32), colour, thickness=0.02)
        scene.add_label(f"{node}_label", name, position=1.08 * tip, anchor="center-center", font_screen_scale=0.9)

    def _draw_arrows(self, live: Live, vehicle_class: str) -> None:
        body = BODIES.get(vehicle_class, BODIES["car"])
        # Beside the box, or the V-frame's own z would hide them.
        place = (body.box[0] - 1.5 * body.box_scale, 0.0, body.box[2])
        self._server.scene.add_frame("/vehicle/live/arrows", show_axes=False, position=place)
        self._arrow("g", np.array([0.0, 0.0, STANDARD_GRAVITY]), GRAVITY)
        if live.f_v is not None:
            self._arrow("f", np.array(live.f_v), FORCE)

    def _arrow(self, name: str, vector: Floats, colour: tuple[int, int, int]) -> None:
        scene = self._server.scene
        tip = _PER_MPS2 * vector
        scene.add_arrows(
            f"/vehicle/live/arrows/{name}",
            np.array([[np.zeros(3), tip]], dtype=np.float32),
            colour,
            shaft_radius=0.022,
            head_radius=0.06,
            head_length=0.16,
        )
        scene.add_label(
            f"/vehicle/live/arrows/{name}_label", name, position=tip + 0.12 * np.sign(tip), anchor="center-center"
        )
