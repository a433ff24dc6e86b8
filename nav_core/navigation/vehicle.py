"""What is known of sensors, mounting and vehicle before the first sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.errors import RangeError
from nav_core.kalman import gate
from nav_core.navigation.fixes import Receiver
from nav_core.navigation.states import Weights


@dataclass(frozen=True, slots=True, kw_only=True)
class Vehicle:
    """What is known of sensors and vehicle beforehand; the defaults are a consumer-grade box in a car.

    Attributes
    ----------
    force_noise, rate_noise : float
        White noise, vibration included, m/s²/√Hz and rad/s/√Hz.
    accel_bias, gyro_bias : float
        1 sigma of the biases at the start, each axis, m/s² and rad/s.
    accel_walk, gyro_walk : float
        How they wander, m/s²/√s and rad/s/√s.
    tilt : float
        1 sigma of roll and pitch of a driving vehicle, rad.
    sideways, downwards : float
        1 sigma of the velocity across and normal to the vehicle at the slip-free point, m/s.
    arm : tuple of float
        Slip-free point (about the middle of the rear axle) seen from the box, V axes, m.
    arm_sigma : float
        1 sigma of `arm`, m.
    mount_sigma : float
        1 sigma of the mounting, rad.
    """

    force_noise: float = 0.015
    rate_noise: float = 2e-4
    accel_bias: float = 0.1
    gyro_bias: float = np.radians(1.0)
    accel_walk: float = 1e-4
    gyro_walk: float = 1e-5
    tilt: float = np.radians(3.0)
    sideways: float = 0.05
    downwards: float = 0.1
    arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    arm_sigma: float = 0.5
    mount_sigma: float = np.radians(0.5)

    def __post_init__(self) -> None:
        for name in ("force_noise", "rate_noise", "accel_bias", "gyro_bias", "tilt", "sideways", "downwards"):
            if not getattr(self, name) > 0.0:
                raise RangeError(name, getattr(self, name), "> 0")

    def weights(self, receiver: Receiver) -> Weights:
        """For the kernel, with the times over which slip (1 s), mounting (30 s) and rest (1 s) repeat themselves.

        Parameters
        ----------
        receiver : Receiver
            Says the correlation time of its errors.

        Returns
        -------
        Weights
            Variances and factors, SI units.
        """
        epoch = 0.1
        return Weights(
            accel_walk=self.accel_walk**2,
            gyro_walk=self.gyro_walk**2,
            correlation=receiver.correlation,
            sideways=self.sideways,
            downwards=self.downwards,
            slip_repeat=2.0 * 1.0 / epoch,
            arm_sigma=self.arm_sigma,
            mount=self.mount_sigma,
            mount_repeat=2.0 * 30.0 / epoch,
            rest=0.05,
            rest_repeat=2.0 * 1.0 / epoch,
            rest_rate=5e-4,
            rest_push=0.1,
            gate=gate(1, 0.9995),
            relent=8.0,
        )
