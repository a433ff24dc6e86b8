"""Find out whether, when and how far the box was moved during a drive.

A suspicion comes cheaply: from the mean direction of specific force, which shows a change of tilt of
any size, and from the evidence by stretches, which shows what else changed.  A suspicion counts when
the two sides, each solved on its own, differ by more than their own doubt.  Hills, bends, slow drift
of the accelerometer and a rough ride raise suspicions; they do not survive that.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from nav_core.mounting.fusion import DOUBTFUL, disagreement, trip_evidence
from nav_core.mounting.model import MILLI_G, TURN, Noise
from nav_core.mounting.quality import excitation, fits_a_car
from nav_core.mounting.refine import BLOCK, HUBER, Fit, view_of, weigh
from nav_core.mounting.solution import Solution, between, matched, solve
from nav_core.mounting.stretch import PAUSE, Record
from nav_core.typing import Floats

LEAST_SIDE = 25.0
"""Shortest side of a move that can be judged, s of record."""

LEAST_TICKS = 50

LEAST_MOVING = 30.0
"""A change of heading alone needs this much driving on either side, s."""

LEAST_ANGLE = np.radians(3.3)
"""Smaller differences are left to other roads and the like, rad."""

STRANGER = 25.0 * MILLI_G
"""Bias that either side of a suspected move may have for itself, m/s²: a cold morning after a hot evening.  What
is left of a difference then is what driving tells of it, and a bias cannot pass for a turn of the box."""

RESTLESS = 3.0 * MILLI_G / np.sqrt(300.0)
"""And its drift, (m/s²)/√s: a short side cannot show how fast its bias runs away."""

SURE = 36.0
"""Squared difference over its covariance (three degrees of freedom) that counts as a move: six sigmas."""

STARTLING = 5.0
LEAST_NEWS = 4.0
"""Mean square of the whitened speeds of a few seconds, at least so many of them, that an ordinary drive hardly reaches:
rough roads, poor fixes and bends stay under 3.5 in 99 of 100 stretches of 5 s."""

NEIGHBOURHOOD = 60.0
"""A suspicion knows the moment to this, s."""

NEAR_PAUSE = 30.0
"""A box is turned while the vehicle is parked rather than half a minute later, s."""

LINEAR = 0.3
"""Up to this turn the evidence is good for more than its own mounting, rad."""

MAX_DEPTH = 4
_TILT = np.radians(8.0)
_RANGE = np.radians(30.0)


class Piece(NamedTuple):
    """A stretch of a drive with one mounting."""

    logged: Record
    solution: Solution

    @property
    def record(self) -> Record:
        """What the solution is of: as the receiver's smoothing has it."""
        return self.solution.record


def tilt_suspicion(record: Record) -> float | None:
    """Box time of the best single step in the mean direction of specific force, s, if it is large.

    Parameters
    ----------
    record : Record
        Ticks, A-frame, m/s².

    Returns
    -------
    float or None
        s; None where no step is large.
    """
    t, f = record.t, record.f
    if t.size < 3:
        return None
    count = np.arange(1, t.size)
    total = np.cumsum(f, axis=0)
    before = total[:-1] / count[:, None]
    after = (total[-1] - total[:-1]) / (t.size - count)[:, None]
    fair = (t[1:] - t[0] >= LEAST_SIDE) & (t[-1] - t[1:] >= LEAST_SIDE)
    if not fair.any():
        return None
    weight = count * (t.size - count) * np.einsum("ij,ij->i", before - after, before - after)
    best = int(np.argmax(np.where(fair, weight, -1.0)))
    return float(t[best + 1]) if _angle(before[best], after[best]) > _TILT else None


