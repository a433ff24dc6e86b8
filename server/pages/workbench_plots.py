"""What the page of an analysis draws and lists, out of the analysis' document."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from server.analyses.kinds import Kind
from server.pages.plots import Drawn, Line, Plot, draw, sphere
from server.wording import marked

Document = Mapping[str, Any]

TRIADS = {
    marked("Accelerometer"): ("fx", "fy", "fz"),
    marked("Gyro"): ("wx", "wy", "wz"),
    marked("Magnetometer"): ("mx", "my", "mz"),
}
AXIS_INKS = ("x", "y", "z")
METHODS = {
    "mekf": (marked("Filter of the thesis"), "a"),
    "two-phase": (marked("Two phases"), "b"),
    "online": (marked("Online"), "c"),
    "whole-drive": (marked("Whole drive"), "d"),
}
SECONDS = marked("box clock, s")
DEGREES = "°"
ELLIPSES = 7


@dataclass(frozen=True)
class Picture:
    """Dots on the two halves of a sphere."""

    title: str
    halves: list[tuple[str, str]]
    """Words below a half, and the path of its dots."""


@dataclass(frozen=True)
class Shown:
    """Everything below the heading of a finished analysis."""

    plots: list[Drawn] = field(default_factory=list[Drawn])
    sphere: Picture | None = None


def shown(kind: Kind, document: Document, *, apart: bool) -> Shown:
    """Plots of a document; `apart` shows mountings by their rotation from the reference instead of by angles."""
    if kind == "allan":
        return Shown([draw(plot) for plot in _allan(document)])
    if kind == "track":
        return Shown([draw(plot, height=height) for plot, height in _track(document)])
    if kind == "mounting":
        return Shown([draw(plot) for plot in (*_courses(document, apart=apart), *_observability(document))])
    return Shown([draw(plot, height=height) for plot, height in _calibration(document)], _coverage(document))


# --- Allan deviation


def _allan(document: Document) -> list[Plot]:
    plots: list[Plot] = []
    for title, names in TRIADS.items():
        columns = [(name, document["columns"][name]) for name in names if name in document["columns"]]
        lines: list[Line] = []
        for (name, column), ink in zip(columns, AXIS_INKS, strict=False):
            tau = column["tau_s"]
            lines.append(Line(name, tau, column["sigma"], ink, column["sigma_low95"], column["sigma_high95"]))
            lines.append(Line(name, tau, column["sigma_model"], f"{ink} ink-thin", listed=False))
        if lines:
            unit = columns[0][1]["unit"]
            plots.append(Plot(title, marked("cluster time, s"), unit, lines, log=True))
    return plots


# --- calibrations


def _coverage(document: Document) -> Picture:
    below, above = sphere([row for row in document["points"]["direction"] if None not in row])
    words = (marked("seen from the z side below zero"), marked("seen from the z side above zero"))
    paths = ["".join(f"M{x} {y}h0" for x, y in half) for half in (below, above)]
    return Picture(marked("Where the poses point"), list(zip(words, paths, strict=True)))


def _calibration(document: Document) -> list[tuple[Plot, float]]:
    points = document["points"]
    if points["corrected"] is None:
        return []
    number = list(range(1, len(points["error_before"]) + 1))
    unit = document["unit"]
    before = Line(marked("before"), number, points["error_before"], "muted", dots=True)
    after = Line(marked("after"), number, points["error_after"], "d", dots=True)
    title, pose = marked("Error of the magnitude"), marked("pose or reading")
    found = [
        (Plot(title, pose, unit, [before, after], levels=(0.0,)), 270.0),
        (Plot(marked("Error after, enlarged"), pose, unit, [after], levels=(0.0,)), 270.0),
    ]
    if document["sensor"] == "mag":
        found += [(plot, 380.0) for plot in _planes(points, document["field_ut"], unit)]
    return found


def _planes(points: Document, size: float, unit: str) -> list[Plot]:
    """The readings in the three planes, before and after, with the sphere that they should lie on."""
    angle = [2.0 * math.pi * k / 90.0 for k in range(91)]
    circle = Line(
        marked("true field"), [size * math.cos(a) for a in angle], [size * math.sin(a) for a in angle], "muted ink-thin"
    )
    plots: list[Plot] = []
    for first, second in ((0, 1), (0, 2), (1, 2)):
        lines = [circle]
        for name, key, ink in ((marked("before"), "reading", "muted"), (marked("after"), "corrected", "d")):
            rows = points[key]
            lines.append(Line(name, [row[first] for row in rows], [row[second] for row in rows], ink, dots=True))
        axes = "xyz"[first], "xyz"[second]
        plots.append(Plot(f"{axes[0]} / {axes[1]}", f"m{axes[0]}, {unit}", f"m{axes[1]}, {unit}", lines, square=True))
    return plots


# --- track


def _track(document: Document) -> list[tuple[Plot, float]]:
    gps, track, cost = document["gps"], document["track"], document["rehearsal"]
    lines = [
        Line("GPS", gps["east_m"], gps["north_m"], "muted", dots=True),
        Line(marked("track"), track["east_m"], track["north_m"], "d"),
    ]
    shaded: list[tuple[float, float]] = []
    near: list[tuple[Plot, float]] = []
    if cost is not None:
        shaded = [(cost["begin_s"], cost["end_s"])]
        dark = [k for k, t in enumerate(track["t_s"]) if cost["begin_s"] <= t <= cost["end_s"]]
        alone = Line(
            marked("track without GPS"),
            [track["east_m"][k] for k in dark],
            [track["north_m"][k] for k in dark],
            "alarm",
        )
        lines.append(alone)
        kept = [k for k, t in enumerate(gps["t_s"]) if cost["begin_s"] <= t <= cost["end_s"]]
        withheld = Line(
            marked("GPS, withheld"),
            [gps["east_m"][k] for k in kept],
            [gps["north_m"][k] for k in kept],
            "muted",
            dots=True,
        )
        close = [withheld, alone, *_ellipses(track, cost)]
        east, north = marked("east, m"), marked("north, m")
        near = [(Plot(marked("The stretch without GPS"), east, north, close, square=True), 400.0)]
        error = [
            Line(marked("distance from the withheld fixes"), cost["t_s"], cost["error_m"], "alarm"),
            Line(marked("95 % radius of the track"), cost["t_s"], cost["ellipse95"]["long_m"], "d"),
            Line(marked("95 % radius with that of a fix"), cost["t_s"], cost["with_fix95_m"], "muted ink-thin"),
        ]
        near.append((Plot(marked("Error without GPS"), SECONDS, "m", error, within=(0.0, math.inf)), 270.0))
    way = (Plot(marked("Way"), marked("east, m"), marked("north, m"), lines, square=True), 400.0)
    t = track["t_s"]
    radius = Line(marked("95 % radius of the track"), t, track["radius95_m"], "d")
    speed = Line(marked("speed"), t, [3.6 * v for v in track["speed_mps"]], "d")
    return [
        way,
        *near,
        (Plot(marked("Uncertainty"), SECONDS, "m", [radius], shaded=shaded, within=(0.0, math.inf)), 270.0),
        (Plot(marked("Speed"), SECONDS, "km/h", [speed], shaded=shaded), 270.0),
    ]


def _ellipses(track: Document, cost: Document) -> list[Line]:
    """95 % ellipses of the track at some moments of the outage."""
    ellipse, count = cost["ellipse95"], len(cost["t_s"])
    lines: list[Line] = []
    for n in range(min(ELLIPSES, count)):
        k = round(n * (count - 1) / max(min(ELLIPSES, count) - 1, 1))
        near = min(range(len(track["t_s"])), key=lambda i, t=cost["t_s"][k]: abs(track["t_s"][i] - t))
        long, short, axis = ellipse["long_m"][k], ellipse["short_m"][k], ellipse["axis_rad"][k]
        east: list[float] = []
        north: list[float] = []
        for step in range(49):
            a = 2.0 * math.pi * step / 48.0
            along, across = long * math.cos(a), short * math.sin(a)
            north.append(track["north_m"][near] + along * math.cos(axis) - across * math.sin(axis))
            east.append(track["east_m"][near] + along * math.sin(axis) + across * math.cos(axis))
        lines.append(Line(marked("95 % ellipse"), east, north, "d ink-thin", listed=n == 0))
    return lines


# --- mounting


def _courses(document: Document, *, apart: bool) -> list[Plot]:
    """Three angles over time, each method with its 1-sigma band."""
    if apart:
        titles = (marked("About x, forward"), marked("About y, right"), marked("About z, down"))
    else:
        titles = (marked("Theta"), marked("Phi"), marked("Psi"))
    plots: list[Plot] = []
    for axis, title in enumerate(titles):
        lines: list[Line] = []
        centre: list[float] = []
        for name, told in document["methods"].items():
            course = told["course"]
            values = course["about_v_deg"] if apart else course["euler_deg"]["angles"]
            sigmas = course["sigma_v_deg"] if apart else course["euler_deg"]["sigma"]
            words, ink = METHODS[name]
            y = [row[axis] for row in values]
            s = [row[axis] for row in sigmas]
            bands = list(zip(y, s, strict=True))
            low = [None if v is None or e is None else v - e for v, e in bands]
            high = [None if v is None or e is None else v + e for v, e in bands]
            lines.append(Line(words, course["t_s"], y, ink, low, high))
            centre += [v for v in y[-1:] if v is not None]
        # A band of half a turn says "unknown"; it must not press everything else flat.
        within = (min(centre) - 30.0, max(centre) + 30.0) if centre else None
        level = (0.0,) if apart else _of_reference(document, axis)
        plots.append(Plot(title, SECONDS, DEGREES, lines, levels=level, within=within))
    return plots


def _of_reference(document: Document, axis: int) -> tuple[float, ...]:
    euler = document["reference"]["euler_deg"]
    return () if euler is None else (euler[axis],)


def _observability(document: Document) -> list[Plot]:
    """Figures 5.3-5.7 of the thesis, and the same question to every method."""
    asked = [
        Line(METHODS[name][0], told["course"]["t_s"], told["course"]["observability"], METHODS[name][1])
        for name, told in document["methods"].items()
    ]
    plots = [Plot(marked("Observability, 1 = all is well seen"), SECONDS, "", asked, within=(-0.02, 1.02))]
    thesis = document["observability"]
    if thesis is None:
        return plots
    t = thesis["t_s"]
    eigenvalue = Line(marked("Filter of the thesis"), t, thesis["largest_eigenvalue"], "a")
    top = float(thesis["states"])
    plots.append(
        Plot(
            marked("Largest eigenvalue of the normalised covariance"),
            SECONDS,
            "",
            [eigenvalue],
            levels=(top,),
            within=(0.0, top * 1.05),
        )
    )
    plots.append(Plot(marked("Course"), SECONDS, DEGREES, [Line("GPS", t, thesis["course_deg"], "muted", dots=True)]))
    if thesis["forward_mps2"] is not None:
        force = Line(marked("Specific force forward"), t, thesis["forward_mps2"], "x")
        plots.append(Plot(marked("Specific force forward"), SECONDS, "m/s²", [force]))
    return plots
