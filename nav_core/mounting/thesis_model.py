"""What goes into the thesis' filter: its tuning, its corrections, and the measurement vector (001 ch. 4-5).

The state is ``v_x, a_x, omega_z, a_V (3), a_A (3)`` around two reference quaternions: ``q_V`` for the
vehicle in the T-frame and ``q_A`` for the box in the V-frame, ``R(q_A) = R_va``.  The small rotations
stand on the left, ``q = dq(a) q_ref`` (001 eq. 4.24), so `a_V` is about the T axes and `a_A` about the V axes.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from nav_core.errors import TooLittleDataError
from nav_core.records import Drive
from nav_core.rotation import wrap
from nav_core.signal import decimate
from nav_core.typing import Flags, Floats, Integers

GRAVITY = 9.81
"""m/s², the value of 001 §5.1."""

THESIS_PERIOD = 0.25
"""s; the tuning of table 5.1 belongs to this step, other steps scale its process noise."""

MOVING = 1.5
"""m/s; below it the receiver's course is noise, so the last one is held."""

N_STATES = 9

VEHICLE_START = (0.3, 4.0, 0.01, 0.0025, 0.0025, 0.01)
"""Variances of v_x, a_x, omega_z and a_V of a vehicle set on its course (correction of 5.2): (0.55 m/s)², (2 m/s²)²,
(0.1 rad/s)², slope and bank of (0.05 rad)², course of (0.1 rad)²."""

LEVEL_TILT, YAW_STEP = 0.1, np.pi / 2.0
"""1-sigma of the tilt of a mounting levelled by gravity, rad: 1 m/s² of acceleration or slope; step between the yaws
at which it is started, and 1-sigma of each, rad."""

CLIMB_WINDOW = 10.0
"""s; height is differenced over it in the corrected 5.1: its error wanders metres within seconds, which a
difference from fix to fix turns into metres per second."""


class Tuning(NamedTuple):
    """Table 5.1 of 001 with units, and the figures that the thesis leaves open.

    The three process variances of `turn`, `attitude` and `mounting` are per step of 0.25 s.
    """

    acceleration: float = 10.0
    """Spectral density that drives a_x, m²/s⁵ (sigma²_a)."""
    turn: float = 5e-3
    """Variance of omega_z per step and per (m/s)² of v_x, 1/m² (sigma²_wz, multiplied by v_x² in 4.63)."""
    attitude: float = 1e-4
    """Variance of a_V per step and per (rad/s)² of omega_z, s² (sigma²_aV)."""
    mounting: float = 0.1
    """Variance of a_A per step and per (rad/s)² of omega_z, s² (sigma²_aA)."""
    accelerometer: float = 15.0 * (0.01 * GRAVITY) ** 2
    """Variance of a decimated accelerometer axis, (m/s²)²; printed as 15, which is (percent of g)²."""
    speed: float = 0.3
    """Variance of each component of GPS velocity, (m/s)²."""
    turn_rate: float = 2.0 * np.radians(1.0) ** 2
    """Variance of the differenced course, (rad/s)²; printed as 2, which is (°/s)²."""
    floor_speed: float = 1.0
    """Least v_x that 4.63 is fed with, m/s (correction)."""
    floor_attitude: float = 0.15
    """Least turn rate that 4.63 is fed with for a_V, rad/s (correction): hills turn a car on straight roads."""
    floor_mounting: float = 0.01
    """Least turn rate that 4.63 is fed with for a_A, rad/s (correction): keeps its covariance from dying."""
    longest_step: float = 5.0
    """s; after a longer gap the corrected filter forgets the vehicle's state and keeps the mounting."""
    steering: bool = False
    """The third state is the curvature x_steer of 4.10, 1/m, with ``omega_z = v_x x_steer``, as in its source [8];
    `turn` is its variance per step, 1/m², so that the noise of omega_z is that of 4.63."""


class Errata(NamedTuple):
    """Which of the thesis' equations are corrected; `PRINTED` has none, `CORRECTED` all (docs/equations.md)."""

    course: bool = True
    """Course clockwise with z down: 4.55 and 4.51 with +omega, 5.1 with +sin (else counter-clockwise)."""
    descent: bool = True
    """The z component of velocity points down, -dh/dt in 5.1, and is differenced over 10 s."""
    jacobian: bool = True
    """Derivative of f instead of F(x) in 4.15, with the left error's signs in 4.50."""
    floor: bool = True
    """Process noise keeps a floor when standing or driving straight (4.63)."""
    covariance: bool = True
    """P - K S K' instead of P + K e K' (4.23)."""
    reset: bool = True
    """Moving the references (4.29, 4.30) transports the covariance."""
    start: bool = True
    """Starts on its course and levelled by gravity, with a covariance that says what is known (5.2)."""
    forward: bool = True
    """v_x >= 0: excludes the mirror solution."""


CORRECTED = Errata()
PRINTED = Errata(*(False,) * len(Errata()))
ErrataName = Literal["corrected", "printed"]


def errata_named(errata: ErrataName | Errata) -> Errata:
    """The set of corrections behind a name.

    Parameters
    ----------
    errata : ErrataName or Errata
        A name, or the set itself.

    Returns
    -------
    Errata
        `CORRECTED`, `PRINTED`, or what was given.
    """
    if isinstance(errata, Errata):
        return errata
    return {"corrected": CORRECTED, "printed": PRINTED}[errata]


