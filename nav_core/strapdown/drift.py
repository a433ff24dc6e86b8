"""How far a position drifts on inertial sensors alone (000 eq. 6.1.3)."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from nav_core.earth import STANDARD_GRAVITY
from nav_core.errors import RangeError
from nav_core.typing import Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualErrors:
    """What calibration and alignment have left; zero unless given.

    Attributes
    ----------
    position : float
        At the start, m.
    velocity : float
        At the start, m/s.
    accel_bias : float
        m/s².
    gyro_bias : float
        Of a horizontal axis, rad/s.
    tilt : float
        Misalignment of the horizontal at the start, rad.
    heading : float
        Misalignment in azimuth at the start, rad.
    accel_scale : float
        Scale error of the accelerometer, 1.
    gyro_scale : float
        Scale error of the vertical gyro, 1.
    """

    position: float = 0.0
    velocity: float = 0.0
    accel_bias: float = 0.0
    gyro_bias: float = 0.0
    tilt: float = 0.0
    heading: float = 0.0
    accel_scale: float = 0.0
    gyro_scale: float = 0.0


@dataclass(frozen=True, slots=True)
class Drift:
    """Error of the position after each of n times, m, by its cause; each of shape (n,).

    The attributes are those of `ResidualErrors`, with their signs.
    """

    position: Floats
    velocity: Floats
    accel_bias: Floats
    gyro_bias: Floats
    tilt: Floats
    heading: Floats
    accel_scale: Floats
    gyro_scale: Floats

    @property
    def terms(self) -> Floats:
        """The causes side by side, in the order of the attributes, m, shape (n, 8)."""
        return np.stack([getattr(self, item.name) for item in fields(self)], axis=-1)

    @property
    def total(self) -> Floats:
        """Their sum: the equation as printed, m, shape (n,)."""
        return self.terms.sum(axis=-1)

    @property
    def rms(self) -> Floats:
        """Root of the sum of squares, m, shape (n,): the 1 sigma when the residuals are 1 sigma and independent."""
        return np.sqrt(np.sum(self.terms**2, axis=-1))


def position_drift(
    t: Floats,
    residual: ResidualErrors,
    *,
    speed: float = 0.0,
    force: float = 0.0,
    turned: float = 0.0,
    gravity: float = STANDARD_GRAVITY,
) -> Drift:
    """Error of one horizontal component of the position after a time without fixes.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Since the last fix, s, >= 0.
    residual : ResidualErrors
    speed : float
        V, m/s: distance gone since then over time, in the direction that the heading says.
    force : float
        Horizontal specific force on the accelerometer in question, m/s²: f of the equation.
    turned : float
        Change of heading over the time, rad: the printed ``dH`` of the last term, to which the gyro's scale applies.
    gravity : float
        m/s².

    Returns
    -------
    Drift

    Notes
    -----
    000 eq. 6.1.3:
    ``p + v t + b_a t²/2 + b_g g t³/6 + tilt g t²/2 + heading V t + s_a f t²/2 + s_g turned V t``.
    The terms in g hold for times short against Schuler's period of 84 min, of which they are the beginning; the one
    in b_g leaves out that a horizontal gyro bias turns with the vehicle.  The last is an upper bound: it takes the
    heading as wrong by its final error all the way.
    """
    time = np.asarray(t, dtype=np.float64)
    if time.size and not time.min() >= 0.0:
        raise RangeError("t", float(time.min()), ">= 0 s")
    square = 0.5 * time**2
    return Drift(
        position=np.full_like(time, residual.position),
        velocity=residual.velocity * time,
        accel_bias=residual.accel_bias * square,
        gyro_bias=residual.gyro_bias * gravity * time**3 / 6.0,
        tilt=residual.tilt * gravity * square,
        heading=residual.heading * speed * time,
        accel_scale=residual.accel_scale * force * square,
        gyro_scale=residual.gyro_scale * turned * speed * time,
    )
