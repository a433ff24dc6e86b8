"""Where to start: gravity gives the tilt, one linear least squares the heading, lags by a scan.

With the vertical known, the forward axis is ``c e1 + s e2`` in any level basis, and both planes of
`nav_core.mounting.model` are linear in (c, s): speed changes by the force along it, course by the
force across it.  Nothing is ambiguous: the sign of speed tells front from rear, and on a straight
road "no force across the axis but turning" finds the axis that braking and slopes excite.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.mounting.echo import echo
from nav_core.mounting.model import LONGEST_STEP, Noise, turned
from nav_core.mounting.pitch_plane import HEIGHT, PITCH_OBSERVED, V, pitch_system
from nav_core.mounting.stretch import Record, Steps, gained, rough_share, steps_of
from nav_core.mounting.whitening import Channel, whiten
from nav_core.mounting.yaw_plane import YAW_OBSERVED, yaw_system
from nav_core.typing import Floats

LAG_GRID = np.arange(0.0, 2.01, 0.25)
"""Lags that are tried, s."""

INTERCEPT = 0.5
"""Deviation of what bias and tilt leave in each level axis, m/s²."""


class Start(NamedTuple):
    """A mounting to refine, and how much of a car was in it."""

    R_va: Floats
    speed_lag: float
    course_lag: float
    strength: float
    """Length of (c, s): 1 for a box fixed in a car."""
    sigma: float
    """Of the heading, as far as this model goes, rad."""
    handed: float = 0.0
    """Twice the log of how much likelier right-handed axes are than left-handed ones."""


def level_basis(f: Floats) -> Floats:
    """Rotation from the A-frame to a level frame of arbitrary heading, z down.

    Parameters
    ----------
    f : ndarray, shape (n, 3)
        Specific force, m/s².

    Returns
    -------
    ndarray, shape (3, 3)
    """
    down = -np.median(f, axis=0)
    down /= np.linalg.norm(down)
    helper = np.eye(3)[np.argmin(np.abs(down))]
    e1 = helper - down * (helper @ down)
    e1 /= np.linalg.norm(e1)
    return np.asarray(np.stack([e1, np.cross(down, e1), down]), dtype=np.float64)


def _planes(record: Record, level: Floats, lag: float, noise: Noise) -> tuple[Channel, Channel]:
    """Both planes with the unknowns (c, s, intercept along, intercept across)."""
    steps = steps_of(record, lag)
    frame = turned(record, level, lag)
    inverse, density = frame.inverse_speed, record.density
    level_force = frame.f.T[:2]
    columns = [*level_force, *(level_force * inverse), inverse, density, density * inverse**2]
    total = gained(record, steps, columns)
    return _along(record, steps, total, noise), _across(record, steps, total, noise)


def _along(record: Record, steps: Steps, total: Floats, noise: Noise) -> Channel:
    fixes, count = record.fixes, steps.when.size
    U = np.zeros((count, 1, 5))
    U[:, 0, 1:3], U[:, 0, 3] = total[:, :2], steps.dt
    size = np.hypot(total[:, 0], total[:, 1])
    P0, carry, Q, share, r = pitch_system(record, steps, noise, size, np.zeros(count), total[:, 5])
    r[:, 2] = np.nan  # the vertical force waits for the refinement
    Y = np.zeros((count, 3, 5))
    Y[:, 0, 0], Y[:, 1, 0] = fixes.speed, np.nan_to_num(fixes.alt)
    x0 = np.zeros(P0.shape[0])
    x0[V], x0[HEIGHT] = Y[0, 0, 0], Y[0, 1, 0]
    grain = _rough(total[:, 5], steps)
    driven, unknowns = np.array([V]), np.arange(4)
    return Channel(x0, P0, carry, Q, driven, U, grain, PITCH_OBSERVED, share, Y, r, np.zeros(3), unknowns)


def _across(record: Record, steps: Steps, total: Floats, noise: Noise) -> Channel:
    fixes, count = record.fixes, steps.when.size
    U = np.zeros((count, 1, 5))
    U[:, 0, 1], U[:, 0, 2], U[:, 0, 4] = total[:, 3], -total[:, 2], total[:, 4]
    elapsed = np.diff(steps.when, prepend=steps.when[:1])
    size = np.hypot(total[:, 2], total[:, 3])
    lost = steps.broken | (elapsed > LONGEST_STEP)
    P0, carry, Q, share, r = yaw_system(fixes, steps, noise, size, total[:, 4], total[:, 6], lost)
    Y = np.zeros((count, 1, 5))
    Y[:, 0, 0] = np.nan_to_num(fixes.course)
    x0 = np.zeros(P0.shape[0])
    grain = _rough(total[:, 6], steps)
    driven, turn, unknowns = np.array([0]), np.array([2.0 * np.pi]), np.arange(4)
    return Channel(x0, P0, carry, Q, driven, U, grain, YAW_OBSERVED, share, Y, r, turn, unknowns)


def _rough(grain: Floats, steps: Steps) -> Floats:
    return (grain * rough_share(steps.dt))[:, None]


def _quieted(gram: Floats, noisy: float) -> Floats:
    """Evidence less what the noise of specific force adds to the squares of (c, s), but never less than a tenth."""
    values, vectors = np.linalg.eigh(gram[1:3, 1:3])
    gram[1:3, 1:3] = (vectors * np.maximum(values - noisy, 0.1 * values)) @ vectors.T
    return gram


def start(record: Record, noise: Noise) -> Start:
    """Closed-form mounting and coarse lags.

    Parameters
    ----------
    record : Record
        With at least two fixes and some ticks.
    noise : Noise

    Returns
    -------
    Start
    """
    level = level_basis(record.f)
    block = np.zeros(record.fixes.t.size, dtype=np.int64)
    zero = np.zeros(4)
    grams: list[tuple[Floats, Floats]] = []
    noisy = np.zeros(2)
    for lag in LAG_GRID:
        pitch, yaw = _planes(record, level, float(lag), noise)
        if not grams:
            noisy = np.concatenate([echo(pitch), echo(yaw)])
        grams.append(
            (
                _quieted(whiten(pitch, block, 1, zero, limit=np.inf).gram.sum((0, 1)), noisy[0]),
                _quieted(whiten(yaw, block, 1, zero, limit=np.inf).gram.sum((0, 1)), noisy[1]),
            )
        )
    information = np.diag([1e-2, 1e-2, INTERCEPT**-2, INTERCEPT**-2])
    along, across = (np.stack(each) for each in zip(*grams, strict=True))
    along, across = along[:, None], across[None, :]
    # A shade in favour of short lags: on a straight road every lag of the course is as good.
    shade = LAG_GRID[:, None] + LAG_GRID[None, :]
    trials, costs = _best(along + across, information)
    costs += shade
    i, j = (int(k) for k in np.unravel_index(np.argmin(costs), costs.shape))
    # Left-handed axes change the sign of what the force does across the travel, and of nothing else.
    _, mirrored = _best(along + np.outer(_ACROSS, _ACROSS) * across, information)
    p, cost = trials[i, j], float(costs[i, j])
    posterior = along[i, 0, 1:, 1:] + across[0, j, 1:, 1:] + information
    strength = float(np.hypot(p[0], p[1]))
    heading = np.arctan2(p[1], p[0])
    c, s = np.cos(heading), np.sin(heading)
    aside = np.array([-s, c, 0.0, 0.0])
    sigma = float(np.sqrt(aside @ np.linalg.solve(posterior, aside)) / max(strength, 1e-9))
    R_va = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ level
    return Start(R_va, float(LAG_GRID[i]), float(LAG_GRID[j]), strength, sigma, float((mirrored + shade).min()) - cost)


_ACROSS = np.array([1.0, -1.0, -1.0, 1.0, 1.0])


def _best(gram: Floats, information: Floats) -> tuple[Floats, Floats]:
    """Unknowns that explain the products best, and what they leave: shapes (..., 4) and (...)."""
    pull = gram[..., 1:, 0]
    p = -np.asarray(np.linalg.solve(gram[..., 1:, 1:] + information, pull[..., None]), dtype=np.float64)[..., 0]
    return p, gram[..., 0, 0] + (pull * p).sum(-1)
