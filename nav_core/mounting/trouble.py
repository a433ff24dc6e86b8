"""Trouble with boxes and receivers: found by evidence, named, and left out or refused.

Nothing is repaired in silence.  What spoils a stretch of the recording is left out of the estimate
and named; what spoils all of it is refused with the reason.

A box that logs minus specific force and a box with left-handed axes are one and the same trouble:
``-I`` is a mirror times half a turn, and half a turn is just another way to mount the box.  Two
wrong signs are no trouble at all.  So the question to the drive is one of handedness: does the force
across the travel point into the bend, or out of it?
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.mounting.clocks import clock_jumps
from nav_core.mounting.closed_form import start
from nav_core.mounting.fixes import FOLLOW_SPEED, Fixes
from nav_core.mounting.model import GRAVITY, Noise
from nav_core.mounting.quality import excitation, fits_a_car
from nav_core.mounting.reasons import reason
from nav_core.mounting.receiver import Repeats, chords, frozen, repeats_on, slow_fixes, wrong_gps_unit
from nav_core.mounting.refine import HUBER, Fit, refine, weigh
from nav_core.mounting.reversing import reversals
from nav_core.mounting.solution import EXCERPT, Solution, excerpt
from nav_core.mounting.stretch import Record, Span
from nav_core.mounting.stuck import stuck_axis
from nav_core.records import Gnss, Reason
from nav_core.rotation import angle_between
from nav_core.signal import KERNEL_TICKS, Ticks, runs
from nav_core.typing import Floats

UNITS = {"g": 1.0, "percent of g": 100.0, "thousandths of g": 1000.0}
"""Gravity in other units."""

UNIT_SHARE = 0.15
"""By how much of it gravity may be off, bias and scale of a bad accelerometer included."""

FLICKER = 0.35
"""Without gravity the magnitude of what is left varies by this share of its median."""

SLOW_SAMPLES = 15.0
"""Hz; up to here named as slow."""

TOO_SLOW = 5.0
"""Hz; an accelerometer slower than this misses half of what a car does: then that is why it fits no car."""

PAUSE = 10.0
"""Longer than this between samples is a pause and no sampling, s."""

SAME = np.radians(3.0)
"""Mountings that differ by less are the same, rad."""

STANDING = 0.3
TRAVELLING = 5.0
"""m/s."""

LEAST_AT_REST = 15.0
LEAST_ABOARD = 90.0
"""s."""

ASHORE = 5.0
"""Left out at either end of a crossing, s."""

QUIET = 1.15
"""Vibration aboard is less than this many times that at a stand."""

TRUSTED_AFTER = 180.0
"""So long a drive without a bend is a straight road, s."""

FOLLOWED = 0.5
"""With a course for less than this share of the driving, more driving will not tell either."""

BENDS = 3.0
"""Handedness shows in bends: with less noticeable acceleration across the travel it is taken on trust, s.  What is
left of a straight road is bank and the receiver's noise, and may speak against a box that is in order."""

HANDED = 10.0
"""Twice the log of likelihoods: `ready` needs this much in favour of right-handed axes."""

MIRRORED = 20.0
"""And this much against them refuses the box."""

CLEAR = 100.0
"""The closed form alone decides beyond this."""


@dataclass(frozen=True, slots=True)
class Trouble:
    """What is wrong with a recording.

    Attributes
    ----------
    refused : Reason or None
        Why there can be no mounting.
    remarks : tuple of Reason
        What was found and dealt with.
    left_out : tuple of Span
        Stretches that must not be used.
    """

    refused: Reason | None = None
    remarks: tuple[Reason, ...] = ()
    left_out: tuple[Span, ...] = ()


