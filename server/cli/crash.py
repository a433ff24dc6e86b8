"""`scatola crash`: the events of a drive file and what they were."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

from server.settings import set_numba_cache_dir


def crash(args: argparse.Namespace) -> int:
    """Read, find the mounting, find and reconstruct the events, report."""
    set_numba_cache_dir()
    from nav_core.crash import reconstruct_drive
    from server.events.result import crash_json
    from server.formats.drive import read_drive_file

    drive = read_drive_file(args.drive)
    if args.mount is None:
        from nav_core.mounting import estimate_mounting

        _progress("mounting")
        mounting = estimate_mounting(drive)
    else:
        from server.installations.mount_file import read_mount_file

        mounting = read_mount_file(args.mount)
    _progress("events")
    result = crash_json(reconstruct_drive(drive, mounting, vehicle_class=args.vehicle_class))
    if args.json:
        print(json.dumps(result))
        return 0
    if not result["events"]:
        print(f"no event in {drive.inertial.t.size} samples (mounting {mounting.status})")
    for event in result["events"]:
        _tell(event)
    return 0


def _tell(event: dict[str, Any]) -> None:
    print(f"{event['kind']}  at {event['t0_s']:.3f} s, {1e3 * (event['t_end_s'] - event['t0_s']):.0f} ms long")
    print(f"  peak {event['peak_g']:.1f} g" + (f", {event['clipped_samples']} clipped" if event["clipped"] else ""))
    delta_v, interval = event["delta_v_kmh"], event["delta_v_interval95_kmh"]
    for name in ("longitudinal", "lateral", "resultant"):
        if delta_v[name] is not None:
            low, high = interval[name]
            print(f"  delta-V {name} {delta_v[name]:.1f} km/h  (95 %: {low:.1f} to {high:.1f})")
    if event["pdof_deg"] is not None:
        low, high = event["pdof_interval95_deg"]
        print(f"  PDOF {event['pdof_deg']:.0f}°, {event['pdof_clock']} o'clock  (95 %: {low:.0f}° to {high:.0f}°)")
    if event["impact_speed_kmh"] is not None:
        low, high = event["impact_speed_interval95_kmh"]
        print(f"  impact speed {event['impact_speed_kmh']:.1f} km/h  (95 %: {low:.1f} to {high:.1f})")
    injury = event["injury"]
    if injury is not None:
        low, high = (100.0 * each for each in injury["interval95"])
        print(f"  MAIS3+ {100.0 * injury['p_mais3']:.1f} % by {injury['curve']}  (95 %: {low:.1f} to {high:.1f})")
    for remark in event["quality_details"]:
        print(f"  - {remark['detail']}")


def _progress(what: str) -> None:
    if sys.stderr.isatty():
        print(f"scatola: {what} ...", file=sys.stderr)
