"""Position and velocity from accelerometer and GPS with a known attitude: the 12 states of 000 §7.7.2.

Specific force, turned into T, is integrated twice, and a linear filter estimates from the fixes what is
missing: residuals of position, velocity and acceleration, and the bias of the acceleration (7.7.16, 7.7.24).  Both act
on the velocity alike, so that only their sum is observed; they differ in how fast they change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from nav_core import earth
from nav_core.errors import RangeError, ShapeError, TooLittleDataError
from nav_core.kalman import filter_record, gate, smooth
from nav_core.navigation.epochs import LONGEST_STEP, UNKNOWN_FORCE
from nav_core.navigation.fixes import Receiver, Reports, as_white, reports
from nav_core.navigation.solution import Solution
from nav_core.processes import transition_series
from nav_core.records import Drive
from nav_core.rotation import euler_to_matrix
from nav_core.typing import Floats, trailing

STATES = 12
EPOCH_RATE = 4.0
"""Epochs a second between the fixes, Hz."""

MEASUREMENT = np.eye(6, STATES)
"""Position and velocity of the fixes (7.7.21)."""

_F = np.zeros((STATES, STATES))
_F[0:3, 3:6] = _F[3:6, 6:9] = _F[3:6, 9:12] = np.eye(3)


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """Covariance per second that each group of three states gains, and the covariance at the start.

    The thesis' own (7.7.22, an update a second) are `THESIS`; the defaults suit a car whose road is taken for level.

    Attributes
    ----------
    position, velocity, acceleration, bias : float
        m²/s, (m/s)²/s, (m/s²)²/s, (m/s²)²/s.
    start : float
        Of every state at the start (000: 1e6).
    """

    position: float = 1e-3
    velocity: float = 0.02
    acceleration: float = 0.05
    bias: float = 1e-4
    start: float = 1e6

    def diagonal(self) -> Floats:
        """Of the twelve states, per second, shape (12,)."""
        return np.repeat([self.position, self.velocity, self.acceleration, self.bias], 3)


THESIS = Noise(position=4.0, velocity=4.0, acceleration=4.0, bias=1.5)
"""7.7.22."""
THESIS_MEASUREMENT = np.array([4.0, 4.0, 4.0, 9.0, 9.0, 9.0])
"""Variances of position, m², and velocity, (m/s)², as the text of §7.7.2 has them; 7.7.23 exchanges the two."""


class Run(NamedTuple):
    """What the filter makes of the residuals.

    Attributes
    ----------
    x : ndarray, shape (k, 12)
        To be added to the integrated motion, m, m/s and m/s².
    P : ndarray, shape (k, 12, 12)
        Its covariance.
    left_out : int
        Epochs of which the gate left out a component of the position.
    """

    x: Floats
    P: Floats
    left_out: int


def augmented_transition(dt: float, *, errata: Literal["corrected", "printed"] = "corrected") -> Floats:
    """Transition matrix of position, velocity, acceleration and bias.

    Parameters
    ----------
    dt : float
        s.
    errata : {"corrected", "printed"}
        "printed" is 7.7.19 without its thirteenth column: position does not follow the velocity, and the bias is added
        to the acceleration at every step, which so grows without end.

    Returns
    -------
    ndarray, shape (12, 12)
        "corrected": ``x' = v``, ``v' = a + b``, both constant within the step, exactly.

    Raises
    ------
    RangeError
        An interval that is not positive.
    """
    if not dt > 0.0:
        raise RangeError("dt", dt, "> 0")
    if errata == "printed":
        Phi = np.eye(STATES)
        Phi[3:6, 6:9] = Phi[3:6, 9:12] = dt * np.eye(3)
        Phi[6:9, 9:12] = np.eye(3)
        return Phi
    return transition_series(_F, dt, 2)


def run(
    t: Floats,
    residual: Floats,
    variance: Floats,
    noise: Noise | None = None,
    *,
    disturbance: Floats | None = None,
    innovation_gate: float = np.inf,
    smoothed: bool = False,
) -> Run:
    """Filter the residuals between fixes and doubly integrated acceleration.

    Parameters
    ----------
    t : ndarray, shape (k,)
        Epochs, s, increasing.
    residual : ndarray, shape (k, 6)
        Position and velocity of the fix minus the integrated ones, T axes, m and m/s; NaN where not measured.
    variance : ndarray, shape (k, 6)
    noise : Noise, optional
    disturbance : ndarray, shape (k - 1,), optional
        Additional covariance of each velocity per second in each interval, (m/s)²/s.
    innovation_gate : float
        Squared normalised innovation beyond which a measurement is left out.
    smoothed : bool

    Returns
    -------
    Run

    Raises
    ------
    ShapeError, RangeError

    Notes
    -----
    000 eqs. 7.7.16-7.7.24 as corrected in docs/equations.md.
    """
    if residual.shape != (t.size, 6):
        raise ShapeError("residual", residual.shape, f"({t.size}, 6)")
    noise = noise or Noise()
    steps = np.diff(t)
    Phi = np.array([augmented_transition(float(dt)) for dt in steps]).reshape(-1, STATES, STATES)
    gain = np.tile(noise.diagonal(), (steps.size, 1))
    if disturbance is not None:
        gain[:, 3:6] += disturbance[:, None]
    half = np.zeros((steps.size, STATES, STATES))
    half[:, range(STATES), range(STATES)] = 0.5 * steps[:, None] * gain
    found = filter_record(
        np.zeros(STATES),
        noise.start * np.eye(STATES),
        Phi=Phi,
        # What enters within the step, half at its start and half at its end.
        Q=half + Phi @ half @ np.swapaxes(Phi, 1, 2),
        z=residual,
        H=MEASUREMENT,
        r=variance,
        gate=innovation_gate,
    )
    left_out = int(np.count_nonzero(found.rejected[:, :3].any(axis=1)))
    x, P = smooth(found, Phi) if smoothed else (found.x, found.P)
    return Run(x, P, left_out)


def navigate_without_gyro(
    drive: Drive,
    R_va: Floats,
    *,
    receiver: Receiver | None = None,
    noise: Noise | None = None,
    speed_lag: float = 0.0,
    course_lag: float = 0.0,
    smoothed: bool = True,
) -> Solution:
    """Track of a drive from GPS and accelerometer.

    Parameters
    ----------
    drive : Drive
    R_va : ndarray, shape (3, 3)
        Mounting.
    receiver : Receiver, optional
    noise : Noise, optional
    speed_lag, course_lag : float
        Of the receiver, s.
    smoothed : bool

    Returns
    -------
    Solution
        Of method "position-velocity".  The vehicle is taken to point along the GPS course, interpolated over
        outages, and to stand level: slopes appear as bias, and a turn within an outage is not seen.

    Raises
    ------
    TooLittleDataError
        Without two fixes with a course within the inertial record.
    ShapeError
    """
    R_va = trailing("R_va", R_va, 3, 3)
    receiver = receiver or Receiver()
    seen = reports(drive.gnss, receiver, speed_lag=speed_lag, course_lag=course_lag)
    t = drive.inertial.t
    inside = (seen.t >= t[0]) & (seen.t <= t[-1]) if t.size else np.zeros(seen.t.size, dtype=np.bool_)
    with_course = np.isfinite(seen.z[:, 4]) & inside
    if np.count_nonzero(with_course) < 2:
        raise TooLittleDataError("fixes with course within the inertial record", int(with_course.sum()), 2)
    heading = _Heading(seen.course_t[with_course], np.unwrap(seen.z[with_course, 4]))
    seen = Reports(seen.t[inside], seen.course_t[inside], seen.z[inside], seen.noise[inside])
    lat, lon, height = (float(value) for value in np.nan_to_num(seen.z[0, :3]))
    force = np.einsum("nij,nj->ni", euler_to_matrix(0.0, 0.0, heading.at(t)), drive.inertial.f @ R_va.T)
    velocity = _integral(t, force + np.array([0.0, 0.0, float(earth.gravity(lat, height))]))
    motion = np.column_stack((_integral(t, velocity), velocity))

    moments = np.union1d(seen.t, np.arange(seen.t[0], seen.t[-1], 1.0 / EPOCH_RATE))
    moments = moments[np.concatenate(([True], np.diff(moments) > 1e-3))]
    integrated = np.column_stack([np.interp(moments, t, column) for column in motion.T])
    meridian, normal = (float(radius) for radius in earth.radii(lat))
    scale = np.array([meridian + height, (normal + height) * np.cos(lat), -1.0])
    place = scale * (seen.z[:, :3] - [lat, lon, height])
    z, variance = _measured(moments, seen, place, as_white(seen, receiver), heading)
    found = run(
        moments,
        z - integrated,
        variance,
        noise,
        disturbance=_broken(moments, t),
        innovation_gate=gate(1, 0.9999),
        smoothed=smoothed,
    )
    state = integrated + found.x[:, :6]
    return Solution(
        "position-velocity",
        smoothed,
        moments,
        lat + state[:, 0] / scale[0],
        np.pi - np.mod(np.pi - lon - state[:, 1] / scale[1], 2.0 * np.pi),
        height - state[:, 2],
        state[:, 3:6],
        euler_to_matrix(0.0, 0.0, heading.at(moments)),
        found.P,
        found.x[:, 9:12],
        np.zeros(moments.size),
        int(seen.t.size),
        found.left_out,
        drive.remarks,
    )


class _Heading(NamedTuple):
    """Courses at their moments, unwrapped, rad."""

    t: Floats
    course: Floats

    def at(self, moments: Floats) -> Floats:
        return np.interp(moments, self.t, self.course)


def _measured(moments: Floats, seen: Reports, place: Floats, noise: Floats, heading: _Heading) -> tuple[Floats, Floats]:
    """Position and velocity of the fixes in T at their moments, and their variances, (k, 6) each; NaN elsewhere."""
    z, variance = np.full((moments.size, 6), np.nan), np.ones((moments.size, 6))
    row = np.minimum(np.searchsorted(moments, seen.t - 1e-3), moments.size - 1)
    course = heading.at(seen.t)
    z[row, :3] = place
    z[row, 3], z[row, 4] = seen.z[:, 3] * np.cos(course), seen.z[:, 3] * np.sin(course)
    variance[row, :5] = noise
    return z, variance


def _broken(moments: Floats, t: Floats) -> Floats:
    """Covariance per second of the velocity where samples are missing, (m/s)²/s, shape (k - 1,)."""
    broken = np.zeros(moments.size - 1)
    for step in np.flatnonzero(np.diff(t) > LONGEST_STEP):
        broken[(moments[1:] > t[step]) & (moments[:-1] < t[step + 1])] = UNKNOWN_FORCE**2
    return broken


def _integral(t: Floats, rate: Floats) -> Floats:
    steps = 0.5 * np.diff(t)[:, None] * (rate[1:] + rate[:-1])
    return np.concatenate((np.zeros((1, 3)), np.cumsum(steps, axis=0)))