def inspect(ticks: Ticks, gnss: Gnss, fixes: Fixes) -> Trouble:
    """Look over a recording before anything is estimated.

    Parameters
    ----------
    ticks : Ticks
    gnss : Gnss
    fixes : Fixes
        The usable ones of `gnss`.

    Returns
    -------
    Trouble
    """
    stuck = stuck_axis(ticks)
    refused = wrong_unit(ticks, stuck) or wrong_gps_unit(chords(gnss))
    if refused is not None:
        return Trouble(refused)
    remarks: list[Reason] = []
    torn, jumps = clock_jumps(gnss)
    remarks += jumps
    backwards = reversals(gnss)
    if backwards:
        remarks.append(reason("reversing", f"{sum(span.end - span.begin for span in backwards):.0f}"))
    for remark in (frozen(repeats_on(Repeats(), gnss)), slow_fixes(gnss), slow_samples(ticks)):
        if remark is not None:
            remarks.append(remark)
    if stuck:
        remarks.append(reason("stuck_axis", f"{sum(span.end - span.begin for span in stuck):.0f}"))
    aboard = unshaken(ticks, fixes)
    if aboard:
        remarks.append(reason("aboard", f"{sum(span.end - span.begin for span in aboard) / 60.0:.0f}"))
    return Trouble(None, tuple(remarks), tuple(sorted((*torn, *backwards, *stuck, *aboard))))


def wrong_unit(ticks: Ticks, stuck: tuple[Span, ...] | None = None) -> Reason | None:
    """What the accelerometer sends instead of specific force in m/s², by the magnitude of gravity.

    Parameters
    ----------
    ticks : Ticks
    stuck : tuple of Span, optional
        What `stuck_axis` found in them, where that is known already.

    Returns
    -------
    Reason or None
        ``wrong_unit``, ``no_gravity``, ``dead_accelerometer`` or ``dead_axis``; None when gravity is where it
        should be.
    """
    valid = ticks.valid
    if valid.sum() < 20:
        return None
    size = np.linalg.norm(ticks.f[valid], axis=1)
    middle = float(np.median(size))
    dead = _dead(ticks, middle, stuck_axis(ticks) if stuck is None else stuck)
    if dead is not None or abs(middle / GRAVITY - 1.0) < UNIT_SHARE:
        return dead
    flicker = float(np.median(np.abs(size - middle))) / middle
    for name, gravity in UNITS.items():
        if abs(middle / gravity - 1.0) < UNIT_SHARE and flicker < FLICKER:
            return reason("wrong_unit", name)
    if middle < 0.5 * GRAVITY and flicker > 0.5 * FLICKER:
        return reason("no_gravity")
    return reason("wrong_unit", f"numbers {float(f'{middle / GRAVITY:.2g}'):g} times as large")


def _dead(ticks: Ticks, middle: float, stuck: tuple[Span, ...]) -> Reason | None:
    """Whether nothing comes from the accelerometer, by the median of its force, or from an axis most of the time."""
    if middle == 0.0:
        return reason("dead_accelerometer")
    silent = sum(span.end - span.begin for span in stuck)
    return reason("dead_axis") if silent > 0.5 * (ticks.t[-1] - ticks.t[0]) else None


def unshaken(ticks: Ticks, fixes: Fixes) -> tuple[Span, ...]:
    """Stretches in which the vehicle travels and its box feels no more vibration than at a stand.

    Wheels on a road shake a box; a ferry or a train carries a vehicle as quietly as it stands.

    Parameters
    ----------
    ticks : Ticks
    fixes : Fixes

    Returns
    -------
    tuple of Span
        None where the vehicle never stood: then nothing says how quiet it can be.
    """
    valid = ticks.valid
    if fixes.t.size < 2 or not valid.any():
        return ()
    t, shaking = ticks.t[valid], ticks.scatter[valid]
    speed = np.interp(t, fixes.t, fixes.speed)
    at_rest = shaking[speed < STANDING]
    if at_rest.size < LEAST_AT_REST * ticks.rate:
        return ()
    quiet = QUIET * float(np.median(at_rest))
    spans: list[Span] = []
    for first, after in runs(speed > FOLLOW_SPEED):
        fast = speed[first:after] > TRAVELLING
        if fast.sum() < LEAST_ABOARD * ticks.rate:
            continue
        if float(np.median(shaking[first:after][fast])) < quiet:
            spans.append(Span(float(t[first]) - ASHORE, float(t[after - 1]) + ASHORE))
    return tuple(spans)


