"""The list of events: by vehicle, days, kind and what the review said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from fastapi import APIRouter, Depends, Query, Request
from sqlalchemy import ColumnElement, SQLColumnExpression, func, select
from sqlalchemy.orm import Session
from starlette.responses import HTMLResponse

from server.accounts.access import Reader
from server.edge import DatabaseOf
from server.errors import ProblemError
from server.events import queries as events
from server.models import Device, Event, Vehicle
from server.pages import lists, queries
from server.pages.events import REVIEWS, Line
from server.pages.routes import answer
from server.wording import marked

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)

Show = Literal["severe", "manoeuvres", "all"]
Review = Literal["any", "open", "confirmed", "false_alarm"]
Sort = Literal["when", "vehicle", "delta_v", "peak"]
SHOWN: dict[Show, str] = {"severe": marked("Crashes"), "manoeuvres": marked("Manoeuvres"), "all": marked("All")}
REVIEWED: dict[Review, str] = {
    "any": marked("any"),
    "open": REVIEWS[None],
    "confirmed": REVIEWS["confirmed"],
    "false_alarm": REVIEWS["false_alarm"],
}
_SORTED: dict[Sort, SQLColumnExpression[Any]] = {
    "when": Event.at,
    "vehicle": func.lower(func.coalesce(Vehicle.name, Device.name)),
    "delta_v": Event.result[("delta_v_kmh", "resultant")].as_float(),
    "peak": Event.result["peak_g"].as_float(),
}


@dataclass(frozen=True)
class Wanted(lists.Wanted):
    """What a reader asked of the list."""

    sort: Sort = "when"
    down: bool = True
    show: Show = "severe"
    review: Review = "any"
    since: str = ""
    until: str = ""

    FALLING: ClassVar[frozenset[str]] = frozenset({"when", "delta_v", "peak"})

    def conditions(self) -> list[ColumnElement[bool]]:
        """Of the filters; raises `InvalidError` when a day is none."""
        found = lists.named(self.q, Event.note, Event.hold_reason)
        if self.show != "all":
            found.append(Event.severe.is_(self.show == "severe"))
        if self.review == "open":
            found += [Event.severe.is_(True), Event.verdict.is_(None)]
        elif self.review != "any":
            found.append(Event.verdict == self.review)
        return found + lists.between(Event.at, self.since, self.until)


def _wanted(
    q: Annotated[str, Query(max_length=100)] = "",
    show: Show = "severe",
    review: Review = "any",
    since: Annotated[str, Query(max_length=20)] = "",
    until: Annotated[str, Query(max_length=20)] = "",
    sort: Sort = "when",
    down: bool = True,
    page: Annotated[int, Query(ge=1, le=100_000)] = 1,
) -> Wanted:
    return Wanted(
        q=q.strip(), sort=sort, down=down, page=page, show=show, review=review, since=since.strip(), until=until.strip()
    )


def listed(session: Session, organisation_id: str, wanted: Wanted) -> tuple[Sequence[Line], int]:
    """Events of one page of the list, and how many the filters leave."""
    query = (
        select(Event, Vehicle, Device)
        .join(Device, Device.id == Event.device_id)
        .outerjoin(Vehicle, Vehicle.id == Event.vehicle_id)
        .where(Event.organisation_id == organisation_id, *events.LISTED, *wanted.conditions())
    )
    column = _SORTED[wanted.sort]
    order = (column.desc() if wanted.down else column.asc()).nulls_last()
    rows, found = lists.rows_of(session, query, wanted, order, Event.at.desc(), Event.id)
    return [Line(event, vehicle, device) for event, vehicle, device in rows], found


@router.get("/events")
def event_list(
    request: Request, caller: Reader, database: DatabaseOf, wanted: Annotated[Wanted, Depends(_wanted)]
) -> HTMLResponse:
    """What happened, the newest first unless asked otherwise."""
    problem: ProblemError | None = None
    lines: Sequence[Line] = []
    found = 0
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        try:
            lines, found = listed(session, caller.organisation_id, wanted)
        except ProblemError as error:
            problem = error
    context = {
        "lines": lines,
        "found": found,
        "wanted": wanted,
        "shown_words": SHOWN,
        "reviewed": REVIEWED,
        "views": caller.preferences.views_of("events"),
        "error": problem and problem.detail,
    }
    page = answer(request, "events.html", caller, "events", change, context)
    page.status_code = 200 if problem is None else problem.status
    return page
