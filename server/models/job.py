from __future__ import annotations

import datetime as dt
from typing import Any

from sqlalchemy import ForeignKey, Index, String, text
from sqlalchemy.orm import Mapped, mapped_column

from server.models.base import Base, id_column

OPEN_ITEM = text("done_at IS NULL")


class JobFailure(Base):
    """A box whose work keeps failing; gone with the first success."""

    __tablename__ = "job_failure"

    device_id: Mapped[str] = mapped_column(ForeignKey("device.id", ondelete="CASCADE"), primary_key=True)
    failures: Mapped[int]
    """In a row."""
    first_at: Mapped[dt.datetime]
    last_at: Mapped[dt.datetime]
    dead_at: Mapped[dt.datetime | None]
    """Since when it counts as a dead letter: it is tried again seldom, unless somebody replays it."""
    error: Mapped[str] = mapped_column(String(500))
    queue: Mapped[str] = mapped_column(String(64))
    job_id: Mapped[str] = mapped_column(String(64))
    request_id: Mapped[str | None] = mapped_column(String(64))


class JobAttempt(Base):
    """A box that a worker may have died at: attempts in a row that nobody answered for, the present one among them."""

    __tablename__ = "job_attempt"

    device_id: Mapped[str] = mapped_column(ForeignKey("device.id", ondelete="CASCADE"), primary_key=True)
    unanswered: Mapped[int]
    job_id: Mapped[str] = mapped_column(String(64))
    began_at: Mapped[dt.datetime]


class Rerun(Base):
    """Events of an organisation computed again by another version."""

    __tablename__ = "rerun"
    __table_args__ = (Index("ix_rerun_organisation_id_created_at", "organisation_id", "created_at"),)

    id: Mapped[str] = id_column()
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"))
    device_id: Mapped[str | None] = mapped_column(ForeignKey("device.id"))
    created_at: Mapped[dt.datetime]
    created_by: Mapped[str] = mapped_column(String(254))
    algorithm: Mapped[str] = mapped_column(String(60))
    """The version that was asked for: only workers of this version take part."""
    total: Mapped[int]
    finished_at: Mapped[dt.datetime | None]
    cancelled_at: Mapped[dt.datetime | None]


class RerunItem(Base):
    """One event of a re-run: who works on it until when, and how it came out."""

    __tablename__ = "rerun_item"
    __table_args__ = (
        Index("ix_rerun_item_open", "rerun_id", "ordinal", postgresql_where=OPEN_ITEM, sqlite_where=OPEN_ITEM),
    )

    rerun_id: Mapped[str] = mapped_column(ForeignKey("rerun.id", ondelete="CASCADE"), primary_key=True)
    event_id: Mapped[str] = mapped_column(ForeignKey("event.id", ondelete="CASCADE"), primary_key=True)
    ordinal: Mapped[int]
    claimed_until: Mapped[dt.datetime | None]
    attempts: Mapped[int] = mapped_column(default=0)
    done_at: Mapped[dt.datetime | None]
    outcome: Mapped[str | None] = mapped_column(String(20))
    error: Mapped[str | None] = mapped_column(String(500))
    before: Mapped[dict[str, Any] | None]
    after: Mapped[dict[str, Any] | None]
    """Version, revision and figures of the event before and after."""
    differences: Mapped[list[Any]] = mapped_column(default=list)
    """Members of the canonical JSON that differ."""
