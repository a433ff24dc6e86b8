"""Drawing on the report's pages: fonts, colours, and plots with axes, bands and marks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from reportlab.lib.colors import Color, HexColor
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont
from reportlab.platypus import Flowable

INK, MUTED, LINE, PAPER = HexColor("#17202b"), HexColor("#5a6572"), HexColor("#c9d0d8"), HexColor("#f3f5f8")
ACCENT, ALARM = HexColor("#1d5bc9"), HexColor("#bd2727")
AXIS_X, AXIS_Y, AXIS_Z = HexColor("#c32222"), HexColor("#14784a"), HexColor("#2050c0")
PLAIN, BOLD, MONO = "Scatola", "Scatola-Bold", "Scatola-Mono"
_FILES = {PLAIN: "DejaVuSansCondensed.ttf", BOLD: "DejaVuSansCondensed-Bold.ttf", MONO: "DejaVuSansMono.ttf"}

Canvas = Any
"""reportlab's canvas; it has no types."""
Numbers = Sequence[float | None]


@cache
def load_fonts() -> None:
    """Make the bundled fonts known, once."""
    for name, file in _FILES.items():
        pdfmetrics.registerFont(TTFont(name, str(Path(__file__).parent / "fonts" / file)))
    pdfmetrics.registerFontFamily(PLAIN, normal=PLAIN, bold=BOLD, italic=PLAIN, boldItalic=BOLD)


def faint(colour: Any, share: float) -> Color:
    """A colour mixed with white: print knows no transparency."""
    return Color(*(1.0 - share * (1.0 - part) for part in (colour.red, colour.green, colour.blue)))


def nice_step(span: float, about: int) -> float:
    """1, 2 or 5 times a power of ten, so that about so many fit in."""
    rough = max(span, 1e-9) / about
    decade = 10.0 ** math.floor(math.log10(rough))
    return next(step * decade for step in (1.0, 2.0, 5.0, 10.0) if step * decade >= rough * 0.999)


@dataclass
class Line:
    """A curve, and how it is drawn."""

    x: Numbers
    y: Numbers
    colour: Any
    width: float = 1.2
    dash: tuple[float, ...] = ()
    name: str = ""


@dataclass
class Plot:
    """Curves over one axis."""

    title: str
    x_name: str
    lines: list[Line]
    bands: list[tuple[Numbers, Numbers, Numbers, Any]] = field(default_factory=list[Any])
    """x, low, high, colour."""
    marks: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    marks_name: str = ""
    zero: bool = True
    """Whether the y axis shows zero."""
    decimal: str = "."


def runs(*columns: Numbers) -> list[list[tuple[float, ...]]]:
    """Rows of which every value is known, cut where one is not."""
    found: list[list[tuple[float, ...]]] = [[]]
    for row in zip(*columns, strict=True):
        known = tuple(value for value in row if value is not None)
        if len(known) == len(row):
            found[-1].append(known)
        elif found[-1]:
            found.append([])
    return [run for run in found if run]


