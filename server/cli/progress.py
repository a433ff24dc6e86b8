"""Progress of long work, on a terminal only."""

from __future__ import annotations

import sys


def progress(text: str) -> None:
    """Replace the last progress line on standard error; an empty text removes it."""
    if sys.stderr.isatty():
        print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)
