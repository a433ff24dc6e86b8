"""The way around an event, what the driver did before it, and where the vehicle came to rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from nav_core.errors import ShapeError
from nav_core.typing import Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Rest:
    """Where and when the vehicle came to rest after the impact.

    Attributes
    ----------
    t : float
        Box clock, s.
    lat, lon : float, optional
        rad.
    radius95 : float, optional
        Of the position, m.
    distance : float, optional
        From the place of impact, m.
    """

    t: float
    lat: float | None
    lon: float | None
    radius95: float | None
    distance: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectory:
    """The way from 30 s before to 30 s after `t0`, smoothed, at k moments.

    Attributes
    ----------
    t : ndarray, shape (k,)
        From `t0`, s.
    lat, lon : ndarray, shape (k,)
        rad.
    position : ndarray, shape (k, 2)
        North and east of the place at `t0`, m.
    position_covariance : ndarray, shape (k, 2, 2)
        m²; `ellipse` turns it into half axes and direction.
    speed, speed_sigma : ndarray, shape (k,)
        m/s.
    heading, heading_sigma : ndarray, shape (k,)
        Where the vehicle points before `t0` and, with a gyro, after it; else where it moves.
        rad clockwise from north; NaN where unknown.
    acceleration : ndarray, shape (k, 2)
        Along and across the heading (right positive), low-passed, m/s²; NaN where not recorded.
    method : str
        ``"gps-inertial"`` or ``"inertial"`` (no fixes: no position, speed relative).
    """

    t: Floats
    lat: Floats
    lon: Floats
    position: Floats
    position_covariance: Floats
    speed: Floats
    speed_sigma: Floats
    heading: Floats
    heading_sigma: Floats
    acceleration: Floats
    method: str

    def __post_init__(self) -> None:
        k = self.t.size
        for name, shape in (
            ("lat", (k,)),
            ("lon", (k,)),
            ("position", (k, 2)),
            ("position_covariance", (k, 2, 2)),
            ("speed", (k,)),
            ("speed_sigma", (k,)),
            ("heading", (k,)),
            ("heading_sigma", (k,)),
            ("acceleration", (k, 2)),
        ):
            if getattr(self, name).shape != shape:
                raise ShapeError(f"trajectory.{name}", getattr(self, name).shape, str(shape))

    def ellipse(self, k: int, chi2: float = 5.991) -> tuple[float, float, float]:
        """Half axes and direction of the ellipse of the position at moment `k`.

        Parameters
        ----------
        k : int
            Index of the moment.
        chi2 : float
            Quantile of chi-square with two degrees of freedom; 5.991 is 95 %.

        Returns
        -------
        tuple of float
            Long and short half axis, m, and direction of the long one, rad clockwise from north.
        """
        values, vectors = np.linalg.eigh(self.position_covariance[k])
        small, large = np.sqrt(chi2 * np.maximum(values, 0.0))
        return float(large), float(small), float(np.arctan2(vectors[1, 1], vectors[0, 1]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Driver:
    """What the driver did in the last five seconds before the first blow, and how far the vehicle went.

    Attributes
    ----------
    t : ndarray, shape (k,)
        From `t0`, s, every 0.5 s of the five seconds before the first blow, as far as recorded.
    speed : ndarray, shape (k,)
        m/s; NaN where unknown.
    longitudinal, lateral : ndarray, shape (k,)
        Mean acceleration of the half second before, m/s².
    yaw_rate : ndarray, shape (k,)
        rad/s, positive to the right; from the gyro, else from the course; NaN where unknown.
    braked_from : float, optional
        Start of the braking that lasted until the first blow, from `t0`, s (negative).
    braking : float, optional
        Strongest half-second deceleration of the last five seconds, m/s².
    steered : {"left", "right", "none"}, optional
        None when not known.
    stopping_distance : float, optional
        From where braking began, or from the impact without any, to rest, m.
    """

    t: Floats
    speed: Floats
    longitudinal: Floats
    lateral: Floats
    yaw_rate: Floats
    braked_from: float | None = None
    braking: float | None = None
    steered: Literal["left", "right", "none"] | None = None
    stopping_distance: float | None = None
