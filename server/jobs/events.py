"""Events out of data: found in what is new, put together from whole batches, revised when more comes.

Detection looks at new data with some context.  A severe event is then computed once more from exactly the batches
around it, which its document names: whoever has them gets the same bytes again.  Data that come later and reach into
that window, or a mounting that becomes ready, make a further revision; the ones before are kept.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from hashlib import sha256
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
import structlog
import zstandard
from sqlalchemy import select

from nav_core.events.record import CrashEvent, VehicleClass
from nav_core.records import Drive, MountingEstimate
from server.database import Database
from server.events import queries
from server.events.canonical import canonical, settle
from server.events.document import document_of
from server.events.holds import AFTER_S, BEFORE_S
from server.events.window import Part, recording
from server.installations.blank import blank_result
from server.installations.result import estimate_of
from server.jobs.mountings import vehicle_at
from server.jobs.results import Results
from server.jobs.situation import Situation
from server.models import Batch, Boot, Event, EventInput, EventRevision, Installation, Vehicle, new_id

CONTEXT_S = 30.0
"""So much before and after new data helps to judge it."""
BACK_S = 5.0
"""An event may have begun this long before the data that completes it."""
SAME_S = 1.5
"""Two time zeros closer than this are one event seen twice."""
STRETCH_S = 600.0
"""Longest stretch that is looked at again in one piece."""
STRETCH_ROWS = 300_000
"""Most rows of several new batches that are looked at in one piece: bounds memory.  Each further piece has the
batches around it read along, so few pieces are less work."""
LATE_MOVE_S = 3600.0
"""A move that is found later than this after it happened has less looked at again: bounds the work of one round."""
STALE = 50
"""So many events at most are judged anew in one round."""
AFTER_MOVE_S = 10.0
"""An event this soon after a move has the mounting before it: the impact itself may have turned the box."""

_MOUNTING_KEYS = ("status", "method", "R_va", "sigma_deg", "stable", "reliable", "gps_lag_s")

log = structlog.stdlib.get_logger("scatola.jobs")


class Reconstructor(Protocol):
    """As `nav_core.crash.reconstruct_drive`."""

    def __call__(
        self,
        drive: Drive,
        mounting: MountingEstimate,
        *,
        vehicle_class: VehicleClass = "car",
        between: tuple[float, float] | None = None,
    ) -> tuple[CrashEvent, ...]: ...


@dataclass(frozen=True)
class Found:
    """An event, what it was computed from, and the document about it."""

    event: CrashEvent
    document: dict[str, Any]
    batches: tuple[Batch, ...]
    installation_id: str | None


def run_inputs(inputs: dict[str, Any], parts: Sequence[Part], reconstructor: Reconstructor) -> tuple[CrashEvent, ...]:
    """Events from the batches and settings that a document names."""
    first, last = inputs["between_s"]
    return reconstructor(
        recording(parts),
        estimate_of(inputs["mounting"]),
        vehicle_class=inputs["vehicle_class"],
        between=(first, last),
    )


class Events:
    """The events of one device during one round."""

    def __init__(
        self,
        database: Database,
        situation: Situation,
        results: Results,
        *,
        load: Callable[[Batch], Part | None],
        installations: Sequence[Installation],
        reconstructor: Reconstructor,
        now: dt.datetime,
    ) -> None:
        self._database = database
        self._situation = situation
        self._results = results
        self._load = load
        self._installations = sorted(installations, key=lambda row: row.began_at)
        self._reconstructor = reconstructor
        self._now = now
        self._done: set[str] = set()
        self._looked_from: dict[str, float] = {}
        """By boot, from where on the new data have been looked at, box clock, s."""

    def take_in(self, new: Iterable[Batch]) -> None:
        """Look for events in new batches, and revise those whose window they reach into."""
        for boot, first, last in stretches_of(new):
            self._look(self._situation.boots[boot], first, last)
            self._looked_from[boot] = min(first - BACK_S, self._looked_from.get(boot, first))

    def revise_unmounted(self, installations: Iterable[str]) -> None:
        """Revise the severe events that were computed before one of these mountings was ready."""
        ready = {row.id for row in self._installations if row.id in set(installations) and row.status == "ready"}
        if not ready:
            return
        with self._database.reading() as session:
            stored = queries.events(
                session,
                self._situation.device.organisation_id,
                device_id=self._situation.device.id,
                severe=True,
                limit=50,
            )
        for row in stored:
            installation = self._installation_at(self._situation.boots[row.boot], row.t0_s)
            waiting = row.result["basis"]["mounting_status"] != "ready"
            known = installation is not None and installation.id in ready
            if waiting and known and row.raw_erased_at is None and row.id not in self._done:
                self._revise(row)

    def judge_anew(self, installations: Iterable[str]) -> None:
        """Look again at what was judged with the mounting before a move that has become known since."""
        told = [row for row in self._installations if row.id in set(installations) and row.beginning == "moved"]
        known = {row.id for row in self._situation.installations}
        for row in told:
            since, until = _holds_from(row), float("inf") if row.ended_at is None else row.ended_at.timestamp()
            if row.id not in known:
                self._look_since(since, until)
            elif row.status == "ready":
                with self._database.reading() as session:
                    device_id = self._situation.device.id
                    stale = list(queries.judged_otherwise(session, device_id, row.id, since, until, limit=STALE))
                for event in stale:
                    if event.id not in self._done:
                        self._look(self._situation.boots[event.boot], event.t0_s - BACK_S, event.t_end_s + BACK_S)

    def _look_since(self, since: float, until: float) -> None:
        """Look at the last of what lies between two moments, Unix s, and was not looked at just now."""
        for boot in self._situation.boots.values():
            last = min(boot.t_last_s, boot.box_s(min(until, boot.unix_s(boot.t_last_s))))
            last = min(last, self._looked_from.get(boot.boot, last))
            first = max(boot.t_first_s, boot.box_s(since), last - LATE_MOVE_S)
            for begin in np.arange(first, last, STRETCH_S).tolist():
                self._look(boot, begin + BACK_S, min(begin + STRETCH_S, last))

    def _look(self, boot: Boot, first_s: float, last_s: float) -> None:
        since = first_s - BACK_S
        found = self._detect(boot, since, last_s)
        with self._database.reading() as session:
            device_id = self._situation.device.id
            stored = list(queries.stored_between(session, device_id, boot.boot, first_s - AFTER_S, last_s + BEFORE_S))
        open_rows = [row for row in stored if row.id not in self._done]
        for each in found:
            row = _same(open_rows, each.event)
            if row is not None:
                open_rows.remove(row)
            if row is not None and row.raw_erased_at is not None:
                continue  # what is left of its data would tell less than it says already
            if row is not None and row.severe:
                self._revise(row, each)
            elif each.event.severe:
                self._store(boot, row, self._refined(boot, each.event.t0, each.event.t_end) or each)
            else:
                self._store(boot, row, each)
        for row in open_rows:
            if row.raw_erased_at is not None:
                continue
            if row.severe:
                self._revise(row)
            elif since + SAME_S <= row.t0_s <= last_s - SAME_S:
                self._withdraw(row)

    def _detect(self, boot: Boot, since_s: float, until_s: float) -> list[Found]:
        """Events that begin in a span, each with the mounting of its time."""
        with self._database.reading() as session:
            batches = queries.batches_between(
                session, self._situation.device.id, boot.boot, since_s - CONTEXT_S, until_s + CONTEXT_S
            )
        found: list[Found] = []
        for begin, end, installation in self._spans(boot, since_s, until_s):
            found += self._run(boot, batches, (begin, end), installation)
        return found

    def _spans(self, boot: Boot, since_s: float, until_s: float) -> list[tuple[float, float, Installation | None]]:
        """A span of the box's clock cut where the mounting changes."""
        edges = [boot.box_s(_holds_from(row)) for row in self._installations[1:]]
        cuts = [since_s, *sorted(edge for edge in edges if since_s < edge < until_s), until_s]
        return [(begin, end, self._installation_at(boot, 0.5 * (begin + end))) for begin, end in pairwise(cuts)]

    def _installation_at(self, boot: Boot, t_s: float) -> Installation | None:
        rows = self._installations
        at = boot.unix_s(t_s)
        return next((row for row in reversed(rows) if _holds_from(row) <= at), rows[0] if rows else None)

    def _refined(self, boot: Boot, t0_s: float, t_end_s: float, keep: dict[str, Any] | None = None) -> Found | None:
        """One event again from exactly the batches around it; `keep` is a mounting to hold on to."""
        with self._database.reading() as session:
            batches = queries.batches_between(
                session, self._situation.device.id, boot.boot, t0_s - BEFORE_S, t_end_s + AFTER_S
            )
        installation = self._installation_at(boot, t0_s)
        found = self._run(boot, batches, (t0_s - SAME_S, t0_s + SAME_S), installation, keep)
        return min(found, key=lambda each: abs(each.event.t0 - t0_s), default=None)

    def _run(
        self,
        boot: Boot,
        batches: Sequence[Batch],
        between_s: tuple[float, float],
        installation: Installation | None,
        keep: dict[str, Any] | None = None,
    ) -> list[Found]:
        loaded = [(batch, part) for batch in batches if (part := self._load(batch)) is not None]
        if not any("fx" in part.columns.values for _, part in loaded):
            return []
        inputs: dict[str, Any] = settle(
            {
                "batches": [batch_json(batch) for batch, _ in loaded],
                "between_s": between_s,
                "mounting": keep or mounting_json(installation),
                "vehicle_class": self._vehicle_class(boot.utc(between_s[0])),
                "clock": clock_json(boot),
            }
        )
        try:
            events = run_inputs(inputs, [part for _, part in loaded], self._reconstructor)
        except (ValueError, ArithmeticError):
            # Typed errors of nav_core and of linear algebra: bad data must not keep the batches from being worked off.
            log.exception("events cannot be computed", device_id=self._situation.device.id, between_s=between_s)
            return []
        used = tuple(batch for batch, _ in loaded)
        return [
            Found(event, self._document(event, inputs, boot), used, None if installation is None else installation.id)
            for event in events
        ]

    def _document(self, event: CrashEvent, inputs: dict[str, Any], boot: Boot) -> dict[str, Any]:
        return event_document(event, inputs, device_id=self._situation.device.id, boot=boot.boot)

    def _vehicle_class(self, at: dt.datetime) -> str:
        vehicle_id = vehicle_at(self._situation.assignments, at) or self._situation.device.vehicle_id
        if vehicle_id is None:
            return "car"
        with self._database.reading() as session:
            vehicle = session.get(Vehicle, vehicle_id)
            return "car" if vehicle is None else vehicle.vehicle_class

    def _revise(self, row: Event, seen: Found | None = None) -> None:
        """Compute a stored severe event again, from where it is seen now; a ready mounting stays the event's own."""
        boot = self._situation.boots[row.boot]
        t0_s, t_end_s = (row.t0_s, row.t_end_s) if seen is None else (seen.event.t0, seen.event.t_end)
        with self._database.reading() as session:
            before = queries.revision_of(session, row)
            inputs = queries.document(before)["inputs"]
        installation = self._installation_at(boot, t0_s)
        same = installation is not None and installation.id == before.installation_id
        keep = inputs["mounting"] if same and inputs["mounting"]["status"] == "ready" else None
        found = self._refined(boot, t0_s, t_end_s, keep) or seen
        if found is None:
            self._withdraw(row)
        else:
            self._store(boot, row, found)

    def _withdraw(self, row: Event) -> None:
        self._done.add(row.id)
        if row.verdict == "confirmed" or row.held_at is not None or row.withdrawn_at is not None:
            return
        row.withdrawn_at = row.updated_at = self._now
        self._results.put(row)
        self._results.announce("event", row.vehicle_id, event_id=row.id, event_kind=row.kind, withdrawn=True)

    def _store(self, boot: Boot, row: Event | None, found: Found) -> None:
        """Make the event or its next revision; nothing when its bytes are the same as before."""
        content = canonical(found.document)
        event = found.event
        hashed = sha256(content).hexdigest()
        known: set[str] = set()
        if row is not None:
            self._done.add(row.id)
            with self._database.reading() as session:
                before = queries.revision_of(session, row)
                known = set(session.scalars(select(EventInput.batch_id).where(EventInput.event_id == row.id)))
                if before.event_sha256 == hashed or (
                    not event.severe and not row.severe and _plain(row.result) == _plain(found.document["event"])
                ):
                    return
        row = row or self._made(boot, event)
        with self._database.reading() as session:
            names = queries.names(session, row.device_id, row.vehicle_id)
        row.revision += 1
        row.kind, row.severe = event.kind, event.severe or row.severe
        row.t0_s, row.t_end_s, row.at = event.t0, event.t_end, boot.utc(event.t0)
        row.result, row.updated_at, row.withdrawn_at = settle(found.document["event"]), self._now, None
        self._results.put(row)
        self._results.put(
            EventRevision(
                id=new_id(),
                event_id=row.id,
                number=row.revision,
                created_at=self._now,
                installation_id=found.installation_id,
                algorithm=found.document["algorithm"],
                input_sha256=found.document["inputs"]["sha256"],
                event_sha256=hashed,
                document=zstandard.ZstdCompressor(level=6).compress(content),
                **names,
            )
        )
        for batch in found.batches:
            if batch.id not in known:
                self._results.put(EventInput(event_id=row.id, batch_id=batch.id))
        self._results.announce(
            "event", row.vehicle_id, event_id=row.id, event_kind=row.kind, severe=row.severe, revision=row.revision
        )

    def _made(self, boot: Boot, event: CrashEvent) -> Event:
        at = boot.utc(event.t0)
        row = Event(
            id=new_id(),
            organisation_id=self._situation.device.organisation_id,
            device_id=self._situation.device.id,
            vehicle_id=vehicle_at(self._situation.assignments, at) or self._situation.device.vehicle_id,
            boot=boot.boot,
            severe=event.severe,
            created_at=self._now,
            revision=0,
        )
        self._done.add(row.id)
        return row


