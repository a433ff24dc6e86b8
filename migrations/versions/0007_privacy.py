"""Retention rules, orders of erasure, tombstones; the audit log lets go of what its rule no longer keeps.

Revision ID: 0007
Revises: 0006
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import JSONB

revision: str = "0007"
down_revision: str | None = "0006"
branch_labels: str | None = None
depends_on: str | None = None

DOCUMENT = sa.JSON().with_variant(JSONB(), "postgresql")
CLASSES = ("raw", "tracks", "trips", "manoeuvres", "events", "diagnosis", "alerts", "changes", "audit")
TIMES = {
    "batch": ("erasing_at", "erased_at"),
    "event": ("raw_erased_at", "erased_at"),
    "trip": ("raw_erased_at", "track_erased_at"),
    "installation": ("raw_erased_at",),
}

# SQLite has no variable of a transaction that a trigger could read, as the guard on PostgreSQL does: there the rule
# itself decides, so that nothing younger than it allows can be taken away whoever asks.
SQLITE_GUARD = """
CREATE TRIGGER audit_entry_no_delete BEFORE DELETE ON audit_entry
WHEN NOT EXISTS (
  SELECT 1 FROM retention_rule r
  WHERE r.organisation_id = OLD.organisation_id AND r.data_class = 'audit' AND r.days IS NOT NULL
  AND OLD.at < datetime('now', '-' || r.days || ' days')
)
BEGIN SELECT RAISE(ABORT, 'audit_entry only grows'); END
"""
SQLITE_GUARD_BEFORE = (
    "CREATE TRIGGER audit_entry_no_delete BEFORE DELETE ON audit_entry"
    " BEGIN SELECT RAISE(ABORT, 'audit_entry only grows'); END"
)


def upgrade() -> None:
    op.create_table(
        "retention_rule",
        sa.Column("organisation_id", sa.String(length=32), nullable=False),
        sa.Column("data_class", sa.String(length=20), nullable=False),
        sa.Column("days", sa.Integer(), nullable=True),
        sa.Column("applies_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("updated_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("updated_by", sa.String(length=254), nullable=False),
        sa.Column("removed", sa.Integer(), nullable=False),
        sa.CheckConstraint(f"data_class IN {CLASSES}", name=op.f("ck_retention_rule_data_class")),
        sa.ForeignKeyConstraint(
            ["organisation_id"], ["organisation.id"], name=op.f("fk_retention_rule_organisation_id_organisation")
        ),
        sa.PrimaryKeyConstraint("organisation_id", "data_class", name=op.f("pk_retention_rule")),
    )
    op.create_table(
        "erasure",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("organisation_id", sa.String(length=32), nullable=False),
        sa.Column("subject_kind", sa.String(length=10), nullable=False),
        sa.Column("subject_id", sa.String(length=32), nullable=False),
        sa.Column("since", sa.DateTime(timezone=True), nullable=True),
        sa.Column("until", sa.DateTime(timezone=True), nullable=True),
        sa.Column("reason", sa.String(length=500), nullable=False),
        sa.Column("requested_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("requested_by", sa.String(length=254), nullable=False),
        sa.Column("finished_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("erased", DOCUMENT, nullable=False),
        sa.Column("kept", DOCUMENT, nullable=False),
        sa.CheckConstraint("subject_kind IN ('vehicle', 'user')", name=op.f("ck_erasure_subject_kind")),
        sa.ForeignKeyConstraint(
            ["organisation_id"], ["organisation.id"], name=op.f("fk_erasure_organisation_id_organisation")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_erasure")),
    )
    op.create_index("ix_erasure_organisation_id_requested_at", "erasure", ["organisation_id", "requested_at"])
    _partial("ix_erasure_open", "erasure", ["requested_at"], "finished_at IS NULL")
    for table, names in TIMES.items():
        for name in names:
            op.add_column(table, sa.Column(name, sa.DateTime(timezone=True), nullable=True))
    for table in ("batch", "event"):
        op.add_column(table, sa.Column("erasure_id", sa.String(length=32), nullable=True))
    _partial("ix_batch_kept", "batch", ["device_id", "received_at"], "erasing_at IS NULL")
    _partial("ix_batch_erasing", "batch", ["device_id"], "erasing_at IS NOT NULL AND erased_at IS NULL")
    if op.get_bind().dialect.name == "sqlite":
        op.execute("DROP TRIGGER audit_entry_no_delete")
        op.execute(SQLITE_GUARD)


def _partial(name: str, table: str, columns: list[str], condition: str) -> None:
    op.create_index(name, table, columns, sqlite_where=sa.text(condition), postgresql_where=sa.text(condition))


def downgrade() -> None:
    if op.get_bind().dialect.name == "sqlite":
        op.execute("DROP TRIGGER audit_entry_no_delete")
        op.execute(SQLITE_GUARD_BEFORE)
    op.drop_index("ix_batch_erasing", "batch")
    op.drop_index("ix_batch_kept", "batch")
    for table in ("event", "batch"):
        op.drop_column(table, "erasure_id")
    for table, names in TIMES.items():
        for name in reversed(names):
            op.drop_column(table, name)
    op.drop_index("ix_erasure_open", "erasure")
    op.drop_index("ix_erasure_organisation_id_requested_at", "erasure")
    op.drop_table("erasure")
    op.drop_table("retention_rule")
