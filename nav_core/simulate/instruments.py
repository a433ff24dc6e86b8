"""What a box makes of the motion: sampling, bias, noise, vibration, clipping, lag, outages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfftfreq
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from nav_core.earth import radii
from nav_core.records import Gnss
from nav_core.simulate.scenario import Scenario
from nav_core.simulate.spline import Spline
from nav_core.simulate.vehicle import START, Vehicle
from nav_core.typing import Flags, Floats, Integers

_VIBRATION_STEP = 0.005
_SMOOTHING_STEP = 0.05


@dataclass(frozen=True, slots=True)
class Biases:
    """What the sensors of one box add to every sample, A axes, each of shape (3,)."""

    accel: Floats
    accel_drift: Floats
    gyro: Floats


def draw_biases(scenario: Scenario, rng: np.random.Generator) -> Biases:
    """Draw the biases of one box.

    Parameters
    ----------
    scenario : Scenario
        Says the 1-sigmas.
    rng : Generator
        Advanced.

    Returns
    -------
    Biases
        m/s² and rad/s, A-frame.
    """
    accel, drift, gyro = rng.standard_normal((3, 3))
    return Biases(scenario.accel_bias * accel, scenario.accel_bias_drift * drift, scenario.gyro_bias * gyro)


def sampling_times(scenario: Scenario, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Moments of inertial sampling and the stamps they get, box clock, s; both increase.

    Parameters
    ----------
    scenario : Scenario
        Says rate, duration and jitters.
    rng : Generator
        Advanced.

    Returns
    -------
    t : ndarray, shape (n,)
        s.
    stamps : ndarray, shape (n,)
        s.
    """
    period = 1.0 / scenario.accel_rate
    count = max(int(np.ceil(scenario.duration * scenario.accel_rate - 1e-9)), 1)
    regular = np.arange(count, dtype=np.float64) * period
    if scenario.sampling_jitter == 0.0 and scenario.stamp_jitter == 0.0:
        return regular, regular
    moved, stamped = rng.standard_normal((2, count))
    t = regular + period * np.clip(scenario.sampling_jitter * moved, -0.4, 0.4)
    room = 0.45 * np.min(np.diff(t), initial=period)
    return t, t + np.clip(scenario.stamp_jitter * stamped, -room, room)


def vibration(t: Floats, v: Floats, scenario: Scenario, rng: np.random.Generator) -> Floats:
    """Vibration of the box at these moments, V axes, m/s², shape (n, 3), for speeds `v`, m/s.

    Parameters
    ----------
    t : ndarray, shape (n,)
        s.
    v : ndarray, shape (n,)
        m/s.
    scenario : Scenario
        Says how strong it is.
    rng : Generator
        Advanced.

    Returns
    -------
    ndarray, shape (n, 3)
        m/s².
    """
    growth = np.minimum(np.abs(v) / scenario.vibration_speed, 1.0)
    high = scenario.vibration_idle + (scenario.vibration - scenario.vibration_idle) * growth
    low = scenario.vibration_low * growth
    shaken = np.empty((t.size, 3))
    for axis in range(3):
        shaken[:, axis] = high * _band(8.0, 25.0, scenario.duration, rng).value(t)
        shaken[:, axis] += low * _band(1.0, 3.0, scenario.duration, rng).value(t)
    return shaken


def _band(low: float, high: float, duration: float, rng: np.random.Generator) -> Spline:
    """Noise of unit variance between two frequencies, Hz, as a spline over 0..`duration` s."""
    count = next_fast_len(int((duration + 10.0) / _VIBRATION_STEP), real=True)
    frequency = rfftfreq(count, _VIBRATION_STEP)
    inside = (frequency >= low) & (frequency <= high)
    lines = int(inside.sum())
    spectrum = np.zeros(frequency.size, dtype=np.complex128)
    real, imaginary = rng.standard_normal((2, lines))
    # The spline passes a frequency f with sinc(f h)^4 times what interpolation of its polygon would.
    passed = np.sinc(frequency[inside] * _VIBRATION_STEP) ** 4
    spectrum[inside] = (real + 1j * imaginary) * count / (2.0 * np.sqrt(lines) * passed)
    polygon: Floats = np.asarray(irfft(spectrum, count))
    return Spline(-2.0 * _VIBRATION_STEP, _VIBRATION_STEP, polygon)


