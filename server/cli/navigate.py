"""`scatola navigate`: the track of a drive from GPS and inertial sensors, with its uncertainty."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from server.cli.progress import progress
from server.settings import set_numba_cache_dir

if TYPE_CHECKING:
    from nav_core.navigation import Solution
    from nav_core.records import Drive
    from nav_core.timebase import ClockFit, Gap
    from nav_core.typing import Floats

NAMES = ("lat", "lon", "alt", "vn", "ve", "vd", "roll", "pitch", "yaw")


USUAL_LATENCY = 0.4
"""Of a receiver whose lag is not known, s: to half a second on either side its pulses can be numbered."""


class Mounting(NamedTuple):
    """What navigation needs of a mounting; lags in s, None where not known."""

    R_va: Floats
    sigma: float
    speed_lag: float | None
    course_lag: float | None


class Clock(NamedTuple):
    """The box clock against UTC, and where the fit comes from; the latency of the fixes is known from pulses alone."""

    fit: ClockFit
    source: str
    latency: float | None


def navigate(args: argparse.Namespace) -> int:
    """Read, navigate, write the track, report."""
    set_numba_cache_dir()
    from nav_core.navigation import Vehicle, navigate_without_gyro, outages
    from nav_core.navigation import navigate as run
    from server.formats.drive import read_drive_file

    drive = read_drive_file(args.drive)
    progress("mounting")
    mounting = _mounting(drive, args.mount)
    progress("track")
    clock = clock_of(drive, args.pulses, mounting.speed_lag)
    R_va, smoothed = mounting.R_va, not args.forward
    # No lag is shorter than the way of the message; where the drive does not tell more, it is taken for that.
    least = (clock.latency if clock is not None else None) or 0.0
    speed_lag = least if mounting.speed_lag is None else mounting.speed_lag
    course_lag = least if mounting.course_lag is None else mounting.course_lag
    if drive.inertial.w is None:
        solution = navigate_without_gyro(drive, R_va, speed_lag=speed_lag, course_lag=course_lag, smoothed=smoothed)
    else:
        vehicle = Vehicle(mount_sigma=mounting.sigma)
        solution = run(drive, R_va, vehicle=vehicle, speed_lag=speed_lag, course_lag=course_lag, smoothed=smoothed)
    spans = outages(drive.gnss)
    table = track_of(solution)
    write_track(args.out, table)
    if args.plot is not None:
        progress("figure")
        plot(args.plot, solution, drive, spans)
    progress("")
    report = report_of(solution, spans, mounting._replace(speed_lag=speed_lag, course_lag=course_lag), clock)
    if args.json:
        print(json.dumps({"out": str(args.out), **report}))
        return 0
    print(f"{args.out}: {report['distance_km']:.3f} km in {report['duration_s']:.0f} s, {report['method']}")
    print(f"  95 % within {report['radius95_m']['median']:.1f} m (median), {report['radius95_m']['max']:.1f} m (worst)")
    if clock is not None and clock.latency is not None:
        print(f"  dated by the pulses, ±{clock.fit.sigma:.2g} s; fixes arrive {clock.latency:.3f} s after their moment")
    for span in report["outages"]:
        reach = span["radius95_m"]
        within = "no inertial data either" if reach is None else f"within {reach:.1f} m"
        print(f"  no GPS from {span['begin_s']:.1f} s for {span['duration_s']:.1f} s: {within}")
    for remark in report["quality"]:
        print(f"  - {remark}")
    return 0


def track_of(solution: Solution) -> dict[str, Floats]:
    """Columns of the track: SI and radians, but degrees for latitude and longitude and their sigmas."""
    from nav_core.earth import radii

    meridian, normal = radii(solution.lat)
    sigma, euler = solution.sigma, solution.euler
    if solution.method == "position-velocity":
        euler[:, :2] = np.nan  # taken to be level, not measured
    north = np.degrees(sigma[:, 0] / (meridian + solution.height))
    east = np.degrees(sigma[:, 1] / ((normal + solution.height) * np.cos(solution.lat)))
    values = (np.degrees(solution.lat), np.degrees(solution.lon), solution.height, *solution.velocity.T, *euler.T)
    sigmas = (north, east, sigma[:, 2], *sigma[:, 3:6].T, *solution.euler_sigma.T)
    return {
        "t": solution.t,
        **dict(zip(NAMES, values, strict=True)),
        **{f"{name}_sigma": column for name, column in zip(NAMES, sigmas, strict=True)},
    }


def write_track(path: Path, columns: dict[str, Floats]) -> None:
    """Parquet where the name ends so, else CSV; nothing where not known."""
    import pyarrow as pa
    import pyarrow.parquet as pq
    from pyarrow import csv

    table = pa.table({name: pa.array(values, mask=np.isnan(values)) for name, values in columns.items()})
    if path.suffix.lower() == ".parquet":
        pq.write_table(table, path, compression="zstd")
    else:
        csv.write_csv(table, path, csv.WriteOptions(quoting_style="none", quoting_header="none"))


def clock_of(drive: Drive, pulses: Path | None, speed_lag: float | None) -> Clock | None:
    """Date the box clock: by the pulse per second where a file of its box times is given, else by the fixes."""
    from nav_core.timebase import fit_clock, fit_pulses

    utc = drive.gnss.utc
    dated = utc is not None and bool(np.isfinite(utc).any())
    if pulses is None:
        return Clock(fit_clock(drive.gnss.t, utc), "fixes", None) if utc is not None and dated else None
    if utc is None or not dated:
        raise ValueError("the pulses need fixes with utc, which say which second each pulse begins")
    t = read_pulses(pulses)
    inside = (t >= drive.gnss.t[0] - 60.0) & (t <= drive.gnss.t[-1] + 60.0)
    if not inside.any():
        raise ValueError(f"{pulses}: no pulse at the time of the drive; t must be the same box clock")
    coarse = fit_clock(drive.gnss.t, utc)
    fine = fit_pulses(t[inside], coarse, lag=USUAL_LATENCY if speed_lag is None else speed_lag)
    middle = np.array([coarse.t_ref])
    return Clock(fine, "pulses", float((fine.utc(middle) - coarse.utc(middle))[0]))


def read_pulses(path: Path) -> Floats:
    """Box times of the pulses, s: the column `t` of a CSV file."""
    import pyarrow as pa
    from pyarrow import csv

    try:
        column = csv.read_csv(path)["t"].cast(pa.float64())
    except (KeyError, pa.ArrowInvalid) as error:
        raise ValueError(f"{path}: a CSV file with a column t of numbers is needed ({error})") from error
    t: Floats = column.to_numpy()
    if not np.isfinite(t).all():
        raise ValueError(f"{path}: row {int(np.argmin(np.isfinite(t))) + 2} is no number")
    return t


def report_of(
    solution: Solution, spans: tuple[Gap, ...], mounting: Mounting, clock: Clock | None = None
) -> dict[str, Any]:
    """What the command says of a track."""
    from nav_core.navigation import radius

    reach = radius(solution)
    speed = np.hypot(solution.velocity[:, 0], solution.velocity[:, 1])
    steps = np.diff(solution.t)
    quality = [remark.detail for remark in solution.remarks]
    inertial = solution.method == "inertial-gnss"
    if not inertial:
        quality.append("No gyro: position and velocity from accelerometer and GPS, heading from the GPS course alone")
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


def _mounting(drive: Drive, path: Path | None) -> Mounting:
    from server.installations.result import mount_json

    if path is None:
        from nav_core.mounting import estimate_mounting

        document, source = mount_json(estimate_mounting(drive)), "the drive itself"
    else:
        document, source = json.loads(path.read_text(encoding="utf-8")), str(path)
    if not isinstance(document, dict) or document.get("R_va") is None:
        reasons: list[str] = document.get("reasons") or [] if isinstance(document, dict) else []
        raise ValueError(f"{source} does not tell the mounting; {' '.join(reasons) or 'give one with --mount'}")
    lags: dict[str, float | None] = document.get("gps_lag_s") or {}
    sigma = document.get("sigma_deg")
    return Mounting(
        np.array(document["R_va"], dtype=np.float64),
        math.radians(max(sigma.values())) if sigma else math.radians(1.0),
        lags.get("speed"),
        lags.get("course"),
    )


def plot(path: Path, solution: Solution, drive: Drive, spans: tuple[Gap, ...]) -> None:
    """Way, speed and uncertainty in one figure; outages are shaded."""
    from matplotlib.figure import Figure

    from nav_core.navigation import radius

    figure: Any = Figure(figsize=(11.0, 6.5), layout="constrained")
    way, speed, reach = figure.subplot_mosaic([["way", "speed"], ["way", "reach"]]).values()
    fixes = drive.gnss.fix
    way.plot(np.degrees(drive.gnss.lon[fixes]), np.degrees(drive.gnss.lat[fixes]), ".", ms=3, color="0.65", label="GPS")
    way.plot(np.degrees(solution.lon), np.degrees(solution.lat), color="tab:blue", lw=1.2, label="track")
    for number, span in enumerate(spans):
        dark = (solution.t >= span.begin) & (solution.t <= span.end)
        name = "without GPS" if number == 0 else None
        way.plot(np.degrees(solution.lon[dark]), np.degrees(solution.lat[dark]), color="tab:red", lw=2.0, label=name)
        for axes in (speed, reach):
            axes.axvspan(span.begin, span.end, color="tab:red", alpha=0.15, lw=0)
    way.set(xlabel="longitude [°]", ylabel="latitude [°]", title=f"Track ({solution.method})")
    way.set_aspect(1.0 / math.cos(float(solution.lat[0])), adjustable="datalim")
    way.ticklabel_format(useOffset=False)
    way.tick_params(axis="x", labelrotation=30)
    way.legend(loc="best")
    speed.plot(drive.gnss.t[fixes], 3.6 * drive.gnss.speed[fixes], ".", ms=3, color="0.65")
    speed.plot(solution.t, 3.6 * np.hypot(solution.velocity[:, 0], solution.velocity[:, 1]), color="tab:blue", lw=1.2)
    speed.set(xlabel="box clock [s]", ylabel="speed [km/h]")
    reach.plot(solution.t, radius(solution), color="tab:blue", lw=1.2)
    reach.set(xlabel="box clock [s]", ylabel="95 % radius [m]", ylim=(0.0, None))
    figure.savefig(path, dpi=130)