def _angle(a: Floats, b: Floats) -> float:
    """Between two vectors, rad."""
    cosine = a @ b / np.linalg.norm(a) / np.linalg.norm(b)
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def evidence_suspicion(fit: Fit) -> float | None:
    """Box time at which the evidence changes its mind most, s, if it does so clearly.

    Every split of the stretches into before and after is tried with a turn of its own on either
    side and all else held; the gain in log likelihood tells.

    Parameters
    ----------
    fit : Fit
        Of one record.

    Returns
    -------
    float or None
        s; None where nothing is clear.
    """
    e = np.concatenate([[1.0], fit.p])
    information = np.cumsum(fit.gram[:, 1:4, 1:4], axis=0)
    pull = -np.cumsum((fit.gram @ e)[:, 1:4], axis=0)
    least = int(np.ceil(LEAST_SIDE / BLOCK))
    if information.shape[0] < 2 * least:
        return None
    weak = np.eye(3) / _RANGE**2

    def gain(A: Floats, b: Floats) -> tuple[Floats, Floats]:
        turn = np.linalg.solve(A + weak, b[..., None])[..., 0]
        return np.einsum("...i,...i->...", turn, b), turn

    split = slice(least - 1, information.shape[0] - least)
    first, turn_first = gain(information[split], pull[split])
    second, turn_second = gain(information[-1] - information[split], pull[-1] - pull[split])
    whole, _ = gain(information[-1], pull[-1])
    ratio = max(float(fit.misfit.sum() / max(fit.count.sum(), 1.0)), 1.0)
    best = int(np.argmax(first + second))
    clear = (first[best] + second[best] - whole) / ratio > SURE
    far = float(np.linalg.norm(turn_second[best] - turn_first[best])) > 0.7 * LEAST_ANGLE
    return fit.begin + (best + least) * BLOCK if clear and far else None


def startled(fit: Fit) -> bool:
    """Whether the end of a record, too short to be a side of a move, is not what a box that stayed in place measures.

    Parameters
    ----------
    fit : Fit
        Of the record since the last move.

    Returns
    -------
    bool
    """
    last = slice(-int(LEAST_SIDE / BLOCK) - 1, None)
    count = fit.count[last, 0]
    return bool(((fit.misfit[last, 0] > STARTLING * count) & (count >= LEAST_NEWS)).any())


def pieces_of(record: Record, noise: Noise, *, depth: int = MAX_DEPTH) -> list[Piece]:
    """A drive cut where the box was moved.

    Parameters
    ----------
    record : Record
        With at least three fixes and some ticks.
    noise : Noise
    depth : int
        How often a piece may be cut again.

    Returns
    -------
    list of Piece
        In order of time; one where the box stayed put.  Whether the receiver smooths is asked of each piece once
        it stands: a box that swings or is thrown looks like smoothing too, and would be explained away.
    """
    return [Piece(solution.record, matched(solution, noise)) for solution in _still(record, noise, depth)]


def _still(record: Record, noise: Noise, depth: int) -> list[Solution]:
    """Of the stretches during which the box did not move, in order of time."""
    solution = solve(record, noise)
    if depth == 0:
        return [solution]
    # The rough fit holds the noise of an ordinary drive, but of a long one it knows an excerpt only.
    evidence = solution.fit if solution.fit.gram.shape[0] > solution.rough.gram.shape[0] else solution.rough
    suspicions = [when for when in (tilt_suspicion(record), evidence_suspicion(evidence)) if when is not None]
    for number, when in enumerate(suspicions):
        # Whether neighbouring trips differ does not depend on the suspicion: it is asked once.
        cut = _confirmed(record, when, noise) or (None if number else _between_trips(record, noise))
        if cut is not None:
            first, second = (_still(side, noise, depth - 1) for side in cut)
            return first + second if len(first) == len(second) == 1 else _rejoined(record, first, second, noise)
    return [solution]


def _rejoined(record: Record, first: list[Solution], second: list[Solution], noise: Noise) -> list[Solution]:
    """The pieces of two sides that were cut again; those that meet are one where they agree: the cut was misplaced."""
    sides = first[-1].record, second[0].record
    wary = _wary(noise)
    before, after = (trip_evidence(solve(side, wary).fit) for side in sides)
    chi2, _ = disagreement(before, after, wary)
    if chi2 > DOUBTFUL:
        return first + second
    whole = between(record, sides[0].fixes.t[0], sides[1].fixes.t[-1])
    return [*first[:-1], solve(whole, noise), *second[1:]]


def _wary(noise: Noise) -> Noise:
    """The same of two sides that may have a bias each."""
    return replace(noise, bias=max(noise.bias, STRANGER), drift=max(noise.drift, RESTLESS))


def _between_trips(record: Record, noise: Noise) -> tuple[Record, Record] | None:
    """Both sides of the first pause over which neighbouring trips differ.

    A box that is turned and turned back leaves no step that divides the whole record in two.
    """
    t = record.fixes.t
    pauses = np.flatnonzero(np.diff(t) > PAUSE)
    if pauses.size < 2:
        return None
    noise = _wary(noise)
    edges = np.concatenate([[t[0]], t[pauses + 1]])
    ends = np.concatenate([t[pauses], [t[-1]]])
    trips = [between(record, begin, end) for begin, end in zip(edges, ends, strict=True)]
    trips = [trip for trip in trips if excitation(trip).moving > LEAST_MOVING and trip.t.size >= LEAST_TICKS]
    solutions = [solve(trip, noise) for trip in trips]
    for number, (one, other) in enumerate(pairwise(trips)):
        if _differ((one, other), solutions[number], solutions[number + 1], noise):
            when = float(other.fixes.t[0])
            return between(record, t[0], np.nextafter(when, t[0])), between(record, when, t[-1])
    return None


