from __future__ import annotations

import datetime as dt
from typing import Any

from sqlalchemy import BigInteger, ForeignKey, Index, String, UniqueConstraint, text
from sqlalchemy.orm import Mapped, mapped_column

from server.models.base import Base, id_column


class Device(Base):
    """A box: who may upload as it, and the head of its evidence chain."""

    __tablename__ = "device"
    __table_args__ = (
        UniqueConstraint("organisation_id", "idempotency_key"),
        Index("ix_device_next_token_hash", "next_token_hash", unique=True),
    )

    id: Mapped[str] = id_column()
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"))
    name: Mapped[str] = mapped_column(String(200))
    token_hash: Mapped[str] = mapped_column(String(64), unique=True)
    next_token_hash: Mapped[str | None] = mapped_column(String(64))
    """A token that the box asked for and has not used yet; its first use ends the one before."""
    signed_only: Mapped[bool] = mapped_column(default=False)
    """Whether the token itself is refused and only signed requests are taken."""
    idempotency_key: Mapped[str | None] = mapped_column(String(200))
    created_at: Mapped[dt.datetime]
    revoked_at: Mapped[dt.datetime | None]
    vehicle_id: Mapped[str | None] = mapped_column(ForeignKey("vehicle.id"), index=True)
    chain_length: Mapped[int] = mapped_column(default=0)
    chain_head: Mapped[str] = mapped_column(String(64), default="")
    last_seen_at: Mapped[dt.datetime | None]
    configuration: Mapped[dict[str, Any] | None]
    """What the box is told to use, and which version of it the box said to have."""
    configuration_version: Mapped[int] = mapped_column(default=0)
    configuration_seen: Mapped[int | None]
    bytes_per_day: Mapped[int | None] = mapped_column(BigInteger)
    """Its own quota; the installation's where there is none."""
    quota_day: Mapped[dt.date | None]
    quota_bytes: Mapped[int] = mapped_column(BigInteger, default=0)
    """Bytes stored of it on `quota_day`, UTC."""
    reference_mountings: Mapped[list[Any]] = mapped_column(default=list)
    """Mountings known from elsewhere (measured, or a simulation's truth), shown beside the estimate:
    ``[{"from": ISO time, "R_va": [[...]]}, ...]`` in the order of time."""


class ClaimCode(Base):
    """A code that a box trades for its token; only its hash is kept."""

    __tablename__ = "claim_code"

    code_hash: Mapped[str] = mapped_column(String(64), primary_key=True)
    device_id: Mapped[str] = mapped_column(ForeignKey("device.id", ondelete="CASCADE"), index=True)
    created_at: Mapped[dt.datetime]
    expires_at: Mapped[dt.datetime]
    claimed_at: Mapped[dt.datetime | None]


class DeviceRequest(Base):
    """A stretch of its clock that a box is asked to send as a burst; told with every answer until it is closed."""

    __tablename__ = "device_request"
    __table_args__ = (
        Index(
            "ix_device_request_open",
            "device_id",
            postgresql_where=text("closed_at IS NULL"),
            sqlite_where=text("closed_at IS NULL"),
        ),
    )

    id: Mapped[str] = id_column()
    device_id: Mapped[str] = mapped_column(ForeignKey("device.id", ondelete="CASCADE"))
    boot: Mapped[str] = mapped_column(String(64))
    t_first_s: Mapped[float]
    t_last_s: Mapped[float]
    reason: Mapped[str] = mapped_column(String(200))
    created_at: Mapped[dt.datetime]
    expires_at: Mapped[dt.datetime]
    closed_at: Mapped[dt.datetime | None]
    outcome: Mapped[str | None] = mapped_column(String(10))
    """``answered``, or ``cancelled``."""
    batch_id: Mapped[str | None] = mapped_column(String(32))
    """The batch that answered."""


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


class Diagnosis(Base):
    """A named value of the vehicle beside the streams: at most one a minute, and only where it changed."""

    __tablename__ = "diagnosis"

    device_id: Mapped[str] = mapped_column(ForeignKey("device.id"), primary_key=True)
    name: Mapped[str] = mapped_column(String(64), primary_key=True)
    at: Mapped[dt.datetime] = mapped_column(primary_key=True)
    value: Mapped[float]
