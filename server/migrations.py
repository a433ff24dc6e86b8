"""Bringing a database to this version's schema; the revisions are in `migrations/`."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from functools import cache
from typing import Any

from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Engine, text

from server.database import make_engine
from server.models import Base
from server.resources import folder
from server.settings import Settings

# Any constant serves: two processes that start at once must not migrate at once.
_MIGRATION_LOCK = 0x5CA701B
# A migration that waits for a lock holds up everybody behind it: better it fails and is tried again.
_LOCK_TIMEOUT = "5s"


def _config(connection: Connection | None = None) -> Config:
    config = Config()
    config.set_main_option("script_location", str(folder("migrations")))
    config.attributes["connection"] = connection
    return config


@cache
def head() -> str | None:
    """The newest revision that this version knows."""
    return ScriptDirectory.from_config(_config()).get_current_head()


def knows(revision: str) -> bool:
    """Whether a revision is one of this version's."""
    return any(script.revision == revision for script in ScriptDirectory.from_config(_config()).walk_revisions())


def revision_of(connection: Connection) -> str | None:
    """At which a database stands."""
    return MigrationContext.configure(connection).get_current_revision()


def is_current(engine: Engine) -> bool:
    """Whether a database stands at the newest revision."""
    with engine.execution_options(writes=False).connect() as connection:
        return MigrationContext.configure(connection).get_current_revision() == head()


def serves(engine: Engine) -> bool:
    """Whether this version works on a database: it is at the newest revision, or ahead by a newer version's.

    Revisions are numbers.  A newer version only adds (docs/operations.md): it can migrate while this one serves.
    """
    with engine.execution_options(writes=False).connect() as connection:
        found, newest = MigrationContext.configure(connection).get_current_revision(), head()
    return found is not None and newest is not None and found.isdecimal() and found >= newest


def upgrade(settings: Settings, revision: str = "head") -> None:
    """Bring the settings' database up to a revision, in one transaction and one process at a time."""
    with migrating(settings) as connection:
        command.upgrade(_config(connection), revision)


def downgrade(settings: Settings, revision: str) -> None:
    """Bring it down to an earlier one; what that one has no place for is lost."""
    with migrating(settings) as connection:
        command.downgrade(_config(connection), revision)


def differences(settings: Settings) -> list[Any]:  # Alembic's own tuples
    """What a migration would have to change to bring the database in step with the models; empty when it is."""
    with migrating(settings) as connection:
        return compare_metadata(MigrationContext.configure(connection, opts={"compare_type": True}), Base.metadata)


@contextmanager
def migrating(settings: Settings) -> Generator[Connection]:
    """A connection in the transaction of a migration, committed when the block ends."""
    engine = make_engine(settings)
    try:
        with engine.connect() as connection:
            if engine.dialect.name == "sqlite":
                # Batch mode copies tables: rows that point at the old copy are right again at the end.
                # Only the driver's own connection can say so, outside a transaction.
                driver = connection.connection.driver_connection
                assert driver is not None
                driver.execute("PRAGMA foreign_keys=OFF")
            with connection.begin():
                if engine.dialect.name == "postgresql":
                    connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _MIGRATION_LOCK})
                    connection.execute(text(f"SET LOCAL lock_timeout = '{_LOCK_TIMEOUT}'"))
                yield connection
    finally:
        engine.dispose()
