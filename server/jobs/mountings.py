"""Installations out of data: when to estimate again, and what a moved box means for the rows.

Cadence, in terms of new data of an installation: the first data at once; then every `EAGER_S` of driving until the
mounting is ready, every `CALM_S` after that, every `SLOW_S` from `SETTLED_S` after its beginning; standing
data alone every `STANDING_S`.  What is left over when a box falls silent is used at its review.  So the last
estimate always rests on all data, in whatever order it came.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import structlog

from nav_core.mounting.fusion import TripEvidence
from nav_core.mounting.model import Noise, roads_of
from nav_core.mounting.trips import Told
from nav_core.records import Gnss
from nav_core.signal import Ticks
from server.installations.blank import blank_result
from server.installations.result import mount_json
from server.jobs import chapters as chapter
from server.jobs.results import Results
from server.jobs.situation import Situation
from server.jobs.stretch import Piece, Stretch, assemble, in_windows
from server.models import Assignment, Installation, MountingRevision, new_id

Estimator = Callable[[Ticks, Gnss, TripEvidence | None, Noise], Told]
"""A stretch of data, the evidence before it, and what is known of the roads."""

ALGORITHM = "whole-drive/3"
EAGER_S = 20.0
CALM_S = 60.0
SLOW_S = 120.0
SETTLED_S = 1800.0
STANDING_S = 300.0

MOVE_GUARD_S = 10.0
"""Data this close to a move is left out on both sides: its moment is known to some seconds."""

SAME_MOVE_S = 60.0
"""A move found this soon after a move is the same one, seen better."""

REVISION_S = 600.0
"""A ready mounting gets a new revision at most this often, in terms of data."""

log = structlog.stdlib.get_logger("scatola.jobs")


@dataclass(slots=True)
class Sources:
    """Where stored data comes from."""

    pieces: Callable[[float, float], list[Piece]]
    """Between two UTC times."""
    last_revision: Callable[[str, dt.datetime | None], MountingRevision | None]
    """An installation's newest, of those whose data ends before a moment if one is given."""


