from __future__ import annotations

import datetime as dt
from typing import Any

from sqlalchemy import BigInteger, CheckConstraint, ForeignKey, Index, LargeBinary, String, UniqueConstraint, text
from sqlalchemy.orm import Mapped, mapped_column

from server.models.base import Base, id_column

STREAMS = ("continuous", "burst")


class Batch(Base):
    """An accepted upload: where its blob lies, both hashes, its link in the chain, and whether it was worked off."""

    __tablename__ = "batch"
    __table_args__ = (
        UniqueConstraint("device_id", "stream", "boot", "sequence"),
        UniqueConstraint("device_id", "chain_index"),
        CheckConstraint(f"stream IN {STREAMS}", name="stream"),
        # The worker's question "what is due?" must not read what is done.
        Index(
            "ix_batch_due",
            "device_id",
            postgresql_where=text("processed_at IS NULL"),
            sqlite_where=text("processed_at IS NULL"),
        ),
        # "Which box has a burst that waits?" is asked before every device, however long the backlog is.
        Index(
            "ix_batch_burst_due",
            "device_id",
            postgresql_where=text("processed_at IS NULL AND stream = 'burst'"),
            sqlite_where=text("processed_at IS NULL AND stream = 'burst'"),
        ),
        Index("ix_batch_device_id_received_at", "device_id", "received_at"),
        # "What lies around this time?" is asked with every upload, and must not read all that a box ever sent.
        Index("ix_batch_clock", "device_id", "boot", "t_last_s", "t_first_s"),
        # Retention looks at what is still kept, and goes on with what it has not finished.
        Index(
            "ix_batch_kept",
            "device_id",
            "received_at",
            postgresql_where=text("erasing_at IS NULL"),
            sqlite_where=text("erasing_at IS NULL"),
        ),
        Index(
            "ix_batch_erasing",
            "device_id",
            postgresql_where=text("erasing_at IS NOT NULL AND erased_at IS NULL"),
            sqlite_where=text("erasing_at IS NOT NULL AND erased_at IS NULL"),
        ),
    )

    id: Mapped[str] = id_column()
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"))
    device_id: Mapped[str] = mapped_column(ForeignKey("device.id"))
    stream: Mapped[str] = mapped_column(String(10))
    boot: Mapped[str] = mapped_column(String(64))
    sequence: Mapped[int] = mapped_column(BigInteger)
    media_type: Mapped[str] = mapped_column(String(100))
    body_sha256: Mapped[str] = mapped_column(String(64))
    column_sha256: Mapped[str] = mapped_column(String(64))
    blob_sha256: Mapped[str | None] = mapped_column(String(64))
    """Of the blob's bytes as they were written: tells quickly that they are still those.  Of two batches
    that share a blob, written by two versions, one has the hash of other bytes, and those of before have none: for
    them the hash of the columns tells."""
    blob_key: Mapped[str] = mapped_column(String(300))
    body_key: Mapped[str | None] = mapped_column(String(300))
    stored_bytes: Mapped[int]
    rows: Mapped[int]
    t_first_s: Mapped[float]
    t_last_s: Mapped[float]
    received_at: Mapped[dt.datetime]
    sent_t_s: Mapped[float | None]
    """The box's clock when it sent the batch, where it told."""
    chain_index: Mapped[int]
    chain_sha256: Mapped[str] = mapped_column(String(64))
    remarks: Mapped[list[Any]] = mapped_column(default=list)
    processed_at: Mapped[dt.datetime | None]
    failure: Mapped[str | None] = mapped_column(String(500))
    erasing_at: Mapped[dt.datetime | None]
    """From when on nobody reads the raw data any more (`server.ingest.raw`); the row stays, with its hashes."""
    erased_at: Mapped[dt.datetime | None]
    """Set once its blobs are gone."""
    erasure_id: Mapped[str | None] = mapped_column(String(32))
    """The order by which it was erased; None by retention."""


class SequenceRun(Base):
    """A longest unbroken run of a boot's stored sequences: what is missing lies between two of them.

    Kept under the lock of the device's row, in the transaction that stores the batch: an upload needs no
    look at the batches that came before it.
    """

    __tablename__ = "sequence_run"

    device_id: Mapped[str] = mapped_column(ForeignKey("device.id", ondelete="CASCADE"), primary_key=True)
    stream: Mapped[str] = mapped_column(String(10), primary_key=True)
    boot: Mapped[str] = mapped_column(String(64), primary_key=True)
    first: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    last: Mapped[int] = mapped_column(BigInteger)


class BatchDigest(Base):
    """The conditioned content of a batch: what re-estimation needs, a few per cent of the raw size."""

    __tablename__ = "batch_digest"

    batch_id: Mapped[str] = mapped_column(ForeignKey("batch.id", ondelete="CASCADE"), primary_key=True)
    content: Mapped[bytes] = mapped_column(LargeBinary)
    clock_t_s: Mapped[float | None]
    """Box time at the middle of the batch's fixes that carry UTC."""
    clock_offset_s: Mapped[float | None]
    """Median of UTC minus box time over those fixes."""
