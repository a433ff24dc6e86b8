"""`scatola align`: the attitude of a box at its longest rest in a drive file."""

from __future__ import annotations

import argparse
import json
import math
from typing import TYPE_CHECKING, Any

from server.cli.progress import progress
from server.settings import set_numba_cache_dir

if TYPE_CHECKING:
    from pathlib import Path

    from nav_core.alignment import Alignment, Attitude, Place
    from nav_core.alignment.recording import Rest
    from nav_core.earth import MagneticField
    from nav_core.records import Drive, Inertial

PER_HOUR = math.degrees(3600.0)
"""°/h in a rad/s."""


def align(args: argparse.Namespace) -> int:
    """`scatola align`."""
    set_numba_cache_dir()
    from nav_core.alignment import Trust
    from nav_core.alignment import align as run
    from server.formats.drive import read_drive_file

    progress("reading")
    drive = read_drive_file(args.file)
    place, field = surroundings(drive, args.lat, args.lon, args.height, args.year)
    if args.by_hand:
        from server.cli.by_hand import by_hand

        progress("")
        return by_hand(args, drive, place)
    trust = Trust(
        accelerometer=args.accel_bias_mg * 9.80665e-3,
        gyro=args.gyro_bias_deg_per_hour / PER_HOUR,
        magnetometer=args.field_sigma_ut,
        heading=math.radians(args.heading_limit_deg),
    )
    progress(f"looking for rest in {drive.inertial.t.size} samples")
    found = run(drive.inertial, place=place, field=field, trust=trust)
    progress("")
    if args.plot is not None:
        draw(args.plot, drive.inertial, found)
    result = align_json(found)
    if args.json:
        print(json.dumps(result))
    else:
        say(result)
        for remark in drive.remarks:
            print(f"  - {remark.detail}")
    return 0


def surroundings(
    drive: Drive, lat: float | None, lon: float | None, height: float | None, year: float | None
) -> tuple[Place | None, MagneticField | None]:
    """Place and magnetic field, from the options (degrees, m) where given, else from the file's fixes."""
    import numpy as np

    from nav_core.alignment import Place
    from nav_core.earth import FIRST_YEAR, LAST_YEAR, decimal_year, magnetic_field

    def typical(values: Any) -> float | None:
        known = values[np.isfinite(values)] if values is not None else np.zeros(0)
        return float(np.median(known)) if known.size else None

    def chosen(option: float | None, from_fixes: float | None) -> float | None:
        return from_fixes if option is None else math.radians(option)

    gnss = drive.gnss
    latitude, longitude = chosen(lat, typical(gnss.lat)), chosen(lon, typical(gnss.lon))
    utc = typical(gnss.utc)
    if height is None:
        height = typical(gnss.alt) or 0.0
    if year is None and utc is not None:
        # A receiver that does not know its date yet, or a week that rolled over, leaves the field unknown.
        dated = decimal_year(utc)
        year = dated if FIRST_YEAR <= dated < LAST_YEAR else None
    place = None if latitude is None else Place(latitude, height)
    if latitude is None or longitude is None or year is None:
        return place, None
    return place, magnetic_field(latitude, longitude, height, year)


def align_json(found: Alignment) -> dict[str, Any]:
    """All keys of `scatola align --json`; unknown values are null."""
    rest, levelled = found.rest, found.levelling
    settled = "levelled" if found.best is None else "aligned"
    return {
        "status": "insufficient" if rest is None else settled,
        "rest": None if rest is None else {"from_s": rest.begin, "to_s": rest.end, "samples": rest.samples},
        "levelling": None
        if levelled is None
        else {
            "roll_deg": math.degrees(levelled.roll),
            "pitch_deg": math.degrees(levelled.pitch),
            "sigma_deg": math.degrees(levelled.sigma),
            "excess_mps2": levelled.excess,
        },
        "gyrocompass": _compass(found),
        "magnetic": _magnetic(found),
        "heading_from": found.source,
        "R_ta": None if found.best is None else found.best.R_ta.tolist(),
        "euler_deg": None if found.best is None else _euler(found.best),
        "sigma_deg": None if found.best is None else _sigma(found.best),
        "reasons": [reason.text for reason in found.reasons],
        "reason_codes": [reason.code for reason in found.reasons],
    }


def _euler(attitude: Attitude) -> dict[str, float]:
    return dict(zip(("roll", "pitch", "yaw"), map(math.degrees, attitude.euler), strict=True))


def _sigma(attitude: Attitude) -> dict[str, float]:
    return dict(zip(("north", "east", "down"), map(math.degrees, attitude.sigma), strict=True))


def _compass(found: Alignment) -> dict[str, Any] | None:
    compass = found.compass
    if compass is None:
        return None
    return {
        "status": compass.status,
        "yaw_deg": None if compass.attitude is None else math.degrees(compass.attitude.euler[2]),
        "sigma_yaw_deg": math.degrees(compass.sigma_yaw),
        "earth_rate_north_dph": compass.horizontal_rate * PER_HOUR,
        "sigma_rate_dph": compass.sigma_rate * PER_HOUR,
        "needed_rate_dph": compass.needed_rate * PER_HOUR,
        "chi2": compass.chi2,
    }


