"""The viser scene of one box in its vehicle.

viser's world has z up, the V-frame has z down.  The one place where they meet is the node
``/vehicle``: everything below it is given in the V-frame.
"""

from __future__ import annotations

import html

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from nav_core.rotation import xyzw_to_wxyz
from nav_core.typing import Floats
from server.view3d.bodywork import BODIES, Body, creases, shell
from server.view3d.uncertainty import cone
from server.view3d.view import MountingView

# V-frame to viser's world: half a turn about x, so forward stays forward and down becomes -z.
R_WORLD_V = np.diag([1.0, -1.0, -1.0])

AXIS_COLOURS = ((205, 24, 30), (10, 140, 60), (20, 80, 210))
_STATE_COLOURS = {"good": "#1e9e54", "attention": "#c77700", "alarm": "#d63031", "unknown": "#7a828c"}
_METAL, _GLASS, _RUBBER, _LINE = (96, 112, 130), (120, 140, 160), (62, 68, 76), (104, 116, 130)
_BOX, _REFERENCE, _GHOST, _GHOST_EDGE = (240, 140, 10), (150, 40, 200), (140, 146, 154), (84, 92, 102)

_NARROW_PX = 720

# The box is drawn larger than it is, or it would be a dot in the car.
_BOX_SIZE = (0.60, 0.40, 0.20)
_AXIS_TO_BOX, _V_MARGIN = 1.75, 0.65


def wxyz(matrix: Floats) -> Floats:
    """Quaternion of a rotation matrix as viser wants it, shape (4,)."""
    return xyzw_to_wxyz(Rotation.from_matrix(matrix).as_quat())


