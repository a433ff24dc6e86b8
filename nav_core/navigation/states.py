"""Places of the states and measurement rows of the 15-state filter, and what its kernels are told of noise."""

from __future__ import annotations

from typing import NamedTuple

STATES = 20
VEHICLE = 15
"""Of them those of the vehicle, which come first."""
SLOW = STATES - 9
"""Those that keep their value, or forget it slowly, while the vehicle moves."""
ROWS = 13
"""Position north, east, down; speed; course; sideways and down velocity; velocity and rate at rest, three each."""

SLOWEST = 1.0
"""Below this speed GPS course and the direction of the speed say nothing, m/s."""


class Weights(NamedTuple):
    """What the kernel needs to know of the noise; variances are inflated for correlation where they enter the filter.

    Attributes
    ----------
    accel_walk, gyro_walk : float
        Random walk of the biases, (m/s²)²/s and (rad/s)²/s.
    correlation : float
        Of the receiver's errors, s.
    sideways, downwards : float
        1 sigma of the velocity of the slip-free point across and normal to the vehicle, m/s.
    slip_repeat : float
        By how much the variance of these grows because neighbouring epochs share their error.
    arm_sigma : float
        1 sigma of the slip-free point's place, m.
    mount : float
        1 sigma of the mounting, rad.
    mount_repeat : float
        As `slip_repeat`, for the mounting.
    rest, rest_repeat : float
        Velocity at rest, m/s, 1 sigma, and its repetition.
    rest_rate : float
        Turning at rest, rad/s, 1 sigma.
    rest_push : float
        Mean acceleration over an epoch at rest, m/s², 1 sigma: people and suspension.
    gate : float
        Squared normalised innovation beyond which a measurement is left out.
    relent : float
        After this time of nothing but fixes left out they are taken as they are, s.
    """

    accel_walk: float
    gyro_walk: float
    correlation: float
    sideways: float
    downwards: float
    slip_repeat: float
    arm_sigma: float
    mount: float
    mount_repeat: float
    rest: float
    rest_repeat: float
    rest_rate: float
    rest_push: float
    gate: float
    relent: float
