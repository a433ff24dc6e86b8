"""The chain of evidence: each batch's link depends on all before it (docs/device-protocol.md)."""

from __future__ import annotations

import datetime as dt
import hashlib

_HEAD = "scatola-chain-1"


def instant(at: dt.datetime) -> str:
    """A time as the chain writes it: UTC with microseconds."""
    return at.astimezone(dt.UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def link(
    previous: str,
    *,
    body_sha256: str,
    column_sha256: str,
    stream: str,
    boot: str,
    sequence: int,
    received_at: dt.datetime,
) -> str:
    """SHA-256 of a link; `previous` is the link before, and the device's id for the first."""
    parts = (_HEAD, previous, body_sha256, column_sha256, stream, boot, str(sequence), instant(received_at))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()
