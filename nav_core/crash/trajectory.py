"""The way from 30 s before to 30 s after a blow, what the driver did, and where the vehicle came to rest.

A path is reckoned from the accelerometer along the course of the fixes; a Kalman filter with smoothing estimates how
far it errs in position and velocity (`nav_core.kalman`), so that the fixes and the blow each say what they know best.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core import earth
from nav_core.crash.case import Case
from nav_core.crash.filters import moving_mean
from nav_core.crash.gps_change import SPEED_NOISE
from nav_core.crash.impact import Impact
from nav_core.events.way import Driver, Rest, Trajectory
from nav_core.kalman import filter_record, smooth
from nav_core.records import Gnss
from nav_core.typing import Flags, Floats

SPAN = 30.0
STEP = 0.1
POSITION_NOISE = 3.0
"""1 sigma of a fix's position, m; it repeats itself over `gps_change.REPEAT`."""

STRAY, STRAY_AFTER = 0.4, 1.5
"""How fast the reckoned velocity strays before and after the blow, m/s/√s."""

STRAY_BLIND = 3.0
"""The same where no inertial samples are, m/s/√s."""

STOPPED = 0.7
"""Speed of a vehicle at rest, m/s, as receivers show it."""

BRAKES = 1.5
"""Deceleration that is braking and not the engine, m/s²."""

STEERS = 0.08
"""Turn rate off the seconds before that is steering, rad/s."""


def trajectory_of(case: Case, blows: list[Impact], head: int) -> Trajectory | None:
    """Smoothed way around an event of one or more blows, its times from the one that has the headline.

    None with fewer than three fixes that have a place within `SPAN` of it.

    Parameters
    ----------
    case : Case
        The recording.
    blows : list of Impact
        Of the event, in order of time; at least one.
    head : int
        Index into `blows`; its time zero is the `t0` that times count from.

    Returns
    -------
    Trajectory or None
        Every 0.1 s and at each fix: s from `t0`, rad, m and m/s, with covariances; position in the T-frame.
    """
    gnss, first = case.gnss, blows[0]
    t0 = float(blows[head].blow.t[blows[head].blow.zero])
    struck = float(first.blow.t[first.blow.zero])
    if gnss is None:
        return None
    at = gnss.t - case.lags.speed
    use = (at >= t0 - SPAN) & (at <= t0 + SPAN) & np.isfinite(gnss.lat)
    if use.sum() < 3:
        return None
    grid = np.arange(np.ceil((max(at[use][0], t0 - SPAN) - t0) / STEP), SPAN / STEP + 1) * STEP + t0
    grid = grid[grid <= max(float(at[use][-1]), float(case.stream.t[-1]))]
    t = np.unique(np.concatenate([grid, at[use], [t0]]))
    heading, heading_sigma = _heading(case, gnss, first, t)
    origin = float(gnss.lat[use][0]), float(gnss.lon[use][0])
    own, way = _reckoned(case, blows, t, heading)
    z = _measured(gnss, use, t, origin, case, _torn(gnss.t[use], blows, case))
    x, P = _smoothed(t, struck, way, z, case)
    zero = int(np.searchsorted(t, t0))
    position = way[:, :2] + x[:, :2] - (way[zero, :2] + x[zero, :2])
    place = origin[0], origin[1], way[zero, :2] + x[zero, :2]
    lat, lon = _geodetic(place, position)
    velocity = way[:, 2:] + x[:, 2:]
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    moving = speed > STOPPED
    course = np.where(moving, np.arctan2(velocity[:, 1], velocity[:, 0]), np.nan)
    shown = np.isfinite(heading) & ((t <= struck) | (first.blow.w is not None))
    along = np.where(moving[:, None], velocity / np.maximum(speed, 1e-9)[:, None], np.sqrt(0.5))
    return Trajectory(
        t=t - t0,
        lat=lat,
        lon=lon,
        position=position,
        position_covariance=P[:, :2, :2],
        speed=speed,
        speed_sigma=np.sqrt(np.einsum("ni,nij,nj->n", along, P[:, 2:, 2:], along)),
        heading=np.mod(np.where(shown, heading, course), 2.0 * np.pi),
        heading_sigma=np.where(shown, heading_sigma, np.sqrt(P[:, 2, 2]) / np.maximum(speed, STOPPED)),
        acceleration=own,
        method="gps-inertial",
    )


