"""What the lists of the pages have in common: the address says filters, order and page."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, NamedTuple, TypeVarTuple
from urllib.parse import urlencode

from sqlalchemy import ColumnElement, Row, Select, func, or_
from sqlalchemy.orm import InstrumentedAttribute, Session

from server.models import Device, Vehicle
from server.pages.forms import day

Columns = TypeVarTuple("Columns")

PAGE = 50


class Place(NamedTuple):
    """Where a page lies in its list."""

    page: int
    pages: int
    before: int
    """Rows before it."""
    last: int
    """Number of its last row."""


@dataclass(frozen=True)
class Wanted:
    """What a reader asked of a list; a list adds its filters, and says by its defaults what is usual."""

    q: str = ""
    sort: str = ""
    down: bool = False
    page: int = 1

    FALLING: ClassVar[frozenset[str]] = frozenset()
    """Columns whose largest come first when their head is pressed."""

    def query(self, **changes: Any) -> str:
        """Query of the address with some fields changed, without what is usual; another page only when asked for."""
        values = {field.name: getattr(self, field.name) for field in fields(self)} | {"page": 1} | changes
        usual = type(self)()
        told = {name: value for name, value in values.items() if value != getattr(usual, name)}
        return urlencode({name: int(value) if isinstance(value, bool) else value for name, value in told.items()})

    def toggled(self, sort: str) -> str:
        """Query after a press on a column's head: figures begin with the largest, names with the first."""
        return self.query(sort=sort, down=not self.down if sort == self.sort else sort in self.FALLING)

    def place(self, found: int) -> Place:
        """Where the page lies when the filters leave so many rows; the last page where it lies beyond."""
        pages = max(1, -(-found // PAGE))
        page = min(self.page, pages)
        return Place(page, pages, (page - 1) * PAGE, min(page * PAGE, found))


def named(q: str, *more: InstrumentedAttribute[Any]) -> list[ColumnElement[bool]]:
    """Conditions: each word stands in the name or plate of the vehicle, in the box's name, or in one of `more`."""
    # A plate is found with and without its blanks.
    columns = (Device.name, Vehicle.name, Vehicle.plate, func.replace(Vehicle.plate, " ", ""), *more)
    return [or_(*(column.icontains(word, autoescape=True) for column in columns)) for word in q.split()]


def between(at: InstrumentedAttribute[dt.datetime], since: str, until: str) -> list[ColumnElement[bool]]:
    """Conditions: from the beginning of one day to the end of another, UTC; raises `InvalidError` when one is none."""
    first, last = day(since), day(until, following=1)
    return ([] if first is None else [at >= first]) + ([] if last is None else [at < last])


def rows_of(
    session: Session, query: Select[*Columns], wanted: Wanted, *order: ColumnElement[Any] | InstrumentedAttribute[Any]
) -> tuple[Sequence[Row[*Columns]], int]:
    """Rows of the page that is wanted, and how many the filters leave."""
    found = session.scalar(query.with_only_columns(func.count())) or 0
    page = query.order_by(*order).offset(wanted.place(found).before).limit(PAGE)
    return session.execute(page).all(), found
