"""The list of the fleet: every vehicle and every box in one row, filtered, sorted, a page at a time.

The list is read whole, as a few plain columns a row, because states are reckoned and not stored; what costs more
(driving, uncertainty) is read for the rows of the page alone, unless the list is sorted by it.
"""

from __future__ import annotations

import datetime as dt
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Literal, get_args

from sqlalchemy import and_, case, func, or_, select
from sqlalchemy.orm import Session

from server.models import Device, DeviceState, Installation, Trip, Vehicle
from server.pages import lists
from server.pages.alert_lines import AlertLine, lines
from server.pages.events import Line, unreviewed
from server.pages.words import LIVE_WITHIN, MOVED_IS_NEWS_FOR, SILENT_AFTER, Standing, State, largest_sigma, standing
from server.wording import marked

Show = Literal["all", "reporting", "loose", "moved", "silent", "waiting", "ready", "empty"]
Sort = Literal["name", "state", "speed", "distance", "driving", "seen"]
PERIODS = {7: marked("7 days"), 30: marked("30 days"), 0: marked("all time")}
SHOWN: dict[Show, str] = {
    "all": marked("All"),
    "reporting": marked("Reporting now"),
    "loose": marked("Not fixed"),
    "moved": marked("Moved"),
    "silent": marked("Silent"),
    "waiting": marked("Not calibrated"),
    "ready": marked("Ready"),
    "empty": marked("No box"),
}
_BADNESS: dict[State, int] = {"alarm": 0, "attention": 1, "unknown": 2, "good": 3}


@dataclass(frozen=True)
class Wanted(lists.Wanted):
    """What a reader asked of the list; its address says the same."""

    sort: Sort = "name"
    show: Show = "all"
    days: int = 30

    FALLING: ClassVar[frozenset[str]] = frozenset({"speed", "distance", "driving", "seen"})


@dataclass(frozen=True)
class Row:
    """A box and the vehicle that carries it, or a vehicle without a box."""

    device_id: str | None
    device_name: str
    vehicle_id: str | None
    vehicle_name: str | None
    plate: str | None
    vehicle_class: str | None
    last_seen_at: dt.datetime | None
    lat_deg: float | None
    lon_deg: float | None
    fix_speed_mps: float | None
    """At the last fix, however old."""
    speed_mps: float | None
    """At a fix so young that it tells of now."""
    standing: Standing
    reporting: bool
    silent: bool
    shows: frozenset[Show]
    """Filters that let it through."""
    distance_m: float = 0.0
    moving_s: float = 0.0

    @property
    def name(self) -> str:
        return self.vehicle_name or self.device_name

    @property
    def url(self) -> str:
        return f"/vehicles/{self.vehicle_id}" if self.vehicle_id else f"/devices/{self.device_id}"

    @property
    def mark(self) -> State:
        """State for the map; a box that is silent is unknown, whatever it was before."""
        return "unknown" if self.silent else self.standing.state


@dataclass(frozen=True)
class Tile:
    """A kind of thing that needs attention, and whom it concerns."""

    state: State
    heading: str
    meaning: str
    href: str
    rows: Sequence[Row | Line | AlertLine]


@dataclass(frozen=True)
class Fleet:
    """The list as a reader asked for it."""

    wanted: Wanted
    rows: Sequence[Row]
    """Of the page."""
    found: int
    """Rows that the filters leave."""
    everything: Sequence[Row]
    """Before the filters."""
    crashes: Sequence[Line]
    """Severe events that nobody has looked at."""
    alerts: Sequence[AlertLine]
    """Alerts that nobody has acknowledged."""

    @property
    def boxes(self) -> int:
        return sum(row.device_id is not None for row in self.everything)

    @property
    def reporting(self) -> int:
        return sum(row.reporting for row in self.everything)

    @cached_property
    def counts(self) -> Mapping[Show, int]:
        found = Counter(show for row in self.everything for show in row.shows)
        return {show: found[show] for show in get_args(Show)}

    @cached_property
    def tiles(self) -> Sequence[Tile]:
        """What needs attention now."""

        def of(show: Show) -> list[Row]:
            return [row for row in self.everything if show in row.shows]

        return [
            Tile("alarm", marked("Crash"), marked("not yet looked at"), "/events", self.crashes),
            Tile("attention", marked("Alerts"), marked("not acknowledged"), "/alerts", self.alerts),
            Tile("alarm", SHOWN["loose"], marked("the box swings or lies loose"), "/?show=loose", of("loose")),
            Tile("attention", SHOWN["moved"], marked("turned in its vehicle"), "/?show=moved", of("moved")),
            Tile("unknown", SHOWN["silent"], marked("no word for a day, or never"), "/?show=silent", of("silent")),
            Tile("attention", SHOWN["waiting"], marked("still learning how it sits"), "/?show=waiting", of("waiting")),
        ]


