"""Immutable blobs: a folder by default, an object store when one is set."""

from server.store.blobs import BlobStore, blob_key, open_store
from server.store.garbage import COLLECT_AGE, collect, has_row
from server.store.raw import raw_body, raw_columns, raw_content

__all__ = [
    "COLLECT_AGE",
    "BlobStore",
    "blob_key",
    "collect",
    "has_row",
    "open_store",
    "raw_body",
    "raw_columns",
    "raw_content",
]
