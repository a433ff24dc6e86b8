"""From the online estimator's state to the product's answer."""

from __future__ import annotations

import numpy as np

from nav_core.mounting.confidence import CONVERGED, STEADY, STEADY_SPAN, observability
from nav_core.mounting.model import GRAVITY
from nav_core.mounting.moved import LEAST_ANGLE
from nav_core.mounting.online import LAG_STEP, LEAST_TICKS, LISTEN, LONGEST_LAG, MISMATCH, OnlineState, advance, begin
from nav_core.mounting.online_hearing import lag_of
from nav_core.mounting.online_hypotheses import handed, settled
from nav_core.mounting.online_model import BIAS, SPEED_LAG, Filters
from nav_core.mounting.online_stream import chunks_of
from nav_core.mounting.online_tally import (
    Tally,
    covariance_of,
    mounting_of,
    recent_test,
    restlessness,
    strangeness,
)
from nav_core.mounting.quality import LAG_KNOWN, MIN_EVENTFUL, MIN_MOVING, USELESS, missing, progress_of
from nav_core.mounting.reasons import reason
from nav_core.mounting.receiver import frozen, late, wrong_gps_unit
from nav_core.mounting.trouble import BENDS, FOLLOWED, HANDED, TRUSTED_AFTER, explained, wrong_unit
from nav_core.records import Drive, MountingChange, MountingEstimate, Reason
from nav_core.rotation import angle_between
from nav_core.typing import Floats

ROUGH = 3.0
"""How many times the usual noise is called rough."""

RESTLESS = 2.0
"""An estimate that moves this much more than its covariance admits contradicts itself."""

NO_GRAVITY = 0.5 * GRAVITY
"""A vertical bias beyond this is none, m/s²."""

STRIDE = 60.0
"""Length of the chunks in which `estimate` feeds a recording, s."""


def assess(state: OnlineState) -> MountingEstimate:
    """What is known of a mounting by now.

    Parameters
    ----------
    state : OnlineState

    Returns
    -------
    MountingEstimate
        `ready` when every sigma, widened by the innovations and by what no single drive can tell, is under
        2°, the drive offered enough, and the receiver's data are those of a car.
    """
    tally, filters = state.tally, state.filters
    refused = wrong_gps_unit(state.chords) or (None if state.ticks is None else wrong_unit(state.ticks))
    if refused is not None:
        return _without(0.0, (refused,), state)
    if filters is None:
        return _without(0.0, (reason(_not_begun(state)),), state)
    share = min(tally.moving / MIN_MOVING, 1.0)
    if share < 1.0:
        return _without(0.1 * share, (reason("not_driven"),), state)
    covariance = covariance_of(filters, tally)
    sigma = np.sqrt(np.diag(covariance))
    eventful = tally.along + tally.across
    progress = progress_of(sigma, eventful)
    strange = strangeness(filters)
    foreign = _foreign(filters, strange, state)
    if foreign is not None:
        reasons = (foreign,) if state.ticks is None else explained((foreign,), state.ticks)
        return _without(min(progress, 0.2), reasons, state)
    if not settled(filters) or sigma.max() > USELESS:
        return _without(min(progress, 0.2), missing(sigma, tally.along, tally.turned), state)
    doubts = _doubts(state)
    ready = bool(sigma.max() < CONVERGED) and eventful >= MIN_EVENTFUL and not doubts
    reasons = () if ready else doubts or missing(sigma, tally.along, tally.turned)
    signs = _signs(filters, tally)
    if signs is not None:
        ready = ready and signs.code == "handedness_trusted"
        reasons = (*reasons, signs)
    if not ready and strange > ROUGH and "rough" not in {each.code for each in reasons}:
        reasons = (*reasons, reason("rough"))
    known = np.sqrt(np.diag(filters.P[filters.best])[SPEED_LAG : SPEED_LAG + 2]) < LAG_KNOWN
    lags = state.lags[0] if known[0] else None, state.lags[1] if known[1] else None
    return MountingEstimate(
        "ready" if ready else "settling",
        "online",
        R_va=mounting_of(filters),
        covariance=covariance,
        progress=1.0 if ready else min(progress, 0.99),
        observability=observability(covariance),
        stable=_is_stable(state),
        reliable=eventful >= MIN_EVENTFUL,
        self_test=recent_test(tally),
        converged_after=tally.sure_since,
        speed_lag=lags[0],
        course_lag=lags[1],
        changes=_changes(state, mounting_of(filters)),
        reasons=(*reasons, *_remarks(state, *lags)),
    )