class Mountings:
    """The installations of one device during one round."""

    def __init__(
        self,
        situation: Situation,
        new: Sequence[Piece],
        sources: Sources,
        results: Results,
        *,
        estimator: Estimator,
        now: dt.datetime,
    ) -> None:
        self._situation = situation
        self._new = new
        self._sources = sources
        self._results = results
        self._estimator = estimator
        self._now = now
        self.recorded: set[str] = set()
        """Ids of the installations that got a new estimate."""
        self.rows = sorted(situation.installations, key=lambda row: row.began_at)
        self._data_end_s = max((boot.unix_s(boot.t_last_s) for boot in situation.boots.values()), default=0.0)

    def take_in(self) -> None:
        """Give the new data to the installations it belongs to, making rows where there are none yet."""
        boots = self._situation.boots
        if self.rows and self.rows[0].beginning == "first":
            begin = min(boot.unix_s(boot.t_first_s) for boot in boots.values())
            self.rows[0].began_at = _utc(begin)
            self._results.put(self.rows[0])
        for piece in self._new:
            middle = boots[piece.boot].unix_s(0.5 * (piece.t_first_s + piece.t_last_s))
            row = self._row_at(_utc(middle), begin_s=boots[piece.boot].unix_s(piece.t_first_s))
            row.unestimated_s += piece.t_last_s - piece.t_first_s
            row.unestimated_moving_s += piece.digest.moving_s
            known = chapter.read(row.evidence, ALGORITHM)
            still = chapter.reopened(known, boots[piece.boot].unix_s(piece.t_first_s))
            if len(still) < len(row.evidence):
                row.evidence = chapter.written(still, ALGORITHM)
            self._results.put(row)

    def estimate_due(self, *, all_pending: bool) -> None:
        """Estimate what the cadence asks for, or everything that has unused data."""
        for row in list(self.rows):
            if is_due(row, data_end_s=self._data_end_s, all_pending=all_pending):
                self._estimate(row)

    @property
    def pending(self) -> bool:
        """Whether data waits for an estimate."""
        return any(row.unestimated_s > 0.0 for row in self.rows)

    def _row_at(self, at: dt.datetime, *, begin_s: float) -> Installation:
        if not self.rows:
            return self._add("first", _utc(begin_s), vehicle_at(self._situation.assignments, _utc(begin_s)))
        row = next((row for row in reversed(self.rows) if row.began_at <= at), self.rows[0])
        if row is self.rows[-1] and row.ended_at is not None and at >= row.ended_at:
            # A swap ended the last one and nothing moved since: the box begins anew in its new vehicle.
            return self._add("swapped", row.ended_at, self._situation.device.vehicle_id)
        return row

    def _add(self, beginning: str, began_at: dt.datetime, vehicle_id: str | None) -> Installation:
        result = blank_result(beginning)
        row = Installation(
            id=new_id(),
            device_id=self._situation.device.id,
            vehicle_id=vehicle_id,
            began_at=began_at,
            ended_at=None,
            beginning=beginning,
            updated_at=self._now,
            status=result["status"],
            progress=0.0,
            result=result,
            algorithm=ALGORITHM,
            input_sha256="",
            unestimated_s=0.0,
            unestimated_moving_s=0.0,
            evidence=[],
        )
        self.rows.append(row)
        self.rows.sort(key=lambda other: other.began_at)
        self._results.put(row)
        return row

    def _bounds(self, row: Installation) -> tuple[float, float]:
        """UTC between which the row's data lies, without the moments around a move."""
        at = self.rows.index(row)
        after = self.rows[at + 1] if at + 1 < len(self.rows) else None
        since = row.began_at.timestamp() + (MOVE_GUARD_S if row.beginning == "moved" else 0.0)
        if row.beginning == "first":
            since -= 1.0  # ticks reach a little before the first sample
        until = row.ended_at.timestamp() if row.ended_at else float("inf")
        if after is not None and after.beginning == "moved":
            until -= MOVE_GUARD_S
        return since, until

    def _stretches(self, row: Installation) -> Iterator[tuple[Stretch, bool]]:
        """The row's data since its last chapter, a window at a time, and whether more follows."""
        since, until = self._bounds(row)
        since = max([since, *(known.until_s for known in chapter.read(row.evidence, ALGORITHM))])
        boots = self._situation.boots
        inside = [
            piece
            for piece in self._new
            if boots[piece.boot].unix_s(piece.t_last_s) > since and boots[piece.boot].unix_s(piece.t_first_s) < until
        ]
        for pieces, more in in_windows([*self._sources.pieces(since, until), *inside], boots):
            yield assemble(pieces, boots).between(since, until), more

    def _estimate(self, row: Installation) -> None:
        row.unestimated_s = row.unestimated_moving_s = 0.0
        for stretch, more in self._stretches(row):
            if not self._take(row, stretch, more=more):
                return

    def _take(self, row: Installation, stretch: Stretch, *, more: bool) -> bool:
        """Estimate with one window of a row's data; whether what follows it is still the row's."""
        told = self._run(row, stretch)
        estimate = None if told is None else told.estimate
        moves = [] if estimate is None else [(stretch.unix_s(c.t), c.angle) for c in estimate.changes]
        if moves and row.beginning == "moved" and moves[0][0] - row.began_at.timestamp() < SAME_MOVE_S:
            self._shift_beginning(row, moves.pop(0)[0])
            stretch = stretch.between(*self._bounds(row))
            told = self._run(row, stretch)
        if not moves:
            self._record(row, told, stretch, closing=more)
            return True
        parts = [row, *(self._moved(row, unix, angle) for unix, angle in moves)]
        for earlier, later in pairwise(parts):
            later.ended_at = earlier.ended_at
            earlier.ended_at = later.began_at
        self._restore(row)
        for part in parts[:-1] if more else parts:
            own = stretch.between(*self._bounds(part))
            self._record(part, self._run(part, own), own, keep_ready=part is row)
        if more:
            self._estimate(parts[-1])  # from the move on, this window's rest included
        return False

    def _moved(self, row: Installation, unix_s: float, angle: float) -> Installation:
        moved = self._add("moved", _utc(unix_s), row.vehicle_id)
        moved.moved_angle_rad = angle
        self._results.announce(
            "moved", moved.vehicle_id, installation_id=moved.id, moved_at=moved.began_at.isoformat(), angle_rad=angle
        )
        return moved

    def _restore(self, row: Installation) -> None:
        """Go back to what was known before a move: looks at data from both sides of it have told of neither."""
        last = self._sources.last_revision(row.id, row.ended_at)
        if last is None or row.beginning == "manual":
            return
        row.result, row.status, row.progress = last.result, last.status, last.progress
        row.algorithm, row.input_sha256, row.updated_at = last.algorithm, last.input_sha256, self._now

    def _shift_beginning(self, row: Installation, unix_s: float) -> None:
        before = self.rows[self.rows.index(row) - 1]
        row.began_at = before.ended_at = _utc(unix_s)
        self._results.put(before)

    def _run(self, row: Installation, stretch: Stretch) -> Told | None:
        if stretch.ticks.index.size == 0:
            return None
        past = chapter.past(chapter.read(row.evidence, ALGORITHM))
        side = self._situation.traffic_sides.get(row.vehicle_id or "")
        try:
            return self._estimator(stretch.ticks, stretch.gnss, past, roads_of(side))
        except Exception:
            # Whatever bad data make of an estimator must not keep the batches from being worked off.
            log.exception("estimate failed", device_id=self._situation.device.id, input_sha256=stretch.input_sha256)
            return None

    def _record(
        self,
        row: Installation,
        told: Told | None,
        stretch: Stretch,
        *,
        keep_ready: bool = False,
        closing: bool = False,
    ) -> None:
        row.unestimated_s = row.unestimated_moving_s = 0.0
        self._results.put(row)
        if told is None:
            return
        self._results.estimates += 1
        estimate = told.estimate
        result = mount_json(estimate)
        input_sha256 = self._close_chapter(row, told, stretch, closing=closing)
        self._revise(row, result, estimate.progress, stretch, input_sha256)
        if row.beginning == "manual":
            return  # said by somebody who looked; the estimate stands beside it as a revision
        if keep_ready and row.status == "ready" and estimate.status != "ready":
            return  # less data before the move than the estimate of then had
        row.result, row.status, row.progress = result, estimate.status, estimate.progress
        row.algorithm, row.input_sha256, row.updated_at = ALGORITHM, input_sha256, self._now
        self.recorded.add(row.id)
        self._results.announce(
            "installation", row.vehicle_id, installation_id=row.id, status=row.status, percent=result["percent"]
        )

    def _close_chapter(self, row: Installation, told: Told, stretch: Stretch, *, closing: bool) -> str:
        """Keep a stretch that is long enough as evidence; gives the hash of all data behind the estimate.

        One that has nothing to say stays open for longer, in case what follows makes it speak.  What it
        takes from the chapters before it takes once, when it closes: until then it is estimated many times.
        """
        known = chapter.read(row.evidence, ALGORITHM)
        input_sha256 = chapter.input_of(known, stretch.input_sha256)
        length_s, own = stretch.length_s, told.own
        closes = closing or length_s >= (chapter.SILENT_S if own is None else chapter.CHAPTER_S)
        if told.past_share == 0.0 or (closes and told.past_share < 1.0):
            known = chapter.faded(known, told.past_share)
            row.evidence = chapter.written(known, ALGORITHM)
        if closes:
            begin = known[-1].until_s if known else stretch.unix_s(float(stretch.ticks.t[0]))
            known.append(chapter.Chapter(begin, stretch.end_unix_s, length_s, own, stretch.input_sha256))
            row.evidence = chapter.written(known, ALGORITHM)
        return input_sha256

    def _revise(
        self, row: Installation, result: dict[str, object], progress: float, stretch: Stretch, input_sha256: str
    ) -> None:
        data_at = _utc(stretch.end_unix_s)
        status = str(result["status"])
        last = self._sources.last_revision(row.id, None)
        since = (
            dt.timedelta.max if last is None or status != "ready" or last.status != "ready" else data_at - last.data_at
        )
        if abs(since.total_seconds()) < REVISION_S:
            return
        self._results.revisions.append(
            MountingRevision(
                id=new_id(),
                installation_id=row.id,
                data_at=data_at,
                created_at=self._now,
                status=status,
                progress=progress,
                result=result,
                algorithm=ALGORITHM,
                input_sha256=input_sha256,
            )
        )


def is_due(row: Installation, *, data_end_s: float, all_pending: bool) -> bool:
    """Whether the cadence asks for an estimate of this installation; the device's data ends at that UTC."""
    if row.unestimated_s <= 0.0:
        return False
    if all_pending or not row.input_sha256 or row.unestimated_s >= STANDING_S:
        return True
    if row.status != "ready":
        return row.unestimated_moving_s >= EAGER_S
    settled = data_end_s - row.began_at.timestamp() >= SETTLED_S
    return row.unestimated_moving_s >= (SLOW_S if settled else CALM_S)


def vehicle_at(assignments: Sequence[Assignment], at: dt.datetime) -> str | None:
    """Vehicle that carried the box; before its first assignment already that vehicle, as recordings may be older."""
    if not assignments:
        return None
    covering = [a for a in assignments if a.began_at <= at]
    if not covering:
        return assignments[0].vehicle_id
    last = covering[-1]
    return last.vehicle_id if last.ended_at is None or at < last.ended_at else None


def _utc(unix_s: float) -> dt.datetime:
    return dt.datetime.fromtimestamp(unix_s, dt.UTC)
