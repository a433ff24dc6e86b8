"""Claim codes, box-side rotation, configuration, requests, quotas.

Revision ID: 0002
Revises: 0001
"""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import JSONB

revision: str = "0002"
down_revision: str | None = "0001"
branch_labels: str | None = None
depends_on: str | None = None

DOCUMENT = sa.JSON().with_variant(JSONB(), "postgresql")
OPEN = sa.text("closed_at IS NULL")


def device_columns() -> list[sa.Column[Any]]:
    return [
        sa.Column("next_token_hash", sa.String(length=64), nullable=True),
        sa.Column("signed_only", sa.Boolean(), nullable=False, server_default=sa.false()),
        sa.Column("configuration", DOCUMENT, nullable=True),
        sa.Column("configuration_version", sa.Integer(), nullable=False, server_default="0"),
        sa.Column("configuration_seen", sa.Integer(), nullable=True),
        sa.Column("bytes_per_day", sa.BigInteger(), nullable=True),
        sa.Column("quota_day", sa.Date(), nullable=True),
        sa.Column("quota_bytes", sa.BigInteger(), nullable=False, server_default="0"),
    ]


def upgrade() -> None:
    # Added one by one, SQLite need not copy the table.
    for column in device_columns():
        op.add_column("device", column)
    op.create_index("ix_device_next_token_hash", "device", ["next_token_hash"], unique=True)
    op.add_column("batch", sa.Column("sent_t_s", sa.Double(), nullable=True))
    op.create_table(
        "claim_code",
        sa.Column("code_hash", sa.String(length=64), nullable=False),
        sa.Column("device_id", sa.String(length=32), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("claimed_at", sa.DateTime(timezone=True), nullable=True),
        sa.ForeignKeyConstraint(
            ["device_id"], ["device.id"], name=op.f("fk_claim_code_device_id_device"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("code_hash", name=op.f("pk_claim_code")),
    )
    op.create_index(op.f("ix_claim_code_device_id"), "claim_code", ["device_id"])
    op.create_table(
        "device_request",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("device_id", sa.String(length=32), nullable=False),
        sa.Column("boot", sa.String(length=64), nullable=False),
        sa.Column("t_first_s", sa.Double(), nullable=False),
        sa.Column("t_last_s", sa.Double(), nullable=False),
        sa.Column("reason", sa.String(length=200), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("closed_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("outcome", sa.String(length=10), nullable=True),
        sa.Column("batch_id", sa.String(length=32), nullable=True),
        sa.ForeignKeyConstraint(
            ["device_id"], ["device.id"], name=op.f("fk_device_request_device_id_device"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_device_request")),
    )
    op.create_index("ix_device_request_open", "device_request", ["device_id"], postgresql_where=OPEN, sqlite_where=OPEN)


def downgrade() -> None:
    op.drop_index("ix_device_request_open", "device_request", postgresql_where=OPEN, sqlite_where=OPEN)
    op.drop_table("device_request")
    op.drop_index(op.f("ix_claim_code_device_id"), "claim_code")
    op.drop_table("claim_code")
    op.drop_column("batch", "sent_t_s")
    op.drop_index("ix_device_next_token_hash", "device")
    for column in reversed(device_columns()):
        op.drop_column("device", column.name)