class Steps(NamedTuple):
    """The measurement vectors of a drive, one row per fix used.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Box clock, s.
    period : ndarray, shape (n,)
        Since the row before, s.
    f : ndarray, shape (n, 3)
        Decimated specific force in the A-frame, m/s².
    velocity : ndarray, shape (n, 3)
        GPS velocity of 5.1, m/s, in the convention of the errata.
    turn_rate : ndarray, shape (n,)
        Differenced course of 5.2, rad/s, in the convention of the errata.
    turning : ndarray of bool, shape (n,)
        Whether `turn_rate` was measured; not at the first moving fix after standing.
    speed : ndarray, shape (n,)
        GPS speed, m/s.
    """

    t: Floats
    period: Floats
    f: Floats
    velocity: Floats
    turn_rate: Floats
    turning: Flags
    speed: Floats


def measurement_vectors(drive: Drive, errata: Errata = CORRECTED) -> Steps:
    """Measurement vectors of 001 eqs. 4.62, 5.1 and 5.2 at the fixes of a drive.

    Starts at the first moving fix (at the first fix if there is none) and uses about four fixes per second at
    most, the rate of table 5.1.  Below 1.5 m/s the course is held; its jump when driving off is no turn rate.
    Differences of course are wrapped, so that passing north makes no peak.

    Parameters
    ----------
    drive : Drive
    errata : Errata
        `course` and `descent` decide on the signs.

    Returns
    -------
    Steps

    Raises
    ------
    TooLittleDataError
        Fewer than two fixes with accelerometer data around them.
    """
    used, f = _usable_fixes(drive)
    gnss = drive.gnss
    moving = (gnss.speed[used] >= MOVING) & np.isfinite(gnss.course[used])
    first = int(np.argmax(moving)) if moving.any() else 0
    used, f, moving = used[first:], f[first:], moving[first:]
    t, speed = gnss.t[used], gnss.speed[used]
    course = _held(gnss.course[used], moving)
    alt = _held(gnss.alt[used], np.isfinite(gnss.alt[used]))
    period = np.diff(t, prepend=t[0] - THESIS_PERIOD)
    climb = _climb(t, alt, CLIMB_WINDOW if errata.descent else 0.0)
    turn_rate = wrap(np.diff(course, prepend=course[0])) / period
    velocity = np.stack([speed * np.cos(course), speed * np.sin(course), -climb if errata.descent else climb], axis=1)
    return Steps(
        t=t,
        period=period,
        f=f,
        velocity=velocity,
        turn_rate=turn_rate if errata.course else -turn_rate,
        turning=~moving | np.append(False, moving[:-1]),
        speed=speed,
    )


def _climb(t: Floats, alt: Floats, window: float) -> Floats:
    """Difference quotient of the height over `window` s, or from fix to fix if that is longer; 0 at the start."""
    now = np.arange(t.size)
    before = np.clip(np.searchsorted(t, t - window, side="right") - 1, 0, np.maximum(now - 1, 0))
    return np.where(now > 0, alt - alt[before], 0.0) / np.where(now > 0, t - t[before], 1.0)


def _usable_fixes(drive: Drive) -> tuple[Integers, Floats]:
    """Indices of fresh fixes that the accelerometer covers, and the specific force there."""
    gnss = drive.gnss
    usable = gnss.fix & np.isfinite(gnss.speed)
    fields = np.stack([gnss.lat, gnss.lon, gnss.speed, gnss.course])
    stale = np.append(False, np.all(fields[:, 1:] == fields[:, :-1], axis=0))
    used = np.flatnonzero(usable & ~(stale & (gnss.speed >= MOVING)))
    if used.size < 2:
        raise TooLittleDataError("fixes", int(used.size), 2)
    if np.median(np.diff(gnss.t[used])) < THESIS_PERIOD / 1.5:
        # Differences of course between closer fixes are noisier than table 5.1 says.
        used = used[np.unique(np.floor(gnss.t[used] / THESIS_PERIOD), return_index=True)[1]]
    ticks = decimate(drive.inertial, 1.0 / THESIS_PERIOD)
    t, f = ticks.t[ticks.valid], ticks.f[ticks.valid]
    if t.size:
        before = np.clip(np.searchsorted(t, gnss.t[used], side="right") - 1, 0, None)
        used = used[np.abs(t[before] - gnss.t[used]) <= 1.5 * THESIS_PERIOD]
    if t.size == 0 or used.size < 2:
        raise TooLittleDataError("fixes with accelerometer data", int(used.size) if t.size else 0, 2)
    return used, np.stack([np.interp(gnss.t[used], t, f[:, axis]) for axis in range(3)], axis=1)


def _held(values: Floats, known: Flags) -> Floats:
    """Each value, or the last known one before it; before the first known one, that one; 0 when none is."""
    if not known.any():
        return np.zeros_like(values)
    last = np.maximum.accumulate(np.where(known, np.arange(values.size), -1))
    return values[np.where(last < 0, int(np.argmax(known)), last)]
