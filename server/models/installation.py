from __future__ import annotations

import datetime as dt
from typing import Any

from sqlalchemy import CheckConstraint, ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from server.models.base import Base, id_column

BEGINNINGS = ("first", "moved", "swapped", "manual")


class Installation(Base):
    """One box in one vehicle in one orientation; a moved box begins a new row."""

    __tablename__ = "installation"
    __table_args__ = (
        CheckConstraint(f"beginning IN {BEGINNINGS}", name="beginning"),
        Index("ix_installation_device_id_began_at", "device_id", "began_at"),
    )

    id: Mapped[str] = id_column()
    device_id: Mapped[str] = mapped_column(ForeignKey("device.id"))
    vehicle_id: Mapped[str | None] = mapped_column(ForeignKey("vehicle.id"), index=True)
    began_at: Mapped[dt.datetime]
    ended_at: Mapped[dt.datetime | None]
    beginning: Mapped[str] = mapped_column(String(10))
    moved_angle_rad: Mapped[float | None]
    manual_reason: Mapped[str | None] = mapped_column(String(500))
    updated_at: Mapped[dt.datetime]
    status: Mapped[str] = mapped_column(String(20))
    progress: Mapped[float] = mapped_column(default=0.0)
    result: Mapped[dict[str, Any]]
    """The mount JSON of the contract."""
    algorithm: Mapped[str] = mapped_column(String(60))
    input_sha256: Mapped[str] = mapped_column(String(64))
    unestimated_s: Mapped[float] = mapped_column(default=0.0)
    """Length of the data that came since the last estimate, and of the driving in it."""
    unestimated_moving_s: Mapped[float] = mapped_column(default=0.0)
    evidence: Mapped[list[Any]] = mapped_column(default=list, deferred=True)
    """What older data said, a chapter each (`server.jobs.chapters`); loaded by the worker alone."""
    raw_erased_at: Mapped[dt.datetime | None]
    """Since when some of the data that it rests on are erased."""


class MountingRevision(Base):
    """An estimate as it stood at a moment of the data: the history behind an installation."""

    __tablename__ = "mounting_revision"
    __table_args__ = (Index("ix_mounting_revision_installation_id_data_at", "installation_id", "data_at"),)

    id: Mapped[str] = id_column()
    installation_id: Mapped[str] = mapped_column(ForeignKey("installation.id", ondelete="CASCADE"))
    data_at: Mapped[dt.datetime]
    created_at: Mapped[dt.datetime]
    status: Mapped[str] = mapped_column(String(20))
    progress: Mapped[float]
    result: Mapped[dict[str, Any]]
    algorithm: Mapped[str] = mapped_column(String(60))
    input_sha256: Mapped[str] = mapped_column(String(64))
