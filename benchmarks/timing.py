"""How long a call takes, the same way for every table."""

from __future__ import annotations

import time
from collections.abc import Callable


def best(function: Callable[[], object], *, repeat: int = 5) -> float:
    """Shortest of a few runs, s; the first, which may compile, is not counted."""
    function()
    durations: list[float] = []
    for _ in range(repeat):
        began = time.perf_counter()
        function()
        durations.append(time.perf_counter() - began)
    return min(durations)