class MountingScene:
    """Draws `MountingView`s on one viser server; shows the latest.

    `bare` leaves the words to the page around it, in its language, and names the axes by their frame's letter.
    """

    def __init__(self, server: viser.ViserServer, *, bare: bool = False) -> None:
        self._server = server
        self._bare = bare
        self._vehicle_class = ""
        self._body: viser.FrameHandle | None = None
        self._mounting: viser.FrameHandle | None = None
        self._shown: MountingView | None = None
        server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        light(server.scene)
        self._panel = server.gui.add_html("")
        server.scene.add_grid(
            "/ground", 16.0, 16.0, cell_size=1.0, section_size=4.0, cell_color=_LINE, section_color=_LINE,
            cell_thickness=0.5, section_thickness=0.8, fade_distance=18.0, fade_strength=2.0, fade_from="origin",
        )  # fmt: skip
        server.scene.add_frame("/vehicle", show_axes=False, wxyz=wxyz(R_WORLD_V))

    def show(self, view: MountingView) -> None:
        """Bring the scene to this view; what did not change is left alone."""
        if view == self._shown:
            return
        with self._server.atomic():
            if view.vehicle_class != self._vehicle_class:
                self._vehicle_class = view.vehicle_class
                self._draw_vehicle(BODIES.get(view.vehicle_class, BODIES["car"]))
            self._draw_box(view)
            self._server.gui.set_panel_label(view.title if self._bare else headline(view))
            if not self._bare:
                self._panel.content = panel_html(view)
        self._server.flush()
        self._shown = view

    def _draw_vehicle(self, body: Body) -> None:
        scene = self._server.scene
        if self._body is not None:
            self._body.remove()
        self._body = draw_body(scene, "/vehicle/body", body)
        self._draw_v_frame(body)
        camera = self._server.initial_camera
        # The box is the subject: of a long vehicle the tail may leave the picture.
        reach = 1.8 + 0.58 * min(body.length, 6.5)
        target = np.array([0.55 + 0.75 * body.box[0], 0.0, 0.5 * body.height])
        camera.fov = float(np.radians(40.0))
        camera.look_at = target
        camera.position = target + reach * np.array([0.9, -0.95, 0.6])

    def _draw_v_frame(self, body: Body) -> None:
        scene = self._server.scene
        origin = np.array(body.box)
        lengths = (
            body.length / 2 + _V_MARGIN - origin[0],
            body.width / 2 + _V_MARGIN - origin[1],
            -origin[2],
        )
        scene.add_frame("/vehicle/body/v", show_axes=False, position=origin)
        names = ("x V", "y V", "z V") if self._bare else ("x forward", "y right", "z down")
        for axis, (name, length) in enumerate(zip(names, lengths, strict=True)):
            tip = length * np.eye(3)[axis]
            scene.add_arrows(
                f"/vehicle/body/v/{name[0]}",
                np.array([[np.zeros(3), tip]], dtype=np.float32),
                AXIS_COLOURS[axis],
                shaft_radius=0.026,
                head_radius=0.075,
                head_length=0.2,
            )
            scene.add_label(
                f"/vehicle/body/v/{name[0]}_label", name, position=tip * 1.04, anchor="center-left",
                font_screen_scale=1.1,
            )  # fmt: skip

    def _draw_box(self, view: MountingView) -> None:
        scene = self._server.scene
        body = BODIES.get(view.vehicle_class, BODIES["car"])
        # Adding a node of the same name would keep the old one's children; removing it takes them along.
        if self._mounting is not None:
            self._mounting.remove()
        self._mounting = scene.add_frame("/vehicle/mounting", show_axes=False, position=body.box)
        size = body.box_scale * np.array(_BOX_SIZE)
        if view.R_va is None:
            self._draw_ghost(view, size)
        else:
            self._draw_estimate(np.array(view.R_va), view, size)
        if view.reference is not None:
            R_va = np.array(view.reference)
            scene.add_frame("/vehicle/mounting/reference", show_axes=False, wxyz=wxyz(R_va))
            edges = box_edges(1.12 * size)
            scene.add_line_segments(
                "/vehicle/mounting/reference/outline", edges.astype(np.float32), _REFERENCE, thickness=0.012
            )
            scene.add_label(
                "/vehicle/mounting/reference/label",
                "ref" if self._bare else "reference",
                position=edges[0, 0],
                anchor="center-right",
            )
        if view.before is not None:
            draw_before(scene, "/vehicle/mounting/before", np.array(view.before), size)

    @property
    def shown(self) -> MountingView | None:
        """What is drawn now."""
        return self._shown

    def _draw_estimate(self, R_va: Floats, view: MountingView, size: Floats) -> None:
        scene = self._server.scene
        length = _AXIS_TO_BOX * float(size.max())
        scene.add_frame("/vehicle/mounting/box", show_axes=False, wxyz=wxyz(R_va))
        scene.add_box("/vehicle/mounting/box/case", _BOX, size)
        scene.add_line_segments(
            "/vehicle/mounting/box/edges", box_edges(size).astype(np.float32), (120, 72, 8), thickness=0.008
        )
        for axis, name in enumerate("xyz"):
            tip = length * np.eye(3)[axis]
            scene.add_arrows(
                f"/vehicle/mounting/box/{name}",
                np.array([[np.zeros(3), tip]], dtype=np.float32),
                AXIS_COLOURS[axis],
                shaft_radius=0.012,
                head_radius=0.035,
                head_length=0.09,
            )
            scene.add_label(
                f"/vehicle/mounting/box/{name}_label", f"{name} A" if self._bare else f"box {name}",
                position=1.08 * tip, anchor="center-center",
                font_screen_scale=0.9,
            )  # fmt: skip
            if view.sigma is not None:
                # The sigmas are about the V axes, so the cones are children of the V-frame, not of the box.
                vertices, faces = cone(R_va[:, axis], np.array(view.sigma), 1.35 * length)
                scene.add_mesh_simple(
                    f"/vehicle/mounting/cone_{name}",
                    vertices.astype(np.float32),
                    faces,
                    color=AXIS_COLOURS[axis],
                    opacity=0.35,
                    side="double",
                )

    def _draw_ghost(self, view: MountingView, size: Floats) -> None:
        scene = self._server.scene
        # A ball: every orientation of the box fits into it and none is suggested.
        radius = 0.5 * float(np.linalg.norm(size))
        scene.add_icosphere("/vehicle/mounting/ghost", radius, _GHOST, subdivisions=3, opacity=0.35)
        scene.add_icosphere("/vehicle/mounting/ghost_lines", radius, _GHOST, subdivisions=2, wireframe=True)
        scene.add_label(
            "/vehicle/mounting/ghost_label",
            "?" if self._bare else f"{view.headline}: orientation unknown",
            position=(0.0, 0.0, -1.5 * radius),
            anchor="bottom-center",
        )


def light(scene: viser.SceneApi) -> None:
    """A bright sky over a dim ground and a sun behind the onlooker's shoulder, none of which casts a shadow.

    viser's own lamps surround the scene with a photograph: prettier by little, and the half of the time that
    software rendering needs for the first picture.
    """
    scene.configure_default_lights(enabled=False)
    scene.configure_environment_map(None)
    scene.add_light_hemisphere("/light/sky", sky_color=(255, 255, 255), ground_color=(170, 176, 190), intensity=2.6)
    scene.add_light_directional("/light/sun", intensity=1.4, position=(4.0, 6.0, 9.0))


