from __future__ import annotations

import datetime as dt
from typing import Any

from sqlalchemy import CheckConstraint, ForeignKey, Index, String, text
from sqlalchemy.orm import Mapped, mapped_column

from server.models.base import Base, id_column

DATA_CLASSES = ("raw", "tracks", "trips", "manoeuvres", "events", "diagnosis", "alerts", "changes", "audit")
SUBJECTS = ("vehicle", "user")


class RetentionRule(Base):
    """How long an organisation keeps one class of data; the trigger that guards `audit_entry` reads it too."""

    __tablename__ = "retention_rule"
    __table_args__ = (CheckConstraint(f"data_class IN {DATA_CLASSES}", name="data_class"),)

    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"), primary_key=True)
    data_class: Mapped[str] = mapped_column(String(20), primary_key=True)
    days: Mapped[int | None]
    """None: kept without end."""
    applies_at: Mapped[dt.datetime]
    """Before this nothing is removed: time to object to a default."""
    updated_at: Mapped[dt.datetime]
    updated_by: Mapped[str] = mapped_column(String(254))
    removed: Mapped[int] = mapped_column(default=0)
    """Removed and not yet told to the audit log; counted in the transactions that remove."""


class Erasure(Base):
    """An order to erase what is held about a vehicle or a user, and what became of it."""

    __tablename__ = "erasure"
    __table_args__ = (
        CheckConstraint(f"subject_kind IN {SUBJECTS}", name="subject_kind"),
        Index("ix_erasure_organisation_id_requested_at", "organisation_id", "requested_at"),
        Index(
            "ix_erasure_open",
            "requested_at",
            postgresql_where=text("finished_at IS NULL"),
            sqlite_where=text("finished_at IS NULL"),
        ),
    )

    id: Mapped[str] = id_column()
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"))
    subject_kind: Mapped[str] = mapped_column(String(10))
    subject_id: Mapped[str] = mapped_column(String(32))
    since: Mapped[dt.datetime | None]
    until: Mapped[dt.datetime | None]
    """A vehicle's data of this time alone: whoever drove it then."""
    reason: Mapped[str] = mapped_column(String(500))
    requested_at: Mapped[dt.datetime]
    requested_by: Mapped[str] = mapped_column(String(254))
    finished_at: Mapped[dt.datetime | None]
    """When the last blob was gone."""
    erased: Mapped[dict[str, Any]] = mapped_column(default=dict)
    """What was erased so far: kind of row to count."""
    kept: Mapped[list[Any]] = mapped_column(default=list)
    """What was not, and why."""
