"""What a box feels just now: the newest second of its specific force, and how upright that says it stands.

For the installer who levels a box by hand (001 §3.2) and for the live arrows of the 3D view.  A second's mean is the
state of a box, like its speed at the last fix; it is not the recording, so it needs no permission for raw data.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session

from nav_core.by_hand import LevelCheck, check_level, levelled, orientations
from nav_core.earth import STANDARD_GRAVITY
from nav_core.typing import Floats
from server.errors import ConflictError
from server.formats.columns import Columns
from server.models import Batch, Boot
from server.store import BlobStore

WINDOW_S = 1.0
"""Long enough for an idling engine to average out, short enough to follow a hand."""
STILL_MPS2 = 0.6
"""Scatter per axis, 1-sigma, above which somebody is still moving the box."""
FRESH_FOR = dt.timedelta(seconds=30)
"""How long a measurement tells of now; a box that levels should send every few seconds."""
SIGMA_DEG = {"x": 2.0, "y": 2.0, "z": 5.0}
"""1-sigma of a mounting set this way: roads and yards are level to about 2°, and the eye finds straight ahead to
about 5° (001 §3.2 warns of the second)."""
_TRIAD = ("fx", "fy", "fz")
_LOOK_BACK = 5


@dataclass(frozen=True, slots=True)
class Source:
    """An upload in which the newest second may be."""

    blob_key: str
    boot: str
    received_at: dt.datetime
    utc_offset_s: float | None
    """None before the worker has placed the boot in time."""
    utc_drift: float


@dataclass(frozen=True, slots=True)
class Feel:
    """The newest second of a box's specific force."""

    f_a: Floats
    """Mean, A-frame, m/s²."""
    scatter: Floats
    """1-sigma of the samples per axis, m/s²."""
    samples: int
    received_at: dt.datetime
    at: dt.datetime | None
    """When the last sample was taken, where the box's clock is known."""

    @property
    def still(self) -> bool:
        """Whether nobody moves the box."""
        return bool(self.scatter.max() <= STILL_MPS2)


@dataclass(frozen=True, slots=True)
class Level:
    """Whether the box stands on one of its axes, and the mountings that remain to choose from if it does."""

    feel: Feel
    check: LevelCheck
    choices: tuple[Floats, ...]
    """Four `R_va`, the measured tilt taken out; none while the box does not stand upright."""

    @property
    def ok(self) -> bool:
        """Whether it may be confirmed."""
        return self.check.ok and self.feel.still


def sources(session: Session, device_id: str) -> list[Source]:
    """The newest uploads of the continuous stream, newest first."""
    statement = (
        select(Batch.blob_key, Batch.boot, Batch.received_at, Boot.utc_offset_s, Boot.utc_drift)
        .outerjoin(Boot, (Boot.device_id == Batch.device_id) & (Boot.boot == Batch.boot))
        .where(Batch.device_id == device_id, Batch.stream == "continuous", Batch.failure.is_(None))
        .where(Batch.erasing_at.is_(None))
        .order_by(Batch.received_at.desc(), Batch.t_last_s.desc())
        .limit(_LOOK_BACK)
    )
    return [Source(key, boot, at, offset, drift or 0.0) for key, boot, at, offset, drift in session.execute(statement)]


def feel(store: BlobStore, found: Sequence[Source]) -> Feel | None:
    """The newest second that holds specific force; None where no upload has any."""
    for source in found:
        try:
            columns = Columns.from_parquet(store.get(source.blob_key)).values
        except KeyError:
            continue  # erased meanwhile
        if not all(name in columns for name in _TRIAD):
            continue
        t, f = columns["t"], np.column_stack([columns[name] for name in _TRIAD])
        known = np.isfinite(f).all(axis=1)
        t, f = t[known], f[known]
        if not t.size:
            continue
        last = float(t.max())
        rows = f[t > last - WINDOW_S]
        at = None
        if source.utc_offset_s is not None:
            at = dt.datetime.fromtimestamp(source.utc_offset_s + (1.0 + source.utc_drift) * last, dt.UTC)
        return Feel(rows.mean(axis=0), rows.std(axis=0), len(rows), source.received_at, at)
    return None


def level_of(felt: Feel) -> Level | None:
    """The check of 001 §3.2 on what the box feels; None in free fall, where there is no vertical."""
    if not float(np.linalg.norm(felt.f_a)) > 0.1 * STANDARD_GRAVITY:
        return None
    check = check_level(felt.f_a, gravity=STANDARD_GRAVITY)
    choices = tuple(levelled(R_va, felt.f_a) for R_va in orientations(check.axis, check.sign)) if check.ok else ()
    return Level(felt, check, choices)


def confirmed(level: Level | None, *, axis: int, sign: int, choice: int, now: dt.datetime) -> Floats:
    """`R_va` of the orientation that the installer chose, if the box still stands as it did when he looked.

    Raises ConflictError.
    """
    if level is None or now - level.feel.received_at > FRESH_FOR:
        raise ConflictError("The box has sent nothing for a while: wait for fresh data", code="level_stale")
    if (level.check.axis, level.check.sign) != (axis, sign):
        raise ConflictError("The box was turned since: look again", code="level_turned")
    if not level.ok:
        raise ConflictError("The box does not stand upright and still", code="not_level")
    return level.choices[choice]


__all__ = ["FRESH_FOR", "SIGMA_DEG", "Feel", "Level", "confirmed", "feel", "level_of", "sources"]
