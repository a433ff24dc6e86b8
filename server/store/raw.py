"""The one way to the raw data of a batch: what is being erased is not there, whether its blobs are gone or not yet."""

from __future__ import annotations

from server.formats.columns import Columns
from server.models import Batch
from server.store.blobs import BlobStore


def raw_content(store: BlobStore, batch: Batch) -> bytes:
    """What a batch measured as Parquet, not looked into; KeyError when it is erased or missing."""
    return store.get(_kept(batch, batch.blob_key))


def raw_columns(store: BlobStore, batch: Batch) -> Columns:
    """What a batch measured; KeyError when it is erased or missing."""
    return Columns.from_parquet(raw_content(store, batch))


def raw_body(store: BlobStore, batch: Batch) -> bytes | None:
    """The upload as it came, None where it was not kept; KeyError when it is erased or missing."""
    return None if batch.body_key is None else store.get(_kept(batch, batch.body_key))


def _kept(batch: Batch, key: str) -> str:
    if batch.erasing_at is not None:
        raise KeyError(key)
    return key
