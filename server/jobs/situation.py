"""What the worker reads of a device: one view before the work, and stored digests where it needs them."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from sqlalchemy import func, or_, select
from sqlalchemy.orm import Session, undefer

from nav_core.mounting.model import TrafficSide
from nav_core.typing import Floats
from server.jobs.clock import PAIRS
from server.jobs.digest import decode
from server.jobs.stretch import WINDOW_S, Piece
from server.models import (
    Assignment,
    Batch,
    BatchDigest,
    Boot,
    Device,
    DeviceState,
    Installation,
    MountingRevision,
    Trip,
    Vehicle,
)

CHUNK = 256

ROUND_ROWS = 4_000_000
"""Rows of a round's batches, unless one alone has more: bounds a round's memory, whatever a box packs into a batch.
Sixty-four batches of five minutes at 200 Hz have fewer."""


@dataclass(frozen=True, slots=True)
class Situation:
    """A device as it stood at `version`; the rows are detached, the write attaches them if the version still holds."""

    version: int | None
    device: Device
    state: DeviceState | None
    batches: Sequence[Batch]
    boots: dict[str, Boot]
    installations: list[Installation]
    assignments: Sequence[Assignment]
    last_arrival: dt.datetime | None
    traffic_sides: dict[str, TrafficSide | None]
    """By vehicle: which side of the road it drives on, where known."""
    more: bool
    """Whether further batches are due after these."""


def read_situation(session: Session, device_id: str, limit: int) -> Situation | None:
    """Read what one round needs, at most `limit` batches in the order of arrival and no more than `ROUND_ROWS`.

    None for an unknown device.

    Bursts come first, and in a round of their own: nobody who waits for a report waits for a backlog too.
    """
    # First of all: whatever changes after this shows in the version when the round writes.
    state = session.get(DeviceState, device_id)
    device = session.get(Device, device_id)
    if device is None:
        return None
    due = select(Batch).where(Batch.device_id == device_id, Batch.processed_at.is_(None))
    in_order = due.order_by(Batch.chain_index).limit(limit + 1)
    batches = session.scalars(in_order.where(Batch.stream == "burst")).all()
    alone = bool(batches)
    if not alone:
        batches = session.scalars(in_order).all()
    taken = _that_fit(batches[:limit], ROUND_ROWS)
    installations = (
        select(Installation)
        .where(Installation.device_id == device_id)
        .order_by(Installation.began_at)
        .options(undefer(Installation.evidence))
    )
    carried = select(Installation.vehicle_id).where(Installation.device_id == device_id)
    carrying = select(Assignment.vehicle_id).where(Assignment.device_id == device_id)
    vehicles = select(Vehicle.id, Vehicle.traffic_side).where(or_(Vehicle.id.in_(carried), Vehicle.id.in_(carrying)))
    assignments = select(Assignment).where(Assignment.device_id == device_id).order_by(Assignment.began_at)
    return Situation(
        version=state.version if state else None,
        device=device,
        state=state,
        batches=taken,
        boots={boot.boot: boot for boot in session.scalars(select(Boot).where(Boot.device_id == device_id))},
        installations=list(session.scalars(installations)),
        assignments=session.scalars(assignments).all(),
        more=len(batches) > len(taken) or (alone and _is_due(session, device_id)),
        last_arrival=session.scalar(select(func.max(Batch.received_at)).where(Batch.device_id == device_id)),
        traffic_sides={vehicle_id: cast("TrafficSide | None", side) for vehicle_id, side in session.execute(vehicles)},
    )


def _that_fit(batches: Sequence[Batch], most_rows: int) -> Sequence[Batch]:
    """The first batches up to so many rows, at least one."""
    rows = np.cumsum([batch.rows for batch in batches])
    return batches[: max(1, int(np.searchsorted(rows, most_rows, side="right")))]


def _is_due(session: Session, device_id: str) -> bool:
    due = Batch.device_id == device_id, Batch.processed_at.is_(None), Batch.stream == "continuous"
    return session.scalar(select(Batch.id).where(*due).limit(1)) is not None


def clock_pairs(session: Session, device_id: str, boot: str) -> tuple[Floats, Floats]:
    """Box time and UTC minus box time of the boot's newest stored batches that have both."""
    query = (
        select(BatchDigest.clock_t_s, BatchDigest.clock_offset_s)
        .join(Batch, Batch.id == BatchDigest.batch_id)
        .where(
            Batch.device_id == device_id,
            Batch.stream == "continuous",
            Batch.boot == boot,
            BatchDigest.clock_t_s.is_not(None),
        )
        .order_by(Batch.sequence.desc())
        .limit(PAIRS)
    )
    pairs = np.array([(t, offset) for t, offset in session.execute(query)], dtype=np.float64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def pieces_of_boot(
    session: Session, device_id: str, boot: str, *, after_s: float, before_s: float, newest_s: float | None = None
) -> list[Piece]:
    """Stored digests of a boot between two box times; with `newest_s` only the newest that long, newest first."""
    pieces: list[Piece] = []
    length = 0.0
    below: int | None = None
    while newest_s is None or length < newest_s:
        query = (
            select(Batch.sequence, Batch.t_first_s, Batch.t_last_s, Batch.column_sha256, BatchDigest.content)
            .join(BatchDigest, BatchDigest.batch_id == Batch.id)
            .where(Batch.device_id == device_id, Batch.stream == "continuous", Batch.boot == boot)
            # `+ 0.0` keeps SQLite off the index of the clock, by which it would sort all of a long boot for a page.
            .where(Batch.t_last_s + 0.0 > after_s, Batch.t_first_s < before_s)
            .order_by(Batch.sequence.desc())
            .limit(CHUNK)
        )
        rows = session.execute(query if below is None else query.where(Batch.sequence < below)).all()
        for sequence, t_first, t_last, column_sha256, content in rows:
            if newest_s is not None and length >= newest_s:
                break
            pieces.append(Piece(boot, sequence, t_first, t_last, column_sha256, decode(content)))
            length += t_last - t_first
        if len(rows) < CHUNK:
            break
        below = rows[-1].sequence
    return pieces


def pieces_between(
    session: Session, device_id: str, boots: Sequence[Boot], since_s: float, until_s: float
) -> list[Piece]:
    """Stored digests between two UTC times, the newest that fill an estimate's window."""
    pieces: list[Piece] = []
    length = 0.0
    for boot in sorted(boots, key=lambda boot: boot.unix_s(boot.t_first_s), reverse=True):
        after, before = boot.box_s(since_s), boot.box_s(until_s)
        if length >= WINDOW_S:
            break
        if boot.t_last_s <= after or boot.t_first_s >= before:
            continue
        found = pieces_of_boot(
            session, device_id, boot.boot, after_s=after, before_s=before, newest_s=WINDOW_S - length
        )
        length += sum(piece.t_last_s - piece.t_first_s for piece in found)
        pieces += found
    return pieces


def trips_of_boot(session: Session, device_id: str, boot: str) -> Sequence[Trip]:
    """Trips of a boot in the order of time."""
    query = select(Trip).where(Trip.device_id == device_id, Trip.boot == boot)
    return session.scalars(query.order_by(Trip.t_first_s)).all()


def last_revision(session: Session, installation_id: str, before: dt.datetime | None) -> MountingRevision | None:
    """The newest revision of an installation by the time of its data, of those with data before a moment only."""
    query = select(MountingRevision).where(MountingRevision.installation_id == installation_id)
    if before is not None:
        query = query.where(MountingRevision.data_at <= before)
    return session.scalar(query.order_by(MountingRevision.data_at.desc(), MountingRevision.created_at.desc()).limit(1))
