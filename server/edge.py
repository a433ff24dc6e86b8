"""What routes take from the application, typed."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable
from typing import Annotated, NamedTuple, cast

from fastapi import Depends
from starlette.requests import HTTPConnection

from server.accounts.caller import Caller
from server.database import Database
from server.errors import InvalidError
from server.moments import Clock as Clock  # noqa: PLC0414  routes take both from here
from server.moments import Moment as Moment  # noqa: PLC0414
from server.settings import Settings
from server.store import BlobStore

Wake = Callable[[str], None]


class Parts(NamedTuple):
    """What most routes take one by one."""

    settings: Settings
    database: Database
    store: BlobStore
    now: dt.datetime


def parts_for_box(connection: HTTPConnection) -> Parts:
    """All at once for a box's uploads: as dependencies the framework takes as long over them as over an SQL statement.

    The database is confined to nothing: a box acts on its own id alone.
    """
    state = connection.app.state
    return Parts(state.settings, state.database, state.store, cast("Clock", state.clock)())


async def _settings(connection: HTTPConnection) -> Settings:
    return cast("Settings", connection.app.state.settings)


async def _database(connection: HTTPConnection) -> Database:
    """The database as the caller may see it: a box acts on its own id alone, everybody else on one organisation."""
    database = cast("Database", connection.app.state.database)
    caller = cast("Caller | None", getattr(connection.state, "caller", None))
    if caller is None or caller.kind in ("device", "ticket"):
        return database
    return database.confined_to(caller.organisation_id)


async def _store(connection: HTTPConnection) -> BlobStore:
    return cast("BlobStore", connection.app.state.store)


async def _now(connection: HTTPConnection) -> dt.datetime:
    return cast("Clock", connection.app.state.clock)()


# These are coroutines so that the framework calls them in place; a plain function costs a thread.
SettingsOf = Annotated[Settings, Depends(_settings)]
DatabaseOf = Annotated[Database, Depends(_database)]
StoreOf = Annotated[BlobStore, Depends(_store)]


Now = Annotated[dt.datetime, Depends(_now)]


def place_of(before: str) -> tuple[dt.datetime, str]:
    """Where a page of a list begins, from what the page before gave as `next`: a moment and an id."""
    moment, _, row_id = before.partition("~")
    try:
        return dt.datetime.fromisoformat(moment).astimezone(dt.UTC), row_id
    except (ValueError, OverflowError):  # the last: a day before the first or after the last of the calendar
        raise InvalidError("`before` is not what a page gave as `next`", code="before") from None
