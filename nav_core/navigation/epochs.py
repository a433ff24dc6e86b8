"""From samples and fixes to the epochs at which the filter predicts, updates and is smoothed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.navigation.fixes import Reports
from nav_core.sensors.statics import moving_spread
from nav_core.typing import Floats, Integers

EPOCH_RATE = 10.0
"""Epochs a second between the fixes, Hz."""

REST_WINDOW = 1.0
"""s."""
REST_FORCE, REST_TURN = 0.25, np.radians(0.6)
"""Spreads of specific force, m/s², and rate, rad/s, of a running vehicle at rest, above the sensors' own noise."""
REST_SPEED = 0.5
"""GPS speed within a window of it that forbids rest, m/s."""

LONGEST_STEP = 0.3
"""Over longer steps between samples the motion is unknown, s."""
UNKNOWN_FORCE, UNKNOWN_TURN = 4.0, 0.5
"""Density of what may have happened there, m/s²/√Hz and rad/s/√Hz."""


class Epochs(NamedTuple):
    """Epochs of a record, as `kernels.run` takes them.

    Attributes
    ----------
    sample : ndarray of int64, shape (m,)
    z, late, noise : ndarray, shape (m, 5), (m, 2), (m, 5, 2)
    still : ndarray, shape (m,)
    density : ndarray, shape (m, 2)
    """

    sample: Integers
    z: Floats
    late: Floats
    noise: Floats
    still: Floats
    density: Floats


def epochs_of(t: Floats, f: Floats, w: Floats, reports: Reports, *, force_noise: float, rate_noise: float) -> Epochs:
    """Lay out the epochs.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Samples, s; two or more.
    f, w : ndarray, shape (n, 3)
        m/s², rad/s.
    reports : Reports
    force_noise, rate_noise : float
        White noise, m/s²/√Hz and rad/s/√Hz.

    Returns
    -------
    Epochs
        At least every 1 / `EPOCH_RATE` s where there are samples, and at the sample nearest to each fix and course.
    """
    cell = np.floor((t - t[0]) * EPOCH_RATE).astype(np.int64)
    index = np.flatnonzero(np.diff(cell, prepend=-1) > 0)
    at, course_at = _nearest(t, reports.t), _nearest(t, reports.course_t)
    here = (reports.t >= t[0]) & (reports.t <= t[-1])
    course_here = (reports.course_t >= t[0]) & (reports.course_t <= t[-1])
    index = np.unique(np.concatenate((index, at[here], course_at[course_here], [t.size - 1])))
    z, late, noise = np.full((index.size, 5), np.nan), np.zeros((index.size, 2)), np.ones((index.size, 5, 2))
    row = np.searchsorted(index, at[here])
    z[row, :4], noise[row, :4] = reports.z[here, :4], reports.noise[here, :4]
    late[row, 0] = reports.t[here] - t[at[here]]
    row = np.searchsorted(index, course_at[course_here])
    z[row, 4], noise[row, 4] = reports.z[course_here, 4], reports.noise[course_here, 4]
    late[row, 1] = reports.course_t[course_here] - t[course_at[course_here]]
    density = np.tile([force_noise**2, rate_noise**2], (index.size, 1))
    broken = np.concatenate(([0.0], np.maximum.reduceat(np.diff(t), index[:-1]))) > LONGEST_STEP
    density[broken] = UNKNOWN_FORCE**2, UNKNOWN_TURN**2
    return Epochs(index, z, late, noise, at_rest(t, f, w, reports)[index], density)


def at_rest(t: Floats, f: Floats, w: Floats, reports: Reports) -> Floats:
    """1 for each sample at which the vehicle stands, 0 for the others, shape (n,).

    Calm sensors are needed, and no fix that says otherwise: on a smooth road they can be calm at any speed, which
    without fixes only the innovation gate of the filter notices.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Box clock, s.
    f : ndarray, shape (n, 3)
        Specific force, m/s², any axes.
    w : ndarray, shape (n, 3)
        Angular rate, rad/s, any axes.
    reports : Reports
        What the receiver said.

    Returns
    -------
    ndarray, shape (n,)
        0 or 1.
    """
    width = int(np.clip(round(REST_WINDOW / float(np.median(np.diff(t)))), 2, t.size))
    # A gyro's own noise is no motion: what the calmest tenth of its samples shows is taken off.
    own_force, own_turn = (float(np.quantile(_roughness(values), 0.1)) for values in (f, w))
    calm = moving_spread(f, width) < np.hypot(REST_FORCE, own_force)
    calm &= moving_spread(w, width) < np.hypot(REST_TURN, own_turn)
    moving = reports.t[reports.z[:, 3] > REST_SPEED]
    if moving.size:
        calm &= np.abs(t - moving[_nearest(moving, t)]) > REST_WINDOW
    # The window of the first samples of a motion looks back into rest.
    return (np.convolve(calm, np.ones(width), "same") >= width).astype(np.float64)


def _roughness(values: Floats) -> Floats:
    """Scatter from sample to sample of three axes together, shape (n - 1,): white noise shows, motion hardly."""
    return np.linalg.norm(np.diff(values, axis=0), axis=1) / np.sqrt(2.0)


def _nearest(t: Floats, moments: Floats) -> Integers:
    """Index of the sample nearest to each moment."""
    after = np.clip(np.searchsorted(t, moments), 1, t.size - 1) if t.size > 1 else np.zeros(moments.size, np.int64)
    before = np.maximum(after - 1, 0)
    return np.where(moments - t[before] < t[after] - moments, before, after).astype(np.int64)
