"""One organisation's sessions see and touch its rows only, whatever a query forgot to say.

Queries name the organisation where it says something; this holds where they do not.  Every statement of a
confined session that goes through the mapper gets a condition for each table, and a flush that would write
another organisation's row is refused.  Sessions of jobs and of boxes are not confined: they act on ids
that no caller chose.
"""

from __future__ import annotations

from collections.abc import Container
from functools import lru_cache
from typing import Any

from sqlalchemy import Select, event, select
from sqlalchemy.orm import ORMExecuteState, Session, with_loader_criteria

from server.database import ORGANISATION
from server.errors import NotFoundError
from server.models import Base, Organisation

EVERYWHERE = "everywhere"
"""Execution option of the rare statement that must see all: is this e-mail in use anywhere?"""
# How a table without the organisation's id is tied to one that has it.
# The event comes first: what belongs to one may name a batch or an installation besides, or none.
_TIES = (
    ("event_id", "event"),
    ("device_id", "device"),
    ("trip_id", "trip"),
    ("batch_id", "batch"),
    ("installation_id", "installation"),
)


def _rows_of(table_name: str, organisation_id: str) -> Select[Any]:
    """Ids of an organisation's rows in a table that others are tied to."""
    # An alias: the statement around it may read the same table.
    table = Base.metadata.tables[table_name].alias()
    if ORGANISATION in table.c:
        return select(table.c.id).where(table.c.organisation_id == organisation_id)
    column, owner = _tie(table.c)
    return select(table.c.id).where(table.c[column].in_(_rows_of(owner, organisation_id)))


def _tie(columns: Container[str]) -> tuple[str, str]:
    return next((column, owner) for column, owner in _TIES if column in columns)


@lru_cache(maxsize=1000)
def _criteria(organisation_id: str) -> tuple[Any, ...]:
    """The conditions of all tables; SQLAlchemy's own options."""
    options: list[Any] = []
    for mapper in Base.registry.mappers:
        row, names = mapper.class_, mapper.columns.keys()
        if row is Organisation:
            condition = row.id == organisation_id
        elif ORGANISATION in names:
            condition = row.organisation_id == organisation_id
        else:  # a table that is tied to nothing fails here, in the first test that runs
            column, owner = _tie(names)
            condition = getattr(row, column).in_(_rows_of(owner, organisation_id))
        options.append(with_loader_criteria(row, condition, include_aliases=True))
    return tuple(options)


def install() -> None:
    """Watch over all sessions from now on; again changes nothing."""
    for name, listener in (("do_orm_execute", _narrow), ("before_flush", _refuse_others)):
        if not event.contains(Session, name, listener):
            event.listen(Session, name, listener)


def _narrow(state: ORMExecuteState) -> None:
    organisation_id = state.session.info.get(ORGANISATION)
    if organisation_id is None or state.is_column_load or state.execution_options.get(EVERYWHERE):
        return
    state.statement = state.statement.options(*_criteria(organisation_id))


def _refuse_others(session: Session, flush_context: object, instances: object) -> None:
    del flush_context, instances
    organisation_id = session.info.get(ORGANISATION)
    if organisation_id is None:
        return
    for row in (*session.new, *session.dirty, *session.deleted):
        owner = getattr(row, ORGANISATION, organisation_id)
        if owner != organisation_id:
            raise NotFoundError("Not of this organisation")
