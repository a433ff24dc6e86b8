"""What a simulated drive is asked to be, and what it truly was."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from nav_core.earth import STANDARD_GRAVITY
from nav_core.errors import OrderError, RangeError, ShapeError
from nav_core.rotation import euler_to_matrix
from nav_core.typing import Floats

RouteName = Literal["static", "straight", "urban", "gentle", "highway", "roundabout"]
PulseShape = Literal["haversine", "half_sine", "triangle"]

MAX_LAG = 5.0
"""Longest receiver lag that can be simulated, s: the trajectory begins that long before the recording."""

_MILLI_G = 1e-3 * STANDARD_GRAVITY


@dataclass(frozen=True, slots=True, kw_only=True)
class Move:
    """The box is turned in its vehicle, at once.

    Attributes
    ----------
    t : float
        Box clock, s.
    turn : tuple of float
        Rotation vector of the box about its own axes before the move, rad:
        ``R_va_after = R_va_before @ exp([turn]x)``.  Ignored when `R_va` is given.
    R_va : ndarray, shape (3, 3), optional
        The mounting after the move.
    """

    t: float
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    R_va: Floats | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Impact:
    """A blow to the vehicle; the pulse starts at `t`.

    Attributes
    ----------
    t : float
        Start of the pulse, box clock, s.
    delta_v : float
        Resultant change of the box's velocity over the pulse, m/s.
    pdof : float
        Where the force came from, rad clockwise from straight ahead: 0 frontal, pi/2 from the right.
    duration : float
        s.
    shape : {"haversine", "half_sine", "triangle"}
    yaw_rate_change : float
        Change of the turn rate over the pulse, rad/s, positive clockwise.  `delta_v` is that of
        the box whatever this is.
    speed : float, optional
        Speed the driver has reached at `t`, m/s; None leaves it to the route.  He drives at it
        straight on from 20 s before.
    braking, braking_time : float
        The driver brakes by so much, m/s², for so long before `t`, s, down to `speed`, which must be given.
    """

    t: float
    delta_v: float
    pdof: float = 0.0
    duration: float = 0.1
    shape: PulseShape = "haversine"
    yaw_rate_change: float = 0.0
    speed: float | None = None
    braking: float = 0.0
    braking_time: float = 0.0

    def __post_init__(self) -> None:
        if self.duration <= 0.0:
            raise RangeError("impact.duration", self.duration, "> 0 s")
        if self.braking < 0.0 or (self.braking > 0.0 and self.speed is None):
            raise RangeError("impact.braking", self.braking, ">= 0 m/s², with a speed")
        if not 0.0 <= self.braking_time <= 10.0:
            raise RangeError("impact.braking_time", self.braking_time, "0..10 s")
        if self.delta_v < 0.0:
            raise RangeError("impact.delta_v", self.delta_v, ">= 0 m/s")
        if self.speed is not None and self.speed < 0.0:
            raise RangeError("impact.speed", self.speed, ">= 0 m/s")


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """A drive to simulate; every default is that of the mounting benchmarks.

    Attributes
    ----------
    route : {"static", "straight", "urban", "gentle", "highway", "roundabout"}
    duration : float
        s.
    R_va : ndarray, shape (3, 3), optional
        Mounting at the start; None draws one uniformly over all rotations.
    gravity : float
        m/s².
    accel_rate : float
        Hz; any, 10 to 1000.
    sampling_jitter : float
        The moments of sampling scatter by this share of the period (1 sigma, cut at 0.4); stamps tell.
    stamp_jitter : float
        Stamps scatter about the moments of sampling, s, 1 sigma; cut so that they keep increasing.
    accel_bias : float
        1 sigma of each axis, constant, m/s².
    accel_bias_drift : float
        1 sigma of each axis of the change from start to end, linear in time, m/s².
    accel_noise : float
        White, per sample and axis, m/s².
    accel_resolution, accel_full_scale : float
        m/s²; a resolution of 0 does not quantise.
    vibration, vibration_low : float
        1 sigma of each V axis of the 8-25 Hz and the 1-3 Hz band at `vibration_speed`, m/s².  Below,
        they grow in proportion to the speed; above, they stay.
    vibration_idle : float
        1 sigma of each V axis of the 8-25 Hz band at standstill, m/s².
    vibration_speed : float
        m/s.
    with_gyro : bool
    gyro_bias, gyro_noise : float
        1 sigma of each axis, constant and per sample, rad/s.
    gyro_full_scale : float
        rad/s.
    gnss_rate : float
        Hz; 0 simulates no receiver.
    gnss_jitter : float
        Fixes arrive late by up to this much, uniformly, s; less than a period.
    speed_lag, course_lag : float, optional
        How much older than its stamp a fix's speed and its course are, s, up to 5; position, height and
        UTC share the speed's.  None draws one from 0..`max_drawn_lag`.
    max_drawn_lag : float
        s.
    gnss_speed_noise : float
        m/s; half of the variance white, half correlated over `gnss_correlation`.
    gnss_course_noise : float
        m/s across the track, divided by the speed; composed like the speed's.
    gnss_position_noise, gnss_height_noise : float
        Each horizontal axis, and height, m; correlated over `gnss_correlation`.
    gnss_correlation : float
        Time constant, s.
    gnss_smoothing : float
        Time constant of a first-order low-pass in the receiver, through which velocity and position go
        before noise comes upon them, s; beside the lags, which are pure delays.
    course_floor : float
        Below this true speed the course is random, m/s.
    outages : tuple of (float, float)
        Without a fix from..until, box clock, s.
    frozen : tuple of (float, float)
        The receiver repeats its last fix from..until, s.
    clock_drift : float
        By which share UTC runs faster than the box clock.
    slope : float
        1 sigma of the road's grade in waves of 400 m and longer.
    crown : float, optional
        Constant bank of the road, rad, positive right side down; None draws 0.3°..1.2° with either sign.
    bank : float
        1 sigma of the varying bank, rad.
    bank_length : float
        Distance over which it is correlated, m.
    body_pitch, body_roll : float
        Suspension: nose up by acceleration, lean outward by cornering, rad per m/s².
    dive : float
        What the nose goes down by in braking, as a share of what it comes up by in accelerating: anti-dive
        and anti-squat of an axle are two different things.
    suspension_frequency, suspension_damping : float
        Hz; share of the critical damping.
    lever_arm : tuple of float
        Box from the vehicle's centre, which moves without slip, V axes, m.
    antenna_arm : tuple of float, optional
        Antenna from the centre, V axes, m; None puts it into the box.
    moves : tuple of Move
        In order of time.
    impacts : tuple of Impact
        In order of time.  After the first the driver does nothing more and friction brings the vehicle to rest.
    start_lat, start_lon : float
        rad.
    start_alt : float
        m.
    start_course : float, optional
        rad; None draws it.
    start_utc : float
        Unix time at box clock 0, s.
    """

    route: RouteName = "urban"
    duration: float = 300.0
    R_va: Floats | None = None
    gravity: float = STANDARD_GRAVITY
    accel_rate: float = 200.0
    sampling_jitter: float = 0.0
    stamp_jitter: float = 0.0
    accel_bias: float = 5.0 * _MILLI_G
    accel_bias_drift: float = 0.0
    accel_noise: float = 8.0 * _MILLI_G
    accel_resolution: float = 10.0 * _MILLI_G
    accel_full_scale: float = 11.0 * STANDARD_GRAVITY
    vibration: float = 120.0 * _MILLI_G
    vibration_low: float = 40.0 * _MILLI_G
    vibration_idle: float = 4.0 * _MILLI_G
    vibration_speed: float = 25.0
    with_gyro: bool = False
    gyro_bias: float = np.radians(0.5)
    gyro_noise: float = np.radians(0.15)
    gyro_full_scale: float = np.radians(500.0)
    gnss_rate: float = 4.0
    gnss_jitter: float = 0.0
    speed_lag: float | None = None
    course_lag: float | None = None
    max_drawn_lag: float = 0.6
    gnss_speed_noise: float = 0.08
    gnss_course_noise: float = 0.08
    gnss_position_noise: float = 2.0
    gnss_height_noise: float = 3.0
    gnss_correlation: float = 4.0
    gnss_smoothing: float = 0.0
    course_floor: float = 0.5
    outages: tuple[tuple[float, float], ...] = ()
    frozen: tuple[tuple[float, float], ...] = ()
    clock_drift: float = 0.0
    slope: float = 0.03
    crown: float | None = None
    bank: float = np.radians(0.8)
    bank_length: float = 80.0
    body_pitch: float = np.radians(2.5) / STANDARD_GRAVITY
    body_roll: float = np.radians(4.0) / STANDARD_GRAVITY
    dive: float = 1.0
    suspension_frequency: float = 1.4
    suspension_damping: float = 0.4
    lever_arm: tuple[float, float, float] = (0.8, 0.3, -0.4)
    antenna_arm: tuple[float, float, float] | None = None
    moves: tuple[Move, ...] = ()
    impacts: tuple[Impact, ...] = ()
    start_lat: float = np.radians(45.07)
    start_lon: float = np.radians(7.69)
    start_alt: float = 240.0
    start_course: float | None = None
    start_utc: float = 1_750_000_000.0

    def __post_init__(self) -> None:
        for name in ("duration", "accel_rate", "gravity", "suspension_frequency", "bank_length", "gnss_correlation"):
            if not getattr(self, name) > 0.0:
                raise RangeError(name, getattr(self, name), "> 0")
        for name in ("speed_lag", "course_lag", "max_drawn_lag"):
            lag = getattr(self, name)
            if lag is not None and not 0.0 <= lag <= MAX_LAG:
                raise RangeError(name, lag, f"0..{MAX_LAG:g} s")
        if not 0.0 <= self.gnss_smoothing <= MAX_LAG:
            raise RangeError("gnss_smoothing", self.gnss_smoothing, f"0..{MAX_LAG:g} s")
        if not 0.0 <= self.gnss_jitter * self.gnss_rate < 1.0:
            raise RangeError("gnss_jitter", self.gnss_jitter, "less than a period")
        if self.R_va is not None and np.shape(self.R_va) != (3, 3):
            raise ShapeError("R_va", np.shape(self.R_va), "(3, 3)")
        _check_order("moves", [move.t for move in self.moves], -np.inf, np.inf)
        _check_order("impacts", [impact.t for impact in self.impacts], 0.0, self.duration)

    def faultless(self) -> Scenario:
        """The same drive seen by perfect instruments: no noise, bias, lag, vibration or quantisation."""
        return replace(
            self,
            accel_bias=0.0,
            accel_bias_drift=0.0,
            accel_noise=0.0,
            accel_resolution=0.0,
            accel_full_scale=np.inf,
            stamp_jitter=0.0,
            vibration=0.0,
            vibration_low=0.0,
            vibration_idle=0.0,
            gyro_bias=0.0,
            gyro_noise=0.0,
            gyro_full_scale=np.inf,
            gnss_jitter=0.0,
            speed_lag=0.0,
            course_lag=0.0,
            gnss_smoothing=0.0,
            gnss_speed_noise=0.0,
            gnss_course_noise=0.0,
            gnss_position_noise=0.0,
            gnss_height_noise=0.0,
        )


def _check_order(name: str, times: list[float], first: float, last: float) -> None:
    for index, t in enumerate(times):
        if not first <= t <= last:
            raise RangeError(f"{name}[{index}].t", t, f"{first:g}..{last:g} s")
        if index and t < times[index - 1]:
            raise OrderError(f"{name}.t", index)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueEvent:
    """What an impact did to the box, in the V axes at `t0`.

    Attributes
    ----------
    t0 : float
        Start of the pulse, box clock, s.
    t_end : float
        End of the pulse, s.
    longitudinal, lateral, resultant : float
        Change of the box's velocity from `t0` to `t_end`, m/s: the impact's, and what brakes, and
        friction after an earlier impact, do meanwhile.
    pdof : float
        ``atan2(-lateral, -longitudinal)``, rad in (-pi, pi].
    speed : float
        The vehicle's forward speed at `t0`, m/s.
    yaw_rate_change : float
        rad/s.
    """

    t0: float
    t_end: float
    longitudinal: float
    lateral: float
    resultant: float
    pdof: float
    speed: float
    yaw_rate_change: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """Everything that the instruments of a simulated drive did not say.

    The trajectory is that at the n moments of inertial sampling.  T follows the vehicle without
    turning: Earth rate and transport rate are left out.

    Attributes
    ----------
    t : ndarray, shape (n,)
        True moments of inertial sampling, box clock, s.
    position, velocity : ndarray, shape (n, 3)
        Of the box, north, east, down of where the vehicle's centre was when the trajectory
        began (box clock ``-MAX_LAG``), m and m/s.
    v, a_x : ndarray, shape (n,)
        Forward speed of the vehicle's centre and its rate, m/s and m/s².
    slope, bank : ndarray, shape (n,)
        Of the road under the vehicle, rad; uphill and right side down are positive; crown included.
    yaw, pitch, roll : ndarray, shape (n,)
        Of the body, suspension included, rad: ``R_tv = Rz(yaw) @ Ry(pitch) @ Rx(roll)``.
    f_v, w_v : ndarray, shape (n, 3)
        Specific force at the box, m/s², and angular rate, rad/s, V axes, before any error.
    mountings : tuple of (float, ndarray)
        From when, box clock, s, and R_va, shape (3, 3); the first from ``-inf``.
    accel_bias, accel_bias_drift, gyro_bias : ndarray, shape (3,)
        A axes, m/s², m/s², rad/s; the drift is what is added from start to end.
    speed_lag, course_lag : float
        s.
    crown : float
        rad.
    events : tuple of TrueEvent
    """

    t: Floats
    position: Floats
    velocity: Floats
    v: Floats
    a_x: Floats
    slope: Floats
    bank: Floats
    yaw: Floats
    pitch: Floats
    roll: Floats
    f_v: Floats
    w_v: Floats
    mountings: tuple[tuple[float, Floats], ...]
    accel_bias: Floats
    accel_bias_drift: Floats
    gyro_bias: Floats
    speed_lag: float
    course_lag: float
    crown: float
    events: tuple[TrueEvent, ...]

    @property
    def w_z(self) -> Floats:
        """Turn rate about the body's z, rad/s, shape (n,)."""
        return self.w_v[:, 2]

    @property
    def R_va(self) -> Floats:
        """The mounting at the end, shape (3, 3)."""
        return self.mountings[-1][1]

    @property
    def R_tv(self) -> Floats:
        """Attitude of the body, shape (n, 3, 3)."""
        return euler_to_matrix(self.roll, self.pitch, self.yaw)
