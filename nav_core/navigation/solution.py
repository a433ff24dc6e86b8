"""What a navigation filter gives: the way of the vehicle, and how sure each moment of it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from nav_core.errors import ShapeError
from nav_core.records import Remark
from nav_core.rotation import matrix_to_euler
from nav_core.typing import Floats

Method = Literal["inertial-gnss", "position-velocity"]


@dataclass(frozen=True, slots=True)
class Solution:
    """Position, velocity and attitude of the box at n moments, with covariances.

    Attributes
    ----------
    method : {"inertial-gnss", "position-velocity"}
    smoothed : bool
        Whether later measurements took part in earlier moments.
    t : ndarray, shape (n,)
        Box clock, s.
    lat, lon, height : ndarray, shape (n,)
        rad, rad, m.
    velocity : ndarray, shape (n, 3)
        North, east, down, m/s.
    R_tv : ndarray, shape (n, 3, 3)
        Attitude of the vehicle.
    P : ndarray, shape (n, k, k)
        Covariance of truth minus estimate: position and velocity in T axes (m, m/s), then, of "inertial-gnss", the
        small rotation about the T axes (rad) and the biases in V axes (m/s², rad/s), k = 15; of
        "position-velocity", acceleration and its bias in T axes (m/s²), k = 12.
    bias : ndarray, shape (n, 6) or (n, 3)
        Of the accelerometer and gyro in V axes, or of the acceleration in T axes.
    still : ndarray, shape (n,)
        1 where the vehicle was taken to stand, else 0.
    fixes, rejected : int
        Fixes that passed the gates of quality, and those of them that the innovation gate left out.
    remarks : tuple of Remark
    """

    method: Method
    smoothed: bool
    t: Floats
    lat: Floats
    lon: Floats
    height: Floats
    velocity: Floats
    R_tv: Floats
    P: Floats
    bias: Floats
    still: Floats
    fixes: int
    rejected: int
    remarks: tuple[Remark, ...] = ()

    def __post_init__(self) -> None:
        n = self.t.size
        for name, shape in (("velocity", (n, 3)), ("R_tv", (n, 3, 3)), ("P", (n, *self.P.shape[1:]))):
            if getattr(self, name).shape != shape:
                raise ShapeError(f"solution.{name}", getattr(self, name).shape, str(shape))

    @property
    def sigma(self) -> Floats:
        """1 sigma of each state, shape (n, k), in the units of `P`."""
        return np.sqrt(np.diagonal(self.P, axis1=1, axis2=2))

    @property
    def euler(self) -> Floats:
        """Roll, pitch, yaw, rad, shape (n, 3)."""
        return matrix_to_euler(self.R_tv)

    @property
    def euler_sigma(self) -> Floats:
        """1 sigma of roll, pitch and yaw, rad, shape (n, 3); NaN where the filter does not estimate attitude.

        The small rotation about the T axes, written as changes of the angles (000 eq. 2.6.47, differentiated).
        """
        if self.method == "position-velocity":
            return np.full((self.t.size, 3), np.nan)
        _, pitch, yaw = self.euler.T
        J = np.zeros((self.t.size, 3, 3))
        J[:, 0, 0], J[:, 0, 1] = np.cos(yaw) / np.cos(pitch), np.sin(yaw) / np.cos(pitch)
        J[:, 1, 0], J[:, 1, 1] = -np.sin(yaw), np.cos(yaw)
        J[:, 2, 0], J[:, 2, 1] = np.cos(yaw) * np.tan(pitch), np.sin(yaw) * np.tan(pitch)
        J[:, 2, 2] = 1.0
        return np.sqrt(np.einsum("nij,njk,nik->ni", J, self.P[:, 6:9, 6:9], J))
