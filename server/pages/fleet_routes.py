"""The pages that show the fleet as a list and on a map, the file of the list, and what readers keep of it."""

from __future__ import annotations

import csv
import io
from typing import Annotated, Literal

import orjson
from fastapi import APIRouter, Depends, Form, Query, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from server.accounts.access import Caller, PlaceReader, Reader, look_at_places
from server.accounts.places import Sight, seen, sight_of
from server.accounts.preferences import View
from server.accounts.service import keep_preferences
from server.edge import DatabaseOf, Now, SettingsOf
from server.formats.spreadsheet import spreadsheet_text
from server.language import catalogue
from server.pages import frame, queries
from server.pages.events import search
from server.pages.fleet import PERIODS, SHOWN, Fleet, Row, Show, Sort, Wanted, fleet, places, whole
from server.pages.routes import answer, map_settings

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)


def _wanted(
    q: Annotated[str, Query(max_length=100)] = "",
    show: Show = "all",
    sort: Sort = "name",
    down: bool = False,
    days: Annotated[int, Query(ge=0, le=3650)] = 30,
    page: Annotated[int, Query(ge=1, le=100_000)] = 1,
) -> Wanted:
    return Wanted(q=q.strip(), show=show, sort=sort, down=down, days=days if days in PERIODS else 30, page=page)


WantedOf = Annotated[Wanted, Depends(_wanted)]
ListPage = Literal["fleet", "vehicles", "events", "trips"]
LISTS: dict[ListPage, str] = {"fleet": "/", "vehicles": "/vehicles", "events": "/events", "trips": "/trips"}
"""Where each list is that views are kept of."""


@router.get("/")
def fleet_page(
    request: Request, caller: Reader, settings: SettingsOf, database: DatabaseOf, now: Now, wanted: WantedOf
) -> HTMLResponse:
    """Map, what needs attention, and the list."""
    look_at_places(request, caller)
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        found = fleet(session, caller.organisation_id, wanted, now=now)
    context = {**_context(found, caller, "fleet", "/"), **map_settings(settings)}
    return answer(request, "fleet.html", caller, "fleet", change, context)


@router.get("/vehicles")
def vehicles_page(request: Request, caller: Reader, database: DatabaseOf, now: Now, wanted: WantedOf) -> HTMLResponse:
    """The list alone, and where the search of every page leads."""
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        found = fleet(session, caller.organisation_id, wanted, now=now)
        events = search(session, caller.organisation_id, wanted.q) if wanted.q else []
    if wanted.q and found.found + len(events) == 1:
        one = found.rows[0].url if found.found else events[0].url
        return RedirectResponse(one, 303)  # type: ignore[return-value]
    context = {**_context(found, caller, "vehicles", "/vehicles"), "events": events}
    return answer(request, "vehicles.html", caller, "vehicles", change, context)


def _context(found: Fleet, caller: Caller, page: str, path: str) -> dict[str, object]:
    return {
        "fleet": found,
        "wanted": found.wanted,
        "path": path,
        "searched": found.wanted.q,
        "shown_words": SHOWN,
        "periods": PERIODS,
        "list_page": page,
        "views": caller.preferences.views_of(page),
    }


@router.get("/fleet.csv")
def fleet_file(request: Request, caller: Reader, database: DatabaseOf, now: Now, wanted: WantedOf) -> Response:
    """The list as a file: the same filters, every row, SI-based units in the names of its columns."""
    look_at_places(request, caller)
    sight = sight_of(caller)
    with database.reading() as session:
        rows = whole(session, caller.organisation_id, wanted, now=now)
    sink = io.StringIO()
    out = csv.writer(sink, lineterminator="\r\n")
    head = [
        "vehicle",
        "plate",
        "class",
        "box",
        "state",
        "percent",
        "sigma_deg",
        "distance_km",
        "driving_h",
        "last_seen",
    ]
    out.writerow([*head, *(("lat_deg", "lon_deg") if sight != "none" else ())])
    for row in rows:
        out.writerow(
            [
                spreadsheet_text(row.vehicle_name),
                spreadsheet_text(row.plate),
                row.vehicle_class or "",
                spreadsheet_text(row.device_name),
                row.standing.headline,
                row.standing.percent if row.device_id else "",
                "" if row.standing.sigma_deg is None else round(row.standing.sigma_deg, 2),
                round(row.distance_m / 1000.0, 3),
                round(row.moving_s / 3600.0, 3),
                "" if row.last_seen_at is None else row.last_seen_at.isoformat(),
                *(() if sight == "none" else _where(row, sight)),
            ]
        )
    headers = {"Content-Disposition": f'attachment; filename="fleet-{now:%Y%m%d-%H%M}.csv"'}
    return Response(sink.getvalue(), media_type="text/csv; charset=utf-8", headers=headers)


def _where(row: Row, sight: Sight) -> tuple[float | str, float | str]:
    place = seen(row.lat_deg, row.lon_deg, sight)
    return ("", "") if place is None else (place.lat_deg, place.lon_deg)


@router.get("/fleet/places")
def fleet_places(request: Request, caller: PlaceReader, database: DatabaseOf, now: Now, wanted: WantedOf) -> Response:
    """Where the rows of the list are, for the map: id, address, name, mark, words, latitude, longitude."""
    said = catalogue(frame.language_of(request)).gettext
    with database.reading() as session:
        rows = places(session, caller.organisation_id, wanted, now=now)
    found: list[tuple[object, ...]] = []
    for row in rows:
        how = row.standing
        words = f"{said(how.headline)} {how.percent} %" if how.percent_says else said(how.headline)
        found.append((row.device_id, row.url, row.name, row.mark, words, *_where(row, sight_of(caller))))
    return Response(orjson.dumps(found), media_type="application/json")


@router.post("/views")
def keep_view(
    caller: Reader,
    database: DatabaseOf,
    page: Annotated[ListPage, Form()],
    name: Annotated[str, Form(min_length=1, max_length=60)],
    query: Annotated[str, Form(max_length=500)] = "",
    forget: Annotated[bool, Form()] = False,
) -> Response:
    """Keep the list as it is shown under a name, or forget one."""
    kept = caller.preferences
    changed = kept.without_view(page, name) if forget else kept.with_view(View(page, name.strip(), query.lstrip("?")))
    with database.transaction() as session:
        keep_preferences(session, caller, changed)
    return RedirectResponse(LISTS[page] + ("" if forget else f"?{query.lstrip('?')}"), 303)
