from __future__ import annotations

import datetime as dt
from typing import Any

from sqlalchemy import ForeignKey, String, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column

from server.models.base import Base, id_column


class Device(Base):
    """A box: who may upload as it, and the head of its evidence chain."""

    __tablename__ = "device"
    __table_args__ = (UniqueConstraint("organisation_id", "idempotency_key"),)

    id: Mapped[str] = id_column()
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"))
    name: Mapped[str] = mapped_column(String(200))
    token_hash: Mapped[str] = mapped_column(String(64), unique=True)
    idempotency_key: Mapped[str | None] = mapped_column(String(200))
    created_at: Mapped[dt.datetime]
    revoked_at: Mapped[dt.datetime | None]
    vehicle_id: Mapped[str | None] = mapped_column(ForeignKey("vehicle.id"), index=True)
    chain_length: Mapped[int] = mapped_column(default=0)
    chain_head: Mapped[str] = mapped_column(String(64), default="")
    last_seen_at: Mapped[dt.datetime | None]
    reference_mountings: Mapped[list[Any]] = mapped_column(default=list)
    """Mountings known from elsewhere (measured, or a simulation's truth), shown beside the estimate:
    ``[{"from": ISO time, "R_va": [[...]]}, ...]`` in the order of time."""


class DeviceState(Base):
    """What the worker knows of a box; `version` makes its writes optimistic."""

    __tablename__ = "device_state"

    device_id: Mapped[str] = mapped_column(ForeignKey("device.id"), primary_key=True)
    version: Mapped[int] = mapped_column(default=0)
    updated_at: Mapped[dt.datetime]
    position_at: Mapped[dt.datetime | None]
    lat_deg: Mapped[float | None]
    lon_deg: Mapped[float | None]
    speed_mps: Mapped[float | None]
    course_rad: Mapped[float | None]
    health: Mapped[dict[str, Any]] = mapped_column(default=dict)
    review_at: Mapped[dt.datetime | None] = mapped_column(index=True)
    """When the worker wants to look again even if nothing new arrives: an estimate or a trip is left open."""


class Boot(Base):
    """One run of a box's clock, and how that clock maps to UTC: ``utc = utc_offset_s + (1 + utc_drift) * t``."""

    __tablename__ = "boot"

    device_id: Mapped[str] = mapped_column(ForeignKey("device.id"), primary_key=True)
    boot: Mapped[str] = mapped_column(String(64), primary_key=True)
    ordinal: Mapped[int]
    utc_offset_s: Mapped[float]
    utc_drift: Mapped[float] = mapped_column(default=0.0)
    utc_sigma_s: Mapped[float]
    utc_source: Mapped[str] = mapped_column(String(10))
    """`gnss` when fixes carried UTC, else `arrival`."""
    arrival_offset_s: Mapped[float]
    """The smallest time of arrival minus box time of the last sample that any batch had."""
    t_first_s: Mapped[float]
    t_last_s: Mapped[float]
    trip_state: Mapped[dict[str, Any]] = mapped_column(default=dict)
    """Where the reckoning of trips stands, so that the next batch continues it."""

    def unix_s(self, t_s: float) -> float:
        """Unix time of a box time."""
        return self.utc_offset_s + (1.0 + self.utc_drift) * t_s

    def box_s(self, unix_s: float) -> float:
        """Box time of a Unix time."""
        return (unix_s - self.utc_offset_s) / (1.0 + self.utc_drift)

    def utc(self, t_s: float) -> dt.datetime:
        """UTC of a box time."""
        return dt.datetime.fromtimestamp(self.unix_s(t_s), dt.UTC)
