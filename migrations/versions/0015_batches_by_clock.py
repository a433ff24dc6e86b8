"""Batches by the box's clock.

Revision ID: 0015
Revises: 0014
"""

from __future__ import annotations

from alembic import op

revision: str = "0015"
down_revision: str | None = "0014"
branch_labels: str | None = None
depends_on: str | None = None

COLUMNS = ["device_id", "boot", "t_last_s", "t_first_s"]


def upgrade() -> None:
    # On a large installation it is there already, built beforehand without a lock (docs/operations.md).
    op.create_index("ix_batch_clock", "batch", COLUMNS, if_not_exists=True)


def downgrade() -> None:
    op.drop_index("ix_batch_clock", "batch")
