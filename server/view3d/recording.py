"""A recorded replay of an event: the vehicle along its path, and the force that hit it.

The world is viser's, z up; the path is in the T-frame (north, east, down) around the place at time zero.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Any

import numpy as np
import viser

from nav_core.typing import Floats
from server.database import Database
from server.errors import NotFoundError
from server.events import queries
from server.models import Event
from server.view3d.bodywork import BODIES, Body
from server.view3d.instants import FRAMES_PER_S, instants, known_rows
from server.view3d.pool import close_share
from server.view3d.scene import AXIS_COLOURS, R_WORLD_V, draw_body, light, wxyz

KEPT = 16
"""Recordings in memory; each is some 100 KB."""

_FORCE, _PATH_BEFORE, _PATH_AFTER, _LINE = (217, 58, 58), (29, 91, 201), (189, 39, 39), (104, 116, 130)


class Replays:
    """Recordings by the hash of what they show, made when asked for."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._kept: OrderedDict[str, bytes] = OrderedDict()
        # One at a time: a recording takes a second of a core.
        self._lock = threading.Lock()

    def of(self, device_id: str, event_id: str) -> bytes:
        """The recording of an event of that box."""
        with self._database.reading() as session:
            event = session.get(Event, event_id)
            if event is None or event.device_id != device_id:
                raise NotFoundError(f"There is no event {event_id!r}")
            revision = queries.revision_of(session, event)
        with self._lock:
            if revision.event_sha256 not in self._kept:
                self._kept[revision.event_sha256] = record(queries.document(revision))
                if len(self._kept) > KEPT:
                    self._kept.popitem(last=False)
            self._kept.move_to_end(revision.event_sha256)
            return self._kept[revision.event_sha256]


def record(document: dict[str, Any]) -> bytes:
    """Content of a `.viser` file."""
    server = viser.ViserServer(host="127.0.0.1", port=0, label=None, verbose=False)
    close_share(server)
    try:
        return _Replay(server, document).recorded()
    finally:
        server.stop()


class _Replay:
    """One scene while it is recorded."""

    def __init__(self, server: viser.ViserServer, document: dict[str, Any]) -> None:
        self._server, self._scene = server, server.scene
        self._event = document["event"]
        self._body = BODIES.get(document["inputs"]["vehicle_class"], BODIES["car"])
        self._way = Way(document)

    def recorded(self) -> bytes:
        scene, way = self._scene, self._way
        light(scene)
        scene.add_grid(
            "/ground", 60.0, 60.0, cell_size=1.0, section_size=5.0, cell_color=_LINE, section_color=_LINE,
            cell_thickness=0.4, section_thickness=0.8, fade_distance=60.0, fade_strength=2.0, fade_from="origin",
        )  # fmt: skip
        _frame(scene, "/t", np.zeros(3), ("north", "east", "down"), 2.0, 0.012)
        self._draw_path()
        vehicle = scene.add_frame("/vehicle", show_axes=False)
        draw_body(scene, "/vehicle/body", self._body)
        _frame(scene, "/vehicle/v", np.array(self._body.box), ("x", "y", "z"), 1.6, 0.03)
        force = self._draw_force()
        self._draw_seconds()
        self._aim()
        recording = self._server.get_scene_serializer()
        waits = np.append(np.diff(way.t), 1.0 / FRAMES_PER_S)
        # A hair early: who asks for the instant of a frame gets that frame.
        waits[0] -= 1e-4
        for k, t in enumerate(way.t.tolist()):
            with self._server.atomic():
                position, turn = way.at(k)
                vehicle.position, vehicle.wxyz = position, wxyz(turn)
                if force is not None and force.visible != (t >= 0.0):
                    force.visible = t >= 0.0
            recording.insert_sleep(float(waits[k]))
        return recording.serialize()

    def _aim(self) -> None:
        camera = self._server.initial_camera
        camera.fov = float(np.radians(42.0))
        camera.look_at = np.array([0.0, 0.0, 0.4])
        # Behind and beside the vehicle as it arrives, so that what hit it from ahead is seen.
        heading = self._way.turn_at_zero
        camera.position = R_WORLD_V @ heading @ np.array([-9.0, 9.5, -7.5])

    def _draw_path(self) -> None:
        way = self._way
        raised = way.positions + np.array([0.0, 0.0, 0.02])
        for name, rows, colour in (("before", way.t <= 0.0, _PATH_BEFORE), ("after", way.t >= 0.0, _PATH_AFTER)):
            points = raised[rows]
            if len(points) > 1:
                segments = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
                self._scene.add_line_segments(f"/path/{name}", segments, colour, thickness=0.06)

    def _draw_seconds(self) -> None:
        """Milestones beside the path: time and speed, every second until the vehicle rests."""
        way = self._way
        side = R_WORLD_V @ way.turn_at_zero @ np.array([0.0, 1.6, 0.0])
        last: Floats | None = None
        for k in np.flatnonzero(way.t == np.round(way.t)).tolist():
            place = way.positions[k]
            if last is not None and np.linalg.norm(place - last) < 1.0:
                continue
            last = place
            speed = "" if not np.isfinite(way.speed[k]) else f" · {way.speed[k]:.0f} km/h"
            words = f"{way.t[k]:+.0f} s{speed}".replace("-", "\N{MINUS SIGN}").replace("+0", "0")
            self._scene.add_icosphere(f"/seconds/{k}", 0.12, _LINE, position=place)
            self._scene.add_label(f"/seconds/{k}_label", words, position=place + side, anchor="center-left")

    def _draw_force(self) -> viser.FrameHandle | None:
        """The arrow where the force came from, and its 95 % sector on the ground; children of the vehicle."""
        pdof, interval = self._event["pdof_deg"], self._event["pdof_interval95_deg"]
        if pdof is None:
            return None
        scene, body = self._scene, self._body
        root = scene.add_frame("/vehicle/force", show_axes=False, visible=False)
        height = -0.55 * body.height
        reach = _edge(body, np.radians(pdof))
        towards = np.array([np.cos(np.radians(pdof)), np.sin(np.radians(pdof)), 0.0])
        points = np.array([[(reach + 2.4) * towards, (reach + 0.1) * towards]]) + np.array([0.0, 0.0, height])
        scene.add_arrows(
            "/vehicle/force/arrow", points.astype(np.float32), _FORCE,
            shaft_radius=0.09, head_radius=0.26, head_length=0.55,
        )  # fmt: skip
        angles = np.radians(np.linspace(interval[0], interval[1], 25))
        rim = (reach + 2.4) * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(25)]) + np.array(
            [0.0, 0.0, -0.03]
        )
        vertices = np.concatenate([[[0.0, 0.0, -0.03]], rim]).astype(np.float32)
        faces = np.array([[0, k, k + 1] for k in range(1, 25)], dtype=np.int64)
        scene.add_mesh_simple("/vehicle/force/sector", vertices, faces, color=_FORCE, opacity=0.3, side="double")
        dv = self._event["delta_v_kmh"]["resultant"]
        if dv is not None:
            place = (reach + 2.6) * towards + np.array([0.0, 0.0, height])
            scene.add_label("/vehicle/force/label", f"delta-V {dv:.0f} km/h", position=place, anchor="bottom-center")
        return root


