"""Parameters of a sensor from poses, a turntable or any motion, and how well the poses cover the sphere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from nav_core.errors import PosesError
from nav_core.sensors import Calibration, calibrate_field, calibrate_positions, interval_means, static_intervals
from server.analyses.compute.triads import UNITS, Triad, triad_of
from server.formats.columns import Columns, Floats

STEADY = 0.1
"""Share by which a mean rate may miss one of the turntable's and still be taken for it; real scales miss by less."""
MANY = 100
"""Residuals from which on it can be told whether neighbours are alike, and the correlation that is remarked."""
ALIKE = 0.5
MANY_POINTS = 1000
"""Readings that a document has of a sensor that was moved all around."""
_DIRECTIONS = 2000


@dataclass(frozen=True)
class Result:
    """A calibration, what it was made of, and its errors before and after."""

    method: str
    calibration: Calibration
    before: Floats
    field: float | None = None


def pose_means(triad: Triad, window: float, *, rows_are_poses: bool) -> Floats:
    """Mean readings of the poses: rows as they are, or stretches in which the readings do not change."""
    if rows_are_poses:
        return triad.values
    stretches = static_intervals(triad.t, triad.values, window=window, shortest=window)
    return interval_means(triad.values, stretches).mean


def by_gravity(poses: Floats, gravity: float) -> Result:
    """Accelerometer: the magnitude of gravity is the same in every pose."""
    calibration = calibrate_positions(poses, gravity)
    return Result("positions", calibration, np.linalg.norm(poses, axis=1) - gravity)


def turned_at(poses: Floats, speeds: Floats, quality: list[str]) -> tuple[Floats, Floats]:
    """The steady stretches that turn at one of a turntable's rates, and which, rad/s."""
    turning = np.linalg.norm(poses, axis=1)
    nearest = speeds[np.argmin(np.abs(turning[:, None] - speeds), axis=1)]
    meant = np.abs(turning - nearest) < STEADY * nearest
    dropped = int(np.count_nonzero(~meant))
    if dropped:
        quality.append(f"{dropped} steady stretches turn at none of the given rates; not used")
    return poses[meant], nearest[meant]


def by_turntable(poses: Floats, rates: Floats) -> Result:
    """Gyro: the magnitude of the rate of each pose is known, rad/s."""
    calibration = calibrate_positions(poses, rates)
    return Result("turntable", calibration, np.linalg.norm(poses, axis=1) - rates)


def by_field(readings: Floats, size: float | None) -> Result:
    """Magnetometer: the field is the same whichever way the box points; `size` in µT where it is known."""
    found = calibrate_field(readings, size)
    return Result("ellipsoid", found.calibration, np.linalg.norm(readings, axis=1) - found.field, found.field)


def too_sure(result: Result) -> list[str]:
    """A remark where neighbouring errors are alike: the intervals take every reading for one by itself."""
    left = np.atleast_2d(result.calibration.residuals.T)
    if left.shape[1] < MANY:
        return []
    left = left - left.mean(axis=1, keepdims=True)
    squares = np.maximum(np.sum(left**2, axis=1), np.finfo(np.float64).tiny)
    alike = min(float(np.max(np.sum(left[:, 1:] * left[:, :-1], axis=1) / squares)), 0.999)
    if alike < ALIKE:
        return []
    wider = np.sqrt((1.0 + alike) / (1.0 - alike))
    text = (
        f"neighbouring errors are alike (correlation {alike:.2f}): the intervals are some {wider:.1f} times too narrow"
    )
    return [text]


def calibration_json(result: Result | None) -> dict[str, Any]:
    """Parameters with intervals, matrices, errors before and after; all null without a result."""
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


def calibrate(
    recording: Columns,
    name: str,
    sensor: str,
    *,
    magnitude: float | None,
    rates: Floats | None = None,
    window: float = 1.0,
    rows_are_poses: bool = False,
    progress: Callable[[str, float], None],
) -> dict[str, Any]:
    """Calibrate a sensor by itself and say how its poses lie on the sphere.

    Poses that do not determine the parameters make no error here: the document has ``"status": "refused"``, the
    reason, and the poses, which show what is missing.  `magnitude` is gravity, m/s², or the field, µT; `rates`
    those of a gyro's turntable, rad/s.
    """
    triad = triad_of(recording, sensor, name)
    quality = list(triad.remarks)
    progress(f"{len(triad.t)} samples", 0.1)
    used = triad.values if sensor == "mag" else pose_means(triad, window, rows_are_poses=rows_are_poses)
    known = np.zeros(0)
    if sensor == "gyro":
        used, known = turned_at(used, np.zeros(1) if rates is None else rates, quality)
    progress(f"{len(used)} poses", 0.5)
    result, refusal = None, None
    try:
        if sensor == "mag":
            result = by_field(used, magnitude)
        elif sensor == "gyro":
            result = by_turntable(used, known)
        else:
            result = by_gravity(used, magnitude or 9.80665)
    except PosesError as error:
        refusal = str(error)
    if result is not None:
        quality += too_sure(result)
    return {
        "file": name,
        "sensor": sensor,
        "unit": UNITS[sensor],
        "status": "refused" if result is None else "calibrated",
        "refusal": refusal,
        "method": None if result is None else result.method,
        **calibration_json(result),
        **_sphere(used, result),
        "quality": quality,
    }


def _sphere(readings: Floats, result: Result | None) -> dict[str, Any]:
    """Where the poses point, what they read before and after, and the largest hole among them."""
    shown = np.unique(np.linspace(0, len(readings) - 1, min(len(readings), MANY_POINTS)).astype(int))
    some = readings[shown] if len(readings) else readings
    after = None
    if result is not None:
        inverse = np.linalg.inv(result.calibration.gain)
        after = (some - result.calibration.bias) @ inverse.T
    vectors = some if after is None else after
    sizes = np.linalg.norm(vectors, axis=1, keepdims=True)
    directions = vectors / np.where(sizes > 0.0, sizes, 1.0)
    return {
        "points": {
            "reading": some.tolist(),
            "corrected": None if after is None else after.tolist(),
            "direction": directions.tolist(),
            "error_before": None if result is None else result.before[shown].tolist(),
            "error_after": None if result is None else result.calibration.residuals[shown].tolist(),
        },
        "largest_hole_deg": _largest_hole(directions) if len(directions) else None,
    }


def _largest_hole(directions: Floats) -> float:
    """Greatest angle from any direction to the nearest pose, degrees: 55 for the six faces of a cube."""
    k = np.arange(_DIRECTIONS) + 0.5
    z, turn = 1.0 - 2.0 * k / _DIRECTIONS, np.pi * (1.0 + np.sqrt(5.0)) * k
    around = np.column_stack([np.sqrt(1.0 - z**2) * np.cos(turn), np.sqrt(1.0 - z**2) * np.sin(turn), z])
    nearest = np.max(around @ directions.T, axis=1)
    return float(np.degrees(np.arccos(np.clip(nearest.min(), -1.0, 1.0))))
