"""The certificate of an erasure: what was erased and by whose order, with the hashes that stay behind."""

from __future__ import annotations

from importlib import metadata
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from sqlalchemy import select
from sqlalchemy.orm import Session

from server.errors import ConflictError
from server.events.canonical import sha256
from server.evidence.package import instant
from server.evidence.seal import public_key
from server.models import Batch, Device, Erasure, Event, EventRevision

SCHEMA = "scatola-erasure-1"


def certificate(session: Session, row: Erasure, key: Ed25519PrivateKey | None = None) -> dict[str, Any]:
    """What was erased and by whose order, with the hashes that stay behind in the boxes' chains; signed with a key."""
    if row.finished_at is None:
        raise ConflictError("The erasure is not finished; blobs put less than a day ago wait", code="not_finished")
    batches = session.execute(
        select(Batch.device_id, Batch.chain_index, Batch.body_sha256, Batch.column_sha256, Batch.erased_at)
        .where(Batch.erasure_id == row.id)
        .order_by(Batch.device_id, Batch.chain_index)
    ).all()
    revisions = session.execute(
        select(Event.id, EventRevision.number, EventRevision.event_sha256, EventRevision.input_sha256)
        .join(EventRevision, EventRevision.event_id == Event.id)
        .where(Event.erasure_id == row.id)
        .order_by(Event.id, EventRevision.number)
    ).all()
    boxes = session.execute(
        select(Device.id, Device.chain_length, Device.chain_head)
        .where(Device.id.in_({batch.device_id for batch in batches}))
        .order_by(Device.id)
    ).all()
    told: dict[str, Any] = {
        "schema": SCHEMA,
        "software": {"name": "scatola", "version": metadata.version("scatola")},
        "erasure_id": row.id,
        "organisation_id": row.organisation_id,
        "subject": {"kind": row.subject_kind, "id": row.subject_id},
        "period": {"since": row.since and instant(row.since), "until": row.until and instant(row.until)},
        "reason": row.reason,
        "requested_at": instant(row.requested_at),
        "requested_by": row.requested_by,
        "finished_at": instant(row.finished_at),
        "erased": row.erased,
        "kept": row.kept,
        "chains": [{"device_id": b.id, "length": b.chain_length, "head": b.chain_head} for b in boxes],
        "batches": [
            {
                "device_id": b.device_id,
                "chain_index": b.chain_index,
                "body_sha256": b.body_sha256,
                "column_sha256": b.column_sha256,
                "erased_at": instant(b.erased_at or row.finished_at),
            }
            for b in batches
        ],
        "event_revisions": [
            {"event_id": r.id, "number": r.number, "event_sha256": r.event_sha256, "input_sha256": r.input_sha256}
            for r in revisions
        ],
    }
    digest = sha256(told)
    if key is None:
        return {**told, "sha256": digest}
    signature = {"public_key": public_key(key), "signature": key.sign(certificate_message(digest)).hex()}
    return {**told, "sha256": digest, "signature": signature}


def certificate_message(digest: str) -> bytes:
    """What the signature of a certificate signs."""
    return f"{SCHEMA}\n{digest}".encode()
