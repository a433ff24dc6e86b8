"""Boxes whose work keeps failing, and re-runs of events by another version.

Revision ID: 0009
Revises: 0008
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import JSONB

revision: str = "0009"
down_revision: str | None = "0008"
branch_labels: str | None = None
depends_on: str | None = None

DOCUMENT = sa.JSON().with_variant(JSONB(), "postgresql")
OPEN_ITEM = sa.text("done_at IS NULL")


def upgrade() -> None:
    op.create_table(
        "job_failure",
        sa.Column("device_id", sa.String(length=32), nullable=False),
        sa.Column("failures", sa.Integer(), nullable=False),
        sa.Column("first_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("last_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("dead_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("error", sa.String(length=500), nullable=False),
        sa.Column("queue", sa.String(length=64), nullable=False),
        sa.Column("job_id", sa.String(length=64), nullable=False),
        sa.Column("request_id", sa.String(length=64), nullable=True),
        sa.ForeignKeyConstraint(
            ["device_id"], ["device.id"], name=op.f("fk_job_failure_device_id_device"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("device_id", name=op.f("pk_job_failure")),
    )
    op.create_table(
        "rerun",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("organisation_id", sa.String(length=32), nullable=False),
        sa.Column("device_id", sa.String(length=32), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("created_by", sa.String(length=254), nullable=False),
        sa.Column("algorithm", sa.String(length=60), nullable=False),
        sa.Column("total", sa.Integer(), nullable=False),
        sa.Column("finished_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("cancelled_at", sa.DateTime(timezone=True), nullable=True),
        sa.ForeignKeyConstraint(
            ["organisation_id"], ["organisation.id"], name=op.f("fk_rerun_organisation_id_organisation")
        ),
        sa.ForeignKeyConstraint(["device_id"], ["device.id"], name=op.f("fk_rerun_device_id_device")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_rerun")),
    )
    op.create_index("ix_rerun_organisation_id_created_at", "rerun", ["organisation_id", "created_at"])
    op.create_table(
        "rerun_item",
        sa.Column("rerun_id", sa.String(length=32), nullable=False),
        sa.Column("event_id", sa.String(length=32), nullable=False),
        sa.Column("ordinal", sa.Integer(), nullable=False),
        sa.Column("claimed_until", sa.DateTime(timezone=True), nullable=True),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("done_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("outcome", sa.String(length=20), nullable=True),
        sa.Column("error", sa.String(length=500), nullable=True),
        sa.Column("before", DOCUMENT, nullable=True),
        sa.Column("after", DOCUMENT, nullable=True),
        sa.Column("differences", DOCUMENT, nullable=False),
        sa.ForeignKeyConstraint(
            ["rerun_id"], ["rerun.id"], name=op.f("fk_rerun_item_rerun_id_rerun"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(
            ["event_id"], ["event.id"], name=op.f("fk_rerun_item_event_id_event"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("rerun_id", "event_id", name=op.f("pk_rerun_item")),
    )
    op.create_index(
        "ix_rerun_item_open",
        "rerun_item",
        ["rerun_id", "ordinal"],
        postgresql_where=OPEN_ITEM,
        sqlite_where=OPEN_ITEM,
    )


def downgrade() -> None:
    op.drop_table("rerun_item")
    op.drop_table("rerun")
    op.drop_table("job_failure")
