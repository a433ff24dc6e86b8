"""What befell the machine, as the problem that a caller sees: passing, so a box keeps its batch and tries again."""

from __future__ import annotations

import errno
import sqlite3

import psycopg
from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as NoConnectionError

from server.errors import FullError, ProblemError, UnavailableError
from server.store.objects import StoreUnavailableError

RETRY_AFTER_S = 10
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
_SQLITE_PASSING = ("SQLITE_BUSY", "SQLITE_LOCKED", "SQLITE_IOERR", "SQLITE_CANTOPEN", "SQLITE_READONLY")
# Classes of SQLSTATE: connection, resources, an operator's intervention, the system.
_POSTGRES_PASSING = frozenset({"08", "53", "57", "58"})


def trouble_of(error: BaseException) -> ProblemError | None:
    """The problem to answer with; None for what is a mistake of ours."""
    if isinstance(error, NoConnectionError):
        return _unavailable("every connection to the database is in use")
    if isinstance(error, StoreUnavailableError):
        return _unavailable("the object store does not answer")
    cause = error.orig if isinstance(error, DBAPIError) else error
    if _is_full(cause):
        return FullError("There is no room left to store anything; nothing was kept", retry_after_s=RETRY_AFTER_S)
    return _unavailable("the database does not answer") if _is_passing(cause) else None


def _is_full(cause: BaseException | None) -> bool:
    if isinstance(cause, sqlite3.OperationalError):
        return cause.sqlite_errorname == "SQLITE_FULL"
    return isinstance(cause, psycopg.errors.DiskFull) or (isinstance(cause, OSError) and cause.errno in _FULL)


def _is_passing(cause: BaseException | None) -> bool:
    if isinstance(cause, sqlite3.OperationalError):
        return cause.sqlite_errorname.startswith(_SQLITE_PASSING)
    if isinstance(cause, psycopg.OperationalError | psycopg.InterfaceError):
        # Without a state it is the driver's own word: there is no connection, or no longer.
        return cause.sqlstate is None or cause.sqlstate[:2] in _POSTGRES_PASSING
    return False


def _unavailable(why: str) -> UnavailableError:
    return UnavailableError(f"Try again soon: {why}", retry_after_s=RETRY_AFTER_S)