def fleet(session: Session, organisation_id: str, wanted: Wanted, *, now: dt.datetime) -> Fleet:
    """The rows of one page of the list, and the figures around it."""
    everything = _rows(session, organisation_id, now=now)
    rows = listed(session, organisation_id, everything, wanted, now=now)
    first = wanted.place(len(rows)).before
    shown = rows[first : first + lists.PAGE]
    if wanted.sort not in ("distance", "driving"):
        shown = _with_driving(session, organisation_id, shown, wanted.days, now=now)
    shown = _with_sigma(session, shown)
    crashes = unreviewed(session, organisation_id, now=now)
    alerts = lines(session, organisation_id, waiting=True)
    return Fleet(wanted, shown, len(rows), everything, crashes, alerts)


def whole(session: Session, organisation_id: str, wanted: Wanted, *, now: dt.datetime) -> Sequence[Row]:
    """Every row that the filters leave, with all figures: for a file."""
    rows = _rows(session, organisation_id, now=now)
    rows = _with_driving(session, organisation_id, rows, wanted.days, now=now, everywhere=True)
    return _with_sigma(session, _sorted([row for row in rows if _matches(row, wanted)], wanted))


def places(session: Session, organisation_id: str, wanted: Wanted, *, now: dt.datetime) -> Sequence[Row]:
    """Rows with a position that the filters leave: for the map."""
    rows = _rows(session, organisation_id, now=now)
    return [row for row in rows if row.lat_deg is not None and _matches(row, wanted)]


def listed(
    session: Session, organisation_id: str, rows: Sequence[Row], wanted: Wanted, *, now: dt.datetime
) -> Sequence[Row]:
    """What the filters leave, in order."""
    kept = [row for row in rows if _matches(row, wanted)]
    if wanted.sort in ("distance", "driving"):
        kept = _with_driving(session, organisation_id, kept, wanted.days, now=now, everywhere=True)
    return _sorted(kept, wanted)


def _matches(row: Row, wanted: Wanted) -> bool:
    if wanted.show not in row.shows:
        return False
    text = f"{row.vehicle_name or ''} {row.plate or ''} {row.device_name}".casefold()
    # A plate is found with and without its blanks.
    return all(word in text or word in text.replace(" ", "") for word in wanted.q.casefold().split())


def _sorted(rows: Sequence[Row], wanted: Wanted) -> list[Row]:
    """By one column; what it does not know comes last, whichever way."""
    names = sorted(rows, key=lambda row: (row.name.casefold(), row.device_name))

    def key(row: Row) -> Any:  # of the column's type
        match wanted.sort:
            case "name":
                return row.name.casefold()
            case "state":
                return (_BADNESS[row.mark], row.standing.percent)
            case "speed":
                return row.speed_mps
            case "distance":
                return row.distance_m or None
            case "driving":
                return row.moving_s or None
            case "seen":
                return row.last_seen_at

    known = [row for row in names if key(row) is not None]
    return sorted(known, key=key, reverse=wanted.down) + [row for row in names if key(row) is None]


def _rows(session: Session, organisation_id: str, *, now: dt.datetime) -> list[Row]:
    """Every box in use and every vehicle without one, by name, without driving and uncertainty."""
    columns = (
        Device.id,
        Device.name,
        Device.last_seen_at,
        Vehicle.id.label("vehicle_id"),
        Vehicle.name.label("vehicle_name"),
        Vehicle.plate,
        Vehicle.vehicle_class,
        DeviceState.lat_deg,
        DeviceState.lon_deg,
        DeviceState.speed_mps,
        DeviceState.position_at,
        Installation.status,
        Installation.progress,
        Installation.beginning,
        Installation.updated_at,
    )
    statement = (
        select(*columns)
        .select_from(Device)
        .outerjoin(Vehicle, Vehicle.id == Device.vehicle_id)
        .outerjoin(DeviceState, DeviceState.device_id == Device.id)
        .outerjoin(Installation, (Installation.device_id == Device.id) & Installation.ended_at.is_(None))
        .where(Device.organisation_id == organisation_id, Device.revoked_at.is_(None))
        .order_by(func.coalesce(Vehicle.name, Device.name), Device.name, Installation.began_at)
    )
    # A box with two open installations shows the later one.
    boxes = {found.id: _row(found, now=now) for found in session.execute(statement)}
    carried = {row.vehicle_id for row in boxes.values()}
    vehicles = select(Vehicle.id, Vehicle.name, Vehicle.plate, Vehicle.vehicle_class)
    empty = [
        Row(None, "", id_, name, plate, class_, None, None, None, None, None, _NO_BOX, False, False, _EMPTY)
        for id_, name, plate, class_ in session.execute(
            vehicles.where(Vehicle.organisation_id == organisation_id).order_by(Vehicle.name)
        )
        if id_ not in carried
    ]
    return [*boxes.values(), *empty]


_EMPTY: frozenset[Show] = frozenset({"all", "empty"})
_NO_BOX = Standing("unknown", SHOWN["empty"], 0, None, moved=False, calibrated=False)


