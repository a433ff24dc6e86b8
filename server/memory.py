"""How the C library's allocator treats freed memory, and Python's collector what lasts."""

from __future__ import annotations

import ctypes
import gc
import platform
from collections.abc import Mapping

_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8
"""Names of glibc's `mallopt`."""
KEPT_BYTES = 256 * 1024 * 1024
ARRAY_BYTES = 32 * 1024 * 1024
HEAPS = 2
UPLOAD_BYTES = 2 * 1024 * 1024
"""Arrays of an ordinary upload are smaller, those of one near the limits larger."""


def keep_freed_memory() -> bool:
    """Keep what large arrays free for the next ones, up to a bound; whether the C library can.

    By itself glibc gives every array of some hundred kilobytes back to the system and fetches zeroed pages for the
    next one: of arithmetic on minutes of samples that is a tenth of the processor time.
    """
    return _tell_glibc({_MMAP_THRESHOLD: ARRAY_BYTES, _TRIM_THRESHOLD: KEPT_BYTES})


def share_heaps() -> bool:
    """Let threads that start from now on share a few heaps; whether the C library can.

    By itself glibc gives threads up to eight heaps a core, and Arrow's allocator each one of its own. Every heap keeps
    room for the largest upload that a thread of it ever had, and which thread has the next is chance: memory goes on
    growing for ten thousand uploads.
    """
    # What is larger goes back to the system at once: by itself glibc raises that bound with each that it sees, up to
    # 32 MiB, and keeps the holes that uploads near the limits leave.
    bounds = {_MMAP_THRESHOLD: UPLOAD_BYTES, _TRIM_THRESHOLD: 8 * UPLOAD_BYTES}
    if not _tell_glibc({_ARENA_MAX: HEAPS, **bounds}):
        return False
    import pyarrow as pa  # here, because the worker needs it only for some of its work

    pa.set_memory_pool(pa.system_memory_pool())
    return True


def _tell_glibc(options: Mapping[int, int]) -> bool:
    if platform.libc_ver()[0] != "glibc":
        return False
    mallopt = ctypes.CDLL(None).mallopt
    return all(mallopt(name, value) for name, value in options.items())


def set_aside() -> None:
    """Take all that is there now out of garbage collection: it lasts as long as the process.

    A full collection looks at every module and model again and stops all threads for a tenth of a second; a service
    that makes a few long-lived objects with each request has one now and then.
    """
    gc.collect()
    gc.freeze()
