"""The online estimator: a mounting that is there while the vehicle still drives.

`begin`, then `advance` with whatever has arrived, then `assess` whenever somebody looks; `advance_fleet`
does it for many boxes with one call of the compiled filter.  A state is never changed, so a worker may
keep it, or throw a failed step away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from nav_core.errors import ShapeError
from nav_core.mounting.closed_form import level_basis
from nav_core.mounting.fixes import gps_rate, unrolled
from nav_core.mounting.online_hearing import TRUSTED, UNPROVED, Hearing, gyro_since, listened, right_lags
from nav_core.mounting.online_hypotheses import adapted, likely, likely_bias, settled, stack
from nav_core.mounting.online_kernel import run
from nav_core.mounting.online_model import (
    BIAS,
    COURSE_LAG,
    N_COLUMNS,
    SPEED_LAG,
    Filters,
    Tuning,
    hypotheses,
    initial_filters,
)
from nav_core.mounting.online_rows import HORIZON, KEEP, SLOWEST, Place, ready_fixes, records_of, rows_of, window
from nav_core.mounting.online_stream import Chunk, fixes_where, joined, jumped_back, ticks_since
from nav_core.mounting.online_tally import PIECE, Tally, heard, moved_on, noted, piece_of, strangeness
from nav_core.mounting.online_watch import Move, Watch, looked_after
from nav_core.mounting.reasons import reason
from nav_core.mounting.receiver import NO_CHORDS, Chords, Repeats, followed_on, repeats_on
from nav_core.mounting.stretch import Record
from nav_core.mounting.trouble import wrong_unit
from nav_core.records import Gnss, Reason
from nav_core.signal import Ticks, merge
from nav_core.timebase import stale
from nav_core.typing import Floats

LISTEN = 8.0
"""Specific force is heard for this long before it levels the start, s."""

LEAST_TICKS = 20
"""Fewer hold no specific force to level by."""

WAIT = 120.0
"""How much of the raw stream is kept while nothing can start, s."""

PROBATION = 60.0
"""For so much driving the raw stream is kept as if nothing had started, s: lags and gyro may turn out to be others."""

ADAPTED_AFTER = 20.0
"""s of driving before the innovations say how rough it is."""

MISMATCH = 10.0
"""So many times the usual noise are no longer that of a box fixed in a car."""

LAG_STEP = 0.15
LONGEST_LAG = 2.5
"""Most that the lags move between two pieces, and their greatest value, s."""


@dataclass(frozen=True, slots=True)
class OnlineState:
    """A box as far as its stream has been worked off.

    Attributes
    ----------
    tuning : Tuning
    filters : Filters, optional
        The yaw hypotheses that are left; None before the start.
    lags : tuple of float
        Of GPS speed and course, at which the filters stand, s.
    bias : float
        What is expected of the accelerometer's level biases, m/s².
    place : Place, optional
    ticks, spin, gnss : optional
        The end of the raw stream that is still needed.
    tally : Tally
        What the drive has offered and how the estimate has developed.
    watch : Watch
        Over the box staying where it is.
    chords : Chords
        What the receiver says of itself, see `receiver.wrong_gps_unit`.
    repeats : Repeats
        How long it has repeated old fixes.
    hearing : Hearing
        What is told of the receiver's lags and the gyro without a mounting.
    gyro : str or Reason
        Whether it is used: `TRUSTED`, not yet, or why not.
    moves : tuple of Move
        After each of which the estimate began anew.
    remarks : tuple of Reason
        What happened to the stream.
    """

    tuning: Tuning = field(default_factory=Tuning)
    filters: Filters | None = None
    lags: tuple[float, float] = (0.3, 0.3)
    bias: float = Tuning().bias
    place: Place | None = None
    ticks: Ticks | None = None
    spin: Ticks | None = None
    gnss: Gnss | None = None
    tally: Tally = field(default_factory=Tally)
    watch: Watch = field(default_factory=Watch)
    chords: Chords = NO_CHORDS
    repeats: Repeats = field(default_factory=Repeats)
    hearing: Hearing = field(default_factory=Hearing)
    gyro: str | Reason = UNPROVED
    moves: tuple[Move, ...] = ()
    remarks: tuple[Reason, ...] = ()


@dataclass(slots=True)
class _Work:
    """A state on its way through a chunk."""

    state: OnlineState
    record: Record
    spin: Record | None
    heard: float
    rows: Floats


def begin(tuning: Tuning | None = None) -> OnlineState:
    """The state of a box that has not been heard of yet.

    Parameters
    ----------
    tuning : Tuning, optional
        What to expect; of ordinary cars and receivers where not given.

    Returns
    -------
    OnlineState
        Before the start.
    """
    tuned = tuning or Tuning()
    return OnlineState(tuning=tuned, lags=(tuned.lag, tuned.lag), bias=tuned.bias)


def advance(state: OnlineState, chunk: Chunk) -> OnlineState:
    """The state after more of the stream.

    Parameters
    ----------
    state : OnlineState
    chunk : Chunk
        Later than all before.  The pieces of a stream may be cut anywhere; fixes that are not later than
        those worked off are left out.  One that comes after a jump back of the box clock (`jumped_back`) begins
        the estimate anew, and the estimate says so.

    Returns
    -------
    OnlineState
        `HORIZON` seconds behind the last fix.
    """
    return advance_fleet([state], [chunk])[0]


def advance_fleet(states: Sequence[OnlineState], chunks: Sequence[Chunk]) -> list[OnlineState]:
    """Every box's state after its chunk; see `advance`.

    Boxes share each call of the compiled filter, piece by piece.

    Parameters
    ----------
    states : sequence of OnlineState
        One per box; not changed.
    chunks : sequence of Chunk
        What each has sent since, one per box.

    Returns
    -------
    list of OnlineState
        In the order of `states`.

    Raises
    ------
    ShapeError
        If there are not as many chunks as states.
    """
    if len(states) != len(chunks):
        raise ShapeError("chunks", (len(chunks),), f"({len(states)},)")
    works = [_prepared(state, chunk) for state, chunk in zip(states, chunks, strict=True)]
    busy = [work for work in works if _next_piece(work)]
    while busy:
        for tuning in {work.state.tuning for work in busy}:
            _run_piece([work for work in busy if work.state.tuning == tuning])
        busy = [work for work in busy if _next_piece(work)]
    return [_trimmed(work.state) for work in works]


def _prepared(state: OnlineState, chunk: Chunk) -> _Work:
    """The stream as far as it is known, with the filters not yet moved."""
    back = None if state.gnss is None else jumped_back(state.gnss, chunk.gnss)
    if back is not None:
        state = replace(begin(state.tuning), remarks=(reason("clock_back", f"{back:.0f}"),))
    ticks = chunk.ticks if state.ticks is None else merge([state.ticks, chunk.ticks])
    spin = chunk.spin if state.spin is None else state.spin if chunk.spin is None else merge([state.spin, chunk.spin])
    gnss = chunk.gnss if state.gnss is None else joined(state.gnss, chunk.gnss)
    record, spins = records_of(ticks, spin, gnss)
    heard = -np.inf
    if record.fixes.t.size and record.t.size:
        last = float(record.fixes.t[-1])
        felt = float(record.t[-1]) - 0.3 + HORIZON
        heard = min(last, felt) if felt > last - 5.0 else last
    repeated = stale(gnss)
    chords, repeats = followed_on(state.chords, gnss, repeated), repeats_on(state.repeats, gnss, repeated)
    state = replace(state, ticks=ticks, spin=spin, gnss=gnss, chords=chords, repeats=repeats)
    return _Work(state, record, spins, heard, np.empty((0, N_COLUMNS)))


def _next_piece(work: _Work) -> bool:
    """Put the rows of the next piece in place, starting the filters if need be; False when there are none."""
    state, record = work.state, work.record
    ready = ready_fixes(record.fixes, -np.inf if state.place is None else state.place.fix, work.heard)
    if not ready.any():
        return False
    if state.filters is None and not _may_start(work):
        return False
    since = float(record.fixes.t[np.argmax(ready)])
    if state.place is not None and piece_of(since) > piece_of(state.place.fix):
        state = _looked_at(state)
        move = _move(state, since)
        if move is not None:
            return _next_piece(_after(move, work, since))
        before, state = state, _listened(state, work)
        if state.lags != before.lags or (before.gyro == TRUSTED and state.gyro != TRUSTED):
            work.state = replace(state, filters=None, place=None, tally=Tally(), watch=Watch())
            return _next_piece(work)
    edge = (piece_of(since) + 1.0) * PIECE
    ready &= record.fixes.t < edge
    part = window(record, since - KEEP, edge + HORIZON)
    spin = work.spin if state.gyro == TRUSTED else None
    spin = None if spin is None else window(spin, since - KEEP, edge + HORIZON)
    kept = (record.fixes.t >= part.fixes.t[0]) & (record.fixes.t <= part.fixes.t[-1])
    rows, place = rows_of(part, spin, state.place, ready[kept], state.lags, state.tuning)
    filters = state.filters
    if filters is None:
        filters = initial_filters(rows[0], _starts(record, state.lags), state.lags, state.tuning)
    work.rows = rows
    work.state = replace(state, filters=filters, place=place)
    return True


def _may_start(work: _Work) -> bool:
    """Whether enough has been heard, and of the right kind."""
    record, ticks = work.record, work.state.ticks
    if work.heard - float(record.fixes.t[0]) < LISTEN or record.t.size < LEAST_TICKS or ticks is None:
        return False
    return wrong_unit(ticks) is None


def _starts(record: Record, lags: tuple[float, float]) -> Floats:
    """Mountings to start from: levelled by the first `LISTEN` seconds, less what the receiver saw of acceleration."""
    fixes = record.fixes
    first = fixes.t <= fixes.t[0] + LISTEN
    t, speed = fixes.t[first], fixes.speed[first]
    heard = (record.t >= t[0] - lags[0]) & (record.t <= t[-1] - lags[0])
    force = record.f[heard if heard.any() else slice(None)].mean(axis=0)
    span = max(float(t[-1] - t[0]), 1.0)
    side = np.where(speed > SLOWEST, speed * gps_rate(t, unrolled(fixes.course[first])), 0.0)
    return hypotheses(force, level_basis(force[None]), (float(speed[-1] - speed[0]) / span, float(side.mean())))


def _run_piece(works: list[_Work]) -> None:
    """Run all boxes' filters over their rows in one call, and take notes."""
    watched = [work for work in works if work.state.watch.second is not None]
    stacked, first, last, rows = stack(
        [*(work.state.filters for work in works), *(work.state.watch.second for work in watched)],
        [work.rows for work in (*works, *watched)],
    )
    steps = last - first
    trace = np.zeros((int(steps.sum()), 4))
    run(stacked, rows, first, last, works[0].state.tuning, trace)
    ends = np.cumsum(steps)
    begin = 0
    for work in works:
        assert work.state.filters is not None
        assert work.state.place is not None
        end = begin + work.state.filters.x.shape[0]
        filters = Filters(*(column[begin:end] for column in stacked))
        told = trace[:0]
        if settled(filters):
            best = begin + filters.best
            told = trace[ends[best] - steps[best] : ends[best]]
        tally = noted(work.state.tally, work.rows, work.state.place.fix, filters, told)
        if told.shape[0] and work.state.filters.x.shape[0] == end - begin:
            tally = heard(moved_on(tally, work.state.filters, filters), work.rows, work.state.filters, filters)
        work.state = replace(work.state, filters=filters, tally=tally)
        begin = end
    for place, work in enumerate(watched, begin):
        second = Filters(*(column[place : place + 1] for column in stacked))
        work.state = replace(work.state, watch=work.state.watch._replace(second=second))


