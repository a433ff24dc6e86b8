"""Rows of any table of any of our databases as lines of JSON, and back.

The tables are read off the database itself, not off this version's models: a backup is restored at the revision
at which it was made.  The form is the same for SQLite and PostgreSQL, so a backup of one restores into the other.
"""

from __future__ import annotations

import base64
import datetime as dt
import hashlib
import json
import math
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Any

import orjson
from psycopg.types.json import Jsonb
from sqlalchemy import (
    JSON,
    Boolean,
    Column,
    Connection,
    Date,
    DateTime,
    Float,
    LargeBinary,
    MetaData,
    Select,
    Table,
    func,
    select,
    text,
    union,
)

from server.database import insert_past_mapper

Row = dict[str, Any]

VERSION_TABLE = "alembic_version"
BLOB_COLUMNS = ("blob_key", "body_key", "input_key", "result_key")
"""Of batches, and of the workbench's analyses."""
_AT_ONCE = 1000
_MODULUS = 1 << 256


def tables(connection: Connection) -> list[Table]:
    """The tables of a database, those that others refer to first."""
    metadata = MetaData()
    metadata.reflect(connection)
    return [table for table in metadata.sorted_tables if table.name != VERSION_TABLE]


def rows(connection: Connection, table: Table) -> Iterator[Row]:
    """All rows, a thousand in memory at a time; in no order."""
    streaming = connection.execution_options(yield_per=_AT_ONCE)
    for row in streaming.execute(select(table)).mappings():
        # `str`: a name that a database gave is a kind of its own, which JSON does not take.
        yield {str(column.name): _to_json(column, row[column]) for column in table.columns}


def blob_keys(connection: Connection, found: Iterable[Table]) -> Iterator[str]:
    """The keys of all blobs that rows name, each once."""
    columns = [column for table in found for column in table.columns if column.name in BLOB_COLUMNS]
    queries: list[Select[Any]] = [select(column).where(column.is_not(None)) for column in columns]
    if queries:
        yield from connection.execution_options(yield_per=_AT_ONCE).execute(union(*queries)).scalars()


def line(row: Row) -> bytes:
    """A row as it is written."""
    return orjson.dumps(row, option=orjson.OPT_SORT_KEYS)


class ContentSum:
    """A hash of many rows that does not depend on their order: databases sort text by rules of their own."""

    def __init__(self) -> None:
        self.rows = 0
        self._sum = 0

    def add(self, row: Row) -> None:
        """Count a row in."""
        self.add_bytes(orjson.dumps({name: _plain(value) for name, value in row.items()}, option=orjson.OPT_SORT_KEYS))

    def add_bytes(self, data: bytes) -> None:
        """Count something in."""
        self.rows += 1
        self._sum = (self._sum + int.from_bytes(hashlib.sha256(data).digest())) % _MODULUS

    def told(self) -> dict[str, Any]:
        """How many, and the sum."""
        return {"rows": self.rows, "sum": f"{self._sum:064x}"}


def insert(connection: Connection, table: Table, found: Iterable[Row]) -> None:
    """Insert rows as `rows` gave them."""
    if connection.dialect.name == "postgresql":
        insert_past_mapper(
            connection,
            table,
            ([_to_postgres(column, row.get(column.name)) for column in table.columns] for row in found),
        )
        return
    names = ", ".join(f'"{column.name}"' for column in table.columns)
    marks = ", ".join("?" for _ in table.columns)
    statement = f'INSERT INTO "{table.name}" ({names}) VALUES ({marks})'  # noqa: S608  names are the database's own
    remaining = iter(found)
    while page := list(islice(remaining, _AT_ONCE)):
        values = [tuple(_to_sqlite(column, row.get(column.name)) for column in table.columns) for row in page]
        connection.exec_driver_sql(statement, values)


def set_sequences(connection: Connection, table: Table) -> None:
    """Let numbers that the database gives go on after the highest there is; SQLite does so by itself."""
    if connection.dialect.name != "postgresql":
        return
    for column in table.primary_key.columns:
        owned = connection.execute(
            text("SELECT pg_get_serial_sequence(:table, :column)"), {"table": f'"{table.name}"', "column": column.name}
        ).scalar()
        highest = connection.execute(select(func.max(column))).scalar() if owned else None
        if highest is not None:
            connection.execute(text("SELECT setval(:sequence, :highest)"), {"sequence": owned, "highest": highest})


def _to_json(column: Column[Any], value: Any) -> Any:
    kind = column.type
    if value is None or isinstance(kind, (JSON, Boolean)):
        return value
    if isinstance(kind, DateTime):
        aware = value.replace(tzinfo=dt.UTC) if value.tzinfo is None else value.astimezone(dt.UTC)
        return aware.isoformat()
    if isinstance(kind, Date):
        return value.isoformat()
    if isinstance(kind, LargeBinary):
        return base64.b64encode(value).decode()
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)  # JSON has no number for it
    return value


def _from_json(column: Column[Any], value: Any) -> Any:
    kind = column.type
    if value is None:
        return None
    if isinstance(kind, DateTime):
        return dt.datetime.fromisoformat(value)
    if isinstance(kind, Date):
        return dt.date.fromisoformat(value)
    if isinstance(kind, LargeBinary):
        return base64.b64decode(value)
    return float(value) if isinstance(kind, Float) else value


def _is_null(column: Column[Any], value: Any) -> bool:
    # A document that must be there may be JSON's null.
    return value is None and not (isinstance(column.type, JSON) and not column.nullable)


def _to_sqlite(column: Column[Any], value: Any) -> Any:
    if _is_null(column, value):
        return None
    if isinstance(column.type, JSON):
        return json.dumps(value)
    found = _from_json(column, value)
    if isinstance(found, dt.datetime):
        return found.astimezone(dt.UTC).replace(tzinfo=None).isoformat(sep=" ", timespec="microseconds")
    return found.isoformat() if isinstance(found, dt.date) else found


def _to_postgres(column: Column[Any], value: Any) -> Any:
    if _is_null(column, value):
        return None
    return Jsonb(value) if isinstance(column.type, JSON) else _from_json(column, value)


def _plain(value: Any) -> Any:
    """Numbers as every database gives them back: PostgreSQL's documents know no -0.0, and 1e22 as an integer."""
    if isinstance(value, dict):
        return {name: _plain(inner) for name, inner in value.items()}
    if isinstance(value, list):
        return [_plain(inner) for inner in value]
    if isinstance(value, float):
        return str(int(value)) if value.is_integer() else value
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value
