"""Events over HTTP."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import orjson
from fastapi import APIRouter, Path, Query, Request
from sqlalchemy.orm import Session
from starlette.responses import Response

from server.accounts import audit
from server.accounts.access import (
    Caller,
    LocationReader,
    RawReader,
    Reader,
    Reviewer,
    look_at_places,
)
from server.accounts.places import sight_of
from server.database import Database
from server.edge import DatabaseOf, Moment, Now, StoreOf, place_of
from server.events import exports, queries, service, verdicts
from server.events.schemas import (
    DifferenceOut,
    DiffOut,
    EventDetail,
    EventOut,
    EventPage,
    History,
    HoldIn,
    Kind,
    ReviewIn,
    event_detail,
    event_out,
    history,
    revision_out,
)
from server.models import Batch, Device, Event, EventRevision, Vehicle

router = APIRouter(prefix="/api/v1/events", tags=["events"])

EventId = Annotated[str, Path(max_length=32)]
Revision = Annotated[int | None, Query(ge=1, le=1_000_000, description="default: the newest")]
Language = Literal["en", "it"]


@router.get("")
def list_events(
    request: Request,
    caller: Reader,
    database: DatabaseOf,
    device: Annotated[str | None, Query(max_length=32)] = None,
    vehicle: Annotated[str | None, Query(max_length=32)] = None,
    kind: Annotated[list[Kind] | None, Query(description="may be repeated")] = None,
    severe: Annotated[
        bool | None, Query(description="crashes, rollovers and parked impacts only, or all but them")
    ] = None,
    since: Annotated[Moment | None, Query(alias="from")] = None,
    until: Annotated[Moment | None, Query(alias="to")] = None,
    before: Annotated[str | None, Query(max_length=100)] = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
) -> EventPage:
    """Events, the newest first, a page at a time; the place of rest is coarse or null without location.read."""
    look_at_places(request, caller)
    with database.reading() as session:
        rows = queries.events(
            session,
            caller.organisation_id,
            device_id=device,
            vehicle_id=vehicle,
            kinds=kind or (),
            severe=severe,
            since=since,
            until=until,
            before=None if before is None else place_of(before),
            limit=limit + 1,
        )
        last = rows[limit - 1] if len(rows) > limit else None
        return EventPage(
            items=[event_out(row, sight=sight_of(caller)) for row in rows[:limit]],
            next=None if last is None else f"{last.at.isoformat()}~{last.id}",
        )


@router.get("/verdicts", responses={200: {"content": {"text/csv": {"schema": {"type": "string"}}}}})
def read_verdicts(
    caller: Reviewer,
    database: DatabaseOf,
    now: Now,
    form: Annotated[verdicts.VerdictFormat, Query(alias="format")] = "json",
    since: Annotated[Moment | None, Query(alias="from")] = None,
    until: Annotated[Moment | None, Query(alias="to")] = None,
) -> Response:
    """Every event that somebody confirmed or called a false alarm, with the detector's figures: to tune it on."""
    with database.transaction() as session:
        rows = list(verdicts.verdicts(session, caller.organisation_id, since=since, until=until))
        detail = {"format": form, "events": len(rows)}
        audit.record(session, caller, "export", "verdicts", now=now, detail=detail)
    content = verdicts.as_csv(rows) if form == "csv" else orjson.dumps({"items": rows})
    headers = {"Content-Disposition": f'attachment; filename="verdicts-{now:%Y%m%dT%H%M%SZ}.{form}"'}
    media_type = "text/csv; charset=utf-8" if form == "csv" else "application/json"
    return Response(content, headers=headers, media_type=media_type)


@router.get("/{event_id}")
def read(request: Request, event_id: EventId, caller: Reader, database: DatabaseOf) -> EventDetail:
    """One event as its newest revision tells it; the place of rest is coarse or null without location.read."""
    look_at_places(request, caller)
    with database.reading() as session:
        event = queries.event_of(session, caller.organisation_id, event_id)
        return event_detail(event, queries.revision_of(session, event), sight=sight_of(caller))


@router.get("/{event_id}/revisions")
def read_history(event_id: EventId, caller: Reader, database: DatabaseOf) -> History:
    """Every revision, and everything that was said or ordered."""
    with database.reading() as session:
        queries.event_of(session, caller.organisation_id, event_id)
        return history(queries.revisions(session, event_id), queries.actions(session, event_id))


@router.get("/{event_id}/diff")
def read_diff(
    event_id: EventId,
    caller: LocationReader,
    database: DatabaseOf,
    before: Annotated[int, Query(ge=1)],
    after: Annotated[int | None, Query(ge=1, description="default: the newest")] = None,
) -> DiffOut:
    """Where two revisions differ, whether by their input or by the algorithm."""
    with database.reading() as session:
        event = queries.event_of(session, caller.organisation_id, event_id)
        old, new = queries.revision_of(session, event, before), queries.revision_of(session, event, after)
    found = service.differences(queries.document(old), queries.document(new))
    return DiffOut(
        before=revision_out(old),
        after=revision_out(new),
        same_input=old.input_sha256 == new.input_sha256,
        same_algorithm=old.algorithm == new.algorithm,
        differences=[DifferenceOut(path=path, before=a, after=b) for path, a, b in found],
    )


