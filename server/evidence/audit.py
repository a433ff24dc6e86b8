"""Recomputing the chain of a box, and the hashes of its events, from the database and the store."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from hashlib import sha256

import zstandard
from sqlalchemy import select

from server.database import Database
from server.errors import ProblemError
from server.events.canonical import sha256 as canonical_sha256
from server.events.queries import canonical_bytes
from server.evidence.seal import timestamp_holds
from server.evidence.verify import seal_message, signature_holds
from server.formats.columns import Columns
from server.ingest.chain import link
from server.models import Batch, ChainSeal, Device, Event, EventRevision
from server.store import BlobStore

CHUNK = 500


@dataclass
class Audit:
    """What was found of one box."""

    device_id: str
    name: str
    links: int = 0
    revisions: int = 0
    seals: int = 0
    erased_links: int = 0
    """Whose raw data were erased by retention or by order; their hashes hold the chain together."""
    erased_revisions: int = 0
    faults: list[str] = field(default_factory=list[str])

    @property
    def passed(self) -> bool:
        return not self.faults


def devices(database: Database, device_id: str | None) -> list[str]:
    """Ids to look at."""
    query = select(Device.id).order_by(Device.id)
    with database.reading() as session:
        return list(session.scalars(query if device_id is None else query.where(Device.id == device_id)))


def audit(database: Database, store: BlobStore, device_id: str, *, root_pem: bytes | None = None) -> Audit:
    """Every link, every blob, every seal, every revision of an event of a box."""
    with database.reading() as session:
        device = session.get_one(Device, device_id)
        seals = session.scalars(
            select(ChainSeal).where(ChainSeal.device_id == device_id).order_by(ChainSeal.chain_length)
        ).all()
    found = Audit(device_id, device.name)
    heads: dict[int, str] = {}
    head = device_id
    for batch in _batches(database, device_id, device.chain_length):
        if batch.chain_index != found.links:
            found.faults.append(f"link {found.links} is missing")
            found.links = batch.chain_index
        expected = link(
            head,
            body_sha256=batch.body_sha256,
            column_sha256=batch.column_sha256,
            stream=batch.stream,
            boot=batch.boot,
            sequence=batch.sequence,
            received_at=batch.received_at,
        )
        if expected != batch.chain_sha256:
            found.faults.append(f"link {batch.chain_index} does not follow from the one before")
        head = batch.chain_sha256
        found.links += 1
        heads[found.links] = head
        _look_at_blobs(found, store, batch)
    if found.links != device.chain_length or head != (device.chain_head or device_id):
        found.faults.append("the chain does not end where the box's row says")
    for seal in seals:
        _look_at_seal(found, seal, heads, root_pem)
    for event_id, erased, revision_id in _revisions(database, device_id):
        with database.reading() as session:
            _look_at_revision(found, event_id, session.get_one(EventRevision, revision_id), erased=erased)
    return found


def _revisions(database: Database, device_id: str) -> Sequence[tuple[str, bool, str]]:
    """Ids of events, whether they are erased, and ids of their revisions; the documents are read one at a time."""
    query = select(Event.id, Event.erased_at, EventRevision.id).join(EventRevision, EventRevision.event_id == Event.id)
    query = query.where(Event.device_id == device_id).order_by(Event.at, Event.id, EventRevision.number)
    with database.reading() as session:
        return [
            (event_id, erased_at is not None, revision_id)
            for event_id, erased_at, revision_id in session.execute(query)
        ]


def _look_at_revision(found: Audit, event_id: str, revision: EventRevision, *, erased: bool) -> None:
    found.revisions += 1
    where = f"revision {revision.number} of event {event_id}"
    if erased:
        found.erased_revisions += 1
        if revision.document:
            found.faults.append(f"{where} is called erased and is still there")
        return
    try:
        content = canonical_bytes(revision)
        told = json.loads(content)["inputs"]
        inputs = canonical_sha256({name: value for name, value in told.items() if name != "sha256"})
    except (zstandard.ZstdError, ValueError, LookupError, TypeError, AttributeError):
        found.faults.append(f"{where} cannot be read")
        return
    if sha256(content).hexdigest() != revision.event_sha256:
        found.faults.append(f"{where} is not what was computed")
    if not inputs == told["sha256"] == revision.input_sha256:
        found.faults.append(f"{where}: its inputs are not those that it names")


def _batches(database: Database, device_id: str, length: int) -> Iterator[Batch]:
    """Batches in the order of the chain, some at a time; those that arrived since the audit began are left out."""
    after = -1
    while True:
        query = select(Batch).where(Batch.device_id == device_id, Batch.chain_index > after, Batch.chain_index < length)
        with database.reading() as session:
            rows = session.scalars(query.order_by(Batch.chain_index).limit(CHUNK)).all()
        yield from rows
        if len(rows) < CHUNK:
            return
        after = rows[-1].chain_index


def _look_at_blobs(found: Audit, store: BlobStore, batch: Batch) -> None:
    if batch.erasing_at is not None:
        found.erased_links += 1
        return
    try:
        columns = Columns.from_parquet(store.get(batch.blob_key))
    except KeyError:  # what was erased has a row that says so
        found.faults.append(f"link {batch.chain_index}: raw data are missing")
    except ProblemError as problem:
        found.faults.append(f"link {batch.chain_index}: raw data cannot be read: {problem.detail}")
    else:
        if columns.column_sha256() != batch.column_sha256:
            found.faults.append(f"link {batch.chain_index}: raw data are not what was uploaded")
    if batch.body_key is not None:
        try:
            body = store.get(batch.body_key)
        except KeyError:
            found.faults.append(f"link {batch.chain_index}: the body is missing")
            return
        if sha256(body).hexdigest() != batch.body_sha256:
            found.faults.append(f"link {batch.chain_index}: the body is not what was uploaded")


def _look_at_seal(found: Audit, seal: ChainSeal, heads: dict[int, str], root_pem: bytes | None) -> None:
    found.seals += 1
    if heads.get(seal.chain_length, found.device_id) != seal.chain_head:
        found.faults.append(f"the seal at {seal.chain_length} links is of another chain")
    message = seal_message(found.device_id, seal.chain_length, seal.chain_head)
    if seal.public_key is not None and seal.signature is not None:
        key, signature = bytes.fromhex(seal.public_key), bytes.fromhex(seal.signature)
        if not signature_holds(key, message, signature):
            found.faults.append(f"the signature at {seal.chain_length} links does not hold")
    token = seal.timestamp_token if root_pem is not None else None
    if token is not None and timestamp_holds(token, message, root_pem or b"") is None:
        found.faults.append(f"the timestamp at {seal.chain_length} links does not hold")