def _looked_at(state: OnlineState) -> OnlineState:
    """Drop hypotheses, move the lags, and take the drive's own measure of noise and bias, at the end of a piece."""
    assert state.filters is not None
    filters = likely(state.filters) if state.filters.x.shape[0] > 1 else state.filters
    best = filters.best
    shift = np.clip(filters.x[best, [SPEED_LAG, COURSE_LAG]], -LAG_STEP, LAG_STEP)
    lags = np.clip(np.add(state.lags, shift), 0.0, LONGEST_LAG)
    bias = likely_bias(filters, state.bias, state.tuning)

    def shifted(these: Filters) -> Filters:
        x, P = these.x.copy(), these.P.copy()
        x[:, [SPEED_LAG, COURSE_LAG]] -= lags - state.lags
        for axis in (BIAS, BIAS + 1):
            P[:, axis, axis] += bias**2 - state.bias**2
        return these._replace(x=x, P=P)

    filters, watch = shifted(filters), state.watch
    if watch.second is not None:
        watch = watch._replace(second=adapted(shifted(watch.second), state.tuning))
    if settled(filters) and state.tally.driven > ADAPTED_AFTER:
        filters = adapted(filters, state.tuning)
        if not filters.mirrored[filters.best]:
            watch = looked_after(watch, filters, state.tally, state.tuning)
    return replace(state, filters=filters, lags=(float(lags[0]), float(lags[1])), bias=bias, watch=watch)


