"""The schema's history: up, down, up; in step with the models; one process at a time."""

from __future__ import annotations

import datetime as dt
import re
import uuid
from concurrent.futures import ThreadPoolExecutor

import pytest
import sqlalchemy as sa

from server.database import make_engine
from server.migrations import differences, downgrade, head, is_current, migrating, serves, upgrade
from server.models import Base
from server.settings import Settings


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.postgres)])
def empty(request, tmp_path):
    """Settings of a database without tables."""
    if request.param == "sqlite":
        yield Settings(data_dir=tmp_path, database_url=None)
        return
    server_url = sa.make_url(request.getfixturevalue("postgres_url")).set(database="postgres")
    name = f"scatola_test_{uuid.uuid4().hex[:12]}"
    server = sa.create_engine(server_url, isolation_level="AUTOCOMMIT")
    with server.connect() as connection:
        connection.execute(sa.text(f'CREATE DATABASE "{name}"'))
    try:
        yield Settings(data_dir=tmp_path, database_url=server_url.set(database=name).render_as_string())
    finally:
        with server.connect() as connection:
            connection.execute(sa.text(f'DROP DATABASE "{name}" WITH (FORCE)'))
        server.dispose()


def tables(settings: Settings) -> set[str]:
    engine = make_engine(settings)
    try:
        return set(sa.inspect(engine).get_table_names())
    finally:
        engine.dispose()


def current(settings: Settings) -> bool:
    engine = make_engine(settings)
    try:
        return is_current(engine)
    finally:
        engine.dispose()


def test_up_down_up(empty):
    assert not current(empty)
    upgrade(empty)
    assert current(empty)
    assert tables(empty) == set(Base.metadata.tables) | {"alembic_version"}
    upgrade(empty)
    downgrade(empty, "base")
    assert tables(empty) == {"alembic_version"}
    assert not current(empty)
    upgrade(empty)
    assert current(empty)


def test_migrations_are_in_step_with_the_models(empty):
    upgrade(empty)
    assert differences(empty) == []


def test_differences_are_noticed(empty):
    upgrade(empty)
    with migrating(empty) as connection:
        connection.execute(sa.text("ALTER TABLE vehicle DROP COLUMN plate"))
    assert [difference[0] for difference in differences(empty)] == ["add_column"]


def test_a_migration_that_fails_leaves_nothing(empty):
    def fail() -> None:
        with migrating(empty) as connection:
            connection.execute(sa.text("CREATE TABLE half (id INTEGER)"))
            connection.execute(sa.text("CREATE TABLE half (id INTEGER)"))

    with pytest.raises(sa.exc.DBAPIError, match="already exists"):
        fail()
    assert tables(empty) == set()


def test_processes_that_start_at_once_migrate_once(empty):
    with ThreadPoolExecutor(3) as pool:
        list(pool.map(lambda _: upgrade(empty), range(3)))
    assert current(empty)


def test_data_outlives_a_migration_of_its_table(empty):
    """Batch mode copies tables on SQLite; rows that point at them must survive."""
    upgrade(empty)
    with migrating(empty) as connection:
        connection.execute(sa.text("INSERT INTO organisation VALUES ('o', 'n', '2026-01-01 00:00:00')"))
        connection.execute(
            sa.text("INSERT INTO vehicle VALUES ('v', 'o', 'name', NULL, 'car', NULL, '2026-01-01 00:00:00')")
        )
    with migrating(empty) as connection:
        from alembic.operations import Operations
        from alembic.runtime.migration import MigrationContext

        operations = Operations(MigrationContext.configure(connection))
        recreate = "always" if connection.dialect.name == "sqlite" else "never"
        with operations.batch_alter_table("organisation", recreate=recreate) as table:
            table.add_column(sa.Column("note", sa.String(10)))
    with migrating(empty) as connection:
        assert connection.execute(sa.text("SELECT organisation_id FROM vehicle")).scalar_one() == "o"


@pytest.mark.parametrize("empty", [pytest.param("postgresql", marks=pytest.mark.postgres)], indirect=True)
def test_a_migration_does_not_wait_for_ever_behind_a_lock(empty, monkeypatch):
    upgrade(empty)
    monkeypatch.setattr("server.migrations._LOCK_TIMEOUT", "100ms")
    engine = make_engine(empty)
    with engine.begin() as reader:
        reader.execute(sa.text("SELECT * FROM trip"))
        with pytest.raises(sa.exc.OperationalError, match="lock timeout"):
            downgrade(empty, "base")
    engine.dispose()
    assert current(empty)


# --- while the version before still serves


def revisions() -> list[str]:
    from alembic.script import ScriptDirectory

    from server.migrations import _config

    return [script.revision for script in reversed(list(ScriptDirectory.from_config(_config()).walk_revisions()))]


def test_revisions_are_numbers_that_grow():
    """`serves` tells by them whether a database is ahead of this version or behind it."""
    found = revisions()
    assert found == sorted(found)
    assert all(len(revision) == 4 and revision.isdecimal() for revision in found)


def reflected(settings: Settings) -> sa.MetaData:
    metadata, engine = sa.MetaData(), make_engine(settings)
    metadata.reflect(engine)
    engine.dispose()
    return metadata


def row_of(table: sa.Table, inspector: sa.Inspector) -> dict[str, object]:
    """A row that a version before might write: the columns that it knows, each with some value that is allowed."""
    by_kind = (
        (sa.String, "x"),
        (sa.JSON, {}),
        (sa.Boolean, True),
        (sa.DateTime, dt.datetime(2026, 1, 1, tzinfo=dt.UTC)),
        (sa.Date, dt.date(2026, 1, 1)),
        (sa.LargeBinary, b"x"),
        (sa.Float, 1.0),
        (sa.Integer, 1),
    )
    row = {c.name: next(value for kind, value in by_kind if isinstance(c.type, kind)) for c in table.columns}
    for check in inspector.get_check_constraints(table.name):
        column = next(name for name in row if re.search(rf"\b{name}\b", check["sqltext"]))
        row[column] = re.search("'([^']*)'", check["sqltext"])[1]
    return row


@pytest.mark.parametrize("before", range(len(revisions()) - 1))
def test_the_version_before_still_reads_and_writes(empty, before):
    """Expand first: nothing that the version before uses goes, and nothing that it does not know must be given."""
    old, new = revisions()[before : before + 2]
    upgrade(empty, old)
    known = reflected(empty)
    tables_before = [table for table in known.sorted_tables if table.name != "alembic_version"]
    upgrade(empty, new)
    engine = make_engine(empty)
    rows = {table: row_of(table, sa.inspect(engine)) for table in tables_before}
    with engine.begin() as connection:
        for table, row in rows.items():
            connection.execute(table.insert().values(row))
        for table in tables_before:
            (row,) = connection.execute(sa.select(table)).all()
            assert len(row) == len(table.columns)
    engine.dispose()


def test_a_database_that_is_ahead_is_served_and_one_behind_is_not(empty):
    upgrade(empty)
    engine = make_engine(empty)

    def at(revision: str) -> bool:
        with engine.begin() as connection:
            connection.execute(sa.text("UPDATE alembic_version SET version_num = :to"), {"to": revision})
        return serves(engine)

    assert at(head())
    assert at("9999")
    assert not at("0001")
    assert not at("old")
    with engine.begin() as connection:
        connection.execute(sa.text("DELETE FROM alembic_version"))
    assert not serves(engine)
    engine.dispose()
