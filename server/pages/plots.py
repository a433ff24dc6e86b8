"""Plots as the templates draw them: SVG, so that a page needs no script to show what was computed.

A plot is given in the units of its axes and leaves here in those of its picture; web/templates/plots.html draws it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from nav_core.typing import Floats

WIDTH, HEIGHT = 480.0, 270.0
LEFT, RIGHT, TOP, BOTTOM = 58.0, 10.0, 8.0, 34.0
_TICKS = 5

Values = Sequence[float | None] | Floats


@dataclass(frozen=True)
class Line:
    """A curve with its band; `ink` names its colour and dash in web/static/css/workbench.css."""

    name: str
    x: Values
    y: Values
    ink: str
    low: Values | None = None
    high: Values | None = None
    dots: bool = False
    listed: bool = True
    """Whether the key below the plot names it."""


@dataclass(frozen=True)
class Plot:
    """What a plot shows."""

    title: str
    x_label: str
    y_label: str
    lines: Sequence[Line]
    log: bool = False
    square: bool = False
    """One unit is as long in x as in y."""
    shaded: Sequence[tuple[float, float]] = ()
    levels: Sequence[float] = ()
    """Dashed horizontal lines."""
    within: tuple[float, float] | None = None
    """Limits of y, where the data may not set them."""


@dataclass(frozen=True)
class Drawn:
    """A plot in the units of its picture."""

    title: str
    x_label: str
    y_label: str
    width: float
    height: float
    frame: tuple[float, float, float, float]
    """Left, top, width, height."""
    x_ticks: list[tuple[float, str]]
    y_ticks: list[tuple[float, str]]
    bands: list[tuple[str, str]]
    """Ink and path."""
    paths: list[tuple[str, str, bool]]
    """Ink, path, and whether it is dots."""
    shaded: list[tuple[float, float]]
    levels: list[float]
    key: list[tuple[str, str, bool]]
    """Ink, name, dots."""
    empty: bool


def draw(plot: Plot, *, height: float = HEIGHT) -> Drawn:
    """Lay out a plot."""
    frame = (LEFT, TOP, WIDTH - LEFT - RIGHT, height - TOP - BOTTOM)
    lines = [(line, *_points(line, log=plot.log)) for line in plot.lines]
    seen = [(x, y) for _, x, y, _, _ in lines if x.size]
    x_range = _range([x for x, _ in seen])
    around = [y for _, y in seen]
    around += [edge for _, x, _, low, high in lines if x.size for edge in (low, high) if edge is not None]
    y_range = _range([*around, _scaled(np.array(plot.levels, dtype=float), log=plot.log)])
    if plot.within is not None:
        y_range = max(y_range[0], plot.within[0]), min(y_range[1], plot.within[1])
    x_range, y_range = _padded(x_range), _padded(y_range)
    if plot.square:
        x_range, y_range = _square(x_range, y_range, frame[2] / frame[3])

    def at_x(values: Floats) -> Floats:
        return frame[0] + frame[2] * (values - x_range[0]) / (x_range[1] - x_range[0])

    def at_y(values: Floats) -> Floats:
        inside = np.clip(values, y_range[0] - 0.5 * np.ptp(y_range), y_range[1] + 0.5 * np.ptp(y_range))
        return frame[1] + frame[3] * (1.0 - (inside - y_range[0]) / (y_range[1] - y_range[0]))

    return Drawn(
        title=plot.title,
        x_label=plot.x_label,
        y_label=plot.y_label,
        width=WIDTH,
        height=height,
        frame=frame,
        x_ticks=_ticks(x_range, at_x, log=plot.log),
        y_ticks=_ticks(y_range, at_y, log=plot.log),
        bands=[
            (line.ink, _area(at_x(x), at_y(low), at_y(high)))
            for line, x, _, low, high in lines
            if x.size and low is not None and high is not None
        ],
        paths=[(line.ink, _path(at_x(x), at_y(y), dots=line.dots), line.dots) for line, x, y, _, _ in lines if x.size],
        shaded=[(float(a), float(b - a)) for a, b in (at_x(np.array(span)) for span in plot.shaded)],
        levels=at_y(_scaled(np.array(plot.levels, dtype=float), log=plot.log)).tolist(),
        key=[(line.ink, line.name, line.dots) for line in plot.lines if line.listed],
        empty=not seen,
    )


def _array(values: Values | None) -> Floats | None:
    return None if values is None else np.array([np.nan if v is None else v for v in values], dtype=np.float64)


def _scaled(values: Floats, *, log: bool) -> Floats:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log10(values) if log else values


def _points(line: Line, *, log: bool) -> tuple[Floats, Floats, Floats | None, Floats | None]:
    """What can be drawn of a line; a gap in y stays as NaN and breaks the path."""
    x, y = _scaled(_array(line.x), log=log), _scaled(_array(line.y), log=log)  # pyright: ignore[reportArgumentType]  both are given
    low, high = _array(line.low), _array(line.high)
    if low is not None and high is not None:
        low, high = _scaled(low, log=log), _scaled(high, log=log)
    known = np.isfinite(x)
    return x[known], y[known], None if low is None else low[known], None if high is None else high[known]


def _range(parts: Sequence[Floats]) -> tuple[float, float]:
    values = np.concatenate(parts) if parts else np.zeros(0)
    values = values[np.isfinite(values)]
    return (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)


def _padded(span: tuple[float, float]) -> tuple[float, float]:
    low, high = span
    room = 0.04 * (high - low) or max(abs(low), 1.0) * 0.05
    return low - room, high + room


def _square(x: tuple[float, float], y: tuple[float, float], shape: float) -> tuple[tuple[float, float], ...]:
    """Both ranges widened about their middles so that a unit is as long in x as in y."""
    unit = max((x[1] - x[0]) / shape, y[1] - y[0])
    middle_x, middle_y = 0.5 * (x[0] + x[1]), 0.5 * (y[0] + y[1])
    return (
        (middle_x - 0.5 * unit * shape, middle_x + 0.5 * unit * shape),
        (middle_y - 0.5 * unit, middle_y + 0.5 * unit),
    )


def _ticks(span: tuple[float, float], at: Callable[[Floats], Floats], *, log: bool) -> list[tuple[float, str]]:
    values = _decades(span) if log else _nice(span)
    digits = 0 if log or len(values) < 2 else max(0, -math.floor(math.log10(values[1] - values[0]) + 1e-9))
    words = [f"10{_raised(round(v))}" if log else f"{v:.{digits}f}".replace("-", "\N{MINUS SIGN}") for v in values]
    return list(zip(at(np.array(values, dtype=float)).tolist(), words, strict=True))


def _decades(span: tuple[float, float]) -> list[float]:
    first, last = math.ceil(span[0]), math.floor(span[1])
    step = max(1, (last - first) // 6)
    return [float(v) for v in range(first, last + 1, step)]


def _nice(span: tuple[float, float]) -> list[float]:
    rough = (span[1] - span[0]) / _TICKS
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1.0, 2.0, 2.5, 5.0, 10.0) if factor * power >= rough)
    first = math.ceil(span[0] / step - 1e-9)
    return [0.0 if k == 0 else k * step for k in range(first, math.floor(span[1] / step + 1e-9) + 1)]


def _raised(power: int) -> str:
    return str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def _path(x: Floats, y: Floats, *, dots: bool) -> str:
    """A line, broken where it is not known; or dots, each a line of no length with round ends."""
    parts: list[str] = []
    pen_down = False
    for a, b in zip(x.tolist(), y.tolist(), strict=True):
        if not math.isfinite(b):
            pen_down = False
        elif dots:
            parts.append(f"M{a:.1f} {b:.1f}h0")
        else:
            parts.append(f"{'L' if pen_down else 'M'}{a:.1f} {b:.1f}")
            pen_down = True
    return "".join(parts)


def _area(x: Floats, low: Floats, high: Floats) -> str:
    known = np.isfinite(low) & np.isfinite(high)
    if not known.any():
        return ""
    there = [f"{a:.1f} {b:.1f}" for a, b in zip(x[known].tolist(), high[known].tolist(), strict=True)]
    back = [f"{a:.1f} {b:.1f}" for a, b in zip(x[known][::-1].tolist(), low[known][::-1].tolist(), strict=True)]
    return "M" + "L".join([*there, *back]) + "Z"


def sphere(directions: Sequence[Sequence[float]]) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    """Directions on the two halves z <= 0 and z > 0 of the box's axes: right is +y, up is +x in the first."""
    halves: tuple[list[tuple[float, float]], list[tuple[float, float]]] = ([], [])
    for x, y, z in directions:
        # Lambert's projection: a hole looks as large as it is.
        scale = 100.0 / math.sqrt(1.0 + abs(z))
        halves[z > 0.0].append((round(scale * y, 1), round(-scale * x, 1)))
    return halves
