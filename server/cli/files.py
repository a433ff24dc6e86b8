"""Commands that work on drive files: `mount`, `simulate`."""

from __future__ import annotations

import argparse
import json
import math
from typing import TYPE_CHECKING, Any

from server.settings import set_numba_cache_dir

if TYPE_CHECKING:
    from nav_core.simulate import Impact, Move, Truth


def mount(args: argparse.Namespace) -> int:
    """`scatola mount`: how the box of a drive file is mounted."""
    set_numba_cache_dir()
    from nav_core.mounting import estimate_mounting
    from server.formats.drive import read_drive_file
    from server.installations.result import mount_json

    drive = read_drive_file(args.drive)
    result = mount_json(estimate_mounting(drive, method=args.method, traffic_side=args.traffic_side))
    if args.json:
        told = [{"code": remark.code, "detail": remark.detail} for remark in drive.remarks]
        print(json.dumps({**result, "quality": [remark.code for remark in drive.remarks], "quality_details": told}))
        return 0
    print(f"{result['status']}  ({result['method']}, {result['percent']:.0f} %)")
    if result["euler_deg"] is not None:
        angles, sigma = result["euler_deg"], result["sigma_deg"]
        print("  theta {theta:.2f}°  phi {phi:.2f}°  psi {psi:.2f}°".format(**angles))
        print("  sigma about V x, y, z: {x:.2f}°  {y:.2f}°  {z:.2f}°".format(**sigma))
    for change in result["changes"]:
        print(f"  moved at {change['t_s']:.0f} s by {change['angle_deg']:.1f}°")
    for reason in (*result["reasons"], *(remark.detail for remark in drive.remarks)):
        print(f"  - {reason}")
    return 0


def simulate(args: argparse.Namespace) -> int:
    """`scatola simulate`: a drive file and, beside it, the truth."""
    set_numba_cache_dir()
    from nav_core.rotation import thesis_to_matrix
    from nav_core.simulate import Scenario
    from nav_core.simulate import simulate as run
    from server.formats.drive import from_drive, write_drive_file

    mounting = None
    if args.mount is not None:
        mounting = thesis_to_matrix(*(math.radians(angle) for angle in args.mount))
    scenario = Scenario(
        route=args.route,
        duration=60.0 * args.minutes,
        R_va=mounting,
        accel_rate=args.rate,
        gnss_rate=args.gps_rate,
        with_gyro=args.gyro,
        impacts=tuple(_impact(*values) for values in args.crash),
        moves=tuple(_move(*values) for values in args.move),
    )
    drive, truth = run(scenario, seed=args.seed)
    write_drive_file(args.out, from_drive(drive))
    document = truth_json(truth, seed=args.seed)
    truth_path = args.out.with_name(args.out.name + ".truth.json")
    truth_path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(document) if args.json else f"{args.out} and {truth_path}")
    return 0


def truth_json(truth: Truth, *, seed: int) -> dict[str, Any]:
    """The truth in the units of the contract's edges."""
    from nav_core.rotation import angle_between, matrix_to_thesis

    theta, phi, psi = (math.degrees(angle) for angle in matrix_to_thesis(truth.R_va))
    steps = zip(truth.mountings, truth.mountings[1:], strict=False)
    return {
        "seed": seed,
        "R_va": truth.R_va.tolist(),
        "euler_deg": {"theta": theta, "phi": phi, "psi": psi},
        "mountings": [{"from_t_s": max(t, 0.0), "R_va": R.tolist()} for t, R in truth.mountings],
        "changes": [
            {"t_s": t, "angle_deg": math.degrees(angle_between(after, before))} for (_, before), (t, after) in steps
        ],
        "gps_lag_s": {"speed": truth.speed_lag, "course": truth.course_lag},
        "events": [
            {
                "kind": "crash",
                "t0_s": event.t0,
                "t_end_s": event.t_end,
                "delta_v_kmh": {
                    "longitudinal": 3.6 * event.longitudinal,
                    "lateral": 3.6 * event.lateral,
                    "resultant": 3.6 * event.resultant,
                },
                "pdof_deg": math.degrees(event.pdof),
                "impact_speed_kmh": 3.6 * event.speed,
            }
            for event in truth.events
        ],
    }


def _impact(t: float, delta_v_kmh: float, pdof_deg: float, duration_ms: float = 100.0) -> Impact:
    from nav_core.simulate import Impact

    return Impact(t=t, delta_v=delta_v_kmh / 3.6, pdof=math.radians(pdof_deg), duration=duration_ms / 1000.0)


def _move(t: float, *turn_deg: float) -> Move:
    from nav_core.simulate import Move

    x, y, z = (math.radians(angle) for angle in turn_deg)
    return Move(t=t, turn=(x, y, z))