def _row(found: Any, *, now: dt.datetime) -> Row:  # a row of the statement above
    moved = found.beginning == "moved"
    how = standing(found.status, {}, progress=found.progress or 0.0, moved=moved)
    quiet_for = None if found.last_seen_at is None else now - found.last_seen_at
    reporting = quiet_for is not None and quiet_for < LIVE_WITHIN
    # Both count: what a box sends late is old although the box is heard now.
    is_live = reporting and found.position_at is not None and now - found.position_at < LIVE_WITHIN
    silent = quiet_for is None or quiet_for > SILENT_AFTER
    shows: dict[Show, bool] = {
        "all": True,
        "reporting": reporting,
        "loose": how.state == "alarm",
        "moved": moved and (not how.calibrated or now - found.updated_at < MOVED_IS_NEWS_FOR),
        "silent": silent,
        "waiting": not how.calibrated and how.state != "alarm",
        "ready": how.calibrated,
    }
    return Row(
        device_id=found.id,
        device_name=found.name,
        vehicle_id=found.vehicle_id,
        vehicle_name=found.vehicle_name,
        plate=found.plate,
        vehicle_class=found.vehicle_class,
        last_seen_at=found.last_seen_at,
        lat_deg=found.lat_deg,
        lon_deg=found.lon_deg,
        fix_speed_mps=found.speed_mps,
        speed_mps=found.speed_mps if is_live else None,
        standing=how,
        reporting=reporting,
        silent=silent,
        shows=frozenset(show for show, holds in shows.items() if holds),
    )


def _with_sigma(session: Session, rows: Sequence[Row]) -> list[Row]:
    """The same rows with the uncertainty of their mountings."""
    statement = select(Installation.device_id, Installation.result).where(Installation.ended_at.is_(None))
    if len(rows) <= lists.PAGE:
        statement = statement.where(Installation.device_id.in_([row.device_id for row in rows if row.device_id]))
    results = session.execute(statement.order_by(Installation.began_at))
    sigmas = {device_id: largest_sigma(result) for device_id, result in results}
    return [
        replace(row, standing=replace(row.standing, sigma_deg=sigmas.get(row.device_id))) if row.device_id else row
        for row in rows
    ]


def _with_driving(
    session: Session,
    organisation_id: str,
    rows: Sequence[Row],
    days: int,
    *,
    now: dt.datetime,
    everywhere: bool = False,
) -> list[Row]:
    """The same rows with what was driven in the last days, or ever."""
    since = None if days == 0 else now - dt.timedelta(days=days)
    driven = _Driven.of(session, organisation_id, since, None if everywhere else rows)
    return [
        replace(row, distance_m=metres, moving_s=seconds) for row in rows for metres, seconds in [driven.by_row(row)]
    ]


Sum = tuple[float, float]
"""Metres and seconds of driving."""


@dataclass(frozen=True)
class _Driven:
    """What was driven, so that it can be told for a vehicle whichever boxes it carried."""

    boxes: Mapping[str, Sum]
    """Of a box, wherever it sat."""
    together: Mapping[tuple[str, str], Sum]
    """Of a box in the vehicle that it still sits in."""
    former: Mapping[str, Sum]
    """Of a vehicle with boxes that left it."""

    def by_row(self, row: Row) -> Sum:
        """What its row shows.  Another box in the same vehicle measured the same way: it counts in its own row."""
        nothing = (0.0, 0.0)
        if row.vehicle_id is None:
            return self.boxes.get(row.device_id or "", nothing)
        here = self.together.get((row.device_id or "", row.vehicle_id), nothing)
        before = self.former.get(row.vehicle_id, nothing)
        return here[0] + before[0], here[1] + before[1]

    @classmethod
    def of(
        cls, session: Session, organisation_id: str, since: dt.datetime | None, rows: Collection[Row] | None
    ) -> _Driven:
        """Sums over trips; of some rows, or of all."""
        sits_there = and_(Device.vehicle_id == Trip.vehicle_id, Device.revoked_at.is_(None))
        statement = (
            select(
                Trip.device_id,
                Trip.vehicle_id,
                func.sum(Trip.distance_m),
                func.sum(Trip.moving_s),
                func.max(case((sits_there, 1), else_=0)),
            )
            .join(Device, Device.id == Trip.device_id)
            .where(Trip.organisation_id == organisation_id)
            .group_by(Trip.device_id, Trip.vehicle_id)
        )
        if since is not None:
            statement = statement.where(Trip.began_at >= since)
        if rows is not None:
            devices, vehicles = {row.device_id for row in rows}, {row.vehicle_id for row in rows}
            statement = statement.where(
                or_(Trip.device_id.in_(devices - {None}), Trip.vehicle_id.in_(vehicles - {None}))
            )
        boxes: defaultdict[str, Sum] = defaultdict(lambda: (0.0, 0.0))
        former: defaultdict[str, Sum] = defaultdict(lambda: (0.0, 0.0))
        together: dict[tuple[str, str], Sum] = {}
        for device_id, vehicle_id, metres, seconds, still_there in session.execute(statement):
            boxes[device_id] = boxes[device_id][0] + metres, boxes[device_id][1] + seconds
            if vehicle_id is not None and still_there:
                together[device_id, vehicle_id] = metres, seconds
            elif vehicle_id is not None:
                former[vehicle_id] = former[vehicle_id][0] + metres, former[vehicle_id][1] + seconds
        return cls(boxes, together, former)
