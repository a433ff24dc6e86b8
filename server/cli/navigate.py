"""`scatola navigate`: the track of a drive from GPS and inertial sensors, with its uncertainty."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from server.cli.progress import progress
from server.settings import set_numba_cache_dir

if TYPE_CHECKING:
    from nav_core.navigation import Solution
    from nav_core.records import Drive
    from nav_core.timebase import Gap
    from nav_core.typing import Floats
    from server.analyses.compute import track

USUAL_LATENCY = 0.4
"""Of a receiver whose lag is not known, s: to half a second on either side its pulses can be numbered."""


def navigate(args: argparse.Namespace) -> int:
    """Read, navigate, write the track, report."""
    set_numba_cache_dir()
    from nav_core.navigation import outages
    from server.analyses.compute import track
    from server.formats.drive import read_drive_file

    drive = read_drive_file(args.drive)
    progress("mounting")
    mounting = track.mounting_of(drive) if args.mount is None else _told(args.mount)
    progress("track")
    clock = clock_of(drive, args.pulses, mounting.speed_lag)
    # No lag is shorter than the way of the message; where the drive does not tell more, it is taken for that.
    mounting = track.lagged(mounting, (clock.latency if clock is not None else None) or 0.0)
    solution = track.solve(drive, mounting, smoothed=not args.forward)
    spans = outages(drive.gnss)
    write_track(args.out, track.track_of(solution))
    if args.plot is not None:
        progress("figure")
        plot(args.plot, solution, drive, spans)
    progress("")
    report = track.report_of(solution, spans, mounting, clock)
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


def clock_of(drive: Drive, pulses: Path | None, speed_lag: float | None) -> track.Clock | None:
    """Date the box clock: by the pulse per second where a file of its box times is given, else by the fixes."""
    from nav_core.timebase import fit_clock, fit_pulses
    from server.analyses.compute import track

    utc = drive.gnss.utc
    dated = utc is not None and bool(np.isfinite(utc).any())
    if pulses is None:
        return track.Clock(fit_clock(drive.gnss.t, utc), "fixes", None) if utc is not None and dated else None
    if utc is None or not dated:
        raise ValueError("the pulses need fixes with utc, which say which second each pulse begins")
    t = read_pulses(pulses)
    inside = (t >= drive.gnss.t[0] - 60.0) & (t <= drive.gnss.t[-1] + 60.0)
    if not inside.any():
        raise ValueError(f"{pulses}: no pulse at the time of the drive; t must be the same box clock")
    coarse = fit_clock(drive.gnss.t, utc)
    fine = fit_pulses(t[inside], coarse, lag=USUAL_LATENCY if speed_lag is None else speed_lag)
    middle = np.array([coarse.t_ref])
    return track.Clock(fine, "pulses", float((fine.utc(middle) - coarse.utc(middle))[0]))


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


def _told(path: Path) -> track.Mounting:
    from server.analyses.compute.track import mounting_from
    from server.installations.mount_file import read_mount_file

    return mounting_from(read_mount_file(path), str(path))


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
