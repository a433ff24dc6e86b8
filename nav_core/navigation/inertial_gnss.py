"""Inertial navigation corrected by GPS: 15 states, closed loop, with the constraints of a wheeled vehicle, smoothed.

Beyond 000 §7.7.2, which takes the attitude as known: here position, velocity, attitude and the biases of accelerometer
and gyro are estimated together, so that a bias learnt while GPS lasts carries through an outage (Groves 2013 ch. 14),
and so is what neighbouring fixes err by in common (000 §3.10), so that it is not taken for motion.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core import earth
from nav_core.errors import NavigationError, TooLittleDataError
from nav_core.kalman.record_kernels import smooth_backwards
from nav_core.navigation import kernels
from nav_core.navigation.epochs import Epochs, epochs_of
from nav_core.navigation.fixes import Receiver, Reports, reports
from nav_core.navigation.solution import Solution
from nav_core.navigation.states import STATES, VEHICLE, Weights
from nav_core.navigation.vehicle import Vehicle
from nav_core.records import Drive, Remark
from nav_core.rotation import euler_to_matrix, rotvec_to_matrix
from nav_core.strapdown.increments import Increments, from_rates
from nav_core.typing import Floats, trailing


class NoGyroError(NavigationError):
    """The recording has no angular rate, without which attitude cannot be carried on."""

    def __init__(self, samples: int) -> None:
        self.samples = samples
        super().__init__(
            f"none of the {samples} inertial samples has an angular rate; position_velocity does without a gyro"
        )


class Start(NamedTuple):
    """Where the filter begins.

    Attributes
    ----------
    sample : int
        Of the inertial record.
    place, v : ndarray, shape (3,)
        Latitude, longitude (rad), height (m); north, east, down, m/s.
    C : ndarray, shape (3, 3)
        Attitude of the vehicle, level on its course.
    P : ndarray, shape (20, 20)
    """

    sample: int
    place: Floats
    v: Floats
    C: Floats
    P: Floats


class Record(NamedTuple):
    """Everything the filter reads, in V axes, from the start on."""

    t: Floats
    increments: Increments
    epochs: Epochs
    start: Start
    arm: Floats
    weights: Weights
    fixes: int


class Forward(NamedTuple):
    """The filter's run over a record, at its m epochs.

    Attributes
    ----------
    places, v : ndarray, shape (m, 3)
        Latitude, longitude (rad), height (m); north, east, down, m/s.
    C : ndarray, shape (m, 3, 3)
        From V to T.
    slow : ndarray, shape (m, 11)
        Biases of accelerometer and gyro, m/s² and rad/s, and the receiver's errors.
    P_prior, P, Phi : ndarray, shape (m, 20, 20)
        Covariances before and after the update, and transitions into each epoch.
    dx : ndarray, shape (m, 20)
        What each update put into the track.
    left_out : int
        Fixes that the gate left out.
    still : ndarray, shape (m,)
        1 where the vehicle stands.
    """

    places: Floats
    v: Floats
    C: Floats
    slow: Floats
    P_prior: Floats
    P: Floats
    Phi: Floats
    dx: Floats
    left_out: int
    still: Floats


UNKNOWN_HEIGHT = 1000.0
"""1 sigma of the height where no fix tells it, m."""

START_SPEED = 3.0
"""The course of the first fix at this speed, m/s, says where the vehicle points."""


def navigate(
    drive: Drive,
    R_va: Floats,
    *,
    receiver: Receiver | None = None,
    vehicle: Vehicle | None = None,
    speed_lag: float = 0.0,
    course_lag: float = 0.0,
    smoothed: bool = True,
) -> Solution:
    """Track of a drive from GPS, accelerometer and gyro.

    Parameters
    ----------
    drive : Drive
        With angular rates; gaps of the record are bridged with large uncertainty.
    R_va : ndarray, shape (3, 3)
        Mounting.
    receiver : Receiver, optional
        Ordinary by default.
    vehicle : Vehicle, optional
    speed_lag, course_lag : float
        Of the receiver, s (`MountingEstimate.speed_lag`, `course_lag`).
    smoothed : bool
        Let later measurements correct earlier moments (RTS).  Without, each moment knows only its past.

    Returns
    -------
    Solution
        Of the box, at 10 Hz and at the moments of fixes, from the first moving fix on.

    Raises
    ------
    NoGyroError
        Without angular rates.
    TooLittleDataError
        Without a moving fix, or with less than a second of samples after it.
    ShapeError

    Notes
    -----
    Mechanisation in T (`nav_core.strapdown`, 000 eqs. 2.5.19-2.5.23), error states and their transition
    as in Groves 2013 §14.2.4, non-holonomic and zero-velocity constraints as in §15.4 and §15.3.  Fixes are
    gated by fix flag, repetition, HDOP and satellites, and by their innovation; they count at the moment they describe.
    Memory: about 11 kB an epoch, of which there are ten a second and two for each fix; an hour at 4 Hz takes 0.7 GB.
    """
    record = prepare(
        drive,
        R_va,
        receiver=receiver or Receiver(),
        vehicle=vehicle or Vehicle(),
        speed_lag=speed_lag,
        course_lag=course_lag,
    )
    run = forward(record)
    places, v, attitudes, slow, P = run.places, run.v, run.C, run.slow, run.P
    if smoothed:
        e = np.zeros_like(run.dx)
        # Corrections are already in the estimate: seen from it, each prediction stood at minus its correction.
        smooth_backwards(-run.dx, run.P_prior, e, P, run.Phi[1:])
        places, v, attitudes, slow = moved(places, v, attitudes, slow, e)
    covariance = P[:, :VEHICLE, :VEHICLE].copy()
    # The triad navigated is the box turned by its mounting: what that errs by, the attitude of the vehicle errs by.
    covariance[:, range(6, 9), range(6, 9)] += record.weights.mount**2
    return Solution(
        "inertial-gnss",
        smoothed,
        record.t[record.epochs.sample],
        places[:, 0],
        np.pi - np.mod(np.pi - places[:, 1], 2.0 * np.pi),
        places[:, 2],
        v,
        attitudes,
        covariance,
        slow[:, :6],
        run.still,
        record.fixes,
        run.left_out,
        (*drive.remarks, *_begun_late(drive, record)),
    )


def _begun_late(drive: Drive, record: Record) -> tuple[Remark, ...]:
    """A remark where more than a second of the recording lies before the track."""
    before = float(record.t[0] - drive.inertial.t[0])
    if before <= 1.0:
        return ()
    text = f"The track begins with the first moving fix at {record.t[0]:.1f} s; the {before:.1f} s before are left out"
    return (Remark("begins_moving", text),)


def forward(record: Record) -> Forward:
    """Run the filter over a record, which stays as it is.

    Parameters
    ----------
    record : Record
        Of `prepare`.

    Returns
    -------
    Forward
        T axes, SI units and rad.
    """
    start, epochs = record.start, record.epochs._replace(still=record.epochs.still.copy())
    places, v, C, slow, P_prior, P, Phi, dx, left_out = kernels.run(
        record.t,
        record.increments.rotation,
        record.increments.velocity,
        *epochs,
        record.arm,
        record.weights,
        start.place.copy(),
        start.v.copy(),
        start.C.copy(),
        start.P.copy(),
    )
    return Forward(places, v, C, slow, P_prior, P, Phi, dx, int(left_out), epochs.still)


def prepare(
    drive: Drive, R_va: Floats, *, receiver: Receiver, vehicle: Vehicle, speed_lag: float, course_lag: float
) -> Record:
    """Samples in V axes, their increments, the epochs and the start; raises as `navigate`.

    Parameters
    ----------
    drive : Drive
        With a gyro; A-frame.
    R_va : ndarray, shape (3, 3)
        From A to V.
    receiver : Receiver
        How good it is.
    vehicle : Vehicle
        What wheels and box allow.
    speed_lag, course_lag : float
        s.

    Returns
    -------
    Record
        Box clock, s; V axes.

    Raises
    ------
    NoGyroError, NoFixError, ShapeError, TooLittleDataError
    """
    R_va = trailing("R_va", R_va, 3, 3)
    if drive.inertial.w is None:
        raise NoGyroError(drive.inertial.t.size)
    full = np.isfinite(drive.inertial.w).all(axis=1)
    t, f, w = drive.inertial.t[full], drive.inertial.f[full] @ R_va.T, drive.inertial.w[full] @ R_va.T
    seen = reports(drive.gnss, receiver, speed_lag=speed_lag, course_lag=course_lag)
    start = _start(t, seen, vehicle)
    t, f, w = t[start.sample :], f[start.sample :], w[start.sample :]
    if t.size < 4 or t[-1] - t[0] < 1.0:
        raise TooLittleDataError("samples after the first moving fix", int(t.size), 4)
    epochs = epochs_of(t, f, w, seen, force_noise=vehicle.force_noise, rate_noise=vehicle.rate_noise)
    fixes = int(np.count_nonzero(np.isfinite(epochs.z[:, 0])))
    return Record(t, from_rates(t, w, f), epochs, start, np.array(vehicle.arm), vehicle.weights(receiver), fixes)


def _start(t: Floats, seen: Reports, vehicle: Vehicle) -> Start:
    # Without a height it begins at zero: only gravity depends on it, and little.
    usable = np.isfinite(seen.z[:, [0, 1, 3, 4]]).all(axis=1) & (seen.z[:, 3] >= START_SPEED)
    if t.size:
        usable &= (seen.t >= t[0]) & (seen.t <= t[-1])
    if t.size == 0 or not usable.any():
        raise TooLittleDataError(
            f"fixes with position, speed and course at {START_SPEED:g} m/s or more among the samples", 0, 1
        )
    first = int(np.argmax(usable))
    lat, lon, height, speed, course = seen.z[first]
    variances = seen.noise[first, :, 0]
    P = np.eye(STATES)
    # Wide, for the place is that of a fix which the filter reads as well, with the same error.
    P[range(3), range(3)] = 100.0 * variances[:3]
    if np.isnan(height):
        height, P[2, 2] = 0.0, UNKNOWN_HEIGHT**2
    P[range(3, 6), range(3, 6)] = 0.5**2
    P[range(6, 8), range(6, 8)] = vehicle.tilt**2
    # Besides noise, the box swings about the slip-free point, and the course may lag by more than was said.
    P[8, 8] = variances[4] / speed**2 + np.radians(3.0) ** 2
    P[range(9, 12), range(9, 12)] = vehicle.accel_bias**2
    P[range(12, 15), range(12, 15)] = vehicle.gyro_bias**2
    return Start(
        int(np.searchsorted(t, seen.t[first])),
        np.array([lat, lon, height]),
        speed * np.array([np.cos(course), np.sin(course), 0.0]),
        euler_to_matrix(0.0, 0.0, course),
        P,
    )


def moved(places: Floats, v: Floats, C: Floats, slow: Floats, e: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Put errors `e` (n, 20), truth minus estimate, into a whole track; what `kernels.apply` does at one epoch.

    Parameters
    ----------
    places : ndarray, shape (n, 3)
        Latitude, longitude, rad, and height, m.
    v : ndarray, shape (n, 3)
        T axes, m/s.
    C : ndarray, shape (n, 3, 3)
        From V to T.
    slow : ndarray, shape (n, 11)
        Biases and the receiver's errors.
    e : ndarray, shape (n, 20)
        Position, m, velocity, m/s, attitude, rad (T axes), biases and the receiver's errors.

    Returns
    -------
    places : ndarray, shape (n, 3)
        As given, corrected.
    v : ndarray, shape (n, 3)
        m/s.
    C : ndarray, shape (n, 3, 3)
        From V to T.
    slow : ndarray, shape (n, 11)
        Biases and the receiver's errors.
    """
    meridian, normal = earth.radii(places[:, 0])
    shift = np.stack(
        (
            e[:, 0] / (meridian + places[:, 2]),
            e[:, 1] / ((normal + places[:, 2]) * np.cos(places[:, 0])),
            -e[:, 2],
        ),
        axis=1,
    )
    return places + shift, v + e[:, 3:6], rotvec_to_matrix(e[:, 6:9]) @ C, slow + e[:, 9:]