@router.put("/{event_id}/review")
def put_review(
    request: Request, event_id: EventId, wanted: ReviewIn, caller: Reviewer, database: DatabaseOf, now: Now
) -> EventOut:
    """Confirm an event, call it a false alarm, or open it again."""
    look_at_places(request, caller)
    with database.transaction() as session:
        event = service.review(
            session, caller.organisation_id, event_id, wanted.verdict, wanted.note, actor=caller.name, now=now
        )
        return event_out(event, sight=sight_of(caller))


@router.put("/{event_id}/hold")
def put_hold(
    request: Request, event_id: EventId, wanted: HoldIn, caller: Reviewer, database: DatabaseOf, now: Now
) -> EventOut:
    """Put an event under a legal hold, or release it."""
    look_at_places(request, caller)
    with database.transaction() as session:
        event = service.hold(
            session,
            caller.organisation_id,
            event_id,
            held=wanted.held,
            reason=wanted.reason,
            actor=caller.name,
            now=now,
        )
        note_hold(session, caller, event, now=now)
        return event_out(event, sight=sight_of(caller))


def note_hold(session: Session, caller: Caller, event: Event, *, now: dt.datetime) -> None:
    """Tell the audit log of a hold that was placed or ended."""
    action = "hold.ended" if event.held_at is None else "hold.placed"
    detail = {} if event.hold_reason is None else {"reason": event.hold_reason}
    audit.record(session, caller, action, f"event {event.id}", now=now, detail=detail)


@dataclass(frozen=True)
class Subject:
    """An event, one revision of it, and what it is about."""

    event: Event
    revision: EventRevision
    document: dict[str, Any]
    device: Device
    vehicle: Vehicle | None
    batches: list[Batch]


def subject_of(database: Database, caller: Caller, event_id: str, number: int | None) -> Subject:
    """Everything that an export needs, read once."""
    with database.reading() as session:
        event = queries.event_of(session, caller.organisation_id, event_id)
        revision = queries.revision_of(session, event, number)
        return Subject(
            event,
            revision,
            queries.document(revision),
            session.get_one(Device, event.device_id),
            session.get(Vehicle, event.vehicle_id) if event.vehicle_id else None,
            list(queries.inputs(session, event.id)),
        )


def attachment(content: bytes, media_type: str, subject: Subject, name: str) -> Response:
    """A file that is named after the event; its tag is the revision's hash."""
    headers = {
        "Content-Disposition": f'attachment; filename="{subject.event.kind}-{subject.event.id[:8]}-{name}"',
        "ETag": f'"{subject.revision.event_sha256[:32]}"',
    }
    return Response(content, headers=headers, media_type=media_type)


def _file(media_type: str) -> dict[int | str, dict[str, Any]]:
    return {200: {"content": {media_type: {"schema": {"type": "string", "format": "binary"}}}}}


@router.get("/{event_id}/event.json", response_class=Response, responses=_file("application/json"))
def read_canonical(
    event_id: EventId, caller: LocationReader, database: DatabaseOf, revision: Revision = None
) -> Response:
    """The canonical JSON: the same bytes whenever it is computed again from the same inputs."""
    subject = subject_of(database, caller, event_id, revision)
    return attachment(queries.canonical_bytes(subject.revision), "application/json", subject, "event.json")


@router.get("/{event_id}/edr.json", response_class=Response, responses=_file("application/json"))
def read_edr(event_id: EventId, caller: Reader, database: DatabaseOf, revision: Revision = None) -> Response:
    """The elements of 49 CFR 563 tables I and II, "not recorded" where a box cannot know."""
    subject = subject_of(database, caller, event_id, revision)
    content = exports.edr_json(subject.document, subject.revision.event_sha256)
    return attachment(orjson.dumps(content), "application/json", subject, "edr.json")


@router.get("/{event_id}/edr.csv", response_class=Response, responses=_file("text/csv"))
def read_edr_csv(event_id: EventId, caller: Reader, database: DatabaseOf, revision: Revision = None) -> Response:
    """The same as a table."""
    subject = subject_of(database, caller, event_id, revision)
    return attachment(exports.edr_csv(subject.document), "text/csv; charset=utf-8", subject, "edr.csv")


@router.get("/{event_id}/trace", response_class=Response, responses=_file("application/octet-stream"))
def read_trace(
    event_id: EventId,
    caller: RawReader,
    _located: LocationReader,
    database: DatabaseOf,
    store: StoreOf,
    form: Annotated[exports.TraceFormat, Query(alias="format")] = "parquet",
    revision: Revision = None,
) -> Response:
    """Raw samples of the event's window, a drive file in Parquet or CSV, or MCAP for telemetry viewers."""
    subject = subject_of(database, caller, event_id, revision)
    columns = exports.trace(store, subject.document, subject.batches)
    content = exports.trace_bytes(columns, subject.document, form)
    return attachment(content, exports.TRACE_MEDIA[form], subject, f"trace.{form}")
