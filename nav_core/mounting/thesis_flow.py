"""The program around the thesis' filter: STABLE, RELIABLE, the test routine and the flow chart (001 §5.3-5.4, §6.2).

None of this feeds back into the filter: a "soft" initialisation only lowers the two flags.  So it reads
the filter's whole history at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from nav_core.mounting.thesis_model import Steps
from nav_core.typing import Flags, Floats

WINDOW = 100
"""Samples of the moving average (001 §5.3)."""

STABLE_STEP = np.radians(0.02)
"""Largest turn of the moving average from one sample to the next while STABLE, rad.

The average moves by a hundredth of what separates the estimate from that of a hundred samples before.  2° of that
are allowed: less than the thesis' own error (table 5.3), more than road and noise still move a settled estimate."""

RELIABLE_RATE = np.radians(10.0)
"""Turn rate that makes RELIABLE, rad/s: every junction and roundabout reaches it, lane changes and fast roads do not.
Taken over a second, the course noise of 0.08 m/s / v stays five sigma below it down to `RELIABLE_SPEED`."""

RELIABLE_SPEED = 3.0
"""Least speed throughout that second, m/s."""

TEST_DURATION = 40.0
"""s (001 §5.4)."""

TEST_LIMIT = 2.5
"""m/s (001 §5.4)."""

LONGEST_HOLE = 5.0
"""s; a test routine with a longer gap between fixes has integrated nothing meaningful and is dropped."""


class Trial(NamedTuple):
    """One run of the test routine."""

    saved: int
    """Row at which STABLE and RELIABLE met and the mounting was saved."""
    ended: int
    """Row of the verdict; the last row if the drive ended first."""
    duration: float
    """s."""
    drift: float
    """|v_x,test - v_GPS| at the end, m/s."""
    complete: bool
    """Whether it lasted its 40 s without a hole."""

    @property
    def passed(self) -> bool:
        """The verdict of 001 §5.4."""
        return self.complete and self.drift < TEST_LIMIT


class FlowChart(NamedTuple):
    """What the program saw and did, one row per filter step.

    Attributes
    ----------
    mean : ndarray, shape (n, 4)
        Moving average of q_A; NaN for the first 99 rows.
    stable, reliable : ndarray of bool, shape (n,)
        The flags; `reliable` is lowered whenever a mounting is saved.
    trials : tuple of Trial
    finished : int or None
        Row at which a test passed and the program ended; later rows are what it would have seen.
    """

    mean: Floats
    stable: Flags
    reliable: Flags
    trials: tuple[Trial, ...]
    finished: int | None


def moving_average(q: Floats, window: int = WINDOW) -> Floats:
    """Average of the last `window` quaternions, q and -q being one rotation (001 eq. 5.4 made causal).

    Parameters
    ----------
    q : ndarray, shape (n, 4)
        Unit quaternions that change little from row to row.
    window : int

    Returns
    -------
    ndarray, shape (n, 4)
        Renormalised; NaN for the first ``window - 1`` rows.
    """
    mean = np.full_like(q, np.nan)
    if q.shape[0] < window:
        return mean
    flips = np.where(np.einsum("ij,ij->i", q[1:], q[:-1]) < 0.0, -1.0, 1.0)
    aligned = q * np.cumprod(np.append(1.0, flips))[:, None]
    total = np.cumsum(aligned, axis=0)
    total[window:] -= total[:-window].copy()
    sums = total[window - 1 :]
    mean[window - 1 :] = sums / np.linalg.norm(sums, axis=1, keepdims=True)
    return mean


def settled(mean: Floats, limit: float = STABLE_STEP) -> Flags:
    """STABLE of 001 §5.3: the moving average turns by less than `limit` from row to row, shape (n,).

    Parameters
    ----------
    mean : ndarray, shape (n, 4)
        Quaternions (x, y, z, w), signs aligned.
    limit : float
        rad per row.

    Returns
    -------
    ndarray of bool, shape (n,)
        False at the first row.
    """
    # Between neighbours the chord is exact enough and, unlike the arc cosine, has no rounding noise at 1.
    chord = np.linalg.norm(np.diff(mean, axis=0), axis=1)
    return np.append(False, 2.0 * chord < limit)


