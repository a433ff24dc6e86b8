"""What a round of work wants written, collected while it computes."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass, field
from typing import Any

from server.diagnosis.service import Reading
from server.models import AlertDelivery, BatchDigest, Installation, MountingRevision, Trip
from server.models.base import Base

TrackRow = tuple[str, float, dt.datetime, float, float, float | None, float | None, float | None]


@dataclass(frozen=True, slots=True)
class Announcement:
    """A change to tell."""

    kind: str
    vehicle_id: str | None
    data: dict[str, Any]


@dataclass(slots=True)
class Results:
    """Rows to insert or update, trips to replace, and what to tell."""

    rows: list[Base] = field(default_factory=list[Base])
    """New rows, and rows that were read and changed since."""
    digests: list[BatchDigest] = field(default_factory=list[BatchDigest])
    revisions: list[MountingRevision] = field(default_factory=list[MountingRevision])
    deliveries: list[AlertDelivery] = field(default_factory=list[AlertDelivery])
    """Messages that are owed for the alerts among `rows`."""
    readings: list[Reading] = field(default_factory=list[Reading])
    """What the batches say of the vehicle beside the streams."""
    points: list[TrackRow] = field(default_factory=list[TrackRow])
    """Values of track points in the order of their columns: too many for an object each."""
    replaced_trips: list[str] = field(default_factory=list[str])
    """Ids of trips to delete with their track, before the rows are written."""
    announcements: list[Announcement] = field(default_factory=list[Announcement])
    estimates: int = 0

    def put(self, row: Installation | Trip | Base) -> None:
        """Have a row written, once."""
        if not any(row is other for other in self.rows):
            self.rows.append(row)

    def announce(self, kind: str, vehicle_id: str | None, **data: Any) -> None:
        """Tell a change when the round is written."""
        self.announcements.append(Announcement(kind, vehicle_id, data))