def event_document(event: CrashEvent, inputs: dict[str, Any], *, device_id: str, boot: str) -> dict[str, Any]:
    """The document, with what the service knows of the box's clock."""
    document = document_of(event, inputs, device_id=device_id, boot=boot)
    if inputs["clock"]["source"] == "arrival":
        told = document["event"]
        told["quality"] = [*told["quality"], "utc_from_arrival"]
        detail = "No fix told UTC; it is the time of arrival, good to half a minute"
        told["quality_details"] = [*told["quality_details"], {"code": "utc_from_arrival", "detail": detail}]
    return document


def batch_json(batch: Batch) -> dict[str, Any]:
    """What a document says of a batch that it rests on."""
    return {
        "chain_index": batch.chain_index,
        "stream": batch.stream,
        "sequence": batch.sequence,
        "rows": batch.rows,
        "t_first_s": batch.t_first_s,
        "t_last_s": batch.t_last_s,
        "body_sha256": batch.body_sha256,
        "column_sha256": batch.column_sha256,
    }


def mounting_json(installation: Installation | None) -> dict[str, Any]:
    """The mounting as a document keeps it."""
    result = blank_result() if installation is None else installation.result
    return {
        **{name: result.get(name) for name in _MOUNTING_KEYS},
        "algorithm": None if installation is None else installation.algorithm,
        "input_sha256": None if installation is None else installation.input_sha256,
    }


