"""The archive of evidence: raw data, report, event, chain, and a verifier that needs Python alone."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import orjson
import structlog
from sqlalchemy import select
from sqlalchemy.orm import Session

from server.errors import UnavailableError
from server.events import exports
from server.events.queries import newest_seal
from server.evidence.seal import public_key, signing_key, timestamp
from server.evidence.verify import manifest_message, seal_message
from server.formats.columns import Columns
from server.formats.tables import write_csv
from server.ingest.chain import instant
from server.models import Batch, ChainSeal
from server.reports.pdf import Heading, report_pdf
from server.settings import Settings
from server.store import BlobStore, raw_body, raw_columns

log = structlog.stdlib.get_logger("scatola.evidence")

_VERIFIER = Path(__file__).with_name("verify.py")
# A fixed date: the same content gives the same archive.
_DATE = (2000, 1, 1, 0, 0, 0)

README = """Evidence of one event of a vehicle's telemetry box, by Scatola.

python3 verify.py      checks all of it; needs Python 3.8 or newer and nothing else.  With --key PUBLIC-KEY, the
                       operator's as you know it from elsewhere, it fails unless that key signed the archive

event.json             everything that was computed, canonical JSON; its SHA-256 is on every page of the report
report-en.pdf          the report; report-it.pdf the same in Italian
edr.json, edr.csv      elements shaped after 49 CFR 563
raw/N.columns          what upload N of the box's chain measured, the very bytes that its column hash is of:
                       a line "scatola-columns-1", then for each column a line "name <f8 rows" and its values,
                       little-endian float64; not sampled is the bit pattern 7ff8000000000000
raw/N.csv              the same to read; raw/N.body the upload exactly as it came, where it was kept
chain.json             the links of the box's chain from before the event on
revisions/K.json       what was computed earlier, from less data or by an older version
manifest.json          SHA-256 of every file above and below, but for the three that follow
signature.json         the operator's Ed25519 signature of signature.txt, which holds the manifest's SHA-256, and so
                       of the whole archive; without it, hashes show damage but do not stand against forgery
signature.txt, .tsr    what was signed, and the RFC 3161 timestamp of it, where there is one; checked as seal.tsr
seal.txt, seal.tsr     what was sealed and the RFC 3161 timestamp of it, where there is one:
                       openssl ts -verify -data seal.txt -in seal.tsr -CAfile ROOT-OF-THE-AUTHORITY.pem
