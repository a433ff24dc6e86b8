"""The data of one installation on one time axis, out of the digests of its batches.

Every boot of a box has a clock of its own.  The boots follow one another on the axis with a gap between,
shifted by whole ticks, so that ticks keep their grid; UTC is mapped through each boot's clock.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256

import numpy as np

from nav_core.records import Gnss
from nav_core.signal import TICK_RATE, Ticks, merge
from nav_core.typing import Flags, Floats
from server.jobs.digest import Digest, join_gnss
from server.models import Boot

WINDOW_S = 7200.0
"""An estimate uses at most this much data, the newest."""

BOOT_GAP_S = (60.0, 3600.0)
"""Between boots the axis has the true pause, within these bounds."""


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
    """One boot on the axis: ``axis = t + shift``."""

    boot: Boot
    shift_s: float
    t_first_s: float
    t_last_s: float


@dataclass(frozen=True, slots=True)
class Stretch:
    """Ticks and fixes on the axis, the boots they come from, and the hash of what went in."""

    ticks: Ticks
    gnss: Gnss
    segments: tuple[Segment, ...]
    input_sha256: str

    @property
    def end_unix_s(self) -> float:
        """UTC of the last data."""
        last = self.segments[-1]
        return last.boot.unix_s(last.t_last_s)

    def unix_s(self, axis_s: float) -> float:
        """UTC of a moment on the axis; within a gap between boots, the beginning of the later boot."""
        for segment in self.segments:
            t = axis_s - segment.shift_s
            if t <= segment.t_last_s:
                return segment.boot.unix_s(max(t, segment.t_first_s))
        return self.end_unix_s

    def between(self, since_s: float, until_s: float) -> Stretch:
        """The part from one UTC to another, same axis."""
        keep_ticks = np.zeros(self.ticks.index.size, dtype=np.bool_)
        keep_fixes = np.zeros(self.gnss.t.size, dtype=np.bool_)
        for segment in self.segments:
            low = max(segment.boot.box_s(since_s), segment.t_first_s - 1.0) + segment.shift_s
            high = min(segment.boot.box_s(until_s), segment.t_last_s + 1.0) + segment.shift_s
            keep_ticks |= (self.ticks.t >= low) & (self.ticks.t < high)
            keep_fixes |= (self.gnss.t >= low) & (self.gnss.t < high)
        ticks = Ticks(
            self.ticks.rate,
            *(getattr(self.ticks, name)[keep_ticks] for name in ("index", "weight", "moment", "square")),
        )
        return replace(self, ticks=ticks, gnss=_select(self.gnss, keep_fixes))


def newest(pieces: Sequence[Piece], boots: Mapping[str, Boot], window_s: float = WINDOW_S) -> list[Piece]:
    """The newest pieces that make up the window, in the order of time."""
    kept: list[Piece] = []
    length = 0.0
    for piece in sorted(pieces, key=lambda piece: (_start(boots[piece.boot]), piece.sequence), reverse=True):
        if length >= window_s:
            break
        kept.append(piece)
        length += piece.t_last_s - piece.t_first_s
    return kept[::-1]


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
        first, last = min(p.t_first_s for p in parts), max(p.t_last_s for p in parts)
        steps = _steps_after(segments[-1], boots[name], first) if segments else 0
        segments.append(Segment(boots[name], steps / TICK_RATE, first, last))
        merged = merge([part.digest.ticks for part in parts])
        ticks.append(replace(merged, index=merged.index + steps))
        gnss.append(_shifted(join_gnss([part.digest.gnss for part in parts]), steps / TICK_RATE))
    hashes = "".join(piece.column_sha256 for piece in pieces)
    return Stretch(merge(ticks), join_gnss(gnss), tuple(segments), sha256(hashes.encode()).hexdigest())


def _start(boot: Boot) -> tuple[float, int]:
    return boot.unix_s(boot.t_first_s), boot.ordinal


def _steps_after(before: Segment, boot: Boot, first_s: float) -> int:
    pause = boot.unix_s(first_s) - before.boot.unix_s(before.t_last_s)
    begin = before.t_last_s + before.shift_s + min(max(pause, BOOT_GAP_S[0]), BOOT_GAP_S[1])
    return math.ceil((begin - first_s) * TICK_RATE)


def _shifted(gnss: Gnss, shift_s: float) -> Gnss:
    return replace(gnss, t=gnss.t + shift_s) if shift_s else gnss


def _select(gnss: Gnss, keep: Flags) -> Gnss:
    columns: dict[str, Floats] = {
        name: values[keep]
        for name in ("t", "lat", "lon", "alt", "speed", "course", "hdop", "sats", "utc")
        if (values := getattr(gnss, name)) is not None
    }
    return replace(gnss, fix=gnss.fix[keep], **columns)
