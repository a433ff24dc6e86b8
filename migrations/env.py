"""Alembic's way into this project: the connection comes from `server.migrations`."""

from __future__ import annotations

from typing import Any, Literal

from alembic import context
from alembic.autogenerate.api import AutogenContext
from sqlalchemy import JSON, Connection

from server.database import UtcDateTime
from server.migrations import migrating
from server.models import Base
from server.settings import Settings


def render(kind: str, item: Any, autogenerate: AutogenContext) -> str | Literal[False]:  # Alembic's callback
    """Write our types as what they are in the database: a migration must outlive the models."""
    del autogenerate
    if kind == "type" and isinstance(item, UtcDateTime):
        return "sa.DateTime(timezone=True)"
    if kind == "type" and isinstance(item, JSON):
        return "DOCUMENT"
    return False


def run(connection: Connection) -> None:
    """Run the revisions on a connection that is in a transaction."""
    context.configure(
        connection=connection,
        target_metadata=Base.metadata,
        render_as_batch=connection.dialect.name == "sqlite",
        render_item=render,
        compare_type=True,
    )
    with context.begin_transaction():
        context.run_migrations()


given = context.config.attributes.get("connection")
if given is not None:
    run(given)
else:  # started by Alembic's own command line
    with migrating(Settings()) as own:
        run(own)