def sense_force(f_a: Floats, t: Floats, biases: Biases, scenario: Scenario, rng: np.random.Generator) -> Floats:
    """What the accelerometer says of the specific force `f_a`, m/s², shape (n, 3): clipping comes last.

    Parameters
    ----------
    f_a : ndarray, shape (n, 3)
        A-frame, m/s².
    t : ndarray, shape (n,)
        s.
    biases : Biases
        m/s².
    scenario : Scenario
        Says noise, resolution and full scale.
    rng : Generator
        Advanced.

    Returns
    -------
    ndarray, shape (n, 3)
        A-frame, m/s².
    """
    read = f_a + biases.accel + np.outer(t / scenario.duration, biases.accel_drift)
    read += scenario.accel_noise * rng.standard_normal(f_a.shape)
    if scenario.accel_resolution > 0.0:
        read = scenario.accel_resolution * np.round(read / scenario.accel_resolution)
    return np.clip(read, -scenario.accel_full_scale, scenario.accel_full_scale)


def sense_rate(w_a: Floats, biases: Biases, scenario: Scenario, rng: np.random.Generator) -> Floats:
    """What the gyro says of the angular rate `w_a`, rad/s, shape (n, 3).

    Parameters
    ----------
    w_a : ndarray, shape (n, 3)
        A-frame, rad/s.
    biases : Biases
        rad/s.
    scenario : Scenario
        Says noise and full scale.
    rng : Generator
        Advanced.

    Returns
    -------
    ndarray, shape (n, 3)
        A-frame, rad/s.
    """
    read = w_a + biases.gyro + scenario.gyro_noise * rng.standard_normal(w_a.shape)
    return np.clip(read, -scenario.gyro_full_scale, scenario.gyro_full_scale)


def draw_lags(scenario: Scenario, rng: np.random.Generator) -> tuple[float, float]:
    """Lags of speed and course, s.

    Parameters
    ----------
    scenario : Scenario
        Gives them, or up to where they are drawn.
    rng : Generator
        Advanced.

    Returns
    -------
    speed : float
        s.
    course : float
        s.
    """
    speed, course = rng.uniform(0.0, scenario.max_drawn_lag, 2)
    return (
        float(speed) if scenario.speed_lag is None else scenario.speed_lag,
        float(course) if scenario.course_lag is None else scenario.course_lag,
    )


def receive(vehicle: Vehicle, scenario: Scenario, lags: tuple[float, float], rng: np.random.Generator) -> Gnss:
    """The fixes of a drive, stamped when the box gets them.

    Parameters
    ----------
    vehicle : Vehicle
        What moves.
    scenario : Scenario
        Says rate, noise and outages of the receiver.
    lags : tuple of float
        Of speed and course, s.
    rng : Generator
        Advanced.

    Returns
    -------
    Gnss
        Box clock, s; rad, m and m/s.
    """
    t = _arrivals(scenario, rng)
    at, course_at = t - lags[0], t - lags[1]
    noise = _Noise(t.size, scenario, rng)
    antenna = np.subtract(scenario.antenna_arm or scenario.lever_arm, scenario.lever_arm)

    def of_antenna(when: Floats) -> Floats:
        motion = vehicle.at(when)
        velocity = motion.velocity + np.einsum("nij,nj->ni", motion.R_tv, np.cross(motion.w, antenna))
        return np.concatenate([velocity, vehicle.position(when) + motion.R_tv @ antenna], axis=1)

    seen = _smoothed(of_antenna, scenario) if scenario.gnss_smoothing else of_antenna
    velocity, position = np.split(seen(at), 2, axis=1)
    track = seen(course_at)[:, :3]

    speed = np.maximum(np.hypot(velocity[:, 0], velocity[:, 1]) + noise.mixed(scenario.gnss_speed_noise), 0.0)
    ground = np.hypot(track[:, 0], track[:, 1])
    slow = ground < scenario.course_floor
    across = noise.mixed(scenario.gnss_course_noise) / np.maximum(ground, scenario.course_floor)
    course = np.arctan2(track[:, 1], track[:, 0]) + across
    course = np.mod(np.where(slow, rng.uniform(0.0, 2.0 * np.pi, t.size), course), 2.0 * np.pi)
    position[:, :2] += scenario.gnss_position_noise * np.stack((noise.correlated(), noise.correlated()), axis=1)
    lat, lon = _geodetic(position, scenario)
    alt = scenario.start_alt - position[:, 2] + scenario.gnss_height_noise * noise.correlated()
    utc = scenario.start_utc + np.round(at * (1.0 + scenario.clock_drift), 3)

    fix = ~_within(t, scenario.outages)
    source = _last_before(t, scenario.frozen)
    columns = [np.where(fix, column[source], np.nan) for column in (lat, lon, alt, speed, course, utc)]
    lat, lon, alt, speed, course, utc = columns
    return Gnss(t=t, lat=lat, lon=lon, alt=alt, speed=speed, course=course, fix=fix, utc=utc)


