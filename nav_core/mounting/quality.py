"""From numbers to a status, and to what a driver can do about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.mounting.closed_form import Start
from nav_core.mounting.confidence import CONVERGED, Confidence
from nav_core.mounting.fixes import FOLLOW_SPEED
from nav_core.mounting.reasons import reason
from nav_core.mounting.refine import BLOCK, Fit
from nav_core.mounting.slip import by_stretch
from nav_core.mounting.stretch import Record
from nav_core.records import MountingStatus, Reason
from nav_core.typing import Floats

LEAST_FIXES = 3
"""Fewer satellite fixes hold no acceleration."""

LEAST_TICKS = 20
BRIEF = 5.0
"""Fewer ticks hold nothing to fit; over more seconds of fixes than this it is the accelerometer that is missing, s."""

MIN_MOVING = 15.0
"""Least time of driving before anything is said, s."""

MIN_EVENTFUL = 8.0
"""Least time with noticeable acceleration, along or across, s."""

NOTICEABLE = 0.35
"""m/s²."""

LIVELY = 0.7
"""Of the vigour of a drive in which slopes are no match for acceleration, m/s²."""

LAG_KNOWN = 0.25
"""A lag of the receiver with a larger sigma is not reported, s."""

USELESS = np.radians(15.0)
"""An axis with a larger sigma is not known at all, rad."""

CONTRADICTING = 40.0
APART = np.radians(0.8)
"""Stretches contradict each other by so many times their own variance and by so much, rad: a drive's pitch is
known so well that a hundredth of a degree of something else would do for the first alone."""

WANDER = np.radians(15.0)
"""Gravity that keeps leaving its mean direction by this is not that of a fixed box, rad."""


@dataclass(frozen=True, slots=True)
class Excitation:
    """What the drive offered.

    Attributes
    ----------
    moving : float
        Time faster than walking, s.
    followed : float
        Of that, with a course from the receiver, s.
    along, across : float
        Time with noticeable acceleration along and across, s.
    turned : float
        Sum of all turning, rad.
    vigour : float
        Root mean square of horizontal acceleration while moving, m/s².
    first_moving : float
        Box time of the first moving fix, s.
    """

    moving: float
    followed: float
    along: float
    across: float
    turned: float
    vigour: float
    first_moving: float


def excitation(record: Record) -> Excitation:
    """What the drive offered, from the receiver alone.

    Parameters
    ----------
    record : Record
        Ticks and fixes of a drive.

    Returns
    -------
    Excitation
        s, rad and m/s².
    """
    fixes = record.fixes
    if fixes.t.size < 2:
        return Excitation(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    span = np.minimum(np.diff(fixes.t, prepend=fixes.t[0]), 2.0)
    moving = fixes.speed > FOLLOW_SPEED
    a = fixes.acceleration
    w = fixes.turn_rate * moving
    return Excitation(
        moving=float(span[moving].sum()),
        followed=float(span[moving & np.isfinite(fixes.course)].sum()),
        along=float(span[np.abs(a) > NOTICEABLE].sum()),
        across=float(span[np.abs(w * fixes.speed) > NOTICEABLE].sum()),
        turned=float((span * np.abs(w)).sum()),
        vigour=float(np.sqrt(np.mean(a[moving] ** 2 + (w * fixes.speed)[moving] ** 2))) if moving.any() else 0.0,
        first_moving=float(fixes.t[np.argmax(moving)]) if moving.any() else float(fixes.t[0]),
    )


def gravity_wander(record: Record, span: float = 20.0) -> float:
    """How far the mean direction of specific force strays from stretch to stretch, rad.

    The 80th percentile of the angles between means over `span` seconds and their median.  Hills,
    bends and braking of a fixed box stay under some 6°.

    Parameters
    ----------
    record : Record
        Ticks, A-frame, m/s².
    span : float
        s.

    Returns
    -------
    float
        rad, 0 to pi.
    """
    block = np.floor((record.t - record.t[0]) / span).astype(np.int64)
    count = np.bincount(block)
    means = np.stack([np.bincount(block, record.f[:, i]) for i in range(3)], axis=1)
    means = means[count > 0.5 * count.max()]
    directions = means / np.linalg.norm(means, axis=1, keepdims=True)
    middle = np.median(directions, axis=0)
    middle /= np.linalg.norm(middle)
    angles = np.arccos(np.clip(directions @ middle, -1.0, 1.0))
    return float(np.percentile(angles, 80.0))


SWAY = np.radians([2.0, 6.0, 12.0])
"""The mounting of a fixed box does not scatter by this from stretch to stretch, rad about V x, y, z.  Roll tells
best; a real road's slope passes for 3° of pitch, and a stretch without turns and braking for any yaw."""

_SWAY_SPAN = 30.0
_SWAY_SURE = 3.0


def sway(fit: Fit) -> Floats:
    """How far the mounting itself scatters from stretch to stretch, beyond what each of them leaves open.

    Parameters
    ----------
    fit : Fit

    Returns
    -------
    ndarray, shape (3,)
        1 sigma about the V axes, rad: the method of moments of DerSimonian and Laird (1986) over
        stretches of half a minute, each moving one axis with all else held; 0 where the excess is
        not clear.
    """
    count = max(int(fit.gram.shape[0] * BLOCK / _SWAY_SPAN), 2)
    weight, deviation = by_stretch(fit, count)
    total = np.maximum(weight.sum(0), 1e-12)
    mean = (weight * deviation).sum(0) / total
    excess = (weight * (deviation - mean) ** 2).sum(0)
    degrees = np.maximum((weight > 0.0).sum(0) - 1, 1)
    spread = np.maximum(total - (weight**2).sum(0) / total, 1e-12)
    variance = np.maximum(excess - degrees, 0.0) / spread
    return np.sqrt(np.where(excess > _SWAY_SURE * degrees, variance, 0.0))