def _edge(body: Body, angle: float) -> float:
    """How far the vehicle's outline is from its middle in a direction, m."""
    cosine, sine = abs(np.cos(angle)), abs(np.sin(angle))
    return float(min(0.5 * body.length / max(cosine, 1e-9), 0.5 * body.width / max(sine, 1e-9)))


def _frame(
    scene: viser.SceneApi, root: str, origin: Floats, names: tuple[str, str, str], length: float, radius: float
) -> None:
    """Three arrows with names.  The T-frame is turned into viser's world here, the V-frame by its parent."""
    turn = R_WORLD_V if root == "/t" else np.eye(3)
    scene.add_frame(root, show_axes=False, position=origin, wxyz=wxyz(turn))
    for axis, name in enumerate(names):
        if name == "down":
            continue  # into the ground
        tip = length * np.eye(3)[axis]
        scene.add_arrows(
            f"{root}/{name}", np.array([[np.zeros(3), tip]], dtype=np.float32), AXIS_COLOURS[axis],
            shaft_radius=radius, head_radius=2.6 * radius, head_length=0.16,
        )  # fmt: skip
        scene.add_label(f"{root}/{name}_label", name, position=1.06 * tip, anchor="center-left", font_screen_scale=0.9)


class Way:
    """Positions and headings at the frames' times; at rest in the middle where no path is known."""

    def __init__(self, document: dict[str, Any]) -> None:
        self.t = instants(document)
        way, known = document["curves"]["trajectory"], known_rows(document)
        if not known:
            self.positions = np.zeros((self.t.size, 3))
            self._heading, self.speed = np.zeros(self.t.size), np.full(self.t.size, np.nan)
            return
        t = np.array(way["t_s"], dtype=np.float64)[known]

        def column(name: str) -> Floats:
            return np.array([np.nan if way[name][k] is None else way[name][k] for k in known], dtype=np.float64)

        north, east = np.interp(self.t, t, column("north_m")), np.interp(self.t, t, column("east_m"))
        self.positions = np.column_stack([north, -east, np.zeros(self.t.size)])
        self._heading = np.interp(self.t, t, _whole(np.radians(column("heading_deg"))))
        self.speed = np.interp(self.t, t, column("speed_kmh"))

    def at(self, k: int) -> tuple[Floats, Floats]:
        """Position and rotation in viser's world."""
        return self.positions[k], R_WORLD_V @ _yaw(float(self._heading[k]))

    @property
    def turn_at_zero(self) -> Floats:
        """From V to T at time zero."""
        return _yaw(float(self._heading[int(np.argmin(np.abs(self.t)))]))


def _yaw(heading: float) -> Floats:
    cosine, sine = np.cos(heading), np.sin(heading)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _whole(heading: Floats) -> Floats:
    """Unwrapped, the last known value where it is not known."""
    known = np.flatnonzero(np.isfinite(heading))
    if known.size == 0:
        return np.zeros(heading.size)
    filled = heading[known[np.clip(np.searchsorted(known, np.arange(heading.size), side="right") - 1, 0, None)]]
    return np.unwrap(filled)
