"""What older data said of a mounting, kept beside the installation.

Revision ID: 0005
Revises: 0004
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import JSONB

revision: str = "0005"
down_revision: str | None = "0004"
branch_labels: str | None = None
depends_on: str | None = None

DOCUMENT = sa.JSON().with_variant(JSONB(), "postgresql")


def upgrade() -> None:
    op.add_column("installation", sa.Column("evidence", DOCUMENT, nullable=False, server_default="[]"))


def downgrade() -> None:
    op.drop_column("installation", "evidence")
