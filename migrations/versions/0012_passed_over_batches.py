"""Batches that a round passed over become due again.

Until now a batch that came while a round was computing, was read as the surroundings of an event, and then belonged to
the next attempt of that round was marked as worked off without having been: it has neither a digest nor a failure.

Revision ID: 0012
Revises: 0011
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import JSONB

revision: str = "0012"
down_revision: str | None = "0011"
branch_labels: str | None = None
depends_on: str | None = None

DOCUMENT = sa.JSON().with_variant(JSONB(), "postgresql")
BATCH = sa.table(
    "batch",
    sa.column("id", sa.String),
    sa.column("stream", sa.String),
    sa.column("processed_at", sa.DateTime(timezone=True)),
    sa.column("erasing_at", sa.DateTime(timezone=True)),
    sa.column("failure", sa.String),
    sa.column("remarks", DOCUMENT),
)
DIGEST = sa.table("batch_digest", sa.column("batch_id", sa.String))


def upgrade() -> None:
    connection = op.get_bind()
    passed_over = sa.select(BATCH.c.id, BATCH.c.remarks).where(
        BATCH.c.stream == "continuous",
        BATCH.c.processed_at.is_not(None),
        BATCH.c.failure.is_(None),
        BATCH.c.erasing_at.is_(None),
        ~sa.exists().where(DIGEST.c.batch_id == BATCH.c.id),
    )
    for batch_id, remarks in connection.execute(passed_over).all():
        told = [*remarks, {"code": "passed_over", "detail": "worked off late: an earlier version had passed it over"}]
        connection.execute(sa.update(BATCH).where(BATCH.c.id == batch_id).values(processed_at=None, remarks=told))


def downgrade() -> None:
    """Nothing: what is due is worked off by any version."""
