"""Where a box stands: all that an upload must know of it, read in one statement where nothing is missing."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sqlalchemy import Connection, and_, bindparam, select, true

from server.devices.provisioning import TOLD, Quota, told_by, with_told
from server.devices.schemas import Told
from server.errors import ConflictError
from server.ingest import queries
from server.models import Batch, Device

if TYPE_CHECKING:
    from server.ingest.service import BatchKey, BoxNotes

_QUOTA = Device.quota_day, Device.quota_bytes, Device.bytes_per_day
_STORED = Batch.id, Batch.body_sha256, Batch.media_type
# Most boots are one unbroken run; the second only tells that there are more.
_RUN = queries.OF_BOOT.limit(2).subquery()
# Built once: building a statement and its key in the compiler's cache costs more than running it.
_STANDING = with_told(
    select(*TOLD, Device.revoked_at, Device.chain_length, Device.chain_head, *_QUOTA, *_STORED, *_RUN.c)
    .outerjoin(
        Batch,
        and_(
            Batch.device_id == Device.id,
            Batch.stream == bindparam("stream"),
            Batch.boot == bindparam("boot"),
            Batch.sequence == bindparam("sequence"),
        ),
    )
    .outerjoin(_RUN, true())
)


@dataclass(frozen=True, slots=True)
class Standing:
    """A box at the time of an upload.

    It changes with the chain only: while that has the same length and head, the batch is as unknown, and the runs and
    the quota are what they were.
    """

    revoked_at: dt.datetime | None
    chain_length: int
    chain_head: str
    quota: Quota
    stored: tuple[str, str, str] | None
    """Id, body's hash and media type of the batch under the upload's key."""
    runs: queries.Runs
    told: list[Told]

    def repeated(self, media_type: str, sha256: str) -> str | None:
        """Id of the batch that is stored under the upload's key, if any; raises when it was another."""
        if self.stored is None:
            return None
        if self.stored[1:] != (sha256, media_type):
            raise ConflictError(
                "Another body was stored under this key; a sequence is used once",
                code="sequence_reused",
                batch_id=self.stored[0],
            )
        return self.stored[0]

    def after(self, runs: queries.Runs, answers: Sequence[str]) -> Standing:
        """With a batch more, which answered some requests."""
        return replace(self, runs=runs, told=[item for item in self.told if getattr(item, "id", None) not in answers])


def read(connection: Connection, device_id: str, key: BatchKey, notes: BoxNotes, *, now: dt.datetime) -> Standing:
    """Of a box for an upload."""
    asked = {"device_id": device_id, "stream": key.stream, "boot": key.boot, "sequence": key.sequence, "now": now}
    rows = connection.execute(_STANDING, asked).all()
    revoked_at, length, head, day, used, own, batch_id, sha256, media_type, first, last = rows[0][len(TOLD) :]
    runs = [] if first is None else [(first, last)]
    of_one_run = [row for row in rows if row[-2] == first]
    if len(of_one_run) < len(rows):
        runs = queries.runs(connection, device_id, key.stream, key.boot)
    return Standing(
        revoked_at=revoked_at,
        chain_length=length,
        chain_head=head,
        quota=Quota(day, used, own),
        stored=None if batch_id is None else (batch_id, sha256, media_type),
        runs=runs,
        told=told_by(of_one_run, notes.configuration, now=now),
    )
