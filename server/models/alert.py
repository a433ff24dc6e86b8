from __future__ import annotations

import datetime as dt
from typing import Any

from sqlalchemy import CheckConstraint, ForeignKey, Index, LargeBinary, String, UniqueConstraint, text
from sqlalchemy.orm import Mapped, mapped_column

from server.models.base import Base, id_column

RULE_KINDS = ("crash", "moved", "silent", "calibration", "harsh", "geofence", "theft")
CHANNEL_KINDS = ("email", "webhook")
DELIVERY_STATES = ("waiting", "delivered", "dead")


class AlertRule(Base):
    """What an organisation wants to be told of, and through which channels."""

    __tablename__ = "alert_rule"
    __table_args__ = (CheckConstraint(f"kind IN {RULE_KINDS}", name="kind"),)

    id: Mapped[str] = id_column()
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"), index=True)
    name: Mapped[str] = mapped_column(String(200))
    kind: Mapped[str] = mapped_column(String(20))
    enabled: Mapped[bool] = mapped_column(default=True)
    vehicle_id: Mapped[str | None] = mapped_column(ForeignKey("vehicle.id", ondelete="CASCADE"))
    """The one vehicle that it is about; none means the whole fleet."""
    parameters: Mapped[dict[str, Any]]
    channels: Mapped[list[Any]]
    """Ids of channels; the live page always knows."""
    cooldown_s: Mapped[float]
    """What happens again to the same box within it is counted, not told again."""
    created_at: Mapped[dt.datetime]


class AlertChannel(Base):
    """Where alerts go."""

    __tablename__ = "alert_channel"
    __table_args__ = (CheckConstraint(f"kind IN {CHANNEL_KINDS}", name="kind"),)

    id: Mapped[str] = id_column()
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"), index=True)
    name: Mapped[str] = mapped_column(String(200))
    kind: Mapped[str] = mapped_column(String(10))
    recipients: Mapped[list[Any]]
    """E-mail addresses, or the one address of a webhook."""
    secret: Mapped[str | None] = mapped_column(String(100))
    """Signs a webhook's bodies, so it must be kept as it is; shown once."""
    emergency: Mapped[bool] = mapped_column(default=False)
    """Whether emergency messages and theft go through it whatever the rules say."""
    enabled: Mapped[bool] = mapped_column(default=True)
    created_at: Mapped[dt.datetime]


class Alert(Base):
    """Something somebody wanted to be told of; written in the transaction of what caused it."""

    __tablename__ = "alert"
    __table_args__ = (
        # The same occurrence seen twice is one alert.
        UniqueConstraint("organisation_id", "occurrence"),
        Index("ix_alert_organisation_id_created_at", "organisation_id", "created_at"),
        Index("ix_alert_device_id_rule_id_created_at", "device_id", "rule_id", "created_at"),
        Index(
            "ix_alert_open",
            "organisation_id",
            postgresql_where=text("acknowledged_at IS NULL"),
            sqlite_where=text("acknowledged_at IS NULL"),
        ),
    )

    id: Mapped[str] = id_column()
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"))
    rule_id: Mapped[str | None] = mapped_column(String(32))
    """None for what is told without a rule: emergencies, and a vehicle armed by hand."""
    kind: Mapped[str] = mapped_column(String(20))
    severity: Mapped[str] = mapped_column(String(10))
    occurrence: Mapped[str] = mapped_column(String(200))
    device_id: Mapped[str] = mapped_column(ForeignKey("device.id"))
    vehicle_id: Mapped[str | None] = mapped_column(String(32))
    event_id: Mapped[str | None] = mapped_column(String(32))
    at: Mapped[dt.datetime]
    """When it happened."""
    created_at: Mapped[dt.datetime]
    facts: Mapped[dict[str, Any]]
    repeats: Mapped[int] = mapped_column(default=0)
    """How often it happened again within the cool-down."""
    repeated_at: Mapped[dt.datetime | None]
    recovered_at: Mapped[dt.datetime | None]
    """When what was wrong was right again, or turned out not to have been."""
    acknowledged_at: Mapped[dt.datetime | None]
    acknowledged_by: Mapped[str | None] = mapped_column(String(254))


