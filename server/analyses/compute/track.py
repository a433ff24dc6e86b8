"""The track of a drive from GPS and inertial sensors, and how it fares where GPS is taken away."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from nav_core.earth import radii
from nav_core.mounting import estimate_mounting
from nav_core.navigation import (
    Solution,
    Vehicle,
    hidden,
    inside,
    miss,
    navigate,
    navigate_without_gyro,
    outages,
    radius,
)
from nav_core.navigation.fixes import Receiver, reports
from nav_core.navigation.inertial_gnss import UNKNOWN_HEIGHT
from nav_core.records import Drive, MountingEstimate
from nav_core.timebase import ClockFit, Gap
from nav_core.typing import Floats

DRAWN = 1500
"""Moments of a track that a document has."""
CHI2_95 = -2.0 * math.log(0.05)
"""Of two degrees of freedom."""
NAMES = ("lat", "lon", "alt", "vn", "ve", "vd", "roll", "pitch", "yaw")


class Mounting(NamedTuple):
    """What navigation needs of a mounting; lags in s, None where not known."""

    R_va: Floats
    sigma: float
    speed_lag: float | None
    course_lag: float | None
    settled: bool = True


class Clock(NamedTuple):
    """The box clock against UTC, and where the fit comes from; the latency of the fixes is known from pulses alone."""

    fit: ClockFit
    source: str
    latency: float | None


def mounting_of(drive: Drive) -> Mounting:
    """From the drive itself."""
    if drive.gnss.fix.any() and not np.isfinite(drive.gnss.speed).any():
        raise ValueError("the fixes tell no speed and course, which mounting and track are made of")
    return mounting_from(estimate_mounting(drive), "the drive itself")


def mounting_from(estimate: MountingEstimate, source: str) -> Mounting:
    """What an estimate tells; `source` names it."""
    if estimate.R_va is None or estimate.sigma is None:
        reasons = " ".join(reason.text for reason in estimate.reasons) or "give one with --mount"
        raise ValueError(f"{source} does not tell the mounting; {reasons}")
    worst = float(estimate.sigma.max())
    return Mounting(estimate.R_va, worst, estimate.speed_lag, estimate.course_lag, estimate.status == "ready")


def lagged(mounting: Mounting, least: float = 0.0) -> Mounting:
    """The same with `least` for a lag that is not known, s."""
    speed, course = (least if lag is None else lag for lag in (mounting.speed_lag, mounting.course_lag))
    return mounting._replace(speed_lag=speed, course_lag=course)


def solve(drive: Drive, mounting: Mounting, *, smoothed: bool) -> Solution:
    """With the gyro where the box has one."""
    R_va, speed_lag, course_lag = mounting.R_va, mounting.speed_lag or 0.0, mounting.course_lag or 0.0
    if drive.inertial.w is None:
        return navigate_without_gyro(drive, R_va, speed_lag=speed_lag, course_lag=course_lag, smoothed=smoothed)
    vehicle = Vehicle(mount_sigma=mounting.sigma)
    return navigate(drive, R_va, vehicle=vehicle, speed_lag=speed_lag, course_lag=course_lag, smoothed=smoothed)


def track_of(solution: Solution) -> dict[str, Floats]:
    """Columns of the track: SI and radians, but degrees for latitude and longitude and their sigmas."""
    meridian, normal = radii(solution.lat)
    sigma, euler = solution.sigma, solution.euler
    if solution.method == "position-velocity":
        euler[:, :2] = np.nan  # taken to be level, not measured
    north = np.degrees(sigma[:, 0] / (meridian + solution.height))
    east = np.degrees(sigma[:, 1] / ((normal + solution.height) * np.cos(solution.lat)))
    # No fix told a height: what the filter began with is none.
    told = sigma[:, 2] < 0.5 * UNKNOWN_HEIGHT
    height, height_sigma = (np.where(told, column, np.nan) for column in (solution.height, sigma[:, 2]))
    values = (np.degrees(solution.lat), np.degrees(solution.lon), height, *solution.velocity.T, *euler.T)
    sigmas = (north, east, height_sigma, *sigma[:, 3:6].T, *solution.euler_sigma.T)
    return {
        "t": solution.t,
        **dict(zip(NAMES, values, strict=True)),
        **{f"{name}_sigma": column for name, column in zip(NAMES, sigmas, strict=True)},
    }


def report_of(
    solution: Solution, spans: tuple[Gap, ...], mounting: Mounting, clock: Clock | None = None
) -> dict[str, Any]:
    """What the command says of a track."""
    reach = radius(solution)
    speed = np.hypot(solution.velocity[:, 0], solution.velocity[:, 1])
    steps = np.diff(solution.t)
    quality = [remark.detail for remark in solution.remarks]
    inertial = solution.method == "inertial-gnss"
    if not inertial:
        quality.append("No gyro: position and velocity from accelerometer and GPS, heading from the GPS course alone")
    if not mounting.settled:
        quality.append(f"The mounting is still settling: known to ±{math.degrees(mounting.sigma):.1f}° (1-sigma)")
    if solution.rejected:
        quality.append(f"{solution.rejected} of {solution.fixes} fixes contradicted the motion and were left out")
    return {
        "method": solution.method,
        "smoothed": solution.smoothed,
        "begin_s": float(solution.t[0]),
        "end_s": float(solution.t[-1]),
        "duration_s": float(solution.t[-1] - solution.t[0]),
        "distance_km": 1e-3 * float(np.sum(0.5 * steps * (speed[1:] + speed[:-1]))),
        "max_speed_kmh": 3.6 * float(speed.max()),
        "standing_s": float(steps @ solution.still[1:]) if inertial else None,
        "fixes": solution.fixes,
        "fixes_rejected": solution.rejected,
        "radius95_m": {"median": float(np.median(reach)), "max": float(reach.max())},
        "outages": [_outage(span, solution.t, reach) for span in spans if span.end > solution.t[0]],
        "accel_bias_mps2": solution.bias[-1, :3].tolist() if inertial else None,
        "gyro_bias_deg_s": np.degrees(solution.bias[-1, 3:]).tolist() if inertial else None,
        "R_va": mounting.R_va.tolist(),
        "gps_lag_s": {"speed": mounting.speed_lag, "course": mounting.course_lag},
        "clock": None
        if clock is None
        else {
            "source": clock.source,
            "utc_at_begin": float(clock.fit.utc(solution.t[:1])[0]),
            "drift_ppm": 1e6 * clock.fit.drift,
            "sigma_s": clock.fit.sigma,
            "fix_latency_s": clock.latency,
        },
        "quality": quality,
    }


def _outage(span: Gap, t: Floats, reach: Floats) -> dict[str, float | None]:
    within = reach[(t >= span.begin) & (t <= span.end)]
    return {
        "begin_s": span.begin,
        "end_s": span.end,
        "duration_s": span.end - span.begin,
        "radius95_m": float(within.max()) if within.size else None,
    }


def rehearse(
    drive: Drive,
    *,
    outage: tuple[float, float] | None,
    smoothed: bool,
    progress: Callable[[str, float], None],
) -> dict[str, Any]:
    """The track with GPS taken away from `outage[0]` to `outage[1]` (s on the box's clock), and what that cost.

    The fixes that were withheld are the truth that the track is measured by.
    """
    progress("mounting", 0.0)
    mounting = lagged(mounting_of(drive))
    spans = outages(drive.gnss)
    span = None if outage is None else _within(drive, outage)
    progress("track", 0.4)
    part = drive if span is None else Drive(drive.inertial, hidden(drive.gnss, *span), drive.remarks)
    solution = solve(part, mounting, smoothed=smoothed)
    origin = float(solution.lat[0]), float(solution.lon[0])
    fixes = drive.gnss.fix & np.isfinite(drive.gnss.lat)
    north, east = _plane(drive.gnss.lat[fixes], drive.gnss.lon[fixes], origin)
    return {
        **report_of(solution, spans, mounting),
        "rehearsal": None if span is None else _cost(drive, solution, span, mounting.speed_lag or 0.0),
        "gps": {"t_s": _some(drive.gnss.t[fixes]), "north_m": _some(north), "east_m": _some(east)},
        "track": _drawn(solution, origin),
    }


def _within(drive: Drive, outage: tuple[float, float]) -> tuple[float, float]:
    """An outage that leaves fixes on both sides."""
    t = drive.gnss.t[drive.gnss.fix]
    begin, end = outage
    if not t.size or not t[0] < begin < end < t[-1]:
        reach = f"from {t[0]:.1f} to {t[-1]:.1f} s" if t.size else "none"
        raise ValueError(f"An outage from {begin:.1f} to {end:.1f} s must lie within the fixes of the drive: {reach}")
    return begin, end


def _cost(drive: Drive, solution: Solution, span: tuple[float, float], speed_lag: float) -> dict[str, Any]:
    """Errors against the withheld fixes, which have errors of their own: both together are what a miss is held against.

    A fix counts at the moment it describes, which is before its stamp by the receiver's lag.
    """
    gnss = drive.gnss
    withheld = replace(gnss, fix=gnss.fix & (gnss.t >= span[0]) & (gnss.t < span[1]))
    seen = reports(withheld, Receiver(), speed_lag=speed_lag)
    rows = (seen.t >= solution.t[0]) & (seen.t <= solution.t[-1])
    if not rows.any():
        raise ValueError("The chosen outage has no fix in it that could tell how well the track does without")
    found = miss(solution, seen.t[rows], seen.z[rows, 0], seen.z[rows, 1])
    values, axes = np.linalg.eigh(found.P)
    own = np.sqrt(CHI2_95 * np.maximum(values, 0.0))
    fix = seen.noise[rows, 0, 0]
    together = found._replace(P=found.P + fix[:, None, None] * np.eye(2))
    return {
        "begin_s": span[0],
        "end_s": span[1],
        "t_s": seen.t[rows].tolist(),
        "error_m": found.distance.tolist(),
        "fix_sigma_m": np.sqrt(fix).tolist(),
        "with_fix95_m": np.sqrt(CHI2_95 * np.linalg.eigvalsh(together.P)[:, 1]).tolist(),
        "ellipse95": {
            "long_m": own[:, 1].tolist(),
            "short_m": own[:, 0].tolist(),
            "axis_rad": np.arctan2(axes[:, 1, 1], axes[:, 0, 1]).tolist(),
        },
        "inside95": float(inside(together).mean()),
        "largest_error_m": float(found.distance.max()),
        "error_at_end_m": float(found.distance[-1]),
        "radius95_at_end_m": float(own[-1, 1]),
    }


def _drawn(solution: Solution, origin: tuple[float, float]) -> dict[str, Any]:
    north, east = _plane(solution.lat, solution.lon, origin)
    speed = np.hypot(solution.velocity[:, 0], solution.velocity[:, 1])
    columns = {"t_s": solution.t, "north_m": north, "east_m": east, "speed_mps": speed, "radius95_m": radius(solution)}
    return {name: _some(values) for name, values in columns.items()}


def _plane(lat: Floats, lon: Floats, origin: tuple[float, float]) -> tuple[Floats, Floats]:
    """North and east of a place, m; good for a drive's length."""
    meridian, normal = radii(np.array(origin[0]))
    return (lat - origin[0]) * float(meridian), (lon - origin[1]) * float(normal) * math.cos(origin[0])


def _some(values: Floats) -> list[float]:
    """So many values as a plot can show, the last among them."""
    rows = np.unique(np.linspace(0, values.size - 1, min(values.size, DRAWN)).astype(int))
    return values[rows].tolist()