def curves(steps: Steps) -> Flags:
    """Rows at which the vehicle has just turned fast enough for RELIABLE (001 §5.3), shape (n,).

    The course is summed from wrapped differences, so passing north is no peak; the rate is that of the last second.

    Parameters
    ----------
    steps : Steps
        n rows.

    Returns
    -------
    ndarray of bool, shape (n,)
        In order.
    """
    heading = np.cumsum(np.where(steps.turning, steps.turn_rate * steps.period, 0.0))
    slow = np.cumsum((steps.speed < RELIABLE_SPEED) | ~steps.turning)
    now = np.arange(steps.t.size)
    before = np.clip(np.searchsorted(steps.t, steps.t - 1.0, side="left"), 0, np.maximum(now - 1, 0))
    span = steps.t - steps.t[before]
    quick = (slow == slow[before]) & (steps.speed[before] >= RELIABLE_SPEED) & (span > 0.0) & (span <= LONGEST_HOLE)
    return quick & (np.abs(heading - heading[before]) > RELIABLE_RATE * span)


def run_test(steps: Steps, mean: Floats, saved: int) -> Trial:
    """Integrate the longitudinal specific force of a saved mounting against GPS speed (001 eqs. 5.5, 5.6).

    Parameters
    ----------
    steps : Steps
        Rows of the drive.
    mean : ndarray, shape (n, 4)
        Quaternions of `R_va`, (x, y, z, w).
    saved : int
        Row at which it was saved.

    Returns
    -------
    Trial
        Drift, m/s, and duration, s.
    """
    ended = int(np.searchsorted(steps.t, steps.t[saved] + TEST_DURATION, side="left"))
    lasted = ended < steps.t.size
    ended = min(ended, steps.t.size - 1)
    rows = slice(saved + 1, ended + 1)
    forward = Rotation.from_quat(mean[saved]).as_matrix()[0]
    v_test = float(steps.speed[saved]) + float(np.sum(steps.f[rows] @ forward * steps.period[rows]))
    whole = bool(np.all(steps.period[rows] <= LONGEST_HOLE))
    return Trial(
        saved=saved,
        ended=ended,
        duration=float(steps.t[ended] - steps.t[saved]),
        drift=abs(v_test - float(steps.speed[ended])),
        complete=lasted and whole,
    )


def follow_flow_chart(steps: Steps, q_A: Floats) -> FlowChart:
    """Walk through the flow chart of 001 fig. 6.2.

    When STABLE and RELIABLE meet, the moving average is saved, both flags are lowered and the test routine starts;
    the filter goes on meanwhile.  A passed test ends the program.  A failed one drops the saved mounting, and the
    next meeting of the flags saves another.

    Parameters
    ----------
    steps : Steps
        Rows of the drive.
    q_A : ndarray, shape (n, 4)
        The filter's reference quaternion after each row.

    Returns
    -------
    FlowChart
    """
    mean = moving_average(q_A)
    stable, turned = settled(mean), curves(steps)
    n = steps.t.size
    reliable = np.zeros(n, dtype=np.bool_)
    trials: list[Trial] = []
    since, free = 0, 0
    while True:
        raised = np.flatnonzero(turned[since:])
        reliable[since:] = False
        if raised.size:
            reliable[since + raised[0] :] = True
        met = np.flatnonzero(stable[free:] & reliable[free:])
        if not met.size:
            return FlowChart(mean, stable, reliable, tuple(trials), None)
        saved = free + int(met[0])
        trials.append(run_test(steps, mean, saved))
        if trials[-1].passed:
            return FlowChart(mean, stable, reliable, tuple(trials), trials[-1].ended)
        since, free = saved + 1, trials[-1].ended + 1
