"""Events as they are shown; JSON, pages and exports read the same."""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Sequence
from typing import Any

import zstandard
from sqlalchemy import Select, select, tuple_
from sqlalchemy.orm import Session

from server.errors import GoneError, NotFoundError
from server.models import Batch, ChainSeal, Device, Event, EventAction, EventInput, EventRevision, Vehicle

LISTED = Event.withdrawn_at.is_(None), Event.erased_at.is_(None)
MAX_DOCUMENT_BYTES = 256 * 1024 * 1024
AROUND_ROWS = 8_000_000
AROUND_BATCHES = 4_000
"""Most rows, unless one batch alone has more, and most batches that are read around an event: a worker's memory."""


def selection(
    organisation_id: str,
    *,
    device_id: str | None = None,
    vehicle_id: str | None = None,
    kinds: Sequence[str] = (),
    severe: bool | None = None,
    since: dt.datetime | None = None,
    until: dt.datetime | None = None,
    before: tuple[dt.datetime, str] | None = None,
    limit: int,
) -> Select[Event]:
    """Events that were not withdrawn, the newest first, from after `before` in that order."""
    query = select(Event).where(Event.organisation_id == organisation_id, *LISTED)
    for column, wanted in ((Event.device_id, device_id), (Event.vehicle_id, vehicle_id), (Event.severe, severe)):
        if wanted is not None:
            query = query.where(column == wanted)
    if kinds:
        query = query.where(Event.kind.in_(kinds))
    if since is not None:
        query = query.where(Event.at >= since)
    if until is not None:
        query = query.where(Event.at < until)
    if before is not None:
        query = query.where(tuple_(Event.at, Event.id) < before)
    return query.order_by(Event.at.desc(), Event.id.desc()).limit(limit)


def events(session: Session, organisation_id: str, **wanted: Any) -> Sequence[Event]:
    """The rows of a `selection`."""
    return session.scalars(selection(organisation_id, **wanted)).all()


def severe(device_id: str | None) -> Select[str]:
    """Ids of the events that are reconstructed, the oldest first."""
    query = select(Event.id).where(Event.severe, *LISTED).order_by(Event.at, Event.id)
    return query if device_id is None else query.where(Event.device_id == device_id)


def event_of(session: Session, organisation_id: str, event_id: str, *, lock: bool = False) -> Event:
    """An event of the organisation, its row locked when it is going to change; a withdrawn one too."""
    event = session.get(Event, event_id, with_for_update=lock)
    if event is None or event.organisation_id != organisation_id:
        raise NotFoundError(f"There is no event {event_id!r}")
    if event.erased_at is not None:
        raise GoneError("The event is erased; its hashes stay in the chain of evidence", erased_at=event.erased_at)
    return event


def revisions(session: Session, event_id: str) -> Sequence[EventRevision]:
    """All revisions, the first one first."""
    query = select(EventRevision).where(EventRevision.event_id == event_id)
    return session.scalars(query.order_by(EventRevision.number)).all()


def revision_of(session: Session, event: Event, number: int | None = None) -> EventRevision:
    """One revision, the newest unless told."""
    query = select(EventRevision).where(
        EventRevision.event_id == event.id, EventRevision.number == (event.revision if number is None else number)
    )
    found = session.scalar(query)
    if found is None:
        raise NotFoundError(f"Event {event.id!r} has no revision {number}")
    return found


def canonical_bytes(revision: EventRevision) -> bytes:
    """The canonical JSON as it was stored."""
    return zstandard.ZstdDecompressor().decompress(revision.document, max_output_size=MAX_DOCUMENT_BYTES)


def document(revision: EventRevision) -> dict[str, Any]:
    """The canonical JSON, read."""
    return json.loads(canonical_bytes(revision))


def actions(session: Session, event_id: str) -> Sequence[EventAction]:
    """What was said and ordered, the newest first."""
    query = select(EventAction).where(EventAction.event_id == event_id)
    return session.scalars(query.order_by(EventAction.at.desc(), EventAction.id)).all()


def inputs(session: Session, event_id: str) -> Sequence[Batch]:
    """The batches that any revision rests on, in the order of the chain."""
    query = select(Batch).join(EventInput, EventInput.batch_id == Batch.id).where(EventInput.event_id == event_id)
    return session.scalars(query.order_by(Batch.chain_index)).all()


def batches_between(session: Session, device_id: str, boot: str, first_s: float, last_s: float) -> Sequence[Batch]:
    """Readable batches of both streams that reach into a span of the box's clock, in the order of the chain.

    The newest that have `AROUND_ROWS` together: of a box that never changes its boot's name and whose clock begins
    anew all the same, or of one with a single time far off, all that it ever sent would be read with each batch.
    """
    query = select(Batch).where(
        Batch.device_id == device_id,
        Batch.boot == boot,
        Batch.t_last_s >= first_s,
        Batch.t_first_s <= last_s,
        Batch.failure.is_(None),
        Batch.erasing_at.is_(None),
    )
    newest: list[Batch] = []
    rows = 0
    # Not by the index of the chain: few batches lie in the span, and with a limit all of the box's might be walked.
    for batch in session.scalars(query.order_by((Batch.chain_index + 0).desc()).limit(AROUND_BATCHES)):
        rows += batch.rows
        if newest and rows > AROUND_ROWS:
            break
        newest.append(batch)
    return newest[::-1]


def stored_between(session: Session, device_id: str, boot: str, first_s: float, last_s: float) -> Sequence[Event]:
    """Events of a boot that touch a span of the box's clock, the withdrawn ones too."""
    query = select(Event).where(
        Event.device_id == device_id,
        Event.boot == boot,
        Event.t_end_s >= first_s,
        Event.t0_s <= last_s,
        Event.erased_at.is_(None),
    )
    return session.scalars(query.order_by(Event.t0_s)).all()


def judged_otherwise(
    session: Session, device_id: str, installation_id: str, since: float, until: float, *, limit: int
) -> Sequence[Event]:
    """Manoeuvres, shocks and handling between two moments, Unix s, that rest on another mounting than this one."""
    query = (
        select(Event)
        .join(EventRevision, (EventRevision.event_id == Event.id) & (EventRevision.number == Event.revision))
        .where(
            Event.device_id == device_id,
            Event.severe.is_(False),
            Event.withdrawn_at.is_(None),
            Event.at >= dt.datetime.fromtimestamp(since, dt.UTC),
            EventRevision.installation_id != installation_id,
        )
    )
    if until < float("inf"):
        query = query.where(Event.at < dt.datetime.fromtimestamp(until, dt.UTC))
    return session.scalars(query.order_by(Event.at).limit(limit)).all()


def names(session: Session, device_id: str, vehicle_id: str | None) -> dict[str, str | None]:
    """What device and vehicle are called now, as a revision keeps it."""
    device, vehicle = session.get_one(Device, device_id), session.get(Vehicle, vehicle_id) if vehicle_id else None
    return {
        "device_name": device.name,
        "vehicle_name": None if vehicle is None else vehicle.name,
        "plate": None if vehicle is None else vehicle.plate,
    }


def newest_seal(session: Session, device_id: str) -> ChainSeal | None:
    """The seal that covers most of a device's chain."""
    query = select(ChainSeal).where(ChainSeal.device_id == device_id)
    return session.scalar(query.order_by(ChainSeal.chain_length.desc()).limit(1))
