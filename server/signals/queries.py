"""Which blobs hold a window of time, and how the box sat meanwhile."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from server.errors import InvalidError, NotFoundError
from server.models import Batch, Boot, Device, Installation

MAX_ROWS = 2_000_000
"""About three hours at 200 Hz: what a request may read."""
MAX_BATCHES = 3000
MAX_COARSE_ROWS = 20_000_000
"""A day at 200 Hz: for a chart that is drawn from thinned batches."""
MAX_COARSE_BATCHES = 20_000


@dataclass(frozen=True)
class Piece:
    """A batch and the map from its box's clock to UTC."""

    blob_key: str
    utc_offset_s: float
    utc_drift: float
    t_first_s: float
    t_last_s: float


@dataclass(frozen=True)
class Mounting:
    """A stretch of time with one known mounting."""

    began_at: dt.datetime
    ended_at: dt.datetime | None
    R_va: list[list[float]]


def require_device(session: Session, organisation_id: str, device_id: str) -> None:
    """Raise unless the organisation has that box."""
    device = session.get(Device, device_id)
    if device is None or device.organisation_id != organisation_id:
        raise NotFoundError(f"There is no box {device_id}")


def newest(session: Session, device_id: str) -> dt.datetime | None:
    """UTC of the newest sample that has been worked off; None before any."""
    boot = session.scalars(
        select(Boot).where(Boot.device_id == device_id).order_by(Boot.ordinal.desc()).limit(1)
    ).first()
    return None if boot is None else boot.utc(boot.t_last_s)


def pieces(
    session: Session, device_id: str, begin: dt.datetime, end: dt.datetime, *, coarse: bool = False
) -> list[Piece]:
    """Batches of the continuous stream that reach into the window, in the order of time."""
    max_rows, max_batches = (MAX_COARSE_ROWS, MAX_COARSE_BATCHES) if coarse else (MAX_ROWS, MAX_BATCHES)
    found: list[tuple[float, Piece]] = []
    rows = 0
    for boot in _boots(session, device_id, begin, end):
        statement = (
            select(Batch.blob_key, Batch.rows, Batch.t_first_s, Batch.t_last_s)
            .where(Batch.device_id == device_id, Batch.boot == boot.boot, Batch.stream == "continuous")
            .where(Batch.t_last_s >= boot.box_s(begin.timestamp()), Batch.t_first_s <= boot.box_s(end.timestamp()))
            .where(Batch.failure.is_(None))
            .limit(max_batches + 1)
        )
        for blob_key, count, t_first_s, t_last_s in session.execute(statement):
            found.append(
                (boot.unix_s(t_first_s), Piece(blob_key, boot.utc_offset_s, boot.utc_drift, t_first_s, t_last_s))
            )
            rows += count
        if rows > max_rows or len(found) > max_batches:
            raise InvalidError(
                "The window holds too many samples for one answer; ask for a shorter one", code="window_too_long"
            )
    return [piece for _, piece in sorted(found, key=lambda item: item[0])]


def _boots(session: Session, device_id: str, begin: dt.datetime, end: dt.datetime) -> Sequence[Boot]:
    """Runs of the box's clock that reach into the window."""
    rate = 1.0 + Boot.utc_drift
    return session.scalars(
        select(Boot)
        .where(Boot.device_id == device_id)
        .where(Boot.utc_offset_s + rate * Boot.t_first_s <= end.timestamp())
        .where(Boot.utc_offset_s + rate * Boot.t_last_s >= begin.timestamp())
        .order_by(Boot.ordinal)
    ).all()


def mountings(session: Session, device_id: str, begin: dt.datetime, end: dt.datetime) -> list[Mounting]:
    """Known mountings during the window, in the order of time."""
    statement = (
        select(Installation)
        .where(Installation.device_id == device_id, Installation.began_at <= end)
        .where(Installation.ended_at.is_(None) | (Installation.ended_at >= begin))
        .order_by(Installation.began_at)
    )
    return [
        Mounting(row.began_at, row.ended_at, row.result["R_va"])
        for row in session.scalars(statement)
        if row.result.get("R_va") is not None
    ]