"""


@dataclass(frozen=True)
class Material:
    """What an archive is made of, read once."""

    device_id: str
    links: Sequence[Batch]
    anchor: str
    seal: ChainSeal | None
    needed: Sequence[Batch]
    revisions: Sequence[tuple[int, bytes]]
    """Number and canonical JSON, the newest last."""


def links_from(session: Session, device_id: str, first_index: int) -> tuple[Sequence[Batch], str]:
    """The links of a chain from one on, and the one before it (the device's id before the first)."""
    rows = select(Batch).where(Batch.device_id == device_id, Batch.chain_index >= first_index)
    before = select(Batch.chain_sha256).where(Batch.device_id == device_id, Batch.chain_index == first_index - 1)
    links = session.scalars(rows.order_by(Batch.chain_index)).all()
    return links, session.scalar(before) or device_id


def material(
    session: Session, device_id: str, needed: Sequence[Batch], revisions: Sequence[tuple[int, bytes]]
) -> Material:
    """Read the chain and its seal."""
    seal = newest_seal(session, device_id)  # before the links: they reach at least as far
    links, anchor = links_from(session, device_id, min((batch.chain_index for batch in needed), default=0))
    return Material(device_id, links, anchor, seal, needed, revisions)


def chain_json(material: Material) -> dict[str, Any]:
    """The chain as the verifier reads it."""
    seal = material.seal
    return {
        "device_id": material.device_id,
        "first_index": material.links[0].chain_index if material.links else 0,
        "anchor": material.anchor,
        "head": material.links[-1].chain_sha256 if material.links else material.anchor,
        "needed": [batch.chain_index for batch in material.needed],
        "links": [link_json(batch) for batch in material.links],
        "seal": None
        if seal is None
        else {
            "chain_length": seal.chain_length,
            "chain_head": seal.chain_head,
            "sealed_at": instant(seal.sealed_at),
            "public_key": seal.public_key,
            "signature": seal.signature,
            "timestamped": seal.timestamp_token is not None,
        },
    }


def link_json(batch: Batch) -> dict[str, Any]:
    """One link with everything that its hash is of, and whether its raw data were erased."""
    erased = {} if batch.erasing_at is None else {"erased_at": instant(batch.erasing_at)}
    return {
        **erased,
        "chain_index": batch.chain_index,
        "body_sha256": batch.body_sha256,
        "column_sha256": batch.column_sha256,
        "stream": batch.stream,
        "boot": batch.boot,
        "sequence": batch.sequence,
        "received_at": instant(batch.received_at),
        "media_type": batch.media_type,
        "chain_sha256": batch.chain_sha256,
    }


def archive(
    material: Material, document: dict[str, Any], heading: Heading, store: BlobStore, settings: Settings
) -> bytes:
    """The archive's bytes; its manifest signed and timestamped as the settings say."""
    number, content = material.revisions[-1]
    of_event = {"event_id": heading.event_id, "revision": number}
    files: dict[str, bytes] = {
        "README.txt": README.encode(),
        "verify.py": _VERIFIER.read_bytes(),
        "event.json": content,
        "report-en.pdf": report_pdf(document, heading, "en"),
        "report-it.pdf": report_pdf(document, heading, "it"),
        "edr.json": orjson.dumps(exports.edr_json(document, heading.event_sha256), option=orjson.OPT_INDENT_2),
        "edr.csv": exports.edr_csv(document),
        "chain.json": json.dumps(chain_json(material) | of_event, indent=1).encode(),
    }
    files |= {f"revisions/{k}.json": earlier for k, earlier in material.revisions[:-1]}
    for batch in material.needed:
        files |= _raw(batch, store)
    if material.seal is not None:
        files["seal.txt"] = seal_message(material.device_id, material.seal.chain_length, material.seal.chain_head)
        if material.seal.timestamp_token is not None:
            files["seal.tsr"] = material.seal.timestamp_token
    manifest = {
        "schema": "scatola-evidence-1",
        **of_event,
        "event_sha256": heading.event_sha256,
        "files": {name: sha256(data).hexdigest() for name, data in sorted(files.items())},
    }
    files["manifest.json"] = json.dumps(manifest, indent=1).encode()
    return _zipped(files | _signed(files["manifest.json"], settings))


def _signed(manifest: bytes, settings: Settings) -> dict[str, bytes]:
    """Who answers for the manifest, and so for every file; nothing where the operator set neither key nor authority."""
    message = manifest_message(manifest)
    try:
        key = signing_key(settings)
    except OSError as error:  # never unsigned where the operator signs
        log.exception("the signing key cannot be read")
        raise UnavailableError("The key that signs archives cannot be read", code="signing_key") from error
    token = None
    if settings.timestamp_url is not None:
        try:
            token = timestamp(settings.timestamp_url, message)
        except (httpx.HTTPError, ValueError):  # evidence is given all the same, and says that it is not stamped
            log.warning("an archive of evidence was not timestamped", exc_info=True)
    if key is None and token is None:
        return {}
    told = {
        "public_key": None if key is None else public_key(key),
        "signature": None if key is None else key.sign(message).hex(),
        "timestamped": token is not None,
    }
    files = {"signature.json": json.dumps(told, indent=1).encode(), "signature.txt": message}
    return files if token is None else {**files, "signature.tsr": token}


def _raw(batch: Batch, store: BlobStore) -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    try:
        columns = raw_columns(store, batch)
        found[f"raw/{batch.chain_index}.columns"] = hashed_bytes(columns)
        found[f"raw/{batch.chain_index}.csv"] = write_csv(columns)
    except KeyError:
        return {}  # gone: the chain still holds its hashes, and the verifier finds it missing
    with suppress(KeyError):
        body = raw_body(store, batch)
        found |= {} if body is None else {f"raw/{batch.chain_index}.body": body}
    return found


def hashed_bytes(columns: Columns) -> bytes:
    """The bytes that a column hash is of, as docs/device-protocol.md says."""
    parts = [b"scatola-columns-1\n"]
    for name, values in columns.values.items():
        bits = np.ascontiguousarray(values, dtype="<f8").view("<u8").copy()
        bits[np.isnan(values)] = 0x7FF8000000000000
        parts += [f"{name} <f8 {values.size}\n".encode(), bits.tobytes()]
    return b"".join(parts)


def _zipped(files: dict[str, bytes]) -> bytes:
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as bundle:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, _DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            bundle.writestr(entry, files[name])
    return sink.getvalue()
