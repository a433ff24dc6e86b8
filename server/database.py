"""The engine and its transactions.

Services never commit: the edge (request, job, command) opens `transaction` and thereby decides.
"""

from __future__ import annotations

import copy
import datetime as dt
import sqlite3
import threading
import time
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from typing import Any

import psycopg
from sqlalchemy import Connection, DateTime, Engine, Table, create_engine, event, insert, text
from sqlalchemy.engine import Dialect
from sqlalchemy.engine.interfaces import DBAPIConnection, DBAPICursor
from sqlalchemy.exc import InvalidatePoolError
from sqlalchemy.orm import Session, sessionmaker
from sqlalchemy.pool import ConnectionPoolEntry, PoolProxiedConnection
from sqlalchemy.types import TypeDecorator

from server.settings import Settings

# Any constant serves; it names the one lock under which rows of `change` get their ids.
CHANGE_LOCK = 0x5CA701A
# What a session is confined to, in its `info`.
ORGANISATION = "organisation_id"
# A connection that was used so lately is taken to stand still.
_FRESH_S = 1.0
_WAL_S = 30.0
_TURN_S = 30.0


class UtcDateTime(TypeDecorator[dt.datetime]):
    """An aware UTC datetime on every database; SQLite would forget the zone."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: dt.datetime | None, dialect: Dialect) -> dt.datetime | None:
        if value is None:
            return None
        if value.tzinfo is None:
            raise ValueError(f"naive datetime {value!r}: every time in the database is UTC")
        value = value.astimezone(dt.UTC)
        return value.replace(tzinfo=None) if dialect.name == "sqlite" else value

    def process_result_value(self, value: dt.datetime | None, dialect: Dialect) -> dt.datetime | None:
        del dialect
        if value is None:
            return None
        return value.replace(tzinfo=dt.UTC) if value.tzinfo is None else value.astimezone(dt.UTC)


def make_engine(settings: Settings) -> Engine:
    """Engine for the settings' database, SQLite in the data folder unless told otherwise."""
    dsn = settings.database_dsn
    if dsn.startswith("sqlite"):
        settings.data_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
        engine = create_engine(dsn, connect_args={"timeout": 30.0, "check_same_thread": False}, hide_parameters=True)
        event.listen(engine, "connect", _prepare_sqlite)
        event.listen(engine, "begin", _begin_sqlite)
        return engine
    # Errors are logged with their statement: its values (hashes of tokens, places) are nobody's to read there.
    engine = create_engine(dsn, pool_size=10, max_overflow=10, hide_parameters=True)
    event.listen(engine, "checkout", _ping_idle)
    event.listen(engine, "checkin", _note_use)
    return engine


def _note_use(connection: DBAPIConnection | None, record: ConnectionPoolEntry) -> None:
    del connection
    record.info["used_at"] = time.monotonic()


def _ping_idle(connection: DBAPIConnection, record: ConnectionPoolEntry, proxy: PoolProxiedConnection) -> None:
    """Ask a connection that lay unused whether it still stands; asking every time costs an upload three answers."""
    del proxy
    used_at = record.info.get("used_at")
    if used_at is None or time.monotonic() - used_at < _FRESH_S:
        return
    try:
        connection.cursor().execute("SELECT 1")
        connection.rollback()
    except psycopg.Error as error:
        raise InvalidatePoolError from error


