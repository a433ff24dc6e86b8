"""Bring a device up to date: read what is new, compute outside any transaction, write once.

The write happens only if the device still stands at the version that was read; else the round starts
over.  So a round may be sent twice, raced or killed anywhere: nothing is lost and nothing is done twice.
"""

from __future__ import annotations

import datetime as dt
import math
from collections import defaultdict
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from typing import Any, cast

import numpy as np
import structlog
from sqlalchemy import Table, delete, select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from nav_core.crash import reconstruct_drive
from nav_core.mounting.trips import told_of
from nav_core.typing import Floats
from server.database import Database, insert_past_mapper
from server.diagnosis.service import keep, of_columns
from server.errors import ProblemError
from server.events.window import Part
from server.formats.columns import Columns
from server.formats.drive import to_drive
from server.jobs import situation as reads
from server.jobs.alerts import Alerts
from server.jobs.boots import Boots
from server.jobs.digest import Digest, clock_pair, digest_drive, encode
from server.jobs.events import Events, Reconstructor
from server.jobs.mountings import Estimator, Mountings, Sources
from server.jobs.results import Results
from server.jobs.situation import Situation
from server.jobs.stretch import Piece
from server.jobs.trips import StoredTrips, Trips, has_rested
from server.live.changes import announce
from server.models import Batch, BatchDigest, Boot, Device, DeviceState, MountingRevision, TrackPoint, Trip
from server.moments import Clock
from server.store import BlobStore, raw_content
from server.trips.track import REST_S

BATCHES = 64
"""Batches of one round: bounds its memory and how long others wait for their turn."""

ATTEMPTS = 5

_POINTS = cast("Table", TrackPoint.__table__)

QUIET_S = 20.0
"""So long after the last upload, or three batches if that is longer, what waits for an estimate is estimated."""

log = structlog.stdlib.get_logger("scatola.jobs")


class ContendedError(Exception):
    """The device changed during every attempt; what is due stays due."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a round did."""

    batches: int = 0
    failed: int = 0
    estimates: int = 0
    more: bool = False
    """Whether batches are left for another round."""


@dataclass(frozen=True, slots=True)
class Read:
    """A batch and its digest, or why there is none."""

    digest: Digest | None
    failure: str | None = None
    part: Part | None = None
    clock_pair: tuple[float, float] | None = None
    """Box time and UTC minus box time, of a burst whose fixes carry UTC."""


def bring_up_to_date(
    database: Database,
    store: BlobStore,
    device_id: str,
    *,
    clock: Clock,
    estimator: Estimator = told_of,
    reconstructor: Reconstructor = reconstruct_drive,
) -> Outcome:
    """Work off a device's next batches, and its review when that is due."""
    known: dict[str, Read] = {}
    for _ in range(ATTEMPTS):
        with database.reading() as session:
            situation = reads.read_situation(session, device_id, BATCHES)
        if situation is None:
            return Outcome()
        work = Round(database, store, situation, clock(), estimator, reconstructor)
        if not situation.batches and not work.review_due:
            return Outcome()
        for batch in situation.batches:
            if batch.id not in known:
                known[batch.id] = read_batch(store, batch)
        outcome = work.compute(known)
        if work.write():
            return outcome
    raise ContendedError(f"device {device_id} changed during {ATTEMPTS} attempts")


def read_batch(store: BlobStore, batch: Batch) -> Read:
    """Columns and digest of a batch; a burst has no digest.  An unreachable store raises: the batch stays due."""
    try:
        content = raw_content(store, batch)
    except KeyError:
        return Read(None, f"blob {batch.blob_key} is missing")
    try:
        columns = Columns.from_parquet(content)
        if not _is_whole(batch, content, columns):
            return Read(None, "the blob's columns do not have the hash that was recorded")
        part = Part(columns, batch.stream == "burst", to_drive(columns))
        if batch.stream != "continuous":
            return Read(None, part=part, clock_pair=clock_pair(part.drive.gnss))
        return Read(digest_drive(part.drive, columns.values.get("battery")), part=part)
    except Exception as error:
        # Whatever a damaged blob raises must not stop the box.
        log.exception("batch cannot be decoded", batch_id=batch.id, device_id=batch.device_id)
        return Read(None, f"cannot be decoded: {type(error).__name__}: {error}"[:500])


