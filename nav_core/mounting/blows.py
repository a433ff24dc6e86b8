"""Crashes, cut out before the mounting is estimated.

The model knows cars that drive.  In a crash the vehicle turns, slides and rolls, the accelerometer
clips, and the receiver follows late; afterwards the vehicle stands as it came to rest, which says
nothing of how the box sits.  All that would pass for a moved or loose box.  What is left out is a
gap like any other; a box that the crash turned is found from the driving after it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from nav_core.mounting.fixes import FOLLOW_SPEED, Fixes
from nav_core.mounting.model import GRAVITY
from nav_core.mounting.stretch import Record, Span
from nav_core.signal import Ticks, first_not_before
from nav_core.typing import Flags, Floats

VIOLENT = 0.8 * GRAVITY
"""Root mean square of force about its surroundings, within one tick, that ordinary driving does not reach, m/s²."""

LASTING = 0.5 * GRAVITY
"""Mean force of a tick off its surroundings that a blow must have as well, m/s².  A pothole shakes
harder than this but gives back what it takes."""

UNUSUAL = 3.0
"""A blow exceeds what nine tenths of the recording stay under by this factor; a rough ride does not."""

SURROUNDINGS = 5.0
ASIDE = 0.4
"""A tick is compared with the means from `ASIDE` to `SURROUNDINGS` seconds before and after it, s.  The nearer one
counts: a box that is turned finds itself in new surroundings, not off them."""

BEFORE = 1.0
AFTER = 10.0
"""Cut out around a blow at the least, s."""

LONGEST_LAG = 3.0
"""Kept before the first fix that shows driving again, s: it may be that late."""

DRIVEN_AGAIN = 15.0
"""What follows a blow counts with this much driving, s."""

MOST = 0.5
"""Blows that would take more of the driving than this are none, but a way of life."""


class Blow(NamedTuple):
    """A blow and what is cut out because of it, box time, s."""

    t: float
    begin: float
    end: float
    """Infinite when the vehicle was not driven any more."""


def blows(ticks: Ticks, fixes: Fixes) -> tuple[Blow, ...]:
    """Blows to the vehicle, in order of time, with the stretches that they spoil.

    Parameters
    ----------
    ticks : Ticks
    fixes : Fixes

    Returns
    -------
    tuple of Blow
        Disjoint.  Blows before the end of an earlier one's stretch are part of it.
    """
    found: list[Blow] = []
    for t in ticks.t[_violent(ticks)].tolist():
        end = _driving_again(fixes, t + AFTER)
        if found and t - BEFORE <= found[-1].end:
            found[-1] = found[-1]._replace(end=max(end, found[-1].end))
        else:
            found.append(Blow(t, t - BEFORE, end))
    moving = fixes.speed > FOLLOW_SPEED
    lost = _inside(fixes.t, found) & moving
    return () if lost.sum() >= MOST * moving.sum() else tuple(found)


def cut_out(record: Record, found: Sequence[Blow | Span]) -> Record:
    """The record without what is spoiled; what follows a cut begins anew.

    Parameters
    ----------
    record : Record
    found : sequence of Blow or Span

    Returns
    -------
    Record
    """
    if not found:
        return record
    keep = ~_inside(record.t, found)
    step = record.step.copy()
    step[1:][~keep[:-1]] = 0.0
    kept = ~_inside(record.fixes.t, found)
    fixes = Fixes(*(column[kept] for column in record.fixes))
    return Record(record.t[keep], record.f[keep], step[keep], fixes, record.density[keep])


def _violent(ticks: Ticks) -> Flags:
    """Ticks in which the vehicle got a blow, shape (n,)."""
    out = np.zeros(ticks.index.size, dtype=np.bool_)
    valid = ticks.valid
    if not valid.any():
        return out
    t, f = ticks.t[valid], ticks.f[valid]
    off = np.fmin(_off(t, f, -SURROUNDINGS, -ASIDE), _off(t, f, ASIDE, SURROUNDINGS))
    off[np.isnan(off)] = 0.0
    force = np.hypot(off, ticks.scatter[valid])
    usual = float(np.percentile(force, 90.0))
    out[valid] = (force > max(VIOLENT, UNUSUAL * usual)) & (off > LASTING)
    return out


def _off(t: Floats, f: Floats, begin: float, end: float) -> Floats:
    """How far each force is off the mean from `begin` to `end` relative to it, shape (n,); NaN without any."""
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(f, axis=0)])
    first, last = first_not_before(t, t + begin), first_not_before(t, np.nextafter(t + end, np.inf))
    count = np.where(last > first, last - first, np.nan)
    off = f - (total[last] - total[first]) / count[:, None]
    size: Floats = np.sqrt(np.einsum("ij,ij->i", off, off))  # a fifth of the time of `norm` along so short an axis
    return size


def _driving_again(fixes: Fixes, since: float) -> float:
    """Box time from which a vehicle is driven again, s; infinite when it is not."""
    span = np.minimum(np.diff(fixes.t, prepend=fixes.t[:1]), 2.0)
    moving = (fixes.speed > FOLLOW_SPEED) & (fixes.t >= since)
    if span[moving].sum() < DRIVEN_AGAIN:
        return float(np.inf)
    return max(since, float(fixes.t[np.argmax(moving)]) - LONGEST_LAG)


def _inside(t: Floats, found: Sequence[Blow | Span]) -> Flags:
    out = np.zeros(t.size, dtype=np.bool_)
    for span in found:
        out |= (t >= span.begin) & (t < span.end)
    return out