def sampling_rate(ticks: Ticks) -> float:
    """Samples per second of the accelerometer, from the weight of the ticks; 0 without any.

    Where the samples are farther apart than the ticks, they are counted: the window's weights of one add up to half
    its width.

    Parameters
    ----------
    ticks : Ticks
        Of the specific force.

    Returns
    -------
    float
        Hz.
    """
    if ticks.weight.size == 0:
        return 0.0
    rate = float(np.median(ticks.weight)) * ticks.rate / (0.5 * KERNEL_TICKS)
    if rate > 0.5 * ticks.rate:
        return rate
    span = float(np.minimum(np.diff(ticks.t), PAUSE).sum())
    return float(ticks.weight.sum()) / (0.5 * KERNEL_TICKS) / max(span, 1.0)


def slow_samples(ticks: Ticks) -> Reason | None:
    """Whether the accelerometer is slow.

    Parameters
    ----------
    ticks : Ticks
        Of the specific force.

    Returns
    -------
    Reason or None
        None of a rate that is high enough, or of no ticks.
    """
    rate = sampling_rate(ticks)
    return reason("slow_accelerometer", f"{rate:.2g}") if 0.0 < rate < SLOW_SAMPLES else None


def explained(reasons: tuple[Reason, ...], ticks: Ticks, code: str = "mismatch") -> tuple[Reason, ...]:
    """The reasons, with an accelerometer that is too slow in place of the mismatch (or `code`) that it makes.

    Parameters
    ----------
    reasons : tuple of Reason
        Of a verdict.
    ticks : Ticks
        Of the specific force.
    code : str
        What slow sampling looks like.

    Returns
    -------
    tuple of Reason
        Unchanged where the accelerometer is not too slow.
    """
    slow = slow_samples(ticks)
    if slow is None or code not in {each.code for each in reasons} or sampling_rate(ticks) >= TOO_SLOW:
        return reasons
    return (slow, *(each for each in reasons if each.code not in (code, slow.code)))


def came_back(mountings: list[Floats]) -> tuple[Reason, ...]:
    """Whether the last of the mountings of a drive is one that it had before, with another in between.

    Parameters
    ----------
    mountings : list of ndarray, shape (3, 3)
        ``R_va`` of each, in order of time.

    Returns
    -------
    tuple of Reason
        One or none.
    """
    return (reason("carried"),) if any(angle_between(R, mountings[-1]) < SAME for R in mountings[:-2]) else ()


def handedness(record: Record, solution: Solution, noise: Noise) -> float:
    """Evidence for right-handed axes.

    Parameters
    ----------
    record : Record
    solution : Solution
        Of the record.
    noise : Noise
        Least noise levels.

    Returns
    -------
    float
        Twice the log of the likelihood of the drive with right-handed axes over that with
        left-handed ones, each at its own best mounting.  What is far beyond `CLEAR` is the closed
        form's; negative only where the left-handed fit looks like a car.
    """
    if solution.start.handed > CLEAR:
        return solution.start.handed
    part = excerpt(record, EXCERPT)
    other = part._replace(f=-part.f)
    mirrored = start(other, noise)
    if solution.start.handed < -CLEAR and fits_a_car(mirrored, excitation(part)):
        return solution.start.handed
    suited = solution.fit.noise
    own = solution.start._replace(
        R_va=solution.fit.R_va, speed_lag=solution.fit.speed_lag, course_lag=solution.fit.course_lag
    )
    # Both are followed by the same filter with the same noise, from where they came to rest.
    right = _cost(part, refine(part, own, suited, solution.fit.p), suited)
    rough = refine(other, mirrored, noise)
    place = mirrored._replace(R_va=rough.R_va, speed_lag=rough.speed_lag, course_lag=rough.course_lag)
    left = _cost(other, refine(other, place, suited, rough.p), suited)
    evidence = left - right
    return evidence if fits_a_car(mirrored, excitation(part)) else max(evidence, 0.0)


def _cost(record: Record, fit: Fit, noise: Noise) -> float:
    """Minus twice the log likelihood of a record at a fit, up to a constant."""
    evidence = weigh(record, fit.view, noise, fit.p, HUBER)
    known = float(fit.p @ (fit.prior * fit.p - 2.0 * fit.prior_pull))
    return float((evidence.misfit(fit.p) + evidence.log_det).sum()) + known
