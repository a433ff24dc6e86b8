"""`scatola calibrate`: parameters of a sensor from poses, a turntable, a reference, or any motion (magnetometer)."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from server.cli.progress import progress
from server.cli.triads import TRIADS, UNITS, Triad, read_triad
from server.formats.columns import Floats
from server.formats.drive import DriveFileError
from server.settings import set_numba_cache_dir

if TYPE_CHECKING:
    from nav_core.sensors import Calibration, TemperatureFit, TurnOnBias

_ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")
_STEADY = 0.1
"""Share by which a mean rate may miss one of the turntable's and still be taken for it; real scales miss by less."""


@dataclass(frozen=True)
class _Result:
    """A calibration, what it was made of, and its errors before and after."""

    method: str
    calibration: Calibration
    before: Floats
    field: float | None = None


def calibrate(args: argparse.Namespace) -> int:
    """`scatola calibrate`."""
    set_numba_cache_dir()
    triad = read_triad(args.file, args.sensor)
    quality: list[str] = []
    progress(f"{args.sensor}: {len(triad.t)} samples")
    result = _by_reference(args, triad) if args.reference is not None else _by_itself(args, triad, quality)
    turn_on, temperature = _at_rest(triad, args, quality) if args.sensor == "gyro" else (None, None)
    progress("")
    if result is None and turn_on is None:
        raise DriveFileError("; ".join(quality) or "the gyro was never at rest")
    document = {
        "file": str(args.file),
        "sensor": args.sensor,
        "unit": UNITS[args.sensor],
        "method": "rest" if result is None else result.method,
        **_calibration_json(result),
        "turn_on_bias": _turn_on_json(turn_on),
        "temperature": _temperature_json(temperature),
        "quality": quality,
    }
    if args.plot is not None:
        if result is None:
            raise DriveFileError("nothing to plot: bias at rest alone; give --reference or --speeds")
        _plot(args.plot, args.sensor, result)
    print(json.dumps(document) if args.json else _in_words(document))
    return 0


def _by_itself(args: argparse.Namespace, triad: Triad, quality: list[str]) -> _Result | None:
    from nav_core.sensors import calibrate_field, calibrate_positions

    if args.sensor == "mag":
        size = None if args.field is None else float(np.linalg.norm(args.field))
        found = calibrate_field(triad.values, size)
        before = np.linalg.norm(triad.values, axis=1) - found.field
        return _Result("ellipsoid", found.calibration, before, found.field)
    if args.sensor == "gyro" and args.speeds is None:
        quality.append("bias only: give --speeds for a turntable or --reference for scale and misalignment")
        return None
    poses = _poses(args, triad)
    if args.sensor == "accel":
        calibration = calibrate_positions(poses, args.gravity)
        return _Result("positions", calibration, np.linalg.norm(poses, axis=1) - args.gravity)
    speeds = np.radians(np.abs(args.speeds))
    turning = np.linalg.norm(poses, axis=1)
    nearest = speeds[np.argmin(np.abs(turning[:, None] - speeds), axis=1)]
    meant = np.abs(turning - nearest) < _STEADY * nearest
    dropped = int(np.count_nonzero(~meant))
    if dropped:
        quality.append(f"{dropped} steady stretches turn at none of the given rates; not used")
    calibration = calibrate_positions(poses[meant], nearest[meant])
    return _Result("turntable", calibration, (turning - nearest)[meant])


def _poses(args: argparse.Namespace, triad: Triad) -> Floats:
    """Mean readings of the poses: rows as they are, or stretches in which the readings do not change."""
    from nav_core.sensors import interval_means, static_intervals

    if args.poses:
        return triad.values
    stretches = static_intervals(triad.t, triad.values, window=args.window, shortest=args.window)
    return interval_means(triad.values, stretches).mean


def _by_reference(args: argparse.Namespace, triad: Triad) -> _Result:
    from nav_core.sensors import calibrate_reference

    t, truth = _reference(args)
    inside = (triad.t >= t[0]) & (triad.t <= t[-1])
    at = np.column_stack([np.interp(triad.t[inside], t, column) for column in truth.T])
    return _Result("reference", calibrate_reference(triad.values[inside], at), triad.values[inside] - at)


def _reference(args: argparse.Namespace) -> tuple[Floats, Floats]:
    """Times and true input of a reference file."""
    from nav_core.sensors import reference_rates, reference_vectors

    with args.reference.open(encoding="utf-8-sig") as file:
        names = [name.strip() for name in file.readline().split(",")]
    wanted = TRIADS[args.sensor]
    if set(wanted) <= set(names):
        reference = read_triad(args.reference, args.sensor)
        return reference.t, reference.values
    if not {"t", *_ANGLES} <= set(names):
        raise DriveFileError(
            f"{args.reference}: columns t and {', '.join(wanted)}, or t and {', '.join(_ANGLES)} needed"
        )
    columns = np.loadtxt(args.reference, delimiter=",", skiprows=1, ndmin=2, encoding="utf-8-sig")
    t = columns[:, names.index("t")]
    euler = np.unwrap(np.radians(columns[:, [names.index(name) for name in _ANGLES]]), axis=0)
    if not (np.isfinite(columns).all() and t.size > 4 and np.all(np.diff(t) > 0.0)):
        raise DriveFileError(f"{args.reference}: at least 5 rows, complete, in the order of time are needed")
    if args.sensor == "gyro":
        return t, reference_rates(t, euler)
    if args.sensor == "accel":
        return t, reference_vectors(euler, np.array([0.0, 0.0, -args.gravity]))
    if args.field is None or len(args.field) != 3:
        raise DriveFileError("attitudes alone do not give the field: --field NORTH,EAST,DOWN in µT is needed")
    return t, reference_vectors(euler, np.array(args.field))


