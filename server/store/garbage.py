"""Deleting blobs that no row speaks of: an upload died between its blob and its row."""

from __future__ import annotations

import datetime as dt

from sqlalchemy import exists, or_, select

from server.database import Database
from server.models import Analysis, Batch
from server.store.blobs import BlobStore

COLLECT_AGE = dt.timedelta(days=1)
"""A blob is deleted this long after its last put: an upload that puts it again has long committed its row by then."""


def collect(store: BlobStore, database: Database, older_than: dt.datetime) -> int:
    """Delete blobs last put before `older_than` (a day ago, say) that have no row; how many.

    The row is looked for in a fresh view just before each deletion, and the store looks at the time
    again while it deletes.  An upload renews the time before it commits its row, so what it relies
    on is never deleted under it.
    """
    deleted = 0
    for key in store.stale(older_than):
        if not has_row(database, key) and store.delete_stale(key, older_than):
            deleted += 1
    return deleted


def has_row(database: Database, key: str) -> bool:
    """Whether a row speaks of a blob."""
    organisation_id, _, rest = key.partition("/")
    device_id = rest.partition("/")[0]
    # By device first: the blob columns have no index of their own, and need none for this.
    # A row whose raw data are being erased holds on to nothing.
    of_device = Batch.organisation_id == organisation_id, Batch.device_id == device_id, Batch.erasing_at.is_(None)
    of_analysis = (
        Analysis.organisation_id == organisation_id,
        or_(Analysis.input_key == key, Analysis.result_key == key),
    )
    with database.reading() as session:
        if session.scalar(select(exists().where(*of_device, or_(Batch.blob_key == key, Batch.body_key == key)))):
            return True
        return bool(session.scalar(select(exists().where(*of_analysis))))
