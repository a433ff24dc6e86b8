"""`scatola align --by-hand`: is one axis of the box upright, and which four mountings remain (001 §3.2)."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

    from nav_core.alignment import Place
    from nav_core.alignment.recording import Rest
    from nav_core.records import Drive, Inertial
    from nav_core.typing import Floats

AXES = "xyz"


def by_hand(args: argparse.Namespace, drive: Drive, place: Place | None) -> int:
    """Check the level of the longest rest and report the choice."""
    from nav_core.alignment import longest_rest

    rest = longest_rest(drive.inertial)
    result = by_hand_json(rest, place, args.tolerance, args.forward_axis)
    if args.plot is not None:
        draw(args.plot, drive.inertial, rest, result)
    if args.json:
        print(json.dumps(result))
    else:
        say(result)
        for remark in drive.remarks:
            print(f"  - {remark.detail}")
    return 0


def by_hand_json(rest: Rest | None, place: Place | None, tolerance: float, forward: str | None) -> dict[str, Any]:
    """All keys of `scatola align --by-hand --json`; unknown values are null."""
    from nav_core.alignment import check_level, largest_tilt, orientations
    from nav_core.alignment.recording import RESTLESS, SHORTEST
    from nav_core.earth import STANDARD_GRAVITY, gravity

    result: dict[str, Any] = {
        "status": "insufficient",
        "rest": None,
        "tolerance_g": tolerance,
        "largest_tilt_deg": math.degrees(largest_tilt(tolerance)),
        "upright": None,
        "orientations": None,
        "R_va": None,
        "reasons": [],
    }
    if rest is None:
        result["reasons"] = [f"The specific force never keeps still to {RESTLESS:g} m/s² for {SHORTEST:g} s."]
        return result
    g = STANDARD_GRAVITY if place is None else float(gravity(place.lat, place.height))
    check = check_level(rest.f, gravity=g, tolerance=tolerance)
    remaining = [_orientation(R_va) for R_va in orientations(check.axis, check.sign)]
    result |= {
        "status": "level" if check.ok else "not_level",
        "rest": {"from_s": rest.begin, "to_s": rest.end, "samples": rest.samples},
        "upright": {
            "axis": AXES[check.axis],
            "points": "up" if check.sign > 0 else "down",
            "reading_g": check.reading,
            "angle_deg": math.degrees(check.angle),
            "axis_error_g": check.axis_error,
            "cross_error_g": check.cross_error,
        },
        "orientations": remaining,
    }
    if not check.ok:
        text = f"{AXES[check.axis]} reads {check.reading:.3f} g, beyond {1.0 - tolerance:g} to {1.0 + tolerance:g} g"
        if abs(check.reading - 1.0) <= tolerance:
            text = "The whole specific force is not gravity's: the box was not at rest, or its unit is another."
        result["reasons"] = [text]
    if forward is not None:
        chosen = [each for each in remaining if each["forward"] == forward]
        if not chosen:
            choice = ", ".join(each["forward"] for each in remaining)
            raise ValueError(f"--forward-axis={forward} is upright; the axes that can point forward are {choice}")
        result["R_va"] = chosen[0]["R_va"] if check.ok else None
    return result


def _orientation(R_va: Floats) -> dict[str, Any]:
    from nav_core.rotation import matrix_to_thesis

    axis = int(abs(R_va[0]).argmax())
    angles = (math.degrees(angle) + 0.0 for angle in matrix_to_thesis(R_va))
    return {
        "forward": ("+" if R_va[0, axis] > 0.0 else "-") + AXES[axis],
        "R_va": R_va.tolist(),
        "euler_deg": dict(zip(("theta", "phi", "psi"), angles, strict=True)),
    }


def say(result: dict[str, Any]) -> None:
    """The result in a few lines."""
    print(result["status"].replace("_", " "))
    upright = result["upright"]
    if upright is not None:
        print("  at rest from {from_s:.1f} to {to_s:.1f} s ({samples} samples)".format(**result["rest"]))
        print("  {axis} points {points}: {reading_g:.3f} g, {angle_deg:.1f}° off the vertical".format(**upright))
        print(f"  within {result['tolerance_g']:g} g of 1 g, which lets {result['largest_tilt_deg']:.2f}° through")
        for number, each in enumerate(result["orientations"], start=1):
            angles = ", ".join(f"{name} {value:.0f}°" for name, value in each["euler_deg"].items())
            chosen = "  <- chosen" if each["R_va"] == result["R_va"] else ""
            print(f"  {number}. {each['forward']} forward: {angles}{chosen}")
    for reason in result["reasons"]:
        print(f"  - {reason}")


def draw(path: Path, inertial: Inertial, rest: Rest | None, result: dict[str, Any]) -> None:
    """Figure of the rest in the recording, and of its three readings against the band in which an axis is upright."""
    from matplotlib.figure import Figure

    from server.cli.align import draw_rest

    figure = Figure(figsize=(11.0, 4.4), layout="constrained")
    time, bars = figure.subplots(1, 2, width_ratios=(2.0, 1.0))
    draw_rest(time, inertial, rest)
    upright, tolerance = result["upright"], result["tolerance_g"]
    if rest is not None and upright is not None:
        # The reading of the upright axis says what gravity was taken for.
        g = abs(float(rest.f[AXES.index(upright["axis"])])) / upright["reading_g"]
        bars.bar([f"f{axis}" for axis in AXES], rest.f / g, color=[f"C{axis}" for axis in range(3)])
    for sign in (1.0, -1.0):
        bars.axhspan(sign * (1.0 - tolerance), sign * (1.0 + tolerance), color="tab:green", alpha=0.25, linewidth=0)
    bars.axhline(0.0, color="0.5", linewidth=0.8)
    bars.set(ylabel="mean at rest (g)", title=result["status"].replace("_", " "), ylim=(-1.25, 1.25))
    figure.savefig(path, dpi=120)
