"""Installations as they are shown; JSON and pages read the same."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import select
from sqlalchemy.orm import Session

from server.models import Installation, MountingRevision

MAX_REVISIONS = 2000


def current(session: Session, device_id: str) -> Installation | None:
    """The installation that is not over, or the last one."""
    query = select(Installation).where(Installation.device_id == device_id)
    return session.scalar(query.order_by(Installation.began_at.desc()).limit(1))


def history(session: Session, device_id: str, *, limit: int = 200) -> Sequence[Installation]:
    """Installations of a box, the newest first."""
    query = select(Installation).where(Installation.device_id == device_id)
    return session.scalars(query.order_by(Installation.began_at.desc()).limit(limit)).all()


def revisions(session: Session, installation_ids: Sequence[str]) -> dict[str, list[MountingRevision]]:
    """Estimates as they stood, of each installation, in the order of their data; the newest `MAX_REVISIONS`."""
    query = select(MountingRevision).where(MountingRevision.installation_id.in_(installation_ids))
    newest = session.scalars(query.order_by(MountingRevision.data_at.desc()).limit(MAX_REVISIONS)).all()
    found: dict[str, list[MountingRevision]] = {installation_id: [] for installation_id in installation_ids}
    for revision in reversed(newest):
        found[revision.installation_id].append(revision)
    return found