def _prepare_sqlite(connection: DBAPIConnection, record: ConnectionPoolEntry) -> None:
    del record
    # The driver must not begin transactions by itself: `_begin_sqlite` does, with the kind that is wanted.
    connection.isolation_level = None  # pyright: ignore[reportAttributeAccessIssue]  sqlite3's own attribute
    cursor = connection.cursor()
    cursor.execute("PRAGMA busy_timeout=30000")
    _use_wal(cursor)
    for pragma in ("synchronous=FULL", "foreign_keys=ON"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _use_wal(cursor: DBAPICursor) -> None:
    """Change the journal; of two processes that do so at once SQLite refuses one without waiting for the time-out."""
    until = time.monotonic() + _WAL_S
    while True:
        try:
            cursor.execute("PRAGMA journal_mode=WAL")
        except sqlite3.OperationalError as error:
            # Extended codes say in their last byte what they are a kind of.
            if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_BUSY or time.monotonic() > until:
                raise
            time.sleep(0.02)
        else:
            return


def _begin_sqlite(connection: Any) -> None:  # SQLAlchemy passes its Connection untyped to listeners
    # A transaction that will write takes the write lock at once: a later upgrade can fail without waiting.
    options = connection.get_execution_options()
    if options.get("begins", True):
        connection.exec_driver_sql("BEGIN IMMEDIATE" if options.get("writes", True) else "BEGIN")


def insert_past_mapper(connection: Connection, table: Table, rows: Iterable[Sequence[Any]]) -> None:
    """Insert many rows, the values in the order of the table's columns: by COPY where there is one.

    A statement a row, even sent many at once, costs ten times the processor time.
    """
    if connection.dialect.name != "postgresql":
        names = [column.name for column in table.columns]
        if values := [dict(zip(names, row, strict=True)) for row in rows]:
            connection.execute(insert(table), values)
        return
    names = ", ".join(f'"{column.name}"' for column in table.columns)
    driver: Any = connection.connection.driver_connection  # psycopg's own connection
    with driver.cursor() as cursor, cursor.copy(f'COPY "{table.name}" ({names}) FROM STDIN') as copy:
        for row in rows:
            copy.write_row(row)


class Database:
    """One engine and the kinds of transactions on it."""

    def __init__(self, settings: Settings) -> None:
        self.engine = make_engine(settings)
        self._writer = sessionmaker(self.engine, expire_on_commit=False)
        sqlite = self.engine.dialect.name == "sqlite"
        self._turn = threading.Lock() if sqlite else None
        self._reader = sessionmaker(self.engine.execution_options(writes=False), expire_on_commit=False)
        self._glances = self.engine.execution_options(
            **({"begins": False} if sqlite else {"isolation_level": "AUTOCOMMIT"})
        )
        self.info: dict[str, str] = {}
        """Goes into the `info` of every session."""

    def confined_to(self, organisation_id: str) -> Database:
        """The same database, whose sessions see one organisation only (`server.isolation` holds them to it)."""
        # Here and not above, because it knows the models; without it a confined session would be none.
        from server.isolation import install

        install()
        confined = copy.copy(self)
        confined.info = {ORGANISATION: organisation_id}
        return confined

    @contextmanager
    def transaction(self) -> Generator[Session]:
        """A writing transaction: committed when the block ends, rolled back when it raises."""
        with self._in_turn(), self._writer.begin() as session:
            session.info.update(self.info)
            yield session

    @contextmanager
    def _in_turn(self) -> Generator[None]:
        """Threads of this process write to SQLite one after the other.

        SQLite itself has a thread that finds it busy ask again later and later, up to a tenth of a second apart, and
        whoever asks in between is served first; so only other processes are waited for in that way.
        """
        # Who waited in vain asks SQLite, which refuses as it would have without turns.
        held = self._turn is not None and self._turn.acquire(timeout=_TURN_S)
        try:
            yield
        finally:
            if held and self._turn is not None:
                self._turn.release()

    @contextmanager
    def reading(self) -> Generator[Session]:
        """A consistent view; nothing that is changed in it is kept."""
        with self._reader() as session:
            session.info.update(self.info)
            yield session

    @contextmanager
    def glance(self) -> Generator[Connection]:
        """For reading statements of which each may see another moment: no transaction is begun and ended around them.

        Confined to nothing: only for what a box asks about itself.
        """
        with self._glances.connect() as connection:
            yield connection

    def ping(self) -> None:
        """Raise unless the database answers."""
        with self.reading() as session:
            session.execute(text("SELECT 1"))

    def dispose(self) -> None:
        self.engine.dispose()