def _smoothed(signal: Callable[[Floats], Floats], scenario: Scenario) -> Callable[[Floats], Floats]:
    """Columns of a function of time behind the receiver's low-pass, as a function of time."""
    nodes = np.arange(START, scenario.duration + _SMOOTHING_STEP, _SMOOTHING_STEP)
    columns = signal(nodes)
    keep = float(np.exp(-_SMOOTHING_STEP / scenario.gnss_smoothing))
    # Linear between the nodes: the exact share of either end of a step.
    ramp = 1.0 - (1.0 - keep) * scenario.gnss_smoothing / _SMOOTHING_STEP
    taps = [ramp, 1.0 - keep - ramp]
    begin = columns[:1] * (1.0 - ramp)
    followed, _ = lfilter(taps, [1.0, -keep], columns, axis=0, zi=begin)
    return CubicSpline(nodes, followed)


class _Noise:
    """Receiver noise, one value a fix."""

    def __init__(self, count: int, scenario: Scenario, rng: np.random.Generator) -> None:
        self._count, self._rng = count, rng
        rate = max(scenario.gnss_rate, 1e-9)
        self._keep = float(np.exp(-1.0 / (rate * scenario.gnss_correlation)))

    def correlated(self) -> Floats:
        """First-order process of unit variance, shape (n,)."""
        drive = self._rng.standard_normal(self._count)
        drive[1:] *= np.sqrt(1.0 - self._keep**2)
        process: Floats = np.asarray(lfilter([1.0], [1.0, -self._keep], drive))
        return process

    def mixed(self, sigma: float) -> Floats:
        """Half of the variance white, half correlated, shape (n,)."""
        return sigma * np.sqrt(0.5) * (self._rng.standard_normal(self._count) + self.correlated())


def _arrivals(scenario: Scenario, rng: np.random.Generator) -> Floats:
    if scenario.gnss_rate == 0.0:
        return np.empty(0)
    period = 1.0 / scenario.gnss_rate
    regular = np.arange(rng.uniform(0.0, period), scenario.duration, period)
    return regular + scenario.gnss_jitter * rng.random(regular.size)


def _within(t: Floats, spans: tuple[tuple[float, float], ...]) -> Flags:
    inside = np.zeros(t.size, dtype=np.bool_)
    for begin, end in spans:
        inside |= (t >= begin) & (t < end)
    return inside


def _last_before(t: Floats, spans: tuple[tuple[float, float], ...]) -> Integers:
    """Index of the fix whose content each fix carries: its own, or the last before it froze."""
    frozen = _within(t, spans)
    own = np.where(frozen, 0, np.arange(t.size))
    return np.maximum.accumulate(own)


def _geodetic(position: Floats, scenario: Scenario) -> tuple[Floats, Floats]:
    """Latitude and longitude, rad, of positions north and east of the start, m, along the ellipsoid."""
    meridian, normal = radii(scenario.start_lat)
    lat = scenario.start_lat + position[:, 0] / (meridian + scenario.start_alt)
    # Eastward metres are summed on the parallel on which they are driven.
    east, middle = np.diff(position[:, 1], prepend=0.0), np.concatenate((lat[:1], 0.5 * (lat[1:] + lat[:-1])))
    return lat, scenario.start_lon + np.cumsum(east / ((normal + scenario.start_alt) * np.cos(middle)))
