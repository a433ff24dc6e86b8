"""Runs of a box's clock, and how they map to UTC, out of what the batches of a round tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from nav_core.typing import Floats
from server.jobs import clock as clocks
from server.jobs.results import Results
from server.jobs.situation import Situation
from server.jobs.stretch import Piece
from server.models import Batch, Boot


class Boots:
    """The boots of one device during one round; `stored_pairs` gives a boot's stored pairs of box time and UTC."""

    def __init__(
        self, situation: Situation, results: Results, stored_pairs: Callable[[str], tuple[Floats, Floats]]
    ) -> None:
        self._situation = situation
        self._results = results
        self._stored_pairs = stored_pairs
        self._offsets = {
            (batch.boot, batch.sequence): _arrival_offset(batch)
            for batch in situation.batches
            if batch.stream != "burst"
        }

    def continue_boot(self, name: str, parts: Sequence[Piece]) -> None:
        """Take in new batches of the continuous stream."""
        boots = self._situation.boots
        offset = min(self._offsets[name, part.sequence] for part in parts)
        first, last = min(part.t_first_s for part in parts), max(part.t_last_s for part in parts)
        boot = boots.get(name) or self._begin(name, offset, first, last)
        boot.arrival_offset_s = min(boot.arrival_offset_s, offset)
        boot.t_first_s, boot.t_last_s = min(boot.t_first_s, first), max(boot.t_last_s, last)
        t, offsets = self._stored_pairs(name)
        pairs = [pair for part in parts if (pair := part.digest.clock_pair()) is not None]
        t, offsets = np.append(t, [pair[0] for pair in pairs]), np.append(offsets, [pair[1] for pair in pairs])
        if t.size:
            _set(boot, clocks.from_fixes(t, offsets))
        elif boot.utc_source != "gnss":  # else a burst told UTC before
            _set(boot, clocks.from_arrival(boot.arrival_offset_s))
        self._results.put(boot)

    def begin_with_burst(self, batch: Batch, pair: tuple[float, float] | None) -> None:
        """Give a boot of which a burst came first a clock; the continuous stream makes it a better one."""
        if batch.boot in self._situation.boots:
            return
        offset = _arrival_offset(batch)
        boot = self._begin(batch.boot, offset, batch.t_first_s, batch.t_last_s)
        _set(boot, clocks.from_arrival(offset) if pair is None else clocks.from_fixes(*np.array([pair]).T))
        self._results.put(boot)

    def _begin(self, name: str, arrival_offset_s: float, t_first_s: float, t_last_s: float) -> Boot:
        boots = self._situation.boots
        boots[name] = boot = Boot(
            device_id=self._situation.device.id,
            boot=name,
            ordinal=max((other.ordinal for other in boots.values()), default=-1) + 1,
            arrival_offset_s=arrival_offset_s,
            t_first_s=t_first_s,
            t_last_s=t_last_s,
            trip_state={},
        )
        return boot


def _arrival_offset(batch: Batch) -> float:
    """Time of arrival minus box time; a box that says when it sent the batch does not let the wait count."""
    return batch.received_at.timestamp() - (batch.t_last_s if batch.sent_t_s is None else batch.sent_t_s)


def _set(boot: Boot, clock: clocks.BootClock) -> None:
    boot.utc_offset_s, boot.utc_drift = clock.offset_s, clock.drift
    boot.utc_sigma_s, boot.utc_source = clock.sigma_s, clock.source