def loosely_held(changes: int, record: Record) -> bool:
    """Whether a box was moved so often that it is not fixed at all: thrice, and every few minutes.

    Parameters
    ----------
    changes : int
        How often it was moved.
    record : Record
        Says for how long it was watched.

    Returns
    -------
    bool
        False for up to two moves.
    """
    return changes >= 3 and changes * 300.0 > record.fixes.t[-1] - record.fixes.t[0]


@dataclass(frozen=True, slots=True)
class Verdict:
    """Status, progress and reasons."""

    status: MountingStatus
    progress: float
    reliable: bool
    reasons: tuple[Reason, ...]

    def held_back(self, code: str) -> Verdict:
        """The same, but not `ready` because of one more reason.

        Parameters
        ----------
        code : str
            Key of `REASONS`.

        Returns
        -------
        Verdict
            `settling`, the new reason first.
        """
        return Verdict("settling", min(self.progress, 0.99), self.reliable, (reason(code), *self.reasons))


def refusal(why: Reason) -> Verdict:
    """The verdict on data that cannot give a mounting.

    Parameters
    ----------
    why : Reason
        What is wrong with the data.

    Returns
    -------
    Verdict
        `insufficient`.
    """
    return Verdict("insufficient", 0.0, False, (why,))


def too_little(record: Record) -> Reason | None:
    """What a recording lacks before anything can be looked at; None to go on.

    Parameters
    ----------
    record : Record
        Ticks and fixes of a drive.

    Returns
    -------
    Reason or None
        No or few fixes, or no accelerometer.
    """
    t = record.fixes.t
    if t.size < LEAST_FIXES:
        return reason("few_fixes" if t.size else "no_fix")
    if record.t.size < LEAST_TICKS:
        return reason("no_accelerometer" if t[-1] - t[0] > BRIEF else "few_fixes")
    return None


def before_fit(record: Record, offered: Excitation) -> Verdict | None:
    """A verdict where there is nothing to fit; None to go on.

    Parameters
    ----------
    record : Record
        Ticks and fixes of a drive.
    offered : Excitation
        What `excitation` says of it.

    Returns
    -------
    Verdict or None
        `insufficient`, with the reason.
    """
    lacks = too_little(record)
    if lacks is not None:
        return refusal(lacks)
    share = min(offered.moving / MIN_MOVING, 1.0)
    if share < 1.0:
        return Verdict("insufficient", 0.1 * share, False, (reason("not_driven"),))
    return None


def fits_a_car(start: Start, offered: Excitation) -> bool:
    """Whether the force along the travel is what the receiver's speed asks for.

    The closed form takes slopes for acceleration and so comes out short where there is little of
    the latter; where there is much, what is missing is the car.

    Parameters
    ----------
    start : Start
        Of the closed form.
    offered : Excitation
        What the drive had.

    Returns
    -------
    bool
        True where its strength is near 1.
    """
    missing = 0.2 if offered.vigour > LIVELY else 0.5
    return abs(start.strength - 1.0) < max(missing, 3.0 * start.sigma)


def after_fit(start: Start, found: Confidence, offered: Excitation) -> Verdict:
    """The verdict on a fit.

    Parameters
    ----------
    start : Start
    found : Confidence
    offered : Excitation

    Returns
    -------
    Verdict
        `ready` when every sigma is under `CONVERGED`, the drive offered enough, the closed form saw
        a car and the stretches agree.
    """
    sigma = np.sqrt(np.diag(found.covariance))
    reliable = offered.along + offered.across >= MIN_EVENTFUL
    progress = progress_of(sigma, offered.along + offered.across)
    if sigma.max() > USELESS:
        return Verdict("insufficient", min(progress, 0.2), reliable, missing(sigma, offered.along, offered.turned))
    if not fits_a_car(start, offered):
        return Verdict("insufficient", min(progress, 0.2), False, (reason("mismatch"),))
    contradiction = bool(((found.scatter > CONTRADICTING) & (found.spread > APART)).any())
    if sigma.max() < CONVERGED and reliable and not contradiction:
        return Verdict("ready", 1.0, True, ())
    reasons = list(missing(sigma, offered.along, offered.turned))
    if contradiction:
        reasons.insert(0, reason("contradiction"))
    elif found.widening.max() > 2.0:
        reasons.append(reason("rough"))
    return Verdict("settling", min(progress, 0.99), reliable, tuple(reasons))


def progress_of(sigma: Floats, eventful: float) -> float:
    """Information grows with time: the share of it that is there, of the worst axis.

    Parameters
    ----------
    sigma : ndarray, shape (3,)
        About the V axes, rad.
    eventful : float
        Time with noticeable acceleration along or across, s.

    Returns
    -------
    float
        0..1.
    """
    share = float(np.min(np.minimum((CONVERGED / sigma) ** 2, 1.0)))
    return min(share, eventful / MIN_EVENTFUL, 1.0)


def missing(sigma: Floats, along: float, turned: float) -> tuple[Reason, ...]:
    """What would help: sigma about the V axes, rad; time with noticeable acceleration along, s; all turning, rad.

    Parameters
    ----------
    sigma : ndarray, shape (3,)
        rad.
    along : float
        s.
    turned : float
        rad.

    Returns
    -------
    tuple of Reason
        At least one.
    """
    codes: list[str] = []
    if sigma[1] > CONVERGED or along < MIN_EVENTFUL:
        codes.append("few_events")
    if max(sigma[0], sigma[2]) > CONVERGED and turned < np.pi:
        codes.append("no_turns")
    return tuple(reason(code) for code in codes or ["keep_driving"])
