"""Sensor columns of a drive file as the numerics take them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nav_core.timebase import in_order
from server.formats.columns import Columns, Floats
from server.formats.drive import DriveFileError, read_drive_columns

TRIADS = {"accel": ("fx", "fy", "fz"), "gyro": ("wx", "wy", "wz"), "mag": ("mx", "my", "mz")}
UNITS = {"accel": "m/s²", "gyro": "rad/s", "mag": "µT"}


@dataclass(frozen=True)
class Triad:
    """Samples of one sensor in the order of time, repeats dropped; the remarks tell of that."""

    sensor: str
    t: Floats
    values: Floats
    temp: Floats | None
    remarks: tuple[str, ...]


def triads_of(recording: Columns, *, as_stored: bool = False) -> dict[str, Triad]:
    """Every sensor that a recording has samples of; `as_stored`: all of them in the order of the file."""
    columns = recording.values
    found: dict[str, Triad] = {}
    for sensor, names in TRIADS.items():
        if names[0] not in columns:
            continue
        rows = np.flatnonzero(~np.isnan(columns[names[0]]))
        remarks: tuple[str, ...] = ()
        if not as_stored:
            ordered = in_order(columns["t"][rows])
            rows = rows[ordered.keep]
            remarks = tuple(f"{sensor}: {each.detail}" for each in ordered.remarks)
        if rows.size:
            temp = columns["temp"][rows] if "temp" in columns else None
            values = np.column_stack([columns[name][rows] for name in names])
            found[sensor] = Triad(sensor, columns["t"][rows], values, temp, remarks)
    return found


def triad_of(recording: Columns, sensor: str, name: str) -> Triad:
    """The samples of one sensor, which must be there; `name` is the recording's."""
    found = triads_of(recording)
    if sensor not in found:
        raise DriveFileError(f"{name}: no samples in the columns {', '.join(TRIADS[sensor])}")
    return found[sensor]


def read_triad(path: Path, sensor: str) -> Triad:
    """The samples of one sensor of a file."""
    return triad_of(read_drive_columns(path), sensor, str(path))
