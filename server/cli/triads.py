"""Sensor columns of a drive file as the numerics take them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from server.formats.columns import Floats
from server.formats.drive import DriveFileError, read_drive_columns

TRIADS = {"accel": ("fx", "fy", "fz"), "gyro": ("wx", "wy", "wz"), "mag": ("mx", "my", "mz")}
UNITS = {"accel": "m/s²", "gyro": "rad/s", "mag": "µT"}


@dataclass(frozen=True)
class Triad:
    """Samples of one sensor in the order of time, repeats dropped."""

    sensor: str
    t: Floats
    values: Floats
    temp: Floats | None


def read_triads(path: Path) -> dict[str, Triad]:
    """Every sensor that a file has samples of."""
    columns = read_drive_columns(path).values
    found: dict[str, Triad] = {}
    for sensor, names in TRIADS.items():
        if names[0] not in columns:
            continue
        rows = np.flatnonzero(~np.isnan(columns[names[0]]))
        _, first = np.unique(columns["t"][rows], return_index=True)
        rows = rows[first]
        if rows.size:
            temp = columns["temp"][rows] if "temp" in columns else None
            values = np.column_stack([columns[name][rows] for name in names])
            found[sensor] = Triad(sensor, columns["t"][rows], values, temp)
    return found


def read_triad(path: Path, sensor: str) -> Triad:
    """The samples of one sensor, which must be there."""
    found = read_triads(path)
    if sensor not in found:
        raise DriveFileError(f"{path}: no samples in the columns {', '.join(TRIADS[sensor])}")
    return found[sensor]
