"""What device and vehicle were called when a revision of an event was computed, kept with it.

Revision ID: 0010
Revises: 0009
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0010"
down_revision: str | None = "0009"
branch_labels: str | None = None
depends_on: str | None = None

NAMES = {"device_name": 200, "vehicle_name": 200, "plate": 20}


def upgrade() -> None:
    for name, length in NAMES.items():
        op.add_column("event_revision", sa.Column(name, sa.String(length), nullable=True))
    # Of revisions from before, the names of now are the best there is; they stay from here on.
    for name, of, key in (
        ("device_name", "device", "name"),
        ("vehicle_name", "vehicle", "name"),
        ("plate", "vehicle", "plate"),
    ):
        op.execute(
            f"UPDATE event_revision SET {name} = (SELECT {of}.{key} FROM event "  # noqa: S608  constants of this file
            f"JOIN {of} ON {of}.id = event.{of}_id WHERE event.id = event_revision.event_id)"
        )


def downgrade() -> None:
    for name in reversed(NAMES):
        op.drop_column("event_revision", name)