def _magnetic(found: Alignment) -> dict[str, Any] | None:
    magnetic = found.magnetic
    if magnetic is None:
        return None
    return {
        "plausible": magnetic.plausible,
        "chi2": magnetic.fitted.chi2,
        "master_slave": {"euler_deg": _euler(magnetic.ruled), "sigma_deg": _sigma(magnetic.ruled)},
        "gauss_newton": {
            "euler_deg": _euler(magnetic.fitted.attitude),
            "sigma_deg": _sigma(magnetic.fitted.attitude),
            "rounds": magnetic.fitted.rounds,
        },
    }


def say(result: dict[str, Any]) -> None:
    """The result in a few lines."""
    rest, level, compass, magnetic = (result[key] for key in ("rest", "levelling", "gyrocompass", "magnetic"))
    print(result["status"])
    if rest is not None:
        print("  at rest from {from_s:.1f} to {to_s:.1f} s ({samples} samples)".format(**rest))
        print("  roll {roll_deg:.2f}°  pitch {pitch_deg:.2f}°  ± {sigma_deg:.2f}°".format(**level))
    if compass is not None:
        sigma = compass["sigma_yaw_deg"]
        spread = f"{sigma:.2g}°" if sigma < 90.0 else "beyond 90°"
        print(f"  heading by the Earth's turning: {compass['status']}, 1-sigma {spread}")
    if magnetic is not None:
        yaw, sigma = magnetic["master_slave"]["euler_deg"]["yaw"], magnetic["master_slave"]["sigma_deg"]["down"]
        print(f"  heading by the magnetic field: {yaw:.1f}° ± {sigma:.1f}°")
    if result["euler_deg"] is not None:
        yaw, sigma = result["euler_deg"]["yaw"], result["sigma_deg"]["down"]
        print(f"  heading {yaw:.2f}° ± {sigma:.2f}° ({result['heading_from']})")
    for reason in result["reasons"]:
        print(f"  - {reason}")


def draw(path: Path, inertial: Inertial, found: Alignment) -> None:
    """Figure of the rest in the recording, and of the headings with their 95 % sectors."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 4.8), layout="constrained")
    grid = figure.add_gridspec(1, 2, width_ratios=[2.0, 1.0])
    time, compass = figure.add_subplot(grid[0]), figure.add_subplot(grid[1], projection="polar")
    draw_rest(time, inertial, found.rest)
    _rose(compass, found)
    figure.savefig(path, dpi=120)


def draw_rest(axes: Any, inertial: Inertial, rest: Rest | None) -> None:
    """The specific force of the recording, the rest in it shaded."""
    for name, values in zip("xyz", inertial.f.T, strict=True):
        axes.plot(inertial.t, values, linewidth=0.7, label=f"f{name}")
    axes.set(xlabel="box clock (s)", ylabel="specific force (m/s²)", title="Where the box was at rest")
    if rest is not None:
        axes.axvspan(rest.begin, rest.end, color="tab:green", alpha=0.2, label="rest used")
    axes.legend(loc="upper right", fontsize="small")


def _rose(axes: Any, found: Alignment) -> None:
    """Headings as sectors of a compass rose; a heading that is not observable fills all of it."""
    axes.set(theta_zero_location="N", theta_direction=-1, yticks=[], ylim=(0.0, 1.0))
    sectors: list[tuple[str, str, float | None, float]] = []
    if found.compass is not None:
        attitude = found.compass.attitude
        yaw = None if attitude is None else float(attitude.euler[2])
        sectors.append((f"Earth's turning: {found.compass.status}", "tab:blue", yaw, found.compass.sigma_yaw))
    if found.magnetic is not None:
        ruled = found.magnetic.ruled
        name = "magnetic field" if found.magnetic.plausible else "magnetic field: disturbed"
        sectors.append((name, "tab:red", float(ruled.euler[2]), float(ruled.sigma[2])))
    for place, (name, colour, yaw, sigma) in enumerate(sectors):
        half = math.pi if yaw is None else min(1.96 * sigma, math.pi)
        axes.bar(
            0.0 if yaw is None else yaw,
            0.35,
            width=max(2.0 * half, 0.01),
            bottom=0.6 - 0.4 * place,
            color=colour,
            alpha=0.2 if yaw is None else 0.8,
            label=name,
        )
    if sectors:
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, -0.3), fontsize="small")
    else:
        axes.text(0.0, 0.0, "no heading", ha="center", va="center", color="0.4")
    level = found.levelling
    tilt = (
        "no rest" if level is None else f"roll {math.degrees(level.roll):.1f}°, pitch {math.degrees(level.pitch):.1f}°"
    )
    axes.set_title(f"Heading, 95 % ({tilt})")
