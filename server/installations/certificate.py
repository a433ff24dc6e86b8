"""The certificate of an installation: how the box sits, how sure that is, and from which data it follows.

What is hashed are ids and figures alone; the names that people give may change without making it another certificate.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from server.devices.queries import device_of
from server.errors import ConflictError, NotFoundError
from server.events.canonical import sha256
from server.installations import queries
from server.models import AuditEntry, Device, Installation, MountingRevision, Vehicle

FORM = "scatola-installation/1"
ACTION = "installed"
"""The audit log's word for what an installer did with the assistant."""


@dataclass(frozen=True)
class Certificate:
    """A ready mounting, pinned to the estimate that it states."""

    id: str
    """Of the revision; of the installation where it was set by hand."""
    document: Mapping[str, Any]
    sha256: str
    device: Device
    vehicle: Vehicle | None
    installer: str | None
    """Who used the assistant last while this installation lasted; None where nobody did."""
    installed_at: dt.datetime
    superseded: bool
    """Whether the box was moved or swapped since."""


def certificate_of(session: Session, organisation_id: str, device_id: str, wanted: str | None = None) -> Certificate:
    """The certificate of the present installation, or of a revision that an earlier certificate names."""
    device = device_of(session, organisation_id, device_id)
    row, revision = _subject(session, device_id, wanted)
    if (row if revision is None else revision).status != "ready":
        raise ConflictError("The mounting is not known well enough yet for a certificate", code="not_ready")
    estimate = row if revision is None else revision
    subject_id = row.id if revision is None else revision.id
    data_at = row.updated_at if revision is None else revision.data_at
    result = estimate.result
    document = {
        "form": FORM,
        "id": subject_id,
        "device_id": device_id,
        "vehicle_id": row.vehicle_id,
        "installation": {
            "id": row.id,
            "began_at": _iso(row.began_at),
            "beginning": row.beginning,
            "reason": row.manual_reason,
        },
        "mounting": {
            name: result.get(name)
            for name in ("status", "method", "R_va", "euler_deg", "sigma_deg", "observability", "gps_lag_s")
        },
        "data_at": _iso(data_at),
        "algorithm": estimate.algorithm,
        "input_sha256": estimate.input_sha256,
    }
    vehicle = session.get(Vehicle, row.vehicle_id) if row.vehicle_id else None
    return Certificate(
        id=subject_id,
        document=document,
        sha256=sha256(document),
        device=device,
        vehicle=vehicle,
        installer=_installer(session, organisation_id, row),
        installed_at=row.began_at,
        superseded=row.ended_at is not None,
    )


def _subject(session: Session, device_id: str, wanted: str | None) -> tuple[Installation, MountingRevision | None]:
    """The installation, and the estimate of it; the newest ready one unless told."""
    if wanted is not None:
        revision = session.get(MountingRevision, wanted)
        row = session.get(Installation, wanted if revision is None else revision.installation_id)
        if row is None or row.device_id != device_id:
            raise NotFoundError(f"There is no mounting {wanted!r} of this box")
        return row, revision
    row = queries.current(session, device_id)
    if row is None:
        raise ConflictError("The box has not been installed yet", code="not_ready")
    if row.status != "ready":
        return row, None
    query = select(MountingRevision).where(MountingRevision.installation_id == row.id)
    return row, session.scalar(
        query.where(MountingRevision.status == "ready").order_by(MountingRevision.data_at.desc()).limit(1)
    )


def _installer(session: Session, organisation_id: str, row: Installation) -> str | None:
    """By the audit log; what was done to this box before the installation ended, the last time."""
    query = select(AuditEntry.actor_name).where(
        AuditEntry.organisation_id == organisation_id,
        AuditEntry.action == ACTION,
        AuditEntry.subject == subject(row.device_id),
    )
    if row.ended_at is not None:
        query = query.where(AuditEntry.at <= row.ended_at)
    return session.scalar(query.order_by(AuditEntry.id.desc()).limit(1))


def subject(device_id: str) -> str:
    """What the audit log calls the box."""
    return f"device_id={device_id}"


def _iso(at: dt.datetime) -> str:
    return at.astimezone(dt.UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