def _remarks(state: OnlineState, speed_lag: float | None, course_lag: float | None) -> tuple[Reason, ...]:
    """What was found and dealt with."""
    found = (None if isinstance(state.gyro, str) else state.gyro, frozen(state.repeats))
    return (*(each for each in found if each is not None), *late(speed_lag, course_lag), *state.remarks)


def _changes(state: OnlineState, present: Floats | None) -> tuple[MountingChange, ...]:
    """The moves of the box; one after which it sat as before was none of the box's."""
    after = [*(move.before for move in state.moves[1:]), present]
    changes: list[MountingChange] = []
    for move, R_va in zip(state.moves, after, strict=False):
        if R_va is None and move.angle > 0.0:
            changes.append(MountingChange(move.t, move.angle, move.before))
        elif R_va is not None and (angle := angle_between(R_va, move.before)) > LEAST_ANGLE:
            changes.append(MountingChange(move.t, angle, move.before, R_va))
    return tuple(changes)


def _not_begun(state: OnlineState) -> str:
    """Why there is no filter yet."""
    t = np.empty(0) if state.gnss is None else state.gnss.t[state.gnss.fix]
    if not t.size:
        return "no_fix"
    deaf = state.ticks is None or state.ticks.t.size < LEAST_TICKS
    return "no_accelerometer" if deaf and t[-1] - t[0] > LISTEN else "few_fixes"


def _foreign(filters: Filters, strange: float, state: OnlineState) -> Reason | None:
    """Why the data are not those of a box fixed in a car, if they are not."""
    if strange > MISMATCH or abs(filters.x[filters.best, BIAS + 2]) > NO_GRAVITY:
        return reason("mismatch")
    if not filters.mirrored[filters.best]:
        return None
    # A receiver later than expected turns force and course against each other as a mirror does.
    return reason("handedness_open" if lag_of(state.hearing.speed) is None else "mirrored")


def _doubts(state: OnlineState) -> tuple[Reason, ...]:
    """Why an estimate that is sure of itself is not to be believed."""
    if state.watch.suspicious or restlessness(state.tally).max() > RESTLESS:
        return (reason("contradiction"),)
    if max(state.lags) > LONGEST_LAG - LAG_STEP:
        return (reason("rough"),)  # a lag at its limit is none: speed and course are something else's
    return (reason("startled"),) if state.watch.startled else ()


def _signs(filters: Filters, tally: Tally) -> Reason | None:
    """What is to be said of the signs of the axes; None once bends have told that they are right."""
    bends = tally.across > BENDS
    if bends and handed(filters) >= HANDED:
        return None
    if bends or tally.followed <= TRUSTED_AFTER:
        return reason("no_course" if tally.followed < FOLLOWED * tally.moving else "handedness_open")
    return reason("handedness_trusted")


def _is_stable(state: OnlineState) -> bool:
    """Whether the mounting of a minute ago is the present one."""
    trail = state.tally.trail
    before = trail[trail[:, 0] <= trail[-1, 0] - STEADY_SPAN]
    if not before.size:
        return False
    was, now = before[-1, 1:10].reshape(3, 3), trail[-1, 1:10].reshape(3, 3)
    # No rotation leads from a mirrored mounting to one that is not.
    return bool(np.linalg.det(was @ now.T) > 0.0) and angle_between(was, now) < STEADY


def _without(progress: float, reasons: tuple[Reason, ...], state: OnlineState) -> MountingEstimate:
    changes = _changes(state, None)
    remarks = _remarks(state, lag_of(state.hearing.speed), lag_of(state.hearing.course))
    return MountingEstimate("insufficient", "online", progress=progress, changes=changes, reasons=(*reasons, *remarks))


def estimate(drive: Drive) -> MountingEstimate:
    """Mounting by the online estimator at the end of a recording.

    Parameters
    ----------
    drive : Drive
        One recording.

    Returns
    -------
    MountingEstimate
        rad about the V axes, s, with status and reasons.
    """
    state = begin()
    for chunk in chunks_of(drive, STRIDE):
        state = advance(state, chunk)
    return assess(state)