def read_columns(store: BlobStore, batch: Batch) -> Read:
    """Columns alone of a batch that was worked off before; none when they are not what was hashed."""
    try:
        content = raw_content(store, batch)
        columns = Columns.from_parquet(content)
    except (KeyError, ProblemError):
        return Read(None, f"blob {batch.blob_key} is missing or damaged")
    if not _is_whole(batch, content, columns):
        return Read(None, "the blob's columns do not have the hash that was recorded")
    return Read(None, part=Part(columns, batch.stream == "burst"))


def _is_whole(batch: Batch, content: bytes, columns: Columns) -> bool:
    """Whether a blob is what was accepted: byte for byte, or else, which takes thirty times as long, by its columns."""
    return sha256(content).hexdigest() == batch.blob_sha256 or columns.column_sha256() == batch.column_sha256


class Round:
    """One attempt at one device."""

    def __init__(
        self,
        database: Database,
        store: BlobStore,
        situation: Situation,
        now: dt.datetime,
        estimator: Estimator,
        reconstructor: Reconstructor,
    ) -> None:
        self._database = database
        self._store_of_blobs = store
        self._reconstructor = reconstructor
        self._situation = situation
        self._now = now
        self._estimator = estimator
        self._results = Results()
        self._state = situation.state or DeviceState(device_id=situation.device.id, updated_at=now, health={})

    @property
    def review_due(self) -> bool:
        """Whether the device wanted to be looked at by now."""
        return self._state.review_at is not None and self._state.review_at <= self._now

    def compute(self, known: dict[str, Read]) -> Outcome:
        """Compute everything from what was read; `known` has every batch of the round."""
        situation, results = self._situation, self._results
        pieces: list[Piece] = []
        failed = 0
        for batch in situation.batches:
            read = known[batch.id]
            batch.processed_at = self._now
            results.put(batch)
            if read.failure is not None:
                failed += 1
                batch.failure = read.failure
                batch.remarks = [*batch.remarks, {"code": "unreadable", "detail": read.failure}]
            elif read.digest is not None:
                pieces.append(_piece(batch, read.digest))
                results.digests.append(_digest_row(batch, read.digest))
        self._map_clocks(pieces, known)
        self._take_position(pieces)
        self._take_health(pieces, failed)
        self._trips(pieces)
        mountings = self._mountings(pieces)
        self._events(known, mountings)
        self._alerts(pieces, known)
        self._plan_review(mountings.pending)
        return Outcome(len(situation.batches), failed, results.estimates, situation.more)

    def _map_clocks(self, pieces: list[Piece], known: dict[str, Read]) -> None:
        """Bring the boots' clocks up to date."""
        boots = Boots(self._situation, self._results, self._stored_pairs)
        for name, parts in _by_boot(pieces).items():
            boots.continue_boot(name, parts)
        for batch in self._situation.batches:
            if batch.stream == "burst" and known[batch.id].part is not None:
                boots.begin_with_burst(batch, known[batch.id].clock_pair)

    def _stored_pairs(self, boot: str) -> tuple[Floats, Floats]:
        with self._database.reading() as session:
            return reads.clock_pairs(session, self._situation.device.id, boot)

    def _take_position(self, pieces: list[Piece]) -> None:
        boots, state = self._situation.boots, self._state
        newest: tuple[dt.datetime, Piece, int] | None = None
        for piece in pieces:
            gnss = piece.digest.gnss
            known = np.flatnonzero(gnss.fix & np.isfinite(gnss.lat) & np.isfinite(gnss.lon))
            if known.size:
                at = boots[piece.boot].utc(float(gnss.t[known[-1]]))
                if newest is None or at > newest[0]:
                    newest = at, piece, int(known[-1])
        if newest is None or (state.position_at is not None and newest[0] <= state.position_at):
            return
        at, piece, row = newest
        gnss = piece.digest.gnss
        state.position_at = at
        state.lat_deg, state.lon_deg = math.degrees(gnss.lat[row]), math.degrees(gnss.lon[row])
        state.speed_mps, state.course_rad = _known(gnss.speed[row]), _known(gnss.course[row])
        self._results.announce(
            "position",
            self._situation.device.vehicle_id,
            position_at=at.isoformat(),
            lat_deg=state.lat_deg,
            lon_deg=state.lon_deg,
            speed_mps=state.speed_mps,
            course_rad=state.course_rad,
        )

    def _take_health(self, pieces: list[Piece], failed: int) -> None:
        boots = self._situation.boots
        health: dict[str, Any] = dict(self._state.health)
        health["unreadable_batches"] = health.get("unreadable_batches", 0) + failed
        newest = max(pieces, key=lambda piece: boots[piece.boot].unix_s(piece.t_last_s), default=None)
        if newest is not None:
            boot = boots[newest.boot]
            remarks = {*newest.digest.remarks} | ({"utc_from_arrival"} if boot.utc_source == "arrival" else set())
            health |= {
                **newest.digest.health,
                "batch_s": newest.t_last_s - newest.t_first_s,
                "remarks": sorted(remarks),
                "utc_sigma_s": boot.utc_sigma_s,
            }
        self._state.health = health

    def _trips(self, pieces: list[Piece]) -> None:
        boots = self._situation.boots
        trips = Trips(
            self._situation, StoredTrips(self._stored_trip, self._stored_trips, self._stored_pieces), self._results
        )
        for name, parts in _by_boot(pieces).items():
            trips.continue_boot(boots[name], parts)
        latest, ends_at = self._latest_boot, self._trips_end_at
        for boot in boots.values():
            if boot is not latest or has_rested(boot) or (ends_at is not None and ends_at <= self._now):
                trips.give_up(boot)

    def _mountings(self, pieces: list[Piece]) -> Mountings:
        """Bring the installations up to date."""
        sources = Sources(self._stored_between, self._last_revision)
        mountings = Mountings(self._situation, pieces, sources, self._results, estimator=self._estimator, now=self._now)
        mountings.take_in()
        mountings.estimate_due(all_pending=not pieces and self._silent_s >= self._quiet_s)
        return mountings

    def _events(self, known: dict[str, Read], mountings: Mountings) -> None:
        """Find and revise events with the mountings as they stand now."""
        batches = [batch for batch in self._situation.batches if known[batch.id].part is not None]
        # Not into `known`: what lies around an event may be due itself by the next attempt, and then wants its digest.
        around: dict[str, Read] = {}

        def load(batch: Batch) -> Part | None:
            if batch.id in known:
                return known[batch.id].part
            if batch.id not in around:
                around[batch.id] = read_columns(self._store_of_blobs, batch)
            return around[batch.id].part

        events = Events(
            self._database,
            self._situation,
            self._results,
            load=load,
            installations=mountings.rows,
            reconstructor=self._reconstructor,
            now=self._now,
        )
        events.take_in(batches)
        events.judge_anew(mountings.recorded)
        events.revise_unmounted(mountings.recorded)

    def _alerts(self, pieces: list[Piece], known: dict[str, Read]) -> None:
        """What the results mean for the organisation's rules, and what the batches say of the vehicle."""
        columns: dict[tuple[str, int], Columns] = {}
        for batch in self._situation.batches:
            part = known[batch.id].part
            if part is None or batch.stream != "continuous":
                continue
            columns[batch.boot, batch.sequence] = part.columns
            boot = self._situation.boots[batch.boot]
            self._results.readings += of_columns(part.columns.values, boot.utc_offset_s, 1.0 + boot.utc_drift)
        Alerts(self._database, self._situation, self._results, self._state, now=self._now).look(pieces, columns)

    def _plan_review(self, pending: bool) -> None:
        under_way = any(
            boot.trip_state.get("trip") and not boot.trip_state["given_up"] for boot in self._situation.boots.values()
        )
        arrival = self._situation.last_arrival
        due = None
        if pending and arrival is not None:
            due = arrival + dt.timedelta(seconds=self._quiet_s)
        elif under_way:
            due = self._trips_end_at
        # Never before now: a review that found nothing to do must not come due at once again.
        self._state.review_at = None if due is None else max(due, self._now + dt.timedelta(seconds=1))

    @property
    def _latest_boot(self) -> Boot | None:
        return max(self._situation.boots.values(), key=lambda boot: boot.unix_s(boot.t_last_s), default=None)

    @property
    def _trips_end_at(self) -> dt.datetime | None:
        """When nothing is under way any more unless data come: a rest's length after the last word.

        Both clocks count: data that were old when they came tell of nothing that goes on, and those of a
        box whose clock is ahead end with its silence.
        """
        arrival, boot = self._situation.last_arrival, self._latest_boot
        if arrival is None or boot is None:
            return None
        return min(arrival, boot.utc(boot.t_last_s)) + dt.timedelta(seconds=REST_S)

    @property
    def _quiet_s(self) -> float:
        return max(QUIET_S, 3.0 * self._state.health.get("batch_s", 0.0))

    @property
    def _silent_s(self) -> float:
        arrival = self._situation.last_arrival
        return 0.0 if arrival is None else (self._now - arrival).total_seconds()

    def _stored_pieces(self, boot: str, after_s: float) -> list[Piece]:
        read = partial(reads.pieces_of_boot, after_s=after_s, before_s=math.inf)
        with self._database.reading() as session:
            return read(session, self._situation.device.id, boot)

    def _stored_between(self, since_s: float, until_s: float) -> list[Piece]:
        boots = list(self._situation.boots.values())
        with self._database.reading() as session:
            return reads.pieces_between(session, self._situation.device.id, boots, since_s, until_s)

    def _stored_trip(self, trip_id: str) -> Trip | None:
        with self._database.reading() as session:
            return session.get(Trip, trip_id)

    def _stored_trips(self, boot: str) -> list[Trip]:
        with self._database.reading() as session:
            return list(reads.trips_of_boot(session, self._situation.device.id, boot))

    def _last_revision(self, installation_id: str, before: dt.datetime | None = None) -> MountingRevision | None:
        with self._database.reading() as session:
            return reads.last_revision(session, installation_id, before)

    def write(self) -> bool:
        """Store everything in one short transaction; False when the device changed since it was read."""
        try:
            with self._database.transaction() as session:
                # The box's own row first, as whoever swaps it or takes its uploads does: else two could wait in a ring.
                device = select(Device.id).where(Device.id == self._situation.device.id)
                session.execute(device.with_for_update(read=True, key_share=True))
                version = session.scalar(
                    select(DeviceState.version)
                    .where(DeviceState.device_id == self._situation.device.id)
                    .with_for_update()
                )
                if version != self._situation.version:
                    return False
                self._store(session)
        except IntegrityError:
            if self._situation.version is None:
                return False  # another worker made the first row of state between the look and the insert
            raise
        return True

    def _store(self, session: Session) -> None:
        results, state = self._results, self._state
        state.version = (self._situation.version or 0) + 1
        state.updated_at = self._now
        session.add(state)
        if results.replaced_trips:
            session.execute(delete(Trip).where(Trip.id.in_(results.replaced_trips)))
        session.add_all([*results.rows, *results.digests])
        session.flush()
        session.add_all([*results.revisions, *results.deliveries])
        keep(session, state.device_id, results.readings, now=self._now)
        if results.points:
            # Past the objects: there is a point a second.
            insert_past_mapper(session.connection(), _POINTS, results.points)
        for announcement in results.announcements:
            announce(
                session,
                announcement.kind,
                at=self._now,
                organisation_id=self._situation.device.organisation_id,
                device_id=self._situation.device.id,
                vehicle_id=announcement.vehicle_id,
                data=announcement.data,
            )


def _piece(batch: Batch, digest: Digest) -> Piece:
    return Piece(batch.boot, batch.sequence, batch.t_first_s, batch.t_last_s, batch.column_sha256, digest)


def _digest_row(batch: Batch, digest: Digest) -> BatchDigest:
    t, offset = digest.clock_pair() or (None, None)
    return BatchDigest(batch_id=batch.id, content=encode(digest), clock_t_s=t, clock_offset_s=offset)


def _by_boot(pieces: list[Piece]) -> dict[str, list[Piece]]:
    parts: defaultdict[str, list[Piece]] = defaultdict(list)
    for piece in pieces:
        parts[piece.boot].append(piece)
    return parts


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
