"""Signals of a window of time, from the blobs to what a chart can draw."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from nav_core.typing import Floats
from server.errors import InvalidError
from server.formats.columns import Columns
from server.signals.decimate import Curve, broken_at, gaps, min_max
from server.signals.queries import Mounting, Piece
from server.store import BlobStore

UNITS = {
    **dict.fromkeys(("fx", "fy", "fz"), "m/s^2"),
    **dict.fromkeys(("wx", "wy", "wz"), "rad/s"),
    **dict.fromkeys(("mx", "my", "mz"), "uT"),
    "temp": "degC",
    "speed": "m/s",
    "course": "deg",
    "alt": "m",
    "battery": "V",
}
TRIADS = (("fx", "fy", "fz"), ("wx", "wy", "wz"), ("mx", "my", "mz"))
GAP_S = 2.0
MAX_GAPS = 200

Frame = Literal["a", "v"]


@dataclass(frozen=True)
class Window:
    """From when to when, UTC."""

    begin: dt.datetime
    end: dt.datetime


@dataclass(frozen=True)
class Signals:
    """Curves on one axis: seconds since `t0`."""

    t0: dt.datetime
    frame: Frame
    curves: list[Curve]
    gaps: list[tuple[float, float]]


def groups_of(names: Sequence[str]) -> list[tuple[str, ...]]:
    """Columns that are drawn on shared times: the axes of a triad together, everything else by itself."""
    unknown = [name for name in names if name not in UNITS]
    if unknown:
        raise InvalidError(f"unknown column {unknown[0]!r}; known are {', '.join(UNITS)}", code="unknown_column")
    wanted = list(dict.fromkeys(names))
    triads = [triad for triad in TRIADS if any(axis in wanted for axis in triad)]
    single = [(name,) for name in wanted if not any(name in triad for triad in TRIADS)]
    return [*triads, *single]


def signals(
    store: BlobStore,
    pieces: Sequence[Piece],
    mountings: Sequence[Mounting],
    window: Window,
    *,
    names: Sequence[str],
    frame: Frame,
    points: int,
) -> Signals:
    """Read, put on one axis of time, turn into the vehicle's axes if asked and possible, and thin out."""
    t0 = window.begin.timestamp()
    span = window.end.timestamp() - t0
    groups = groups_of(names)
    parts = [_part(store, piece, t0, groups) for piece in pieces]
    turned = frame == "v" and bool(mountings)
    curves: list[Curve] = []
    pauses: list[tuple[float, float]] = []
    for number, group in enumerate(groups):
        curve = _joined([part[number] for part in parts], group)
        curve = curve.part((curve.t >= 0.0) & (curve.t <= span))
        if turned and group in TRIADS:
            curve = _in_vehicle(curve, group, mountings, t0)
        breaks = gaps(curve.t, at_least=GAP_S)
        pauses = pauses or breaks
        kept = tuple(name for name in group if name in names)
        thin = min_max(Curve(curve.t, {name: curve.columns[name] for name in kept}), points)
        curves.append(broken_at(thin, breaks[:MAX_GAPS]))
    return Signals(window.begin, "v" if turned else "a", curves, pauses[:MAX_GAPS])


def _part(store: BlobStore, piece: Piece, t0: float, groups: Sequence[tuple[str, ...]]) -> list[Curve]:
    """One batch as a curve per group, only rows that have a value."""
    columns = Columns.from_parquet(store.get(piece.blob_key)).values
    t = piece.utc_offset_s - t0 + (1.0 + piece.utc_drift) * columns["t"]
    nothing = np.full(t.size, np.nan)
    parts: list[Curve] = []
    for group in groups:
        values = {name: columns.get(name, nothing) for name in group}
        sampled = np.any([np.isfinite(column) for column in values.values()], axis=0)
        parts.append(Curve(t, values).part(sampled))
    return parts


def _joined(parts: Sequence[Curve], group: tuple[str, ...]) -> Curve:
    """Batches one after the other; overlaps are sorted in, and of equal times the first stays."""
    if not parts:
        return Curve(np.empty(0), {name: np.empty(0) for name in group})
    t, first = np.unique(np.concatenate([part.t for part in parts]), return_index=True)
    return Curve(t, {name: np.concatenate([part.columns[name] for part in parts])[first] for name in group})


def _in_vehicle(curve: Curve, group: tuple[str, ...], mountings: Sequence[Mounting], t0: float) -> Curve:
    """``f_v = R_va @ f_a``, each stretch with the mounting of its time; NaN where none is known."""
    box = np.column_stack([curve.columns[name] for name in group])
    vehicle = np.full_like(box, np.nan)
    for rows, R_va in _stretches(curve.t, mountings, t0):
        vehicle[rows] = box[rows] @ R_va.T
    return Curve(curve.t, {name: vehicle[:, axis] for axis, name in enumerate(group)})


def _stretches(t: Floats, mountings: Sequence[Mounting], t0: float) -> Iterator[tuple[slice, Floats]]:
    for mounting in mountings:
        begin = np.searchsorted(t, mounting.began_at.timestamp() - t0)
        end = t.size if mounting.ended_at is None else np.searchsorted(t, mounting.ended_at.timestamp() - t0)
        yield slice(int(begin), int(end)), np.array(mounting.R_va)
