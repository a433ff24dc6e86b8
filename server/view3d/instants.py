"""Which instants of an event its replay shows.

Apart from the recording, because the event's page tells its scripts too, and the API imports no viser.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from nav_core.typing import Floats

BEFORE_S, AFTER_S = 6.0, 6.0
AROUND_S = 1.0
"""Where no path is known: the vehicle only stands there."""

FRAMES_PER_S = 20
BLOW_S, BLOW_FRAMES_PER_S = (-0.05, 0.25), 200
"""The pulse takes a tenth of a second: its instants are shown one by one."""


def known_rows(document: Mapping[str, Any]) -> list[int]:
    """Rows of the path that have a place; none if that makes no path."""
    way = document["curves"]["trajectory"]
    rows = [] if way is None else [k for k, north in enumerate(way["north_m"]) if north is not None]
    return rows if len(rows) > 1 else []


def instants(document: Mapping[str, Any]) -> Floats:
    """Times of the replay's frames, s from time zero; its own clock is zero at the first."""
    first, last = -AROUND_S, AROUND_S
    if rows := known_rows(document):
        t = document["curves"]["trajectory"]["t_s"]
        first, last = max(t[rows[0]], -BEFORE_S), min(t[rows[-1]], AFTER_S)
    t = _grid(first, last, FRAMES_PER_S)
    return np.union1d(t, _grid(max(t[0], BLOW_S[0]), min(t[-1], BLOW_S[1]), BLOW_FRAMES_PER_S))


def _grid(first: float, last: float, rate: int) -> Floats:
    return np.arange(np.ceil(first * rate), np.floor(last * rate) + 1) / rate
