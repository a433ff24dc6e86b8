"""What people want to read the pages in, with their account or session.

Revision ID: 0010
Revises: 0005
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import JSONB

revision: str = "0010"
down_revision: str | None = "0005"
branch_labels: str | None = None
depends_on: str | None = None

DOCUMENT = sa.JSON().with_variant(JSONB(), "postgresql")


def upgrade() -> None:
    for table in ("user_account", "web_session"):
        op.add_column(table, sa.Column("preferences", DOCUMENT, nullable=False, server_default="{}"))


def downgrade() -> None:
    for table in ("web_session", "user_account"):
        op.drop_column(table, "preferences")
