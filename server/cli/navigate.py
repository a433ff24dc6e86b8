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
    from nav_core.timebase import Gap
    from nav_core.typing import Floats

NAMES = ("lat", "lon", "alt", "vn", "ve", "vd", "roll", "pitch", "yaw")


class Mounting(NamedTuple):
    """What navigation needs of a mounting."""

    R_va: Floats
    sigma: float
    speed_lag: float
    course_lag: float


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
    R_va, smoothed = mounting.R_va, not args.forward
    speed_lag, course_lag = mounting.speed_lag, mounting.course_lag
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
    report = report_of(solution, spans, mounting)
    if args.json:
        print(json.dumps({"out": str(args.out), **report}))
        return 0
    print(f"{args.out}: {report['distance_km']:.3f} km in {report['duration_s']:.0f} s, {report['method']}")
    print(f"  95 % within {report['radius95_m']['median']:.1f} m (median), {report['radius95_m']['max']:.1f} m (worst)")
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


def report_of(solution: Solution, spans: tuple[Gap, ...], mounting: Mounting) -> dict[str, Any]:
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
    lags = document.get("gps_lag_s") or {}
    sigma = document.get("sigma_deg")
    return Mounting(
        np.array(document["R_va"], dtype=np.float64),
        math.radians(max(sigma.values())) if sigma else math.radians(1.0),
        float(lags.get("speed") or 0.0),
        float(lags.get("course") or 0.0),
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