def _listened(state: OnlineState, work: _Work) -> OnlineState:
    """The state with what the piece behind it tells of lags and gyro."""
    assert state.place is not None
    begin = piece_of(state.place.fix) * PIECE
    around = (begin - 2.0, begin + PIECE + 2.0 * HORIZON)
    spin = None if work.spin is None else window(work.spin, *around)
    hearing = listened(state.hearing, window(work.record, *around), spin, begin)
    if hearing.until == state.hearing.until:
        return state
    lags, gyro = right_lags(hearing, state.lags), gyro_since(state.gyro, hearing)
    return replace(state, hearing=hearing, lags=lags, gyro=gyro)


def _move(state: OnlineState, now: float) -> Move | None:
    """The move of the box that has come out by now, if one has.

    Where the data stop being those of a box fixed in a car, the filter can no longer say by how much.
    """
    anchor = state.watch.anchor
    if anchor is None or state.filters is None:
        return None
    if state.watch.moved:
        return Move(state.watch.quiet, anchor.R_va, state.watch.angle)
    return Move(now, anchor.R_va, 0.0) if strangeness(state.filters) > MISMATCH else None


def _after(move: Move, work: _Work, now: float) -> _Work:
    """The same box from a box time on, its mounting unknown."""
    state = work.state
    assert state.ticks is not None
    assert state.gnss is not None
    ticks, gnss = ticks_since(state.ticks, now - LONGEST_LAG), fixes_where(state.gnss, state.gnss.t >= now)
    spin = None if state.spin is None else ticks_since(state.spin, now - LONGEST_LAG)
    work.state = OnlineState(
        state.tuning,
        lags=state.lags,
        bias=state.bias,
        ticks=ticks,
        spin=spin,
        gnss=gnss,
        chords=state.chords,
        repeats=state.repeats,
        gyro=state.gyro,
        moves=(*state.moves, move),
        remarks=state.remarks,
    )
    work.record, work.spin = records_of(ticks, spin, gnss)
    return work


def _trimmed(state: OnlineState) -> OnlineState:
    """Without what will not be needed again of the raw stream."""
    if state.ticks is None or state.gnss is None:
        return state
    if state.place is None:
        ends = [float(t[-1]) for t in (state.ticks.t, state.gnss.t) if t.size]
        since = max(ends, default=0.0) - WAIT
    else:
        since = state.place.fix - (WAIT if state.tally.driven < PROBATION else KEEP)
    spin = state.spin
    return replace(
        state,
        ticks=ticks_since(state.ticks, since - KEEP),
        spin=None if spin is None else ticks_since(spin, since - KEEP),
        gnss=fixes_where(state.gnss, state.gnss.t >= since),
    )
