"""How the C library's allocator treats freed memory, and Python's collector what lasts."""

from __future__ import annotations

import ctypes
import gc
import platform

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Names of glibc's `mallopt`."""
KEPT_BYTES = 256 * 1024 * 1024
ARRAY_BYTES = 32 * 1024 * 1024


def keep_freed_memory() -> bool:
    """Keep what large arrays free for the next ones, up to a bound; whether the C library can.

    By itself glibc gives every array of some hundred kilobytes back to the system and fetches zeroed pages for the
    next one: of arithmetic on minutes of samples that is a tenth of the processor time.
    """
    if platform.libc_ver()[0] != "glibc":
        return False
    mallopt = ctypes.CDLL(None).mallopt
    return bool(mallopt(_MMAP_THRESHOLD, ARRAY_BYTES)) and bool(mallopt(_TRIM_THRESHOLD, KEPT_BYTES))


def set_aside() -> None:
    """Take all that is there now out of garbage collection: it lasts as long as the process.

    A full collection looks at every module and model again and stops all threads for a tenth of a second; a service
    that makes a few long-lived objects with each request has one now and then.
    """
    gc.collect()
    gc.freeze()