def draw_body(scene: viser.SceneApi, root: str, body: Body) -> viser.FrameHandle:
    """A vehicle's shells and wheels below a new node, in the V-frame."""
    frame = scene.add_frame(root, show_axes=False)
    for index, loft in enumerate(body.lofts):
        vertices, faces = shell(loft)
        scene.add_mesh_simple(
            f"{root}/shell{index}",
            vertices.astype(np.float32),
            faces,
            color=_GLASS if loft.glass else _METAL,
            opacity=0.05 if loft.glass else 0.16,
            flat_shading=True,
            side="double",
        )
        scene.add_line_segments(f"{root}/lines{index}", creases(loft).astype(np.float32), _LINE, thickness=0.008)
    # A cylinder stands along z; half a quarter turn about x lays its axis across the vehicle.
    across = wxyz(Rotation.from_euler("x", 90, degrees=True).as_matrix())
    for index, wheel in enumerate(body.wheels):
        place = (wheel.x, wheel.y, -wheel.radius)
        name = f"{root}/wheel{index}"
        scene.add_cylinder(name, wheel.radius, wheel.width, _RUBBER, wxyz=across, position=place)
        scene.add_cylinder(f"{name}hub", 0.55 * wheel.radius, wheel.width + 0.02, _GLASS, wxyz=across, position=place)
    return frame


def draw_before(scene: viser.SceneApi, root: str, R_va: Floats, size: Floats) -> None:
    """A box as it sat before it was moved: a pale shape with its axes as thin lines."""
    scene.add_frame(root, show_axes=False, wxyz=wxyz(R_va))
    scene.add_box(f"{root}/case", _GHOST, size, opacity=0.45)
    scene.add_line_segments(f"{root}/edges", box_edges(size).astype(np.float32), _GHOST_EDGE, thickness=0.02)
    axes = np.stack([np.zeros((3, 3)), _AXIS_TO_BOX * float(size.max()) * np.eye(3)], axis=1)
    colours = np.repeat(np.array(AXIS_COLOURS, dtype=np.uint8)[:, None], 2, axis=1)
    scene.add_line_segments(f"{root}/axes", axes.astype(np.float32), colours, thickness=0.008)


def box_edges(size: Floats) -> Floats:
    """The twelve edges of a box in its own frame, shape (12, 2, 3)."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    pairs = [(a, b) for a in range(8) for b in range(a) if np.count_nonzero(corners[a] != corners[b]) == 1]
    return 0.5 * size * corners[np.array(pairs)]


def headline(view: MountingView) -> str:
    """The one line that stays in the smallest frame."""
    if view.state == "good" and view.sigma is not None:
        return f"{view.headline} · ±{np.degrees(max(view.sigma)):.1f}°"
    return view.headline if view.state == "alarm" else f"{view.headline} · {view.percent} %"


def panel_html(view: MountingView) -> str:
    """The words below the headline; names come from users and are escaped."""
    dot = f'<span style="color:{_STATE_COLOURS[view.state]}">●</span>'
    lines = [f"<div><b>{dot} {html.escape(view.title)}</b></div>"]
    if view.sigma is None:
        lines.append("<div>Orientation not known yet</div>")
    else:
        values = (f"{name} ±{np.degrees(sigma):.1f}°" for name, sigma in zip("xyz", view.sigma, strict=True))
        lines.append(f'<div style="font-variant-numeric:tabular-nums">{" · ".join(values)}</div>')
    lines.extend(f"<div>{html.escape(reason)}</div>" for reason in view.reasons)
    legend = "Thick axes: vehicle. Thin axes: box, with its 95&nbsp;% cone. The box is drawn larger than it is."
    if view.reference is not None:
        legend += ' <span style="color:#9628c8">▢</span> Violet outline: reference mounting.'
    lines.append(f'<div style="font-size:11px;opacity:.7;margin-top:6px">{legend}</div>')
    # A small frame is a picture in a page that says all this beside it.
    fold = f"<style>@media (max-width:{_NARROW_PX}px){{.mounting-words{{display:none}}}}</style>"
    return (
        f'{fold}<div class="mounting-words" style="padding:6px 12px 10px;line-height:1.45;font-size:13px">'
        f"{''.join(lines)}</div>"
    )
