"""The history of a box's mounting as steps to walk through: each estimate as it stood."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy.orm import Session

from server.installations import queries
from server.models import Installation, MountingRevision

MAX_STEPS = 160
"""More than a slider can tell apart on a phone."""


@dataclass(frozen=True)
class Step:
    """An estimate as it stood at a moment of the data."""

    id: str
    """Of the revision; of the installation where this is how it stands now."""
    installation: Installation
    at: dt.datetime
    status: str
    progress: float
    result: Mapping[str, Any]
    before: Mapping[str, Any] | None
    """The mount JSON of how the box sat before it was moved; None where it was not, or nothing was known."""

    @property
    def moved(self) -> bool:
        """Whether this installation began with a move."""
        return self.installation.beginning == "moved"


def steps(session: Session, device_id: str) -> list[Step]:
    """All steps of a box in the order of time, thinned to `MAX_STEPS`; the last is how it stands now."""
    rows = list(reversed(queries.history(session, device_id)))
    revisions = queries.revisions(session, [row.id for row in rows])
    found: list[Step] = []
    before: Mapping[str, Any] | None = None
    for row in rows:
        earlier = before if row.beginning in ("moved", "manual") else None
        found += [_of_revision(row, revision, earlier) for revision in revisions[row.id]]
        # Its row is newer than its last revision: ready mountings get one every few minutes only.
        # One that ended may have been worked out later: it says how the box sat until then.
        at = row.updated_at if row.ended_at is None else min(row.updated_at, row.ended_at)
        found.append(Step(row.id, row, at, row.status, row.progress, row.result, earlier))
        if row.result.get("R_va") is not None:
            before = row.result
    return thinned(found, MAX_STEPS)


def thinned(found: Sequence[Step], most: int) -> list[Step]:
    """At most about so many: first and last of each installation, changes of status, and evenly from the rest."""
    if len(found) <= most:
        return list(found)

    def matters(k: int) -> bool:
        if k in (0, len(found) - 1):
            return True
        a, b, c = found[k - 1], found[k], found[k + 1]
        return b.installation is not a.installation or b.installation is not c.installation or b.status != a.status

    kept = {k for k in range(len(found)) if matters(k)}
    rest = [k for k in range(len(found)) if k not in kept]
    room = max(0, most - len(kept))
    every = len(rest) / room if room else 0.0
    kept |= {rest[int(k * every)] for k in range(room)}
    return [found[k] for k in sorted(kept)[-most:]]


def _of_revision(row: Installation, revision: MountingRevision, before: Mapping[str, Any] | None) -> Step:
    return Step(revision.id, row, revision.data_at, revision.status, revision.progress, revision.result, before)
