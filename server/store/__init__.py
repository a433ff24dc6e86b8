"""Immutable blobs: a folder by default, an object store when one is set."""

from server.store.blobs import BlobStore, blob_key, open_store
from server.store.garbage import collect

__all__ = ["BlobStore", "blob_key", "collect", "open_store"]
