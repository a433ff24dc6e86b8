"""The yaw plane: course and bank, driven by lateral specific force.

Signs and the idea are those of `nav_core.mounting.model`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.mounting.fixes import Fixes, clear_part
from nav_core.mounting.model import (
    ANTENNA_X,
    COURSE_LAG,
    FLOOR_SPEED,
    GRAVITY,
    LEVER_X,
    LONGEST_STEP,
    ROLL_GAIN,
    YAW_UNKNOWNS,
    Frame,
    Noise,
    columns_of,
    first_order,
    per_step,
)
from nav_core.mounting.stretch import Record, Steps, at, gained, rough_share, steps_of
from nav_core.mounting.whitening import Channel
from nav_core.typing import Flags, Floats

YAW_OBSERVED = np.array([(0, 2)])
"""The receiver's course is that of the vehicle and the slow error over the speed."""

_COLUMN = columns_of(YAW_UNKNOWNS)


class Across(NamedTuple):
    """What the ticks say of the yaw plane from fix to fix, whatever the noise levels."""

    steps: Steps
    w: Floats
    """Turn rate at the fixes, rad/s, shape (n,)."""
    inverse_now: Floats
    """One over the speed there, s/m, shape (n,)."""
    spin: Floats
    """Change of the turn rate in each step over the speed, rad/m, shape (n,)."""
    total: Floats
    """Specific force over speed and its companions integrated over each step, shape (n, 5)."""
    grain: Floats
    """Variance of sensor noise in the force over the speed, over each step, rad², shape (n,)."""


def across_of(record: Record, lag: float, frame: Frame) -> Across:
    """The part of `yaw_plane` that does not depend on the noise levels.

    Parameters
    ----------
    record : Record
    lag : float
        Present estimate of the lag of GPS course, s.
    frame : Frame
        The ticks at the lag of GPS speed, in the V axes of the present estimate.

    Returns
    -------
    Across
    """
    steps = steps_of(record, lag)
    inverse = frame.inverse_speed
    total = gained(record, steps, [*(frame.f.T * inverse), inverse, record.density * inverse**2])
    w = at(record, steps.when, frame.w)
    inverse_now = at(record, steps.when, inverse)
    spin = per_step(w, steps.broken) * inverse_now
    return Across(steps, w, inverse_now, spin, total, total[:, 4] * rough_share(steps.dt))


def yaw_plane(record: Record, across: Across, noise: Noise) -> Channel:
    """Course against lateral specific force; see `pitch_plane`.

    Parameters
    ----------
    record : Record
    across : Across
        What the ticks say at the present estimate.
    noise : Noise

    Returns
    -------
    Channel
        Measurement: GPS course.  States: course, bank, slow error of lateral velocity, drift of the bias.
    """
    steps, w, inverse_now, spin, total, rough = across
    elapsed = np.diff(steps.when, prepend=steps.when[:1])
    keep = 1.0 - noise.roll_gain[0]
    U = np.zeros((steps.when.size, 1, 1 + YAW_UNKNOWNS.size))
    U[:, 0, 0] = keep * total[:, 1] - noise.lever[0] * spin
    U[:, 0, _COLUMN[0]], U[:, 0, _COLUMN[2]] = -keep * total[:, 2], keep * total[:, 0]
    U[:, 0, _COLUMN[4]] = -total[:, 3]
    course_noise = noise.across_white / np.maximum(record.fixes.speed, FLOOR_SPEED)
    turn_rate = clear_part(record.fixes.turn_rate, course_noise)
    U[:, 0, _COLUMN[ROLL_GAIN]] = -turn_rate * steps.dt
    U[:, 0, _COLUMN[LEVER_X]] = -spin
    lost = steps.broken | (elapsed > LONGEST_STEP)
    P0, carry, Q, share, r = yaw_system(record.fixes, steps, noise, total[:, 1], total[:, 3], total[:, 4], lost)
    Y = np.zeros((steps.when.size, 1, 1 + YAW_UNKNOWNS.size))
    # Ahead of the point that does not slip, the track points into the turn.
    Y[:, 0, 0] = np.nan_to_num(record.fixes.course) - noise.lever[0] * w * inverse_now
    Y[:, 0, _COLUMN[COURSE_LAG]] = w
    Y[:, 0, _COLUMN[LEVER_X]] = Y[:, 0, _COLUMN[ANTENNA_X]] = -w * inverse_now
    return Channel(
        np.zeros(4),
        P0,
        carry,
        Q,
        np.array([0]),
        U,
        rough[:, None],
        YAW_OBSERVED,
        share,
        Y,
        r,
        np.array([2.0 * np.pi]),
        YAW_UNKNOWNS,
    )


def yaw_system(
    fixes: Fixes, steps: Steps, noise: Noise, change: Floats, inverse: Floats, grain: Floats, lost: Flags
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Start, transition, noise and measurement rows of the yaw plane.

    `change` is the turn that the lateral force makes in each step, `inverse` one over the speed,
    integrated, `grain` the noise of that turn in rad²; where the course is `lost`, or too slow to
    follow, the thread begins anew.

    Parameters
    ----------
    fixes : Fixes
        n of them.
    steps : Steps
        From fix to fix.
    noise : Noise
        What to expect.
    change : ndarray, shape (n,)
        rad.
    inverse : ndarray, shape (n,)
        s²/m.
    grain : ndarray, shape (n,)
        rad².
    lost : ndarray of bool, shape (n,)
        Where the thread begins anew.

    Returns
    -------
    P0 : ndarray, shape (4, 4)
        Covariance of course, bank, slow error of the course (m/s) and lateral bias drift (m/s²).
    carry : ndarray, shape (4, n)
        Coefficients of the transition over each step; see `planes`.
    Q : ndarray, shape (4, n)
        Variances of its noise.
    share : ndarray, shape (1, n)
        Of the slow error in the course; see `YAW_OBSERVED`.
    r : ndarray, shape (n, 1)
        Variance, rad²; NaN where not measured.
    """
    z = np.maximum(steps.distance / noise.bank_length, 1e-6)
    along = np.exp(-z)
    elapsed = np.diff(steps.when, prepend=steps.when[:1])
    decay, fresh = first_order(elapsed, noise.slow_time)
    # Of bank and bias into course, of bank into bank, and what is left of the slow error.
    carry = np.stack([-GRAVITY * inverse * (1.0 - along) / z, -inverse, along, decay])
    slack = np.where(steps.dt > 0.0, inverse**2 / np.maximum(steps.dt, 1e-3), 0.0)
    anew = np.where(lost | np.isnan(fixes.course), 100.0, 0.0)
    Q = np.stack(
        [
            noise.force**2 * slack + grain + (noise.relative_turn * change) ** 2 + anew,
            (1.0 - along**2) * noise.bank**2,
            fresh * noise.across_slow**2,
            noise.drift**2 * elapsed,
        ]
    )
    now = 1.0 / np.maximum(fixes.speed, FLOOR_SPEED)
    r = np.where(np.isfinite(fixes.course), (noise.across_white * now) ** 2 + 1e-6, np.nan)[:, None]
    return np.diag([100.0, noise.bank**2, noise.across_slow**2, 0.0]), carry, Q, now[None, :], r
