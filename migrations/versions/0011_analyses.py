"""Analyses of the engineers' workbench.

Revision ID: 0011
Revises: 0010
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import JSONB

revision: str = "0011"
down_revision: str | None = "0010"
branch_labels: str | None = None
depends_on: str | None = None

DOCUMENT = sa.JSON().with_variant(JSONB(), "postgresql")
WHEN = sa.DateTime(timezone=True)
OPEN = sa.text("status IN ('waiting', 'running')")


def upgrade() -> None:
    op.create_table(
        "analysis",
        sa.Column("id", sa.String(32), nullable=False),
        sa.Column("organisation_id", sa.String(32), nullable=False),
        sa.Column("user_id", sa.String(32)),
        sa.Column("creator", sa.String(254), nullable=False),
        sa.Column("kind", sa.String(20), nullable=False),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("device_id", sa.String(32)),
        sa.Column("boot", sa.String(64)),
        sa.Column("t_first_s", sa.Double),
        sa.Column("t_last_s", sa.Double),
        sa.Column("input_key", sa.String(300)),
        sa.Column("input_bytes", sa.Integer, nullable=False),
        sa.Column("input_sha256", sa.String(64), nullable=False),
        sa.Column("parameters", DOCUMENT, nullable=False),
        sa.Column("status", sa.String(10), nullable=False),
        sa.Column("progress", sa.Double, nullable=False),
        sa.Column("stage", sa.String(200), nullable=False),
        sa.Column("attempts", sa.Integer, nullable=False),
        sa.Column("leased_until", WHEN),
        sa.Column("created_at", WHEN, nullable=False),
        sa.Column("finished_at", WHEN),
        sa.Column("algorithm", sa.String(60), nullable=False),
        sa.Column("result_key", sa.String(300)),
        sa.Column("result_sha256", sa.String(64)),
        sa.Column("error", sa.String(1000)),
        sa.CheckConstraint(
            "status IN ('waiting', 'running', 'done', 'failed', 'cancelled')", name=op.f("ck_analysis_status")
        ),
        sa.ForeignKeyConstraint(
            ["organisation_id"], ["organisation.id"], name=op.f("fk_analysis_organisation_id_organisation")
        ),
        sa.ForeignKeyConstraint(["user_id"], ["user_account.id"], name=op.f("fk_analysis_user_id_user_account")),
        sa.ForeignKeyConstraint(
            ["device_id"], ["device.id"], name=op.f("fk_analysis_device_id_device"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_analysis")),
    )
    op.create_index("ix_analysis_organisation_id_created_at", "analysis", ["organisation_id", "created_at"])
    op.create_index("ix_analysis_device_id", "analysis", ["device_id"])
    op.create_index("ix_analysis_due", "analysis", ["created_at"], postgresql_where=OPEN, sqlite_where=OPEN)


def downgrade() -> None:
    op.drop_table("analysis")
