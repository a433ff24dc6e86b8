"""The one form in which an event is written: the same numbers give the same bytes, so that a hash means something.

JSON by the standard library alone: keys sorted, no blanks, UTF-8, no NaN; every number that is not whole is rounded to
thirteen significant digits and written as Python's shortest form of that.  Anybody with a Python can do it again.
"""

from __future__ import annotations

import hashlib
import json
import math
from typing import Any

DIGITS = 13
"""Less than a float holds: the last bits may differ between processors, and mean nothing."""


def settle(value: Any) -> Any:  # JSON
    """The value with its numbers as they will be written; tuples become lists, what is not finite None."""
    if isinstance(value, dict):
        return {str(name): settle(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [settle(part) for part in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") + 0.0 if math.isfinite(value) else None
    return value


def canonical(document: dict[str, Any]) -> bytes:
    """Bytes of a document."""
    text = json.dumps(settle(document), sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.encode()


def sha256(document: dict[str, Any]) -> str:
    """Hash of a document's bytes."""
    return hashlib.sha256(canonical(document)).hexdigest()
