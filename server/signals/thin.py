"""Hours of samples for a chart: each batch is thinned once to the extremes of short buckets, and that is remembered.

What is remembered depends on the batch's content and on how the box sat meanwhile; both are in the key, so nothing
here can be stale.  Extremes of extremes are extremes, so a chart of hours shows the same peaks as one of the samples.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import cast

import numpy as np

from nav_core.typing import Floats
from server.signals.decimate import Curve, extremes

BUCKET_S = 0.25
"""A window whose chart has at least two of these to a pixel is drawn from them."""
MAX_BYTES = 96 * 1024 * 1024


def thin(curve: Curve) -> Curve:
    """The smallest and largest values of each bucket of the box's clock; a slow signal stays as it is."""
    t = curve.t
    if t.size < 2:
        return curve
    if np.any(np.diff(t) < 0.0):
        curve = curve.part(np.argsort(t, kind="stable"))
        t = curve.t
    bucket = np.floor(t / BUCKET_S)
    starts = np.append(0, np.flatnonzero(np.diff(bucket)) + 1)
    return extremes(curve, starts) if starts.size < t.size else curve


class Memory:
    """Thinned parts, the latest used ones, up to `MAX_BYTES`; for any thread."""

    def __init__(self, max_bytes: int = MAX_BYTES) -> None:
        self._max_bytes = max_bytes
        self._parts: OrderedDict[Hashable, Curve] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], Curve]) -> Curve:
        """The part of that key, made when it is not there; two threads may both make it, and it is the same."""
        with self._lock:
            found = self._parts.get(key)
            if found is not None:
                self._parts.move_to_end(key)
                return found
        made = make()
        # Half the bytes; what is sent has no more digits.
        small = Curve(made.t, {name: cast("Floats", v.astype(np.float32)) for name, v in made.columns.items()})
        with self._lock:
            if key not in self._parts:
                self._parts[key] = small
                self._bytes += _size(small)
            while self._bytes > self._max_bytes:
                _, oldest = self._parts.popitem(last=False)
                self._bytes -= _size(oldest)
        return small


def _size(curve: Curve) -> int:
    return curve.t.nbytes + sum(values.nbytes for values in curve.columns.values()) + 500