def _heading(case: Case, gnss: Gnss, impact: Impact, t: Floats) -> tuple[Floats, Floats]:
    """Where the vehicle points and 1 sigma, rad: the fixes' course before the blow, then the gyro, else held."""
    blow, known = impact.blow, impact.known
    t0 = float(blow.t[blow.zero])
    at = gnss.t - case.lags.course
    use = (gnss.t <= t0) & (gnss.speed > 1.5) & np.isfinite(gnss.course)
    at_zero = known.course if known is not None and np.isfinite(known.course) else np.nan
    sigma_zero = known.course_sigma if known is not None and np.isfinite(known.course) else np.nan
    if not use.any():
        return np.full(t.size, np.nan), np.full(t.size, np.nan)
    times, courses, speeds = at[use], gnss.course[use], gnss.speed[use]
    if np.isfinite(at_zero):
        times, courses = np.append(times[times < t0], t0), np.append(courses[times < t0], at_zero)
        speeds = np.append(speeds[: times.size - 1], speeds[-1])
    heading = np.interp(t, times, np.unwrap(courses))
    sigma = np.interp(t, times, SPEED_NOISE / speeds)
    after = t > t0
    if blow.w is not None and case.w_v is not None:
        stream = case.stream
        first = int(np.searchsorted(stream.t, t0))
        turned = np.cumsum(np.nan_to_num(case.w_v[first:, 2]) * stream.step[first:])
        heading = np.where(after, heading + np.interp(t, stream.t[first:], turned - turned[0]), heading)
        sigma = np.where(after, np.hypot(np.nan_to_num(sigma_zero, nan=0.05), np.radians(1.0) * (t - t0)), sigma)
    return heading, sigma


def _reckoned(case: Case, blows: list[Impact], t: Floats, heading: Floats) -> tuple[Floats, Floats]:
    """Acceleration along and across the heading (k, 2), and north, east, their rates by reckoning from zero (k, 4)."""
    stream = case.stream
    a = (stream.f - blows[0].steady.f)[:, :2]
    for impact in blows:
        blow = impact.blow
        first = int(np.searchsorted(stream.t, blow.t[0]))
        held = np.einsum("nji,nj->ni", blow.C, impact.filled)[blow.zero : blow.last + 1, :2]
        a[first + blow.zero : first + blow.last + 1] = held
    a = np.where(np.abs(a) < 500.0, a, 0.0)
    v = np.cumsum(a * stream.step[:, None], axis=0)
    seen = (t >= stream.t[0]) & (t <= stream.t[-1])
    gained = np.column_stack([np.interp(t, stream.t, column) for column in v.T])
    smooth_a = moving_mean(a, case.rate, 0.2)
    own = np.column_stack([np.interp(t, stream.t, column) for column in smooth_a.T])
    own[~seen] = np.nan
    steps = np.diff(gained, axis=0, prepend=gained[:1])
    psi = np.nan_to_num(heading)
    # Half a step's turn is within what the filter lets stray.
    north, east = (
        np.cos(psi) * steps[:, 0] - np.sin(psi) * steps[:, 1],
        np.sin(psi) * steps[:, 0] + np.cos(psi) * steps[:, 1],
    )
    velocity = np.cumsum(np.stack((north, east), axis=1), axis=0)
    middle = 0.5 * (velocity[1:] + velocity[:-1]) * np.diff(t)[:, None]
    position = np.concatenate([np.zeros((1, 2)), np.cumsum(middle, axis=0)])
    return own, np.hstack([position, velocity])


class _Measured(NamedTuple):
    z: Floats
    r: Floats


def _torn(t: Floats, blows: list[Impact], case: Case) -> Flags:
    """Fixes, box clock, s, whose speed is of before a blow and whose course of after it, or may be: no velocity."""
    lags = np.array([case.lags.speed, case.lags.course])
    early, late = t - lags.max() - 2.0 * case.lags.sigma, t - lags.min() + 2.0 * case.lags.sigma
    torn = np.zeros(t.size, dtype=np.bool_)
    for blow in (each.blow for each in blows):
        torn |= (early < blow.t[blow.end]) & (late > blow.t[blow.zero])
    return torn


