"""The hash of a batch's blob beside that of its columns.

Batches from before have none; they are told whole by their columns, as ever.

Revision ID: 0013
Revises: 0012
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0013"
down_revision: str | None = "0012"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    op.add_column("batch", sa.Column("blob_sha256", sa.String(64), nullable=True))


def downgrade() -> None:
    op.drop_column("batch", "blob_sha256")
