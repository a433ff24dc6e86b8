from __future__ import annotations

import datetime as dt
from typing import Any

from sqlalchemy import CheckConstraint, ForeignKey, Index, LargeBinary, String, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column

from server.models.base import Base, id_column

CRASHES = ("crash", "rollover", "parked_impact")
HARSH = ("harsh_braking", "harsh_acceleration", "harsh_cornering")
VERDICTS = ("confirmed", "false_alarm")
ACTIONS = ("confirmed", "false_alarm", "reopened", "held", "released")


class Event(Base):
    """Something that happened on a drive, as its newest revision tells it, and what people say of it."""

    __tablename__ = "event"
    __table_args__ = (
        CheckConstraint(f"verdict IN {VERDICTS}", name="verdict"),
        Index("ix_event_organisation_id_at", "organisation_id", "at"),
        Index("ix_event_device_id_at", "device_id", "at"),
        Index("ix_event_vehicle_id_at", "vehicle_id", "at"),
    )

    id: Mapped[str] = id_column()
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"))
    device_id: Mapped[str] = mapped_column(ForeignKey("device.id"))
    vehicle_id: Mapped[str | None] = mapped_column(ForeignKey("vehicle.id"))
    boot: Mapped[str] = mapped_column(String(64))
    kind: Mapped[str] = mapped_column(String(20))
    severe: Mapped[bool]
    """Whether it is reconstructed and kept with every revision, not a mere manoeuvre."""
    t0_s: Mapped[float]
    t_end_s: Mapped[float]
    at: Mapped[dt.datetime]
    """UTC of time zero by the boot's clock."""
    created_at: Mapped[dt.datetime]
    updated_at: Mapped[dt.datetime]
    revision: Mapped[int]
    result: Mapped[dict[str, Any]]
    """The crash JSON of the contract, of the newest revision."""
    withdrawn_at: Mapped[dt.datetime | None]
    """When data that came later showed that there was no such event; it is kept and no longer listed."""
    verdict: Mapped[str | None] = mapped_column(String(20))
    note: Mapped[str | None] = mapped_column(String(2000))
    reviewed_at: Mapped[dt.datetime | None]
    held_at: Mapped[dt.datetime | None]
    """Since when a legal hold keeps the event and its raw data from retention and erasure."""
    hold_reason: Mapped[str | None] = mapped_column(String(500))
    raw_erased_at: Mapped[dt.datetime | None]
    """Since when raw data that it rests on are erased: it cannot be computed again."""
    erased_at: Mapped[dt.datetime | None]
    """Since when it is a tombstone: results, documents and notes are gone, hashes and times stay."""
    erasure_id: Mapped[str | None] = mapped_column(String(32))


class EventRevision(Base):
    """What was computed of an event from the data of a moment; never changed."""

    __tablename__ = "event_revision"
    __table_args__ = (UniqueConstraint("event_id", "number"),)

    id: Mapped[str] = id_column()
    event_id: Mapped[str] = mapped_column(ForeignKey("event.id", ondelete="CASCADE"))
    number: Mapped[int]
    created_at: Mapped[dt.datetime]
    installation_id: Mapped[str | None] = mapped_column(String(32))
    algorithm: Mapped[str] = mapped_column(String(60))
    input_sha256: Mapped[str] = mapped_column(String(64))
    event_sha256: Mapped[str] = mapped_column(String(64))
    """Of the canonical JSON."""
    document: Mapped[bytes] = mapped_column(LargeBinary)
    """The canonical JSON, zstd; empty once the event is erased."""
    device_name: Mapped[str | None] = mapped_column(String(200))
    vehicle_name: Mapped[str | None] = mapped_column(String(200))
    plate: Mapped[str | None] = mapped_column(String(20))
    """As they were called then: the report of a revision names them, and must stay the same when they are renamed."""


class EventInput(Base):
    """A batch that an event rests on; as long as this row is there the database refuses to lose the batch."""

    __tablename__ = "event_input"

    event_id: Mapped[str] = mapped_column(ForeignKey("event.id", ondelete="CASCADE"), primary_key=True)
    batch_id: Mapped[str] = mapped_column(ForeignKey("batch.id"), primary_key=True, index=True)


class EventAction(Base):
    """What somebody said or ordered of an event; only added to."""

    __tablename__ = "event_action"
    __table_args__ = (
        CheckConstraint(f"action IN {ACTIONS}", name="action"),
        Index("ix_event_action_event_id_at", "event_id", "at"),
    )

    id: Mapped[str] = id_column()
    event_id: Mapped[str] = mapped_column(ForeignKey("event.id", ondelete="CASCADE"))
    at: Mapped[dt.datetime]
    actor: Mapped[str] = mapped_column(String(254))
    action: Mapped[str] = mapped_column(String(20))
    note: Mapped[str | None] = mapped_column(String(2000))


class ChainSeal(Base):
    """A device's chain as it stood, signed and timestamped: nobody can rewrite what lies before it."""

    __tablename__ = "chain_seal"
    __table_args__ = (UniqueConstraint("device_id", "chain_length"),)

    id: Mapped[str] = id_column()
    device_id: Mapped[str] = mapped_column(ForeignKey("device.id"))
    chain_length: Mapped[int]
    chain_head: Mapped[str] = mapped_column(String(64))
    sealed_at: Mapped[dt.datetime]
    public_key: Mapped[str | None] = mapped_column(String(64))
    """Ed25519, hexadecimal; None where the operator set no key."""
    signature: Mapped[str | None] = mapped_column(String(128))
    timestamp_token: Mapped[bytes | None] = mapped_column(LargeBinary)
    """RFC 3161 response, DER; None where the operator set no authority."""
