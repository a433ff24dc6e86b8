"""The pitch plane: speed, climb, slope and height, driven by longitudinal and vertical specific force.

Signs and the idea are those of `nav_core.mounting.model`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.mounting.fixes import COARSE, clear_part
from nav_core.mounting.model import (
    ANTENNA_Y,
    GRAVITY,
    LEVER_X,
    LONGEST_STEP,
    PITCH_GAIN,
    PITCH_UNKNOWNS,
    ROLL_GAIN,
    SPEED_LAG,
    UNLIKE_GAIN,
    Frame,
    Noise,
    columns_of,
    first_order,
)
from nav_core.mounting.stretch import Record, Steps, at, gained, rough_share, smoothed, steps_of
from nav_core.mounting.whitening import Channel
from nav_core.typing import Floats

# States of the pitch plane.
V, CLIMB, SLOPE, CURVE, HEIGHT, SPEED_ERROR, HEIGHT_ERROR, TILT, DRIFT_X, DRIFT_Z = range(10)
PITCH_OBSERVED = np.array([(V, SPEED_ERROR), (HEIGHT, HEIGHT_ERROR), (CLIMB, SLOPE)])
_COLUMN = columns_of(PITCH_UNKNOWNS)


def pitch_system(
    record: Record, steps: Steps, noise: Noise, change: Floats, swing: Floats, grain: Floats
) -> tuple[Floats, ...]:
    """Start, transition, noise and measurement rows of the pitch plane.

    `change` and `swing` are the longitudinal and lateral specific force integrated over each step,
    `grain` the density of its noise.
    The body stands on the slope and on the bank: of the acceleration along the road none shows on
    its vertical axis, of the lateral one the share of the bank does.

    Parameters
    ----------
    record : Record
        Ticks and fixes, n of them.
    steps : Steps
        From fix to fix.
    noise : Noise
        What to expect.
    change, swing : ndarray, shape (n,)
        V axes, m/s.
    grain : ndarray, shape (n,)
        (m/s²)²/Hz.

    Returns
    -------
    P0 : ndarray, shape (10, 10)
        Covariance of the states at the first fix: V, CLIMB, SLOPE, ... as numbered above.
    carry : ndarray, shape (14, n)
        Coefficients of the transition over each step; see `planes`.
    Q : ndarray, shape (11, n)
        Its noise: variances, and the covariance of slope and curvature.
    share : ndarray, shape (3, n)
        Of the second state in speed, height, and climb by slope; see `PITCH_OBSERVED`.
    r : ndarray, shape (n, 3)
        Variances; NaN where not measured.
    """
    fixes = record.fixes
    count = fixes.t.size
    elapsed = np.diff(steps.when, prepend=steps.when[:1])
    # Critically damped second-order Gauss-Markov process along the distance.
    beta = 1.0 / noise.slope_length
    d = steps.distance
    decay = np.exp(-beta * d)
    # Means of the slope over the step, per slope and per curvature at its begin: at 30 m/s and one
    # fix a second the slope at either end would lead or lag by half a step.
    z = np.maximum(beta * d, 1e-3)
    of_slope = (2.0 - (2.0 + z) * np.exp(-z)) / z
    of_curve = d * (1.0 - (1.0 + z) * np.exp(-z)) / z**2
    # Slope and curvature after the step, per slope and per curvature before it.
    ss, sc = decay * (1.0 + beta * d), decay * d
    cs, cc = -(beta**2) * d * decay, decay * (1.0 - beta * d)
    slope, curve = noise.slope**2, (beta * noise.slope) ** 2
    along = np.exp(-d / noise.bank_length)
    speed_kept, speed_fresh = first_order(elapsed, noise.slow_time)
    height_kept, height_fresh = first_order(elapsed, noise.height_time)
    swell = -GRAVITY * steps.dt
    carry = np.stack(
        [
            -steps.dt,  # of the drifts, into speed and climb
            -np.diff(fixes.speed, prepend=fixes.speed[:1]),  # of the slope, into climb
            -swing,  # of the tilt, into climb
            swell * of_slope,  # of slope and curvature, into speed
            swell * of_curve,
            d * of_slope,  # and into height
            d * of_curve,
            ss,
            sc,
            cs,
            cc,
            along,
            speed_kept,
            height_kept,
        ]
    )
    lost = np.where(steps.broken, 1e4, 0.0)
    shaken = noise.force**2 * steps.dt + grain
    # What of the mean slope does not follow from its begin; in short steps the receiver's noise hides it.
    mean = slope * 2.0 * (2.0 * z - 3.0 + (z + 3.0) * np.exp(-z)) / z**2
    far = elapsed > LONGEST_STEP
    unseen = np.where(far, np.maximum(mean - of_slope**2 * slope - of_curve**2 * curve, 0.0), 0.0)
    Q = np.empty((11, count))
    Q[V] = shaken + (noise.relative * change) ** 2 + (GRAVITY * steps.dt) ** 2 * unseen + lost
    # Braking and bends tilt with the slope and bank of their moment, not with those at the ends of the step.
    Q[CLIMB] = shaken + np.where(far, 1e4, lost)
    Q[SLOPE] = slope - (ss * slope * ss + sc * curve * sc)
    Q[CURVE] = curve - (cs * slope * cs + cc * curve * cc)
    # Over a long gap the vehicle may have got anywhere, by a ramp, a train, or a reset of the receiver.
    Q[HEIGHT] = (0.02 * d) ** 2 * steps.broken + np.where(far, 1e4, 0.0)
    Q[SPEED_ERROR] = speed_fresh * noise.speed_slow**2
    Q[HEIGHT_ERROR] = height_fresh * noise.height_slow**2
    Q[TILT] = (1.0 - along**2) * noise.bank**2
    Q[DRIFT_X] = Q[DRIFT_Z] = noise.drift**2 * elapsed
    Q[10] = -(ss * slope * cs + sc * curve * cc)
    share = np.ones((3, count))
    share[2] = fixes.speed
    r = np.empty((count, 3))
    r[:, 0] = noise.speed_white**2
    r[:, 1] = np.where(np.isfinite(fixes.alt), noise.height_white**2, np.nan)
    r[:, 2] = noise.heave**2
    deviations = [
        1e2,
        1e2,
        noise.slope,
        beta * noise.slope,
        1e2,
        noise.speed_slow,
        noise.height_slow,
        noise.bank,
        0.0,
        0.0,
    ]
    P0 = np.diag(np.square(deviations))
    return P0, carry, Q, share, r


FINE = 2.0
"""Half width of the mean that takes vibration from the slope, s."""


def road_slope(record: Record, felt: Floats) -> Floats:
    """Slope at the ticks, good enough for its square.

    Parameters
    ----------
    record : Record
    felt : ndarray, shape (m,)
        Longitudinal specific force less acceleration, over gravity.  It gives the waves between `FINE` and
        `COARSE`, height the rest, because a bias of the force times the slope would pass for pitch.

    Returns
    -------
    ndarray, shape (m,)
        rad, uphill positive.
    """
    waves = smoothed(record, felt, FINE)
    return waves - smoothed(record, waves, COARSE) + np.interp(record.t, record.fixes.t, record.fixes.rise)


class Along(NamedTuple):
    """What the ticks say of the pitch plane from fix to fix, whatever the noise levels."""

    steps: Steps
    w: Floats
    """Turn rate at the fixes, rad/s, shape (n,)."""
    total: Floats
    """Specific force and its companions integrated over each step, shape (n, 9)."""
    grain: Floats
    """Variance of sensor noise in the force over each step, (m/s)², shape (n,)."""


def along_of(record: Record, lag: float, frame: Frame) -> Along:
    """The part of `pitch_plane` that does not depend on the noise levels.

    Parameters
    ----------
    record : Record
    lag : float
        Present estimate of the lag of GPS speed, s.
    frame : Frame
        The ticks at that lag, in the V axes of the present estimate.

    Returns
    -------
    Along
    """
    steps = steps_of(record, lag)
    pushed = np.interp(record.t + lag, record.fixes.t, record.fixes.acceleration)
    slope = road_slope(record, (frame.f[:, 0] - pushed) / GRAVITY)
    felt = [
        *frame.f.T,
        pushed**2 / GRAVITY,
        frame.lateral**2 / GRAVITY,
        pushed * np.abs(pushed) / GRAVITY,
        frame.w**2,
        0.5 * GRAVITY * slope**2,
        record.density,
    ]
    total = gained(record, steps, felt)
    return Along(steps, at(record, steps.when, frame.w), total, total[:, 8] * rough_share(steps.dt))


def pitch_plane(record: Record, along: Along, noise: Noise) -> Channel:
    """Speed, climb and height against longitudinal and vertical specific force.

    Parameters
    ----------
    record : Record
    along : Along
        What the ticks say at the present estimate; the unknown turn is a small rotation about its V axes.
    noise : Noise

    Returns
    -------
    Channel
        Measurements: GPS speed, GPS height, and "climb is speed times slope".
    """
    steps, w, total, rough = along
    fixes = record.fixes
    keep = 1.0 - noise.pitch_gain[0]
    change = clear_part(fixes.acceleration, noise.speed_white)
    U = np.zeros((steps.when.size, 2, 1 + PITCH_UNKNOWNS.size))
    U[:, 0, 0] = keep * total[:, 0] + noise.lever[0] * total[:, 6]
    U[:, 0, _COLUMN[1]], U[:, 0, _COLUMN[2]] = keep * total[:, 2], -keep * total[:, 1]
    U[:, 0, _COLUMN[3]] = -steps.dt
    U[:, 0, _COLUMN[PITCH_GAIN]] = -change * steps.dt
    U[:, 0, _COLUMN[UNLIKE_GAIN]] = -np.abs(change) * steps.dt
    U[:, 0, _COLUMN[LEVER_X]] = total[:, 6]
    U[:, 1, 0] = (
        total[:, 2]
        + GRAVITY * steps.dt
        - noise.pitch_gain[0] * total[:, 3]
        - noise.roll_gain[0] * total[:, 4]
        - total[:, 7]
    )
    U[:, 1, _COLUMN[0]], U[:, 1, _COLUMN[1]] = total[:, 1], -total[:, 0]
    U[:, 1, _COLUMN[5]] = -steps.dt
    U[:, 1, _COLUMN[PITCH_GAIN]], U[:, 1, _COLUMN[ROLL_GAIN]] = -total[:, 3], -total[:, 4]
    U[:, 1, _COLUMN[UNLIKE_GAIN]] = -total[:, 5]
    P0, carry, Q, share, r = pitch_system(record, steps, noise, total[:, 0], total[:, 1], total[:, 8])
    Y = np.zeros((steps.when.size, 3, 1 + PITCH_UNKNOWNS.size))
    Y[:, 0, 0], Y[:, 1, 0] = fixes.speed, np.nan_to_num(fixes.alt)
    Y[:, 0, _COLUMN[SPEED_LAG]] = change
    Y[:, 0, _COLUMN[ANTENNA_Y]] = w
    x0 = np.zeros(10)
    x0[V] = fixes.speed[0]
    x0[HEIGHT] = Y[0, 1, 0]
    grain = np.repeat(rough[:, None], 2, axis=1)
    return Channel(
        x0,
        P0,
        carry,
        Q,
        np.array([V, CLIMB]),
        U,
        grain,
        PITCH_OBSERVED,
        share,
        Y,
        r,
        np.zeros(3),
        PITCH_UNKNOWNS,
    )
