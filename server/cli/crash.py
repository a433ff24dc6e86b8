"""`scatola crash`: the events of a drive file and what they were."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from server.settings import set_numba_cache_dir

if TYPE_CHECKING:
    from nav_core.records import MountingEstimate


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
        mounting = mounting_of(json.loads(args.mount.read_text(encoding="utf-8")), args.mount)
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


def mounting_of(document: Any, path: Path) -> MountingEstimate:
    """A mounting out of what `mount --json` printed."""
    import numpy as np

    from nav_core.records import MountingChange, MountingEstimate

    if not isinstance(document, dict) or "R_va" not in document:
        raise ValueError(f"{path} is not what `scatola mount --json` prints: no R_va")
    status = document.get("status", "ready")
    if document["R_va"] is None:
        unknown = status if status in ("insufficient", "not_fixed") else "insufficient"
        return MountingEstimate(status=unknown, method="whole-drive")
    try:
        R_va = np.array(document["R_va"], dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{path}: R_va is not three rows of three numbers") from None
    if R_va.shape != (3, 3) or not np.allclose(R_va @ R_va.T, np.eye(3), atol=1e-4) or np.linalg.det(R_va) < 0.0:
        raise ValueError(f"{path}: R_va is not a rotation")
    sigma, lags = _part(document, "sigma_deg", path), _part(document, "gps_lag_s", path)
    degrees = [_number(sigma, name, f"{path}: sigma_deg") for name in ("x", "y", "z")] if sigma else [1.0] * 3
    if min(degrees) < 0.0:
        raise ValueError(f"{path}: sigma_deg is negative")
    changes = document.get("changes") or []
    if not isinstance(changes, list):
        raise ValueError(f"{path}: changes is not a list")  # noqa: TRY004 - of the file, not of an argument
    return MountingEstimate(
        status=status if status in ("ready", "settling") else "ready",
        method="whole-drive",
        R_va=R_va,
        covariance=np.diag(np.radians(np.array(degrees, dtype=np.float64)) ** 2),
        progress=1.0,
        speed_lag=None if lags.get("speed") is None else _number(lags, "speed", f"{path}: gps_lag_s"),
        course_lag=None if lags.get("course") is None else _number(lags, "course", f"{path}: gps_lag_s"),
        changes=tuple(
            MountingChange(_number(each, "t_s", where), math.radians(_number(each, "angle_deg", where)))
            for where, each in ((f"{path}: changes[{k}]", each) for k, each in enumerate(cast("list[Any]", changes)))
        ),
    )


def _part(document: dict[str, Any], name: str, path: Path) -> dict[str, Any]:
    """An object within the document; empty where there is none."""
    part = document.get(name)
    if part is not None and not isinstance(part, dict):
        raise ValueError(f"{path}: {name} is not an object")
    return cast("dict[str, Any]", part or {})


def _number(part: Any, name: str, where: str) -> float:
    value = cast("dict[str, Any]", part).get(name) if isinstance(part, dict) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{where}.{name} is not a number")
    return float(value)


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