def _measured(gnss: Gnss, use: Flags, t: Floats, origin: tuple[float, float], case: Case, torn: Flags) -> _Measured:
    """North, east and their rates by the fixes at the moments that they describe; NaN at the others."""
    at = gnss.t - case.lags.speed
    meridian, normal = earth.radii(origin[0])
    k = np.searchsorted(t, at[use])
    z, r = np.full((t.size, 4), np.nan), np.ones((t.size, 4))
    z[k, 0] = (gnss.lat[use] - origin[0]) * float(meridian)
    z[k, 1] = (gnss.lon[use] - origin[1]) * float(normal) * np.cos(origin[0])
    speed, course = gnss.speed[use], gnss.course[use]
    slow = speed < 1.0
    course = np.where(np.isfinite(course), course, 0.0)
    z[k, 2], z[k, 3] = speed * np.cos(course), speed * np.sin(course)
    z[k[slow], 2] = z[k[slow], 3] = 0.0
    z[k[torn], 2] = z[k[torn], 3] = np.nan
    # Errors that repeat themselves count as often as they are new.
    usual = float(np.median(np.diff(at[use]))) if at[use].size > 1 else 1.0
    repeats = max(2.0 * 4.0 / max(usual, 0.05), 1.0)
    r[k, :2] = repeats * POSITION_NOISE**2
    turn = (case.lags.sigma * 0.2 * speed) ** 2
    r[k, 2:] = (0.5 * (1.0 + repeats) * SPEED_NOISE**2 + turn + np.where(slow, 0.5 * speed**2, 0.0))[:, None]
    return _Measured(z, r)


def _smoothed(t: Floats, t0: float, way: Floats, measured: _Measured, case: Case) -> tuple[Floats, Floats]:
    """What the reckoning errs by, (k, 4), and its covariance."""
    step = np.diff(t)
    Phi = np.broadcast_to(np.eye(4), (step.size, 4, 4)).copy()
    Phi[:, 0, 2] = Phi[:, 1, 3] = step
    inside = (t[1:] >= case.stream.t[0]) & (t[1:] <= case.stream.t[-1])
    q = np.where(inside, np.where(t[1:] <= t0, STRAY, STRAY_AFTER), STRAY_BLIND) ** 2
    Q = np.zeros((step.size, 4, 4))
    for axis in range(2):
        Q[:, axis, axis] = q * step**3 / 3.0
        Q[:, axis, axis + 2] = Q[:, axis + 2, axis] = q * step**2 / 2.0
        Q[:, axis + 2, axis + 2] = q * step
    z = measured.z - way
    start = np.diag([1e4, 1e4, 60.0**2, 60.0**2])
    filtered = filter_record(np.zeros(4), start, Phi=Phi, Q=Q, z=z, H=np.eye(4), r=measured.r, gate=30.0)
    return smooth(filtered, Phi)


def _geodetic(place: tuple[float, float, Floats], position: Floats) -> tuple[Floats, Floats]:
    lat0, lon0, offset = place
    meridian, normal = earth.radii(lat0)
    north, east = position[:, 0] + offset[0], position[:, 1] + offset[1]
    return lat0 + north / float(meridian), lon0 + east / (float(normal) * np.cos(lat0))


def rest_of(trajectory: Trajectory | None, t0: float, since: float) -> Rest | None:
    """When and where the vehicle stood for at least a second after the last blow ended, `since`, box clock, s.

    None when that is not recorded.

    Parameters
    ----------
    trajectory : Trajectory or None
        Of the event, times from `t0`; None gives None.
    t0, since : float
        Box clock, s.

    Returns
    -------
    Rest or None
        rad; distance from `t0` on and radius of 95 %, m.
    """
    if trajectory is None:
        return None
    after = trajectory.t > max(since - t0, 0.0)
    still = after & (trajectory.speed < STOPPED)
    for k in np.flatnonzero(still).tolist():
        later = (trajectory.t >= trajectory.t[k]) & (trajectory.t <= trajectory.t[k] + 1.0)
        if trajectory.t[-1] - trajectory.t[k] < 1.0:
            return None
        if still[later].all():
            large, _, _ = trajectory.ellipse(k)
            zero = int(np.searchsorted(trajectory.t, 0.0))
            distance = float(np.hypot(*(trajectory.position[k] - trajectory.position[zero])))
            at = float(trajectory.t[k]) + t0
            return Rest(
                t=at, lat=float(trajectory.lat[k]), lon=float(trajectory.lon[k]), radius95=large, distance=distance
            )
    return None


