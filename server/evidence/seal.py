"""Sealing a chain's head: signed with the operator's key, timestamped by an authority of his choice."""

from __future__ import annotations

import datetime as dt
from hashlib import sha256

import httpx
import structlog
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_private_key
from cryptography.x509 import load_pem_x509_certificates
from rfc3161_client import (
    HashAlgorithm,
    TimestampRequestBuilder,
    TimeStampResponse,
    VerifierBuilder,
    decode_timestamp_response,
)
from sqlalchemy import func, select
from sqlalchemy.orm import Session

from server.database import Database
from server.errors import UnavailableError
from server.evidence.verify import seal_message
from server.models import Batch, ChainSeal, Device, Event, EventInput
from server.settings import Settings

TIMEOUT_S = 20.0
AT_ONCE = 50

log = structlog.stdlib.get_logger("scatola.evidence")


def signing_key(settings: Settings) -> Ed25519PrivateKey | None:
    """The operator's key; ValueError when the file holds no Ed25519 key."""
    if settings.signing_key_file is None:
        return None
    key = load_pem_private_key(settings.signing_key_file.read_bytes(), password=None)
    if not isinstance(key, Ed25519PrivateKey):
        raise ValueError(f"{settings.signing_key_file} holds no Ed25519 private key")  # noqa: TRY004  a setting's value
    return key


def readable_key(settings: Settings) -> Ed25519PrivateKey | None:
    """The same for who is asked over HTTP: nothing leaves unsigned where the operator signs."""
    try:
        return signing_key(settings)
    except OSError as error:
        log.exception("the signing key cannot be read")
        raise UnavailableError("The key that signs cannot be read", code="signing_key") from error


def public_key(key: Ed25519PrivateKey) -> str:
    """The key's public half, hexadecimal."""
    return key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw).hex()


def is_on(settings: Settings) -> bool:
    """Whether the operator wants seals."""
    return settings.signing_key_file is not None or settings.timestamp_url is not None


def waiting(session: Session, limit: int = AT_ONCE) -> list[str]:
    """Devices with a severe event that rests on links which no seal covers yet."""
    sealed = (
        select(ChainSeal.device_id, func.max(ChainSeal.chain_length).label("length"))
        .group_by(ChainSeal.device_id)
        .subquery()
    )
    query = (
        select(Event.device_id)
        .join(EventInput, EventInput.event_id == Event.id)
        .join(Batch, Batch.id == EventInput.batch_id)
        .outerjoin(sealed, sealed.c.device_id == Event.device_id)
        .where(Event.severe, Batch.chain_index >= func.coalesce(sealed.c.length, 0))
        .distinct()
        .limit(limit)
    )
    return list(session.scalars(query))


def seal_waiting(database: Database, settings: Settings, *, now: dt.datetime) -> int:
    """Seal what waits for it; one device after the other, the network outside any transaction."""
    if not is_on(settings):
        return 0
    key = signing_key(settings)
    with database.reading() as session:
        devices = waiting(session)
    for device_id in devices:
        with database.reading() as session:
            device = session.get_one(Device, device_id)
        row = seal(device, key, settings.timestamp_url, now=now)
        with database.transaction() as session:
            same = ChainSeal.device_id == device_id, ChainSeal.chain_length == row.chain_length
            if session.scalar(select(ChainSeal.id).where(*same)) is None:
                session.add(row)
    return len(devices)


def seal(device: Device, key: Ed25519PrivateKey | None, timestamp_url: str | None, *, now: dt.datetime) -> ChainSeal:
    """A seal of the device's chain as it stands in the row."""
    message = seal_message(device.id, device.chain_length, device.chain_head)
    return ChainSeal(
        device_id=device.id,
        chain_length=device.chain_length,
        chain_head=device.chain_head,
        sealed_at=now,
        public_key=None if key is None else public_key(key),
        signature=None if key is None else key.sign(message).hex(),
        timestamp_token=None if timestamp_url is None else timestamp(timestamp_url, message),
    )


def timestamp(url: str, message: bytes) -> bytes:
    """The authority's answer, DER; raises when it gives none or one for something else."""
    request = TimestampRequestBuilder().data(message).hash_algorithm(HashAlgorithm.SHA256).nonce(nonce=True).build()
    headers = {"Content-Type": "application/timestamp-query", "Accept": "application/timestamp-reply"}
    answer = httpx.post(url, content=request.as_bytes(), headers=headers, timeout=TIMEOUT_S)
    answer.raise_for_status()
    response: TimeStampResponse = decode_timestamp_response(answer.content)
    if response.tst_info.message_imprint.message != sha256(message).digest():
        raise ValueError("the time-stamping authority stamped something else")
    return answer.content


def timestamp_holds(token: bytes, message: bytes, root_pem: bytes) -> dt.datetime | None:
    """When the authority under that root saw the message; None when it did not."""
    roots = load_pem_x509_certificates(root_pem)
    response = decode_timestamp_response(token)
    builder = VerifierBuilder()
    for root in roots:
        builder = builder.add_root_certificate(root)
    try:
        builder.build().verify_message(response, message)
    except Exception:  # whatever the library finds wrong, it does not hold
        log.warning("timestamp does not hold", exc_info=True)
        return None
    return response.tst_info.gen_time
