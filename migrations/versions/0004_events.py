"""Events with their revisions, inputs, reviews and legal holds; seals of chains.

Revision ID: 0004
Revises: 0003
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import JSONB

revision: str = "0004"
down_revision: str | None = "0003"
branch_labels: str | None = None
depends_on: str | None = None

DOCUMENT = sa.JSON().with_variant(JSONB(), "postgresql")


WAITING_BURST = sa.text("processed_at IS NULL AND stream = 'burst'")


def upgrade() -> None:
    op.create_index(
        "ix_batch_burst_due", "batch", ["device_id"], postgresql_where=WAITING_BURST, sqlite_where=WAITING_BURST
    )
    op.add_column("view_ticket", sa.Column("event_id", sa.String(length=32), nullable=True))
    op.create_table(
        "chain_seal",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("device_id", sa.String(length=32), nullable=False),
        sa.Column("chain_length", sa.Integer(), nullable=False),
        sa.Column("chain_head", sa.String(length=64), nullable=False),
        sa.Column("sealed_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("public_key", sa.String(length=64), nullable=True),
        sa.Column("signature", sa.String(length=128), nullable=True),
        sa.Column("timestamp_token", sa.LargeBinary(), nullable=True),
        sa.ForeignKeyConstraint(["device_id"], ["device.id"], name=op.f("fk_chain_seal_device_id_device")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_chain_seal")),
        sa.UniqueConstraint("device_id", "chain_length", name=op.f("uq_chain_seal_device_id_chain_length")),
    )
    op.create_table(
        "event",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("organisation_id", sa.String(length=32), nullable=False),
        sa.Column("device_id", sa.String(length=32), nullable=False),
        sa.Column("vehicle_id", sa.String(length=32), nullable=True),
        sa.Column("boot", sa.String(length=64), nullable=False),
        sa.Column("kind", sa.String(length=20), nullable=False),
        sa.Column("severe", sa.Boolean(), nullable=False),
        sa.Column("t0_s", sa.Double(), nullable=False),
        sa.Column("t_end_s", sa.Double(), nullable=False),
        sa.Column("at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("updated_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("result", DOCUMENT, nullable=False),
        sa.Column("withdrawn_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("verdict", sa.String(length=20), nullable=True),
        sa.Column("note", sa.String(length=2000), nullable=True),
        sa.Column("reviewed_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("held_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("hold_reason", sa.String(length=500), nullable=True),
        sa.CheckConstraint("verdict IN ('confirmed', 'false_alarm')", name=op.f("ck_event_verdict")),
        sa.ForeignKeyConstraint(["device_id"], ["device.id"], name=op.f("fk_event_device_id_device")),
        sa.ForeignKeyConstraint(
            ["organisation_id"], ["organisation.id"], name=op.f("fk_event_organisation_id_organisation")
        ),
        sa.ForeignKeyConstraint(["vehicle_id"], ["vehicle.id"], name=op.f("fk_event_vehicle_id_vehicle")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_event")),
    )
    with op.batch_alter_table("event", schema=None) as batch_op:
        batch_op.create_index("ix_event_device_id_at", ["device_id", "at"], unique=False)
        batch_op.create_index("ix_event_organisation_id_at", ["organisation_id", "at"], unique=False)
        batch_op.create_index("ix_event_vehicle_id_at", ["vehicle_id", "at"], unique=False)

    op.create_table(
        "event_action",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("event_id", sa.String(length=32), nullable=False),
        sa.Column("at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("actor", sa.String(length=254), nullable=False),
        sa.Column("action", sa.String(length=20), nullable=False),
        sa.Column("note", sa.String(length=2000), nullable=True),
        sa.CheckConstraint(
            "action IN ('confirmed', 'false_alarm', 'reopened', 'held', 'released')",
            name=op.f("ck_event_action_action"),
        ),
        sa.ForeignKeyConstraint(
            ["event_id"], ["event.id"], name=op.f("fk_event_action_event_id_event"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_event_action")),
    )
    with op.batch_alter_table("event_action", schema=None) as batch_op:
        batch_op.create_index("ix_event_action_event_id_at", ["event_id", "at"], unique=False)

    op.create_table(
        "event_input",
        sa.Column("event_id", sa.String(length=32), nullable=False),
        sa.Column("batch_id", sa.String(length=32), nullable=False),
        sa.ForeignKeyConstraint(["batch_id"], ["batch.id"], name=op.f("fk_event_input_batch_id_batch")),
        sa.ForeignKeyConstraint(
            ["event_id"], ["event.id"], name=op.f("fk_event_input_event_id_event"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("event_id", "batch_id", name=op.f("pk_event_input")),
    )
    with op.batch_alter_table("event_input", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_event_input_batch_id"), ["batch_id"], unique=False)

    op.create_table(
        "event_revision",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("event_id", sa.String(length=32), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("installation_id", sa.String(length=32), nullable=True),
        sa.Column("algorithm", sa.String(length=60), nullable=False),
        sa.Column("input_sha256", sa.String(length=64), nullable=False),
        sa.Column("event_sha256", sa.String(length=64), nullable=False),
        sa.Column("document", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["event_id"], ["event.id"], name=op.f("fk_event_revision_event_id_event"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_event_revision")),
        sa.UniqueConstraint("event_id", "number", name=op.f("uq_event_revision_event_id_number")),
    )


def downgrade() -> None:
    op.drop_table("event_revision")
    with op.batch_alter_table("event_input", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_event_input_batch_id"))

    op.drop_table("event_input")
    with op.batch_alter_table("event_action", schema=None) as batch_op:
        batch_op.drop_index("ix_event_action_event_id_at")

    op.drop_table("event_action")
    with op.batch_alter_table("event", schema=None) as batch_op:
        batch_op.drop_index("ix_event_vehicle_id_at")
        batch_op.drop_index("ix_event_organisation_id_at")
        batch_op.drop_index("ix_event_device_id_at")

    op.drop_table("event")
    op.drop_table("chain_seal")
    op.drop_column("view_ticket", "event_id")
    op.drop_index("ix_batch_burst_due", table_name="batch")
