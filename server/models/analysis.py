from __future__ import annotations

import datetime as dt
from typing import Any

from sqlalchemy import CheckConstraint, ForeignKey, Index, String, text
from sqlalchemy.orm import Mapped, mapped_column

from server.models.base import Base, id_column

STATUSES = ("waiting", "running", "done", "failed", "cancelled")


class Analysis(Base):
    """A recording that an engineer wants analysed, and what came out of it."""

    __tablename__ = "analysis"
    __table_args__ = (
        CheckConstraint(f"status IN {STATUSES}", name="status"),
        Index("ix_analysis_organisation_id_created_at", "organisation_id", "created_at"),
        # The worker's question "what is due?" must not read what is done.
        Index(
            "ix_analysis_due",
            "created_at",
            postgresql_where=text("status IN ('waiting', 'running')"),
            sqlite_where=text("status IN ('waiting', 'running')"),
        ),
    )

    id: Mapped[str] = id_column()
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"))
    user_id: Mapped[str | None] = mapped_column(ForeignKey("user_account.id"))
    creator: Mapped[str] = mapped_column(String(254))
    """The name of who asked, as it was then."""
    kind: Mapped[str] = mapped_column(String(20))
    name: Mapped[str] = mapped_column(String(200))
    """Of the file, or of the trip's vehicle or box."""
    device_id: Mapped[str | None] = mapped_column(ForeignKey("device.id", ondelete="CASCADE"), index=True)
    """The box whose stored data are the input; None for an uploaded file."""
    boot: Mapped[str | None] = mapped_column(String(64))
    t_first_s: Mapped[float | None]
    t_last_s: Mapped[float | None]
    """The trip's stretch of the box's clock; the row of a trip may be replaced when data come late."""
    input_key: Mapped[str | None] = mapped_column(String(300))
    input_bytes: Mapped[int] = mapped_column(default=0)
    input_sha256: Mapped[str] = mapped_column(String(64), default="")
    """Of the file, or of the columns of the stretch, known once it ran."""
    parameters: Mapped[dict[str, Any]]
    status: Mapped[str] = mapped_column(String(10), default="waiting")
    progress: Mapped[float] = mapped_column(default=0.0)
    stage: Mapped[str] = mapped_column(String(200), default="")
    attempts: Mapped[int] = mapped_column(default=0)
    """How often a worker began; also the token without which a worker that was given up writes nothing."""
    leased_until: Mapped[dt.datetime | None]
    """A running analysis whose worker has not renewed this is due again."""
    created_at: Mapped[dt.datetime]
    finished_at: Mapped[dt.datetime | None]
    algorithm: Mapped[str] = mapped_column(String(60), default="")
    result_key: Mapped[str | None] = mapped_column(String(300))
    result_sha256: Mapped[str | None] = mapped_column(String(64))
    error: Mapped[str | None] = mapped_column(String(1000))
