"""A window of a box's clock put together from its batches: of overlapping streams the higher rate wins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from nav_core.records import Drive
from nav_core.typing import Floats
from server.formats.columns import Columns
from server.formats.drive import join_gnss, join_inertial, to_drive

_INERTIAL = ("fx", "fy", "fz", "wx", "wy", "wz", "mx", "my", "mz", "temp")
_FIX = ("lat", "lon", "alt", "speed", "course", "fix")


@dataclass(frozen=True)
class Part:
    """The columns of one batch."""

    columns: Columns
    burst: bool
    known: Drive | None = None
    """The records that the columns say, where somebody has made them already."""

    @cached_property
    def drive(self) -> Drive:
        """The records that the columns say."""
        return to_drive(self.columns) if self.known is None else self.known


def recording(parts: Sequence[Part]) -> Drive:
    """The records of parts put together: those of `merged`, and without that way round where nothing is to be merged.

    Batches that follow one another, all their rows in the order of time, are most of what there is.
    """
    ordered = sorted(parts, key=lambda part: part.columns.values["t"][:1].tolist())
    if not _in_one_line(ordered) or any(part.drive.remarks for part in ordered):
        return to_drive(merged(parts))
    drives = [part.drive for part in ordered]
    return Drive(join_inertial([each.inertial for each in drives]), join_gnss([each.gnss for each in drives]))


def _in_one_line(parts: Sequence[Part]) -> bool:
    """Whether the parts have the same columns, none is a burst, and time never stands or goes back."""
    if any(part.burst for part in parts) or len({tuple(part.columns.values) for part in parts}) != 1:
        return False
    times = [part.columns.values["t"] for part in parts]
    within = all(t.size and bool((np.diff(t) > 0.0).all()) for t in times)
    return within and all(before[-1] < after[0] for before, after in pairwise(times))


def merged(parts: Sequence[Part]) -> Columns:
    """One recording in the order of time.

    Where parts overlap, the inertial samples of the one with the lower rate are left out, of equal rates those of
    the continuous stream; of fixes that were sent twice one stays.  The batches themselves stay as they are.
    """
    ranked = sorted(parts, key=lambda part: (_rate(part.columns), part.burst))
    masked: list[dict[str, Floats]] = []
    for k, part in enumerate(ranked):
        values = dict(part.columns.values)
        covered = np.zeros(values["t"].size, dtype=np.bool_)
        for better in ranked[k + 1 :]:
            if better.burst != part.burst:
                first, last = _span(better.columns)
                covered |= (values["t"] >= first) & (values["t"] <= last)
        if covered.any():
            values |= {name: np.where(covered, np.nan, values[name]) for name in _INERTIAL if name in values}
        masked.append(values)
    names = dict.fromkeys(name for part in parts for name in part.columns.values)
    joined = {name: np.concatenate([_filled(values, name) for values in masked]) for name in names}
    if (np.diff(joined["t"]) < 0.0).any():
        order = np.argsort(joined["t"], kind="stable")
        joined = {name: values[order] for name, values in joined.items()}
    _drop_repeated_fixes(joined)
    told = np.zeros(joined["t"].size, dtype=np.bool_)
    for name, values in joined.items():
        if name != "t":
            told |= ~np.isnan(values)
            if told.all():
                break
    return Columns(joined if told.all() else {name: values[told] for name, values in joined.items()})


def between(columns: Columns, first_s: float, last_s: float) -> Columns:
    """The rows of a span of the box's clock."""
    t = columns.values["t"]
    rows = (t >= first_s) & (t <= last_s)
    return Columns({name: values[rows] for name, values in columns.values.items()})


def _sampled(columns: Columns) -> Floats:
    force = columns.values.get("fx")
    return columns.values["t"] if force is None else columns.values["t"][~np.isnan(force)]


def _rate(columns: Columns) -> float:
    t = _sampled(columns)
    if (np.diff(t) < 0.0).any():
        t = np.sort(t)
    return 0.0 if t.size < 2 else 1.0 / max(float(np.median(np.diff(t))), 1e-9)


def _span(columns: Columns) -> tuple[float, float]:
    t = _sampled(columns)
    return (np.inf, -np.inf) if t.size == 0 else (float(t.min()), float(t.max()))


def _filled(values: dict[str, Floats], name: str) -> Floats:
    return values[name] if name in values else np.full(values["t"].size, np.nan)


def _drop_repeated_fixes(joined: dict[str, Floats]) -> None:
    names = [name for name in (*_FIX, "hdop", "sats", "utc") if name in joined]
    if not names:
        return
    told = np.zeros(joined["t"].size, dtype=np.bool_)
    for name in names:
        told |= ~np.isnan(joined[name])
    index = np.flatnonzero(told)
    again = index[1:][np.diff(joined["t"][index]) == 0.0]
    for name in names:
        values = joined[name].copy()
        values[again] = np.nan
        joined[name] = values
