"""`scatola calibrate`: parameters of a sensor from poses, a turntable, a reference, or any motion (magnetometer)."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from server.analyses.compute.triads import TRIADS, UNITS, Triad, read_triad, triad_of
from server.cli.progress import progress
from server.formats.columns import Floats
from server.formats.drive import DriveFileError, read_drive_columns
from server.settings import set_numba_cache_dir

if TYPE_CHECKING:
    from nav_core.sensors import TemperatureFit, TurnOnBias
    from server.analyses.compute.calibration import Result

_ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")


def calibrate(args: argparse.Namespace) -> int:
    """`scatola calibrate`."""
    set_numba_cache_dir()
    from server.analyses.compute.calibration import calibration_json, too_sure

    recording = read_drive_columns(args.file)
    triad = triad_of(recording, args.sensor, str(args.file))
    quality = [*(remark.detail for remark in recording.remarks), *triad.remarks]
    progress(f"{args.sensor}: {len(triad.t)} samples")
    result = _by_reference(args, triad) if args.reference is not None else _by_itself(args, triad, quality)
    turn_on, temperature = _at_rest(triad, args, quality) if args.sensor == "gyro" else (None, None)
    progress("")
    if result is not None:
        quality += too_sure(result)
    if result is None and turn_on is None:
        raise DriveFileError("; ".join(quality) or "the gyro was never at rest")
    document = {
        "file": str(args.file),
        "sensor": args.sensor,
        "unit": UNITS[args.sensor],
        "method": "rest" if result is None else result.method,
        **calibration_json(result),
        "turn_on_bias": _turn_on_json(turn_on),
        "temperature": _temperature_json(temperature),
        "quality": quality,
    }
    if args.plot is not None and result is not None:
        _plot(args.plot, args.sensor, result)
    elif args.plot is not None:
        _plot_rest(args.plot, triad, turn_on, temperature)
    print(json.dumps(document) if args.json else _in_words(document))
    return 0


def _by_itself(args: argparse.Namespace, triad: Triad, quality: list[str]) -> Result | None:
    from server.analyses.compute import calibration as compute

    if args.sensor == "mag":
        return compute.by_field(triad.values, None if args.field is None else float(np.linalg.norm(args.field)))
    if args.sensor == "gyro" and args.speeds is None:
        quality.append("bias only: give --speeds for a turntable or --reference for scale and misalignment")
        return None
    poses = compute.pose_means(triad, args.window, rows_are_poses=args.poses)
    if args.sensor == "accel":
        return compute.by_gravity(poses, args.gravity)
    return compute.by_turntable(*compute.turned_at(poses, np.radians(np.abs(args.speeds)), quality))


def _by_reference(args: argparse.Namespace, triad: Triad) -> Result:
    from nav_core.sensors import calibrate_reference
    from server.analyses.compute.calibration import Result

    t, truth = _reference(args)
    inside = (triad.t >= t[0]) & (triad.t <= t[-1])
    if not inside.any():
        spans = f"{t[0]:g} to {t[-1]:g} s, the recording {triad.t[0]:g} to {triad.t[-1]:g} s"
        raise DriveFileError(f"{args.reference} covers {spans}: they have no time in common")
    at = np.column_stack([np.interp(triad.t[inside], t, column) for column in truth.T])
    return Result("reference", calibrate_reference(triad.values[inside], at), triad.values[inside] - at)


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
    try:
        columns = np.loadtxt(args.reference, delimiter=",", skiprows=1, ndmin=2, encoding="utf-8-sig")
    except ValueError as error:
        raise DriveFileError(f"{args.reference}: {error}") from error
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


def _plot(path: Path, sensor: str, result: Result) -> None:
    """Errors of the magnitude, or of each axis, before and after: each on a scale of its own."""
    from matplotlib.figure import Figure

    after, before = np.atleast_2d(result.calibration.residuals.T), np.atleast_2d(result.before.T)
    names = TRIADS[sensor] if len(after) == 3 else ("magnitude",)
    figure = Figure(figsize=(11.0, 2.6 * len(after) + 0.8), layout="constrained")
    panels = figure.subplots(len(after), 2, squeeze=False, sharex=True)
    style = "o" if after.shape[1] <= 200 else "."
    for row, name, *errors in zip(panels, names, before, after, strict=True):
        for panel, word, colour, values in zip(row, ("before", "after"), ("C0", "C1"), errors, strict=True):
            panel.axhline(0.0, color="0.6", linewidth=0.8)
            panel.plot(values, style, color=colour, markersize=3)
            panel.set_title(f"{name} {word}: rms {np.sqrt(np.mean(values**2)):.3g} {UNITS[sensor]}", fontsize="medium")
            panel.grid(visible=True, alpha=0.3)
        row[0].set_ylabel(f"error [{UNITS[sensor]}]")
    for panel in panels[-1]:
        panel.set_xlabel("pose or sample")
    figure.suptitle(f"Calibration of the {sensor}: method {result.method}")
    figure.savefig(path, dpi=150)


def _plot_rest(path: Path, triad: Triad, turn_on: TurnOnBias | None, temperature: TemperatureFit | None) -> None:
    """A gyro at rest: how its means wander from the turn-on bias, and the lines against temperature."""
    from matplotlib.figure import Figure

    second, first, count = np.unique(np.floor(triad.t - triad.t[0]), return_index=True, return_counts=True)
    means = np.add.reduceat(triad.values, first) / count[:, None]
    base = means[0] if turn_on is None else turn_on.bias
    figure = Figure(figsize=(8.0, 3.4 if temperature is None else 6.2), layout="constrained")
    panels = figure.subplots(1 if temperature is None else 2, 1, squeeze=False)[:, 0]
    for axis, name in enumerate(TRIADS[triad.sensor]):
        panels[0].plot(triad.t[0] + second, means[:, axis] - base[axis], label=f"{name} less {base[axis]:.4g}")
    panels[0].set(xlabel="box clock [s]", ylabel="mean of a second [rad/s]", title="At rest, less the turn-on bias")
    if temperature is not None and triad.temp is not None:
        span, known = np.array(temperature.span), ~np.isnan(triad.temp[first])
        for axis, name in enumerate(TRIADS[triad.sensor]):
            at = temperature.offset[axis]
            panels[1].plot(triad.temp[first][known], means[known, axis] - at, ".", markersize=3, color=f"C{axis}")
            line = temperature.bias(span)[:, axis] - at
            panels[1].plot(span, line, color=f"C{axis}", label=f"{name}: {temperature.slope[axis]:.3g} rad/s per K")
        panels[1].set(xlabel="temperature [°C]", ylabel="less the bias at 25 °C [rad/s]")
    for panel in panels:
        panel.grid(visible=True, alpha=0.3)
        panel.legend(fontsize="small")
    figure.savefig(path, dpi=150)
