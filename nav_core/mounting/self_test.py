"""The thesis' self-test: forty seconds of specific force, integrated, against GPS speed (001 §5.4).

Slope-compensated.  It is nearly blind to yaw; it is kept as a check that needs no model to read.
"""

from __future__ import annotations

import numpy as np

from nav_core.mounting.pitch_plane import pitch_plane
from nav_core.mounting.refine import Fit
from nav_core.mounting.stretch import Record
from nav_core.mounting.whitening import whiten
from nav_core.records import SelfTest
from nav_core.typing import Integers

DURATION = 40.0
LIMIT = 2.5
"""s and m/s, 001 §5.4."""

_MIN_SPEED = 3.0


RECENT = 600.0
"""How far back the test may reach, s."""


def _stretch(record: Record) -> tuple[int, int] | None:
    """First and last fix of the `DURATION` seconds of unbroken recent driving that lead farthest.

    The same error of height means the less slope the longer the way.
    """
    t, speed = record.fixes.t, record.fixes.speed
    gaps = np.concatenate([[0], np.cumsum(np.diff(t) > 3.0)])
    slow = np.concatenate([[0], np.cumsum(speed < _MIN_SPEED)])
    begin: Integers = np.searchsorted(t, t - DURATION, side="right") - 1
    begin = np.maximum(begin, 0)
    end = np.arange(t.size)
    usable = (t - t[begin] >= DURATION) & (gaps[end] == gaps[begin]) & (slow[end + 1] == slow[begin])
    usable &= t > t[-1] - RECENT
    if not usable.any():
        return None
    way = np.cumsum(speed * np.diff(t, prepend=t[0]))
    last = int(np.argmax(np.where(usable, way - way[begin], -1.0)))
    return int(begin[last]), last


def self_test(record: Record, fit: Fit) -> SelfTest | None:
    """Integrate longitudinal specific force over the last 40 s of driving and compare with GPS speed.

    Parameters
    ----------
    record : Record
    fit : Fit
        The mounting under test, with its biases and noise levels.

    Returns
    -------
    SelfTest or None
        None when there were no 40 s of driving in one go, or the slope is not known well enough to
        tell `LIMIT`.

    Notes
    -----
    Slope-compensated: the filter of the pitch plane runs on with height and climb while speed is
    withheld.  Without that, half a degree of road fails a perfect mounting.  An offset of the last
    speed is carried as an unknown; its column gives the innovation with its sign.  The limit is
    widened by what the slope leaves open.
    """
    stretch = _stretch(record)
    if stretch is None:
        return None
    first, last = stretch
    plane = pitch_plane(record, fit.view.along, fit.noise)
    p = fit.p[plane.unknowns]
    U = np.zeros((last + 1, plane.U.shape[1], 2))
    Y = np.zeros((last + 1, plane.Y.shape[1], 2))
    U[:, :, 0] = plane.U[: last + 1, :, 0] + plane.U[: last + 1, :, 1:] @ p
    Y[:, :, 0] = plane.Y[: last + 1, :, 0] + plane.Y[: last + 1, :, 1:] @ p
    Y[last, 0, 1] = 1.0
    r = plane.r[: last + 1].copy()
    r[first + 1 : last, 0] = np.nan
    block = np.zeros(last + 1, dtype=np.int64)
    block[last] = 1
    part = slice(last + 1)
    withheld = plane._replace(
        carry=plane.carry[:, part], Q=plane.Q[:, part], U=U, share=plane.share[:, part], Y=Y, r=r, unknowns=np.arange(1)
    )
    gram = whiten(withheld, block, 2, np.zeros(1)).gram[1, 0]
    drift, sigma = -float(gram[0, 1] / gram[1, 1]), float(1.0 / np.sqrt(gram[1, 1]))
    if sigma > LIMIT:
        return None
    duration = float(record.fixes.t[last] - record.fixes.t[first])
    return SelfTest(passed=bool(abs(drift) <= np.hypot(LIMIT, 2.0 * sigma)), drift=drift, duration=duration)