class AlertDelivery(Base):
    """A message that is owed: the outbox.  Its id is the idempotency key that the receiver sees."""

    __tablename__ = "alert_delivery"
    __table_args__ = (
        UniqueConstraint("alert_id", "channel_id", "reason"),
        CheckConstraint(f"state IN {DELIVERY_STATES}", name="state"),
        Index(
            "ix_alert_delivery_due",
            "priority",
            "due_at",
            postgresql_where=text("state = 'waiting'"),
            sqlite_where=text("state = 'waiting'"),
        ),
        Index(
            "ix_alert_delivery_dead",
            "organisation_id",
            postgresql_where=text("state = 'dead'"),
            sqlite_where=text("state = 'dead'"),
        ),
        Index("ix_alert_delivery_organisation_id_created_at", "organisation_id", "created_at"),
    )

    id: Mapped[str] = id_column()
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"))
    alert_id: Mapped[str] = mapped_column(ForeignKey("alert.id", ondelete="CASCADE"))
    channel_id: Mapped[str] = mapped_column(String(32))
    reason: Mapped[str] = mapped_column(String(10))
    """``raised``, or ``recovered``."""
    priority: Mapped[int]
    """0 for emergencies, which have a sender of their own; 1 for the rest."""
    state: Mapped[str] = mapped_column(String(10), default="waiting")
    created_at: Mapped[dt.datetime]
    due_at: Mapped[dt.datetime]
    """When it is to be tried; while it is being tried, when another worker may take it for lost."""
    attempts: Mapped[int] = mapped_column(default=0)
    finished_at: Mapped[dt.datetime | None]
    error: Mapped[str | None] = mapped_column(String(500))
    body: Mapped[bytes | None] = mapped_column(LargeBinary)
    """What was sent first: every further attempt sends the same."""


class DeliveryAttempt(Base):
    """One try at a delivery; only added to."""

    __tablename__ = "delivery_attempt"
    __table_args__ = (Index("ix_delivery_attempt_delivery_id_began_at", "delivery_id", "began_at"),)

    id: Mapped[str] = id_column()
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"))
    delivery_id: Mapped[str] = mapped_column(ForeignKey("alert_delivery.id", ondelete="CASCADE"))
    number: Mapped[int]
    began_at: Mapped[dt.datetime]
    ended_at: Mapped[dt.datetime | None]
    """None when the worker that tried was lost on the way."""
    outcome: Mapped[str | None] = mapped_column(String(10))
    """``delivered``, ``failed``."""
    status: Mapped[int | None]
    """HTTP or SMTP."""
    detail: Mapped[str | None] = mapped_column(String(500))


class GeofencePresence(Base):
    """Whether a box was inside of a rule's fence when it was last seen."""

    __tablename__ = "geofence_presence"

    rule_id: Mapped[str] = mapped_column(ForeignKey("alert_rule.id", ondelete="CASCADE"), primary_key=True)
    device_id: Mapped[str] = mapped_column(ForeignKey("device.id", ondelete="CASCADE"), primary_key=True)
    inside: Mapped[bool]
    at: Mapped[dt.datetime]
    """Of the newest fix that was looked at."""


class TheftWatch(Base):
    """A vehicle that somebody armed, or that was found moving without ignition."""

    __tablename__ = "theft_watch"

    vehicle_id: Mapped[str] = mapped_column(ForeignKey("vehicle.id", ondelete="CASCADE"), primary_key=True)
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"), index=True)
    armed_at: Mapped[dt.datetime | None]
    """Armed by hand: any movement is theft, whatever the ignition says."""
    armed_by: Mapped[str | None] = mapped_column(String(254))
    alarm_at: Mapped[dt.datetime | None]
    """Since when it moves as it should not; the box is asked to report often until this is cleared."""


class AccidentClaim(Base):
    """An accident that somebody says a vehicle had, and what the recorded data show of it."""

    __tablename__ = "accident_claim"

    id: Mapped[str] = id_column()
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"), index=True)
    vehicle_id: Mapped[str] = mapped_column(ForeignKey("vehicle.id"), index=True)
    reference: Mapped[str] = mapped_column(String(200))
    began_at: Mapped[dt.datetime]
    ended_at: Mapped[dt.datetime]
    direction_deg: Mapped[float | None]
    note: Mapped[str | None] = mapped_column(String(2000))
    created_at: Mapped[dt.datetime]
    created_by: Mapped[str] = mapped_column(String(254))
    answer: Mapped[dict[str, Any]]
    """What the data showed when it was asked; asked again, it is another claim's row."""