class PlotFlow(Flowable):
    """A plot in the flow of a page."""

    def __init__(self, plot: Plot, width: float, height: float) -> None:
        super().__init__()
        self.plot, self.width, self.height = plot, width, height

    def draw(self) -> None:
        """Called by reportlab."""
        canvas, plot = self.canv, self.plot
        left, right, bottom, top = 34.0, self.width - 4.0, 26.0, self.height - 30.0
        known = [row for line in plot.lines for run in runs(line.x, line.y) for row in run]
        known += [
            (x, y) for x, low, high, _ in plot.bands for run in runs(x, low, high) for x, a, b in run for y in (a, b)
        ]
        canvas.setFont(BOLD, 8.5)
        canvas.setFillColor(INK)
        canvas.drawString(0, self.height - 9, plot.title)
        if not known:
            return
        x0, x1 = min(x for x, _ in known), max(x for x, _ in known)
        y0, y1 = min(y for _, y in known), max(y for _, y in known)
        if plot.zero:
            y0, y1 = min(y0, 0.0), max(y1, 0.0)
        y_step, x_step = nice_step(max(y1 - y0, 1e-6), 5), nice_step(max(x1 - x0, 1e-6), 8)
        y0, y1 = math.floor(y0 / y_step + 1e-9) * y_step, math.ceil(y1 / y_step - 1e-9) * y_step
        y1 = y1 if y1 > y0 else y0 + y_step

        def at(x: float, y: float) -> tuple[float, float]:
            return left + (x - x0) / max(x1 - x0, 1e-9) * (right - left), bottom + (y - y0) / (y1 - y0) * (top - bottom)

        self._axes(canvas, at, (x0, x1, x_step), (y0, y1, y_step), (left, right, bottom, top))
        for x, low, high, colour in plot.bands:
            for run in runs(x, low, high):
                _polygon(canvas, [at(a, b) for a, b, _ in run] + [at(a, c) for a, _, c in reversed(run)], colour)
        for line in plot.lines:
            for run in runs(line.x, line.y):
                polyline(canvas, [at(a, b) for a, b in run], line.colour, line.width, line.dash)
        canvas.setFillColor(ALARM)
        for x, y in plot.marks:
            px, py = at(x, y)
            canvas.rect(px - 1.6, py - 1.6, 3.2, 3.2, stroke=0, fill=1)
        self._key(canvas, right)

    def _axes(
        self, canvas: Canvas, at: Any, xs: tuple[float, ...], ys: tuple[float, ...], box: tuple[float, ...]
    ) -> None:
        left, right, bottom, top = box
        canvas.setFont(PLAIN, 7)
        for value, (low, high, step), is_x in [(k, s, n) for s, n in ((xs, True), (ys, False)) for k in _ticks(*s)]:
            del low, high
            px, py = at(value if is_x else xs[0], ys[0] if is_x else value)
            canvas.setStrokeColor(INK if value == 0.0 else LINE)
            canvas.setLineWidth(0.6 if value == 0.0 else 0.4)
            canvas.setFillColor(MUTED)
            words = self._number(value, step)
            if is_x:
                canvas.line(px, bottom, px, top)
                canvas.drawCentredString(px, bottom - 9, words)
            else:
                canvas.line(left, py, right, py)
                canvas.drawRightString(left - 4, py - 2.4, words)
        canvas.drawRightString(right, bottom - 20, self.plot.x_name)

    def _number(self, value: float, step: float) -> str:
        digits = max(0, -math.floor(math.log10(step) + 1e-9))
        return f"{value:.{digits}f}".replace("-", "\N{MINUS SIGN}").replace(".", self.plot.decimal)

    def _key(self, canvas: Canvas, right: float) -> None:
        canvas.setFont(PLAIN, 7)
        x, y = 0.0, self.height - 21
        entries: list[tuple[str, Line | None]] = [(line.name, line) for line in self.plot.lines if line.name]
        if self.plot.marks:
            entries.append((self.plot.marks_name, None))
        for name, line in entries:
            if line is None:
                canvas.setFillColor(ALARM)
                canvas.rect(x + 6, y + 0.8, 3.2, 3.2, stroke=0, fill=1)
            else:
                polyline(canvas, [(x, y + 2.4), (x + 14, y + 2.4)], line.colour, line.width, line.dash)
            canvas.setFillColor(MUTED)
            canvas.drawString(x + 17, y, name)
            x += 17 + pdfmetrics.stringWidth(name, PLAIN, 7) + 12
            if x > right:
                return


def _ticks(low: float, high: float, step: float) -> list[float]:
    return [k * step for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def polyline(
    canvas: Canvas, points: Sequence[tuple[float, float]], colour: Any, width: float, dash: tuple[float, ...] = ()
) -> None:
    """Connected lines, rounded."""
    if len(points) < 2:
        return
    canvas.saveState()
    canvas.setStrokeColor(colour)
    canvas.setLineWidth(width)
    canvas.setLineJoin(1)
    canvas.setLineCap(1)
    canvas.setDash(*([list(dash)] if dash else [[]]))
    path = canvas.beginPath()
    path.moveTo(*points[0])
    for point in points[1:]:
        path.lineTo(*point)
    canvas.drawPath(path, stroke=1, fill=0)
    canvas.restoreState()


def _polygon(canvas: Canvas, points: Sequence[tuple[float, float]], colour: Any) -> None:
    path = canvas.beginPath()
    path.moveTo(*points[0])
    for point in points[1:]:
        path.lineTo(*point)
    path.close()
    canvas.setFillColor(colour)
    canvas.drawPath(path, stroke=0, fill=1)