def driver_of(case: Case, first: Impact, t0: float, trajectory: Trajectory | None, rest: Rest | None) -> Driver | None:
    """The last five seconds before the first blow; times are from `t0`, box clock, s.

    None of a recording that has not half a second of them, or of an unknown mounting.

    Parameters
    ----------
    case : Case
        The recording.
    first : Impact
        The first blow of the event.
    t0 : float
        Time zero of the event's headline blow, box clock, s.
    trajectory : Trajectory or None
        Around the event, times from `t0`; None leaves the speed NaN.
    rest : Rest or None
        Where the vehicle came to rest; None gives no stopping distance.

    Returns
    -------
    Driver or None
        Every half second: s from `t0`, m/s, m/s² along V x and y, rad/s.
    """
    stream, blow = case.stream, first.blow
    struck = float(blow.t[blow.zero])
    span = min(struck - float(stream.t[0]), 5.0)
    if span < 0.5 or not case.yaw_known:
        return None
    before = np.arange(-np.floor(span / 0.5), 1.0) * 0.5
    t = before + (struck - t0)
    means = [stream.mean(t0 + each - 0.5, t0 + each) for each in t]
    a = np.array([np.full(3, np.nan) if mean is None else mean - first.steady.f for mean in means])
    speed = np.full(t.size, np.nan) if trajectory is None else np.interp(t, trajectory.t, trajectory.speed)
    rate = _yaw_rate(case, t0 + t, speed, a[:, 1])
    braked = _braked_from(case, first, struck)
    level = float(np.nanmedian(rate)) if np.isfinite(rate).any() else 0.0
    late = rate[before > -2.1]
    steered = None
    if np.isfinite(late).any():
        strongest = float(late[np.nanargmax(np.abs(late - level))]) - level
        steered = "none" if abs(strongest) < STEERS else ("right" if strongest > 0.0 else "left")
    return Driver(
        t=t,
        speed=speed,
        longitudinal=a[:, 0],
        lateral=a[:, 1],
        yaw_rate=rate,
        braked_from=None if braked is None else braked + struck - t0,
        braking=float(np.nanmax(-a[:, 0])) if np.isfinite(a[:, 0]).any() else None,
        steered=steered,
        stopping_distance=_stopping_distance(trajectory, rest, t0, (braked or 0.0) + struck - t0),
    )


def _yaw_rate(case: Case, t: Floats, speed: Floats, lateral: Floats) -> Floats:
    if case.w_v is None:
        # a_y = v w_z: at a crawl it says nothing.
        return np.where(speed > 3.0, lateral / np.maximum(speed, 3.0), np.nan)
    edges = np.searchsorted(case.stream.t, np.stack((t - 0.5, t)))
    w = case.w_v[:, 2]
    return np.array([np.nanmean(w[i:j]) if j > i and np.isfinite(w[i:j]).any() else np.nan for i, j in edges.T])


def _braked_from(case: Case, impact: Impact, t0: float) -> float | None:
    """Start of the braking that lasted until the blow, s from it (negative)."""
    stream = case.stream
    first, last = np.searchsorted(stream.t, [t0 - 10.0, t0 - 0.02])
    if last - first < 0.3 * case.rate:
        return None
    a = moving_mean(stream.f[first:last, :1] - impact.steady.f[0], case.rate, 0.3)[:, 0]
    easy = np.flatnonzero(a > -BRAKES)
    begin = int(easy[-1]) + 1 if easy.size else 0
    if begin >= a.size or stream.t[last - 1] - stream.t[first + begin] < 0.2:
        return None
    return float(stream.t[first + begin]) - t0


def _stopping_distance(trajectory: Trajectory | None, rest: Rest | None, t0: float, begin: float) -> float | None:
    if trajectory is None or rest is None:
        return None
    inside = (trajectory.t >= begin) & (trajectory.t <= rest.t - t0)
    if inside.sum() < 2:
        return None
    return float(np.hypot(*np.diff(trajectory.position[inside], axis=0).T).sum())
