"""The report's two drawings: the vehicle from above with the force, and its way in local metres."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from reportlab.pdfbase.pdfmetrics import stringWidth
from reportlab.platypus import Flowable

from server.reports.paper import ACCENT, ALARM, BOLD, INK, LINE, MUTED, PLAIN, Canvas, faint, nice_step, polyline
from server.reports.words import Words

_SIZES = {"car": (4.4, 1.8), "van": (5.5, 2.0), "truck": (8.0, 2.5), "bus": (10.0, 2.5), "motorcycle": (2.1, 0.8)}


class VehicleSketch(Flowable):
    """The vehicle from above, front up, in a ring of hours; an arrow for the force, a sector for its interval."""

    def __init__(self, event: dict[str, Any], vehicle_class: str, words: Words, width: float, height: float) -> None:
        super().__init__()
        self._event, self._class, self._words = event, vehicle_class, words
        self.width, self.height = width, height

    def draw(self) -> None:
        """Called by reportlab."""
        canvas, words = self.canv, self._words
        radius = min(self.width, self.height - 34) / 2 - 12
        x, y = self.width / 2, 24 + (self.height - 34) / 2
        pdof, interval = self._event["pdof_deg"], self._event["pdof_interval95_deg"]
        canvas.setLineWidth(0.5)
        canvas.setStrokeColor(LINE)
        canvas.circle(x, y, radius, stroke=1, fill=0)
        if pdof is not None and interval is not None:
            canvas.setFillColor(faint(ALARM, 0.30))
            # reportlab counts from the right, counter-clockwise; ours from ahead, clockwise.
            extent = max(interval[1] - interval[0], 0.6)
            canvas.wedge(
                x - radius, y - radius, x + radius, y + radius, 90.0 - interval[0] - extent, extent, stroke=0, fill=1
            )
        self._hours(canvas, x, y, radius)
        _vehicle(canvas, x, y, 1.05 * radius, self._class)
        canvas.setFont(PLAIN, 7)
        canvas.setFillColor(MUTED)
        if pdof is None:
            canvas.drawCentredString(self.width / 2, 4, words("sketch_unknown"))
            return
        angle = math.radians(pdof)
        outer, inner = radius * 0.97, radius * 0.40
        tail = x + outer * math.sin(angle), y + outer * math.cos(angle)
        tip = x + inner * math.sin(angle), y + inner * math.cos(angle)
        _arrow(canvas, tail, tip)
        canvas.drawCentredString(self.width / 2, 4, words("sketch_note"))

    def _hours(self, canvas: Canvas, x: float, y: float, radius: float) -> None:
        canvas.setFont(PLAIN, 7)
        for hour in range(1, 13):
            angle = math.radians(30.0 * hour)
            mine = self._event["pdof_clock"] == hour
            canvas.setFillColor(ALARM if mine else MUTED)
            canvas.setFont(BOLD if mine else PLAIN, 8 if mine else 7)
            dx, dy = math.sin(angle), math.cos(angle)
            canvas.drawCentredString(x + (radius + 7) * dx, y + (radius + 7) * dy - 2.5, str(hour))
            canvas.setStrokeColor(LINE)
            canvas.line(x + 0.96 * radius * dx, y + 0.96 * radius * dy, x + radius * dx, y + radius * dy)


def _arrow(canvas: Canvas, tail: tuple[float, float], tip: tuple[float, float]) -> None:
    length = math.dist(tail, tip)
    ux, uy = (tip[0] - tail[0]) / length, (tip[1] - tail[1]) / length
    neck = tip[0] - 11 * ux, tip[1] - 11 * uy
    polyline(canvas, [tail, neck], ALARM, 1.8)
    canvas.setFillColor(ALARM)
    path = canvas.beginPath()
    path.moveTo(*tip)
    path.lineTo(neck[0] - 4 * uy, neck[1] + 4 * ux)
    path.lineTo(neck[0] + 4 * uy, neck[1] - 4 * ux)
    path.close()
    canvas.drawPath(path, stroke=0, fill=1)
    canvas.setFillColor(MUTED)


def _vehicle(canvas: Canvas, x: float, y: float, length: float, vehicle_class: str) -> None:
    """A plan view that shows which end is the front, and no more."""
    real_length, real_width = _SIZES.get(vehicle_class, _SIZES["car"])
    width = length * real_width / real_length
    half, side = length / 2, width / 2
    canvas.saveState()
    canvas.setStrokeColor(INK)
    canvas.setLineWidth(1.0)
    canvas.setFillColor(faint(INK, 0.05))
    canvas.roundRect(x - side, y - half, width, length, 0.32 * width, stroke=1, fill=1)
    if vehicle_class != "motorcycle":
        canvas.setFillColor(faint(ACCENT, 0.20))
        canvas.setLineWidth(0.5)
        for front, near, far, inset in ((1.0, 0.42, 0.24, 0.10), (-1.0, 0.74, 0.62, 0.14)):
            path = canvas.beginPath()
            path.moveTo(x - side * 0.84, y + front * half * near)
            path.lineTo(x + side * 0.84, y + front * half * near)
            path.lineTo(x + side * (0.84 - inset), y + front * half * far)
            path.lineTo(x - side * (0.84 - inset), y + front * half * far)
            path.close()
            canvas.drawPath(path, stroke=1, fill=1)
    canvas.setStrokeColor(INK)
    canvas.setLineWidth(0.8)
    tip = y + half * 0.86
    for dx in (-0.22, 0.22):
        canvas.line(x, tip, x + dx * side, tip - 0.18 * side)
    canvas.restoreState()


class WayMap(Flowable):
    """The path in local metres, north up, with grid, scale, ellipses and what happened where."""

    def __init__(
        self,
        way: dict[str, Any],
        words: Words,
        width: float,
        height: float,
        *,
        title: str,
        span_s: tuple[float, float],
        rest: float | None,
        others: Sequence[float],
    ) -> None:
        super().__init__()
        self._way, self._words, self._title = way, words, title
        self._rest, self._others = rest, others
        self.width, self.height = width, height
        rows = zip(
            way["t_s"],
            way["east_m"],
            way["north_m"],
            way["ellipse_long_m"],
            way["ellipse_short_m"],
            way["ellipse_deg"],
            strict=True,
        )
        self._rows = [row for row in rows if span_s[0] <= row[0] <= span_s[1] and None not in row[1:3]]
        self.grid = 0.0
        self._fit()

    def _fit(self) -> None:
        easts = [row[1] for row in self._rows] or [0.0]
        norths = [row[2] for row in self._rows] or [0.0]
        inner_w, inner_h = self.width - 28, self.height - 42
        span = max((max(easts) - min(easts)) / inner_w, (max(norths) - min(norths)) / inner_h, 12.0 / inner_w)
        self._scale = 0.86 / span
        self._middle = 0.5 * (max(easts) + min(easts)), 0.5 * (max(norths) + min(norths))
        self.grid = nice_step(self.width / self._scale, 5)

    def _at(self, east: float, north: float) -> tuple[float, float]:
        return (
            self.width / 2 + (east - self._middle[0]) * self._scale,
            (self.height - 14) / 2 + (north - self._middle[1]) * self._scale,
        )

    def draw(self) -> None:
        """Called by reportlab."""
        canvas, words = self.canv, self._words
        canvas.setFont(BOLD, 8.5)
        canvas.setFillColor(INK)
        canvas.drawString(0, self.height - 9, self._title)
        canvas.saveState()
        frame = canvas.beginPath()
        frame.rect(0, 0, self.width, self.height - 14)
        canvas.clipPath(frame, stroke=0, fill=0)
        self._draw_grid(canvas)
        last5 = [row for row in self._rows if -5.0 <= row[0] <= 0.0]
        before = [row for row in self._rows if row[0] <= 0.0]
        after = [row for row in self._rows if row[0] >= 0.0]
        for rows, colour, line in ((before, faint(ACCENT, 0.5), 1.6), (last5, ACCENT, 2.6), (after, ALARM, 2.0)):
            polyline(canvas, [self._at(row[1], row[2]) for row in rows], colour, line)
        self._draw_ellipses(canvas)
        self._draw_marks(canvas, before, after)
        canvas.restoreState()
        canvas.setStrokeColor(LINE)
        canvas.setLineWidth(0.5)
        canvas.rect(0, 0, self.width, self.height - 14, stroke=1, fill=0)
        self._draw_scale(canvas)
        self._draw_key(canvas, words)

    def _draw_grid(self, canvas: Canvas) -> None:
        canvas.setStrokeColor(faint(LINE, 0.6))
        canvas.setLineWidth(0.35)
        reach = max(self.width, self.height) / self._scale
        count = math.ceil(reach / self.grid)
        for k in range(-count, count + 1):
            east = math.floor(self._middle[0] / self.grid) * self.grid + k * self.grid
            north = math.floor(self._middle[1] / self.grid) * self.grid + k * self.grid
            px, py = self._at(east, north)
            canvas.line(px, 0, px, self.height)
            canvas.line(0, py, self.width, py)

    def _draw_ellipses(self, canvas: Canvas) -> None:
        canvas.setLineWidth(0.6)
        canvas.setStrokeColor(MUTED)
        due = -math.inf
        for t, east, north, long, short, angle in self._rows:
            if t < due or long is None:
                continue
            due = t + 5.0 - 1e-6
            canvas.saveState()
            canvas.translate(*self._at(east, north))
            canvas.rotate(90.0 - angle)
            a, b = long * self._scale, short * self._scale
            canvas.ellipse(-a, -b, a, b, stroke=1, fill=0)
            canvas.restoreState()

    def _draw_marks(self, canvas: Canvas, before: list[Any], after: list[Any]) -> None:
        canvas.setFont(PLAIN, 7)
        places: list[tuple[str, float, float, Any]] = []
        # Numbered in order of time, as in the table; the strongest is at zero.
        for k, t in enumerate(sorted([0.0, *self._others]), start=1):
            row = (0.0, 0.0, 0.0) if t == 0.0 else self._row_at(t)
            if row is not None:
                name = f"{self._words('impact')} {k}" if self._others else self._words("impact")
                places.append((name, row[1], row[2], ALARM))
        if before:
            places.append((self._words("start"), before[0][1], before[0][2], ACCENT))
        rest = None if self._rest is None or not after else self._row_at(self._rest)
        if rest is not None:
            places.append((self._words("rest"), rest[1], rest[2], INK))
        dots = [self._at(east, north) for _, east, north, _ in places]
        taken = [(x - 3.0, y - 3.0, x + 3.0, y + 3.0) for x, y in dots] + self._occupied()
        for (name, _, _, colour), (px, py) in zip(places, dots, strict=True):
            canvas.setFillColor(colour)
            canvas.circle(px, py, 2.6, stroke=0, fill=1)
            box = room_beside(px, py, stringWidth(name, PLAIN, 7), taken)
            taken.append(box)
            canvas.drawString(box[0], box[1] + 1.5, name)

    def _row_at(self, t: float) -> Any:
        """The row nearest to a moment, s from time zero; None of one that the map does not reach."""
        row = min(self._rows, key=lambda row: abs(row[0] - t), default=None)
        return None if row is None or abs(row[0] - t) > 2.0 else row

    def _occupied(self) -> list[Box]:
        """Where no word may stand: along the way, under the scale and the key, at the arrow, outside of the frame."""
        way = [self._at(row[1], row[2]) for row in self._rows]
        boxes: list[Box] = []
        for (x1, y1), (x2, y2) in pairwise(way):
            pieces = max(math.ceil(math.dist((x1, y1), (x2, y2)) / 4.0), 1)
            steps = [(x1 + (x2 - x1) * k / pieces, y1 + (y2 - y1) * k / pieces) for k in range(pieces)]
            boxes += [(x - 1.0, y - 1.0, x + 1.0, y + 1.0) for x, y in steps]
        right, top = self.width, self.height - 14
        far = 10.0 * (right + top)
        boxes += [(-far, -far, 2.0, far), (right - 2.0, -far, far, far), (-far, top - 2.0, far, far)]
        scale = right - self.grid * self._scale - 12.0
        return [*boxes, (-far, -far, far, 16.0), (scale, 16.0, right, 34.0), (right - 22.0, top - 46.0, right, top)]

    def _draw_scale(self, canvas: Canvas) -> None:
        length = self.grid * self._scale
        x, y = self.width - length - 10, 20.0
        polyline(canvas, [(x, y + 3), (x, y), (x + length, y), (x + length, y + 3)], INK, 0.9)
        canvas.setFont(PLAIN, 7)
        canvas.setFillColor(INK)
        canvas.drawCentredString(x + length / 2, y + 3, f"{self._words.short(self.grid)} m")
        # North.
        nx, ny = self.width - 12, self.height - 42
        polyline(canvas, [(nx, ny), (nx, ny + 16)], INK, 0.9)
        polyline(canvas, [(nx - 3, ny + 11), (nx, ny + 16), (nx + 3, ny + 11)], INK, 0.9)
        canvas.drawCentredString(nx, ny - 8, "N")

    def _draw_key(self, canvas: Canvas, words: Words) -> None:
        x = 6.0
        for name, colour in (("before", faint(ACCENT, 0.5)), ("last5", ACCENT), ("after", ALARM)):
            polyline(canvas, [(x, 8), (x + 12, 8)], colour, 2.0)
            canvas.setFillColor(MUTED)
            canvas.drawString(x + 15, 5.6, words(name))
            x += 18 + 5.0 * len(words(name))


Box = tuple[float, float, float, float]
"""Left, bottom, right, top."""


def room_beside(x: float, y: float, width: float, taken: list[Box]) -> Box:
    """A place for a word beside a dot where nothing is yet: right, left, above, below, and so on further out."""
    for away in (0.0, 9.0, 18.0, 27.0, 36.0):
        for left, bottom in (
            (x + 5.0, y - 4.0 - away),
            (x - 5.0 - width, y - 4.0 - away),
            (x - width / 2.0, y + 4.0 + away),
            (x - width / 2.0, y - 12.0 - away),
        ):
            box = (left, bottom, left + width, bottom + 8.0)
            if not any(box[0] < r and l < box[2] and box[1] < t and b < box[3] for l, b, r, t in taken):
                return box
    return x + 5.0, y - 4.0, x + 5.0 + width, y + 4.0