def clock_json(boot: Boot) -> dict[str, Any]:
    """How the box's clock maps to UTC: ``utc = offset + (1 + drift) t``, to the millisecond."""
    return {
        "source": boot.utc_source,
        "utc_offset_s": round(boot.utc_offset_s, 3),
        "utc_drift": round(boot.utc_drift, 9),
        "utc_sigma_s": round(boot.utc_sigma_s, 2),
    }


def stretches_of(new: Iterable[Batch]) -> list[tuple[str, float, float]]:
    """New batches as stretches of their boots' clocks, those that touch joined."""
    stretches: list[tuple[str, float, float]] = []
    rows = 0
    for batch in sorted(new, key=lambda batch: (batch.boot, batch.t_first_s)):
        boot, first, last = stretches[-1] if stretches else ("", 0.0, 0.0)
        rows += batch.rows
        if boot == batch.boot and batch.t_first_s <= last + BACK_S and rows <= STRETCH_ROWS:
            stretches[-1] = boot, first, max(last, batch.t_last_s)
        else:
            stretches.append((batch.boot, batch.t_first_s, batch.t_last_s))
            rows = batch.rows
    return stretches


def _holds_from(row: Installation) -> float:
    """Unix time from which events have this mounting."""
    return row.began_at.timestamp() + (AFTER_MOVE_S if row.beginning == "moved" else 0.0)


def _same(rows: Sequence[Event], event: CrashEvent) -> Event | None:
    """The stored event that this one is: of the same kind if there is one, else one that it overlaps."""
    # Of several blows the one that is told of may change with what is known; the event stays the same.
    near = [row for row in rows if row.t0_s - SAME_S <= event.ends and event.begins <= row.t_end_s + SAME_S]
    return min(near, key=lambda row: (row.kind != event.kind, abs(row.t0_s - event.t0)), default=None)


def _plain(result: dict[str, Any]) -> dict[str, Any]:
    """A manoeuvre without what only tells how much context there was."""
    return settle({name: value for name, value in result.items() if name not in ("basis", "driver")})
