"""Signals of a window of time, from the blobs to what a chart can draw."""

from __future__ import annotations

import datetime as dt
from collections.abc import Hashable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal

import numpy as np

from nav_core.typing import Floats
from server.errors import InvalidError
from server.formats.parquet import read_columns
from server.signals.decimate import Curve, broken_at, gaps, min_max
from server.signals.queries import Mounting, Piece
from server.signals.thin import BUCKET_S, Memory, thin
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
READERS = 2
"""Batches that one request decodes at a time."""

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


def is_coarse(window: Window, points: int) -> bool:
    """Whether a chart of so many points is drawn from thinned batches: two of their buckets at least to a pixel."""
    span = (window.end - window.begin).total_seconds()
    return span / max(points // 2, 1) >= 2.0 * BUCKET_S


def signals(
    store: BlobStore,
    memory: Memory,
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
    turned = frame == "v" and bool(mountings)
    read = _Reader(store, memory if is_coarse(window, points) else None, mountings if turned else (), groups)
    with ThreadPoolExecutor(READERS) as readers:
        parts = list(readers.map(read.parts, pieces))
    curves: list[Curve] = []
    pauses: list[tuple[float, float]] = []
    for number, group in enumerate(groups):
        joined = _joined([_shifted(part[number], piece, t0) for part, piece in zip(parts, pieces, strict=True)], group)
        curve = joined.part((joined.t >= 0.0) & (joined.t <= span))
        breaks = gaps(curve.t, at_least=GAP_S)
        pauses = pauses or breaks
        kept = tuple(name for name in group if name in names)
        drawn = min_max(Curve(curve.t, {name: curve.columns[name] for name in kept}), points)
        curves.append(broken_at(drawn, breaks[:MAX_GAPS]))
    return Signals(window.begin, "v" if turned else "a", curves, pauses[:MAX_GAPS])


@dataclass(frozen=True)
class _Reader:
    """From a batch to its curves, a group of columns each, on the box's clock and in the wanted axes."""

    store: BlobStore
    memory: Memory | None
    """Where thinned batches are remembered; None for the samples themselves."""
    mountings: Sequence[Mounting]
    """By which vectors are turned into the vehicle's axes; none to leave them in the box's."""
    groups: Sequence[tuple[str, ...]]

    def parts(self, piece: Piece) -> list[Curve]:
        """The curves of one batch, only rows that have a value."""
        content: dict[str, Floats] = {}

        def made(group: tuple[str, ...]) -> Curve:
            if not content:
                content.update(read_columns(self.store.get(piece.blob_key), [n for g in self.groups for n in g]))
            return self._curve(piece, group, content)

        if self.memory is None:
            return [made(group) for group in self.groups]
        return [
            self.memory.get(self._key(piece, group), lambda group=group: thin(made(group))) for group in self.groups
        ]

    def _key(self, piece: Piece, group: tuple[str, ...]) -> Hashable:
        """All that a thinned curve depends on."""
        if group not in TRIADS or not self.mountings:
            return piece.blob_key, group
        begin, end = (piece.utc_offset_s + (1.0 + piece.utc_drift) * t for t in (piece.t_first_s, piece.t_last_s))
        held = [
            (m.began_at, m.ended_at, tuple(map(tuple, m.R_va)))
            for m in self.mountings
            if m.began_at.timestamp() <= end and (m.ended_at is None or m.ended_at.timestamp() >= begin)
        ]
        return piece.blob_key, group, piece.utc_offset_s, piece.utc_drift, tuple(held)

    def _curve(self, piece: Piece, group: tuple[str, ...], content: Mapping[str, Floats]) -> Curve:
        t = content["t"]
        nothing = np.full(t.size, np.nan)
        values = {name: content.get(name, nothing) for name in group}
        sampled = np.any([np.isfinite(column) for column in values.values()], axis=0)
        curve = Curve(t, values).part(sampled)
        if self.mountings and group in TRIADS:
            return _in_vehicle(curve, group, self.mountings, piece)
        return curve


def _shifted(curve: Curve, piece: Piece, t0: float) -> Curve:
    """The same on the window's axis of time."""
    return Curve(piece.utc_offset_s - t0 + (1.0 + piece.utc_drift) * curve.t, curve.columns)


def _joined(parts: Sequence[Curve], group: tuple[str, ...]) -> Curve:
    """Batches one after the other; overlaps are sorted in, and of equal times the first stays."""
    if not parts:
        return Curve(np.empty(0), {name: np.empty(0) for name in group})
    t, first = np.unique(np.concatenate([part.t for part in parts]), return_index=True)
    return Curve(t, {name: np.concatenate([part.columns[name] for part in parts])[first] for name in group})


def _in_vehicle(curve: Curve, group: tuple[str, ...], mountings: Sequence[Mounting], piece: Piece) -> Curve:
    """``f_v = R_va @ f_a``, each stretch with the mounting of its time; NaN where none is known."""
    box = np.column_stack([curve.columns[name] for name in group])
    vehicle = np.full_like(box, np.nan)
    for rows, R_va in _stretches(curve.t, mountings, piece):
        vehicle[rows] = box[rows] @ R_va.T
    return Curve(curve.t, {name: vehicle[:, axis] for axis, name in enumerate(group)})


def _stretches(t: Floats, mountings: Sequence[Mounting], piece: Piece) -> Iterator[tuple[slice, Floats]]:
    def place(at: dt.datetime) -> int:
        return int(np.searchsorted(t, (at.timestamp() - piece.utc_offset_s) / (1.0 + piece.utc_drift)))

    for mounting in mountings:
        end = t.size if mounting.ended_at is None else place(mounting.ended_at)
        yield slice(place(mounting.began_at), end), np.array(mounting.R_va)
