"""The data of one installation on one time axis, out of the digests of its batches.

Every boot of a box has a clock of its own, and a box may sleep for weeks within a boot.  The runs of data follow
one another on the axis with a bounded pause between, shifted by whole ticks, so that ticks keep their grid;
UTC is mapped through each boot's clock.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256

import numpy as np

from nav_core.records import Gnss
from nav_core.signal import TICK_RATE, Ticks, merge
from nav_core.typing import Flags, Floats
from server.formats.drive import join_gnss
from server.jobs.digest import Digest
from server.models import Boot

WINDOW_S = 7200.0
"""An estimate reads at most this much data; what is older has become a chapter."""

PAUSE_S = (60.0, 600.0)
"""Between boots the axis has the true pause within these bounds; a longer one within a boot is cut to the second."""


@dataclass(frozen=True, slots=True)
class Piece:
    """A batch's digest and where it belongs."""

    boot: str
    sequence: int
    t_first_s: float
    t_last_s: float
    column_sha256: str
    digest: Digest


@dataclass(frozen=True, slots=True)
class Segment:
    """A run of data of one boot on the axis: ``axis = t + shift``."""

    boot: Boot
    shift_s: float
    t_first_s: float
    t_last_s: float


@dataclass(frozen=True, slots=True)
class Stretch:
    """Ticks and fixes on the axis, the runs they come from, and the hash of what went in."""

    ticks: Ticks
    gnss: Gnss
    segments: tuple[Segment, ...]
    input_sha256: str

    @property
    def length_s(self) -> float:
        """Of the data on the axis, pauses left out."""
        return self.ticks.index.size / self.ticks.rate

    @property
    def end_unix_s(self) -> float:
        """UTC of the last data."""
        last = self.segments[-1]
        return last.boot.unix_s(last.t_last_s)

    def unix_s(self, axis_s: float) -> float:
        """UTC of a moment on the axis; within a pause, the beginning of what follows."""
        for segment in self.segments:
            t = axis_s - segment.shift_s
            if t <= segment.t_last_s:
                return segment.boot.unix_s(max(t, segment.t_first_s))
        return self.end_unix_s

    def between(self, since_s: float, until_s: float) -> Stretch:
        """The part from one UTC to another, same axis; runs outside of it are gone."""
        cut = [
            replace(
                run,
                t_first_s=max(run.boot.box_s(since_s), run.t_first_s),
                t_last_s=min(run.boot.box_s(until_s), run.t_last_s),
            )
            for run in self.segments
        ]
        segments = tuple(run for run in cut if run.t_first_s <= run.t_last_s)
        ranges = np.array([(run.t_first_s + run.shift_s, run.t_last_s + run.shift_s) for run in segments])
        # What lies on the edge of a run belongs to it; rounding of the shift must not lose it.
        margin = 0.01 / TICK_RATE
        keep_ticks = _inside(self.ticks.t, ranges, margin)
        return replace(
            self,
            ticks=_chosen(self.ticks, keep_ticks),
            gnss=_select(self.gnss, _inside(self.gnss.t, ranges, margin)),
            segments=segments,
        )


def in_windows(
    pieces: Sequence[Piece], boots: Mapping[str, Boot], window_s: float = WINDOW_S
) -> Iterator[tuple[list[Piece], bool]]:
    """The pieces in the order of time, at most a window's length at once, and whether more follow."""
    order = sorted(pieces, key=lambda piece: (_start(boots[piece.boot]), piece.sequence))
    kept: list[Piece] = []
    length = 0.0
    for piece in order:
        own = piece.t_last_s - piece.t_first_s
        if kept and length + own > window_s:
            yield kept, True
            kept, length = [], 0.0
        kept.append(piece)
        length += own
    if kept:
        yield kept, False


def assemble(pieces: Sequence[Piece], boots: Mapping[str, Boot]) -> Stretch:
    """Put pieces, in the order of time, onto one axis.

    The order makes the result independent of the order of arrival, to the last bit.
    """
    by_boot: defaultdict[str, list[Piece]] = defaultdict(list)
    for piece in pieces:
        by_boot[piece.boot].append(piece)
    segments: list[Segment] = []
    ticks: list[Ticks] = []
    gnss: list[Gnss] = []
    for name, parts in by_boot.items():
        boot_ticks = merge([part.digest.ticks for part in parts])
        boot_gnss = join_gnss([part.digest.gnss for part in parts])
        for first, last in _runs(np.union1d(boot_ticks.t, boot_gnss.t)):
            steps = _steps(segments[-1] if segments else None, boots[name], first)
            segments.append(Segment(boots[name], steps / TICK_RATE, first, last))
            k = slice(*np.searchsorted(boot_ticks.t, [first, np.nextafter(last, np.inf)]))
            run = _chosen(boot_ticks, k)
            ticks.append(replace(run, index=run.index + steps))
            k = slice(*np.searchsorted(boot_gnss.t, [first, np.nextafter(last, np.inf)]))
            gnss.append(_shifted(_select(boot_gnss, k), steps / TICK_RATE))
    hashes = "".join(piece.column_sha256 for piece in pieces)
    return Stretch(merge(ticks), join_gnss(gnss), tuple(segments), sha256(hashes.encode()).hexdigest())


def _runs(t: Floats) -> list[tuple[float, float]]:
    """First and last time of each run of data without a long pause."""
    if t.size == 0:
        return []
    breaks = np.flatnonzero(np.diff(t) > PAUSE_S[1])
    firsts, lasts = np.append(t[0], t[breaks + 1]), np.append(t[breaks], t[-1])
    return list(zip(firsts.tolist(), lasts.tolist(), strict=True))


def _steps(before: Segment | None, boot: Boot, first_s: float) -> int:
    """Ticks by which a run is shifted so that it follows the one before."""
    if before is None:
        return 0
    if before.boot is boot:
        return round((before.shift_s - (first_s - before.t_last_s - PAUSE_S[1])) * TICK_RATE)
    pause = boot.unix_s(first_s) - before.boot.unix_s(before.t_last_s)
    begin = before.t_last_s + before.shift_s + min(max(pause, PAUSE_S[0]), PAUSE_S[1])
    return math.ceil((begin - first_s) * TICK_RATE)


def _inside(t: Floats, ranges: Floats, margin: float) -> Flags:
    """Which times lie in one of the ranges, which are in order and apart."""
    if ranges.size == 0:
        return np.zeros(t.size, dtype=np.bool_)
    k = np.searchsorted(ranges[:, 0] - margin, t, side="right") - 1
    known = k >= 0
    return known & (t < ranges[np.maximum(k, 0), 1] + margin)


def _chosen(ticks: Ticks, keep: Flags | slice) -> Ticks:
    return Ticks(ticks.rate, ticks.index[keep], ticks.weight[keep], ticks.moment[keep], ticks.square[keep])


def _start(boot: Boot) -> tuple[float, int]:
    return boot.unix_s(boot.t_first_s), boot.ordinal


def _shifted(gnss: Gnss, shift_s: float) -> Gnss:
    return replace(gnss, t=gnss.t + shift_s) if shift_s else gnss


def _select(gnss: Gnss, keep: Flags | slice) -> Gnss:
    columns: dict[str, Floats] = {
        name: values[keep]
        for name in ("t", "lat", "lon", "alt", "speed", "course", "hdop", "sats", "utc")
        if (values := getattr(gnss, name)) is not None
    }
    return replace(gnss, fix=gnss.fix[keep], **columns)
