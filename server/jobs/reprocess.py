"""Computing events again from their own inputs, with this version; other bytes make a further revision."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import zstandard
from sqlalchemy.orm import Session

from nav_core.crash import reconstruct_drive
from nav_core.events.record import CrashEvent
from server.database import Database
from server.events import exports, queries
from server.events.canonical import canonical, settle
from server.events.service import differences
from server.events.window import Part
from server.jobs.events import SAME_S, Reconstructor, event_document, run_inputs
from server.live.changes import announce
from server.models import DeviceState, Event, EventRevision, new_id
from server.store import BlobStore, raw_columns


@dataclass(frozen=True)
class Again:
    """How an event came out."""

    event_id: str
    revision: int
    before_algorithm: str
    algorithm: str
    outcome: str
    """same, revised, gone (no such event by this version), erased (raw data are gone), contended (try again)."""
    differences: tuple[str, ...] = ()
    """Members of the canonical JSON that differ."""
    before: dict[str, Any] | None = None
    after: dict[str, Any] | None = None
    """The event's figures."""


FIGURES = (
    "kind",
    "t0_s",
    "delta_v_kmh",
    "pdof_deg",
    "impact_speed_kmh",
    "peak_g",
    "asi",
    "olc_g",
    "clipped",
    "quality",
)
"""Of an event, what a comparison of versions shows."""


def figures(event: dict[str, Any]) -> dict[str, Any]:
    """Those of an event's JSON."""
    return {name: event.get(name) for name in FIGURES}


def severe_events(database: Database, device_id: str | None) -> list[str]:
    """Ids of the events that are reconstructed, the oldest first."""
    with database.reading() as session:
        return list(session.scalars(queries.severe(device_id)))


def reprocess(
    database: Database,
    store: BlobStore,
    event_id: str,
    *,
    clock: Callable[[], dt.datetime],
    reconstructor: Reconstructor = reconstruct_drive,
) -> Again:
    """Compute one event again."""
    with database.reading() as session:
        event = session.get_one(Event, event_id)
        state = session.get(DeviceState, event.device_id)
        version = None if state is None else state.version
        revision = queries.revision_of(session, event)
        batches = list(queries.inputs(session, event_id))
    document = queries.document(revision)
    inputs = {name: value for name, value in document["inputs"].items() if name != "sha256"}
    try:
        parts = [Part(raw_columns(store, batch), batch.stream == "burst") for batch in exports.used(document, batches)]
    except KeyError:
        return Again(event_id, event.revision, revision.algorithm, revision.algorithm, "erased")
    found = run_inputs(inputs, parts, reconstructor)

    def away(each: CrashEvent) -> float:
        # Another version may tell of another of its blows.
        return min(abs(t - event.t0_s) for t in each.blows)

    nearest = min(found, key=away, default=None)
    if nearest is None or away(nearest) > SAME_S:
        return Again(event_id, event.revision, revision.algorithm, revision.algorithm, "gone")
    again = settle(event_document(nearest, inputs, device_id=event.device_id, boot=event.boot))
    paths = tuple(path for path, _, _ in differences(document, again))
    outcome = "same"
    if paths:
        with database.transaction() as session:
            kept = _keep(session, event_id, version, revision, again, now=clock())
        outcome = "revised" if kept else "contended"
    number = event.revision + (outcome == "revised")
    told = figures(document["event"]), figures(again["event"])
    return Again(event_id, number, revision.algorithm, again["algorithm"], outcome, paths, *told)


def _keep(
    session: Session,
    event_id: str,
    version: int | None,
    before: EventRevision,
    document: dict[str, Any],
    *,
    now: dt.datetime,
) -> bool:
    """Store the revision unless the box was worked on meanwhile."""
    event = session.get_one(Event, event_id)
    state = session.get(DeviceState, event.device_id, with_for_update=True)
    if (None if state is None else state.version) != version:
        return False
    if state is not None:
        state.version += 1
    content = canonical(document)
    event.revision += 1
    event.kind, event.result, event.updated_at = document["event"]["kind"], document["event"], now
    event.t0_s, event.t_end_s = document["event"]["t0_s"], document["event"]["t_end_s"]
    session.add(
        EventRevision(
            id=new_id(),
            event_id=event_id,
            number=event.revision,
            created_at=now,
            installation_id=before.installation_id,
            algorithm=document["algorithm"],
            input_sha256=document["inputs"]["sha256"],
            event_sha256=sha256(content).hexdigest(),
            document=zstandard.ZstdCompressor(level=6).compress(content),
            **queries.names(session, event.device_id, event.vehicle_id),
        )
    )
    announce(
        session,
        "event",
        at=now,
        organisation_id=event.organisation_id,
        device_id=event.device_id,
        vehicle_id=event.vehicle_id,
        data={"event_id": event.id, "event_kind": event.kind, "severe": event.severe, "revision": event.revision},
    )
    return True