def _at_rest(
    triad: Triad, args: argparse.Namespace, quality: list[str]
) -> tuple[TurnOnBias | None, TemperatureFit | None]:
    """Bias of a gyro over its first 2 s, and against temperature where the file has it."""
    from nav_core.errors import NavigationError
    from nav_core.sensors import fit_temperature, static_intervals, turn_on_bias

    if args.poses:
        return None, None
    try:
        turn_on = turn_on_bias(triad.t, triad.values)
    except NavigationError as error:
        quality.append(f"no turn-on bias: {error}")
        turn_on = None
    known = None if triad.temp is None else np.flatnonzero(~np.isnan(triad.temp))
    if triad.temp is None or known is None or args.speeds is not None or args.reference is not None:
        return turn_on, None
    try:
        stretches = static_intervals(triad.t[known], triad.values[known], window=args.window, shortest=args.window)
        rows = np.concatenate([known[:0], *(known[begin:end] for begin, end in stretches)])
        return turn_on, fit_temperature(triad.temp[rows], triad.values[rows])
    except NavigationError as error:
        quality.append(f"no line against temperature: {error}")
        return turn_on, None


def _calibration_json(result: _Result | None) -> dict[str, Any]:
    if result is None:
        keys = ("parameters", "gain", "bias", "matrix", "rms_before", "rms_after", "poses", "field_ut")
        return dict.fromkeys(keys)
    found = result.calibration
    rows = zip(found.names, found.values, found.sigma, found.interval(), strict=True)
    return {
        "parameters": [
            {"name": name, "value": float(value), "sigma": float(sigma), "interval95": interval.tolist()}
            for name, value, sigma, interval in rows
        ],
        "gain": found.gain.tolist(),
        "bias": found.bias.tolist(),
        "matrix": found.matrix.tolist(),
        "rms_before": np.sqrt(np.mean(result.before**2, axis=0)).tolist(),
        "rms_after": found.rms.tolist(),
        "poses": {
            "count": found.poses.count,
            "needed": found.poses.needed,
            "condition": found.poses.condition,
            "enough": True,
        },
        "field_ut": result.field,
    }


def _turn_on_json(found: TurnOnBias | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {"bias": found.bias.tolist(), "sigma": np.sqrt(np.diag(found.covariance)).tolist(), "samples": found.count}


def _temperature_json(found: TemperatureFit | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "slope_per_k": found.slope.tolist(),
        "slope_interval95": found.interval().tolist(),
        "bias_at_25_c": found.offset.tolist(),
        "span_c": list(found.span),
    }


def _in_words(document: dict[str, Any]) -> str:
    unit = document["unit"]
    lines = [f"{document['sensor']}, method {document['method']}"]
    for entry in document["parameters"] or ():
        low, high = entry["interval95"]
        lines.append(f"  {entry['name']:<9} {entry['value']:>12.6g}   95 %: {low:.6g} .. {high:.6g}")
    if document["poses"] is not None:
        before, after = np.atleast_1d(document["rms_before"]), np.atleast_1d(document["rms_after"])
        for name, values in (("before", before), ("after", after)):
            lines.append(f"  rms {name}: {', '.join(f'{value:.4g}' for value in values)} {unit}")
        lines.append(f"  {document['poses']['count']} poses or samples, condition {document['poses']['condition']:.3g}")
    if document["turn_on_bias"] is not None:
        bias = document["turn_on_bias"]["bias"]
        lines.append(f"  turn-on bias: {', '.join(f'{value:.4g}' for value in bias)} {unit}")
    if document["temperature"] is not None:
        slopes = document["temperature"]["slope_per_k"]
        lines.append(f"  bias against temperature: {', '.join(f'{value:.3g}' for value in slopes)} {unit} per K")
    return "\n".join([*lines, *(f"- {remark}" for remark in document["quality"])])


def _plot(path: Path, sensor: str, result: _Result) -> None:
    """Errors before and after: of the magnitude, or of each axis."""
    from matplotlib.figure import Figure

    after, before = np.atleast_2d(result.calibration.residuals.T), np.atleast_2d(result.before.T)
    names = TRIADS[sensor] if len(after) == 3 else ("magnitude",)
    figure = Figure(figsize=(8.0, 2.6 * len(after) + 0.6), layout="constrained")
    panels = figure.subplots(len(after), 1, squeeze=False, sharex=True)[:, 0]
    style = "o" if after.shape[1] <= 200 else "."
    for panel, name, old, new in zip(panels, names, before, after, strict=True):
        panel.plot(old, style, markersize=3, label=f"before, rms {np.sqrt(np.mean(old**2)):.3g}")
        panel.plot(new, style, markersize=3, label=f"after, rms {np.sqrt(np.mean(new**2)):.3g}")
        panel.set_ylabel(f"error of {name} [{UNITS[sensor]}]")
        panel.grid(visible=True, alpha=0.3)
        panel.legend()
    panels[-1].set_xlabel("pose or sample")
    figure.suptitle(f"Calibration of the {sensor}: method {result.method}")
    figure.savefig(path, dpi=150)