def _confirmed(record: Record, when: float, noise: Noise) -> tuple[Record, Record] | None:
    """Both sides of a suspected move, with the moment sharpened; None when they agree."""
    noise = _wary(noise)
    confirmed: tuple[Record, Record] | None = None
    for _ in range(2):
        sides = _sides(record, when)
        if sides is None:
            break
        before, after = (solve(side, noise) for side in sides)
        if not _differ(sides, before, after, noise):
            break
        confirmed = sides
        sharper = _moment(record, when, before.fit, after.fit, noise)
        if abs(sharper - when) < BLOCK:
            break
        when = sharper
    return confirmed


def _sides(record: Record, when: float) -> tuple[Record, Record] | None:
    t = record.fixes.t
    if when - t[0] < LEAST_SIDE or t[-1] - when < LEAST_SIDE:
        return None
    sides = between(record, t[0], when), between(record, when, t[-1])
    return sides if all(side.fixes.t.size >= 5 and side.t.size >= LEAST_TICKS for side in sides) else None


def _differ(sides: tuple[Record, Record], before: Solution, after: Solution, noise: Noise) -> bool:
    """Whether the mountings of two sides differ by more than their doubt.

    Half a minute without much traffic can hold a heading that is wrong and sure of itself; where the
    closed form does not see a car, tilt alone decides.
    """
    offered = [excitation(side) for side in sides]
    heading = all(
        each.moving > LEAST_MOVING and fits_a_car(solution.start, each)
        for each, solution in zip(offered, (before, after), strict=True)
    )
    axes = slice(0, 3) if heading else slice(0, 2)
    chi2, e = disagreement(trip_evidence(before.fit), trip_evidence(after.fit), noise, axes)
    if np.linalg.norm(e[:2]) > 2.0 * _tilt_seen(sides) + LEAST_ANGLE:
        return False  # half a minute of bends can end in a mounting that stands on its head: gravity would know
    return bool(np.linalg.norm(e[axes]) > LEAST_ANGLE and chi2 > SURE)


def _tilt_seen(sides: tuple[Record, Record]) -> float:
    """Angle between the mean directions of specific force of two sides, rad."""
    before, after = (side.f.mean(axis=0) for side in sides)
    return _angle(before, after)


def _moment(record: Record, when: float, before: Fit, after: Fit, noise: Noise) -> float:
    """Box time of the move, near a guess, that makes the record most likely, given both mountings.

    The sides differ in biases, gains and lags as well, which says nothing of the moment: the turn alone
    is compared, all else being that of the side before.  A large turn cannot be followed linearly;
    there every stretch begins anew, so that what the wrong mounting did to the state ends with it.
    """
    near = between(record, when - NEIGHBOURHOOD, when + NEIGHBOURHOOD)
    if near.fixes.t.size < 2:
        return when  # in a long tunnel: no fix is near enough to tell
    turn = Rotation.from_matrix(after.R_va @ before.R_va.T).as_rotvec()
    small = float(np.linalg.norm(turn)) < LINEAR
    lags = (before.speed_lag, before.course_lag)

    def cost(R_va: Floats, p: Floats) -> Floats:
        evidence = weigh(near, view_of(near, R_va, lags), noise, before.p, HUBER, restart=not small)
        return (evidence.misfit(p) + evidence.log_det).sum(1)

    turned = before.p.copy()
    turned[TURN] += turn
    other = cost(before.R_va, turned) if small else cost(after.R_va, before.p)
    gain = np.concatenate([[0.0], np.cumsum(cost(before.R_va, before.p) - other)])
    return _at_a_pause(record, float(near.fixes.t[0]) + int(np.argmin(gain)) * BLOCK)


def _at_a_pause(record: Record, when: float) -> float:
    """The end of a pause between trips, where one is near enough for the evidence not to tell: s."""
    t = record.fixes.t
    pauses = np.flatnonzero(np.diff(t) > PAUSE)
    ends = t[pauses + 1][(t[pauses] - NEAR_PAUSE < when) & (when < t[pauses + 1] + NEAR_PAUSE)]
    return float(ends[0]) if ends.size else when
