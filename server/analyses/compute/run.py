"""From a recording and the parameters of a kind to the kind's document."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, cast

import numpy as np

from nav_core.records import Drive
from nav_core.typing import Floats
from server.analyses import kinds
from server.formats.columns import Columns
from server.formats.drive import to_drive


def analyse(
    kind: kinds.Kind,
    recording: Columns,
    name: str,
    parameters: Mapping[str, Any],
    *,
    reference: Floats | None = None,
    progress: Callable[[str, float], None],
) -> dict[str, Any]:
    """The document of one analysis; ValueError with a clear line where the recording does not allow it.

    `reference` is the mounting known from elsewhere, if any.
    """
    told = kinds.PARAMETERS[kind].model_validate(parameters)
    if isinstance(told, kinds.Allan):
        from server.analyses.compute.allan import allan

        found = allan(
            recording, name, terms=told.terms, rate=told.rate_hz, shortest=told.shortest_s, progress=progress
        ).document
    elif isinstance(told, kinds.Track):
        from server.analyses.compute.track import rehearse

        drive = to_drive(recording)
        found = rehearse(drive, outage=_outage(drive, told), smoothed=told.smoothed, progress=progress)
    elif isinstance(told, kinds.Mounting):
        from server.analyses.compute.mounting import compare

        found = compare(
            to_drive(recording),
            methods=told.methods,
            traffic_side=told.traffic_side,
            reference=reference,
            progress=progress,
        )
    else:
        found = _calibration(told, recording, name, progress)
    return {"file": name, "remarks": [remark.detail for remark in recording.remarks], **found}


def _calibration(told: Any, recording: Columns, name: str, progress: Callable[[str, float], None]) -> dict[str, Any]:
    from server.analyses.compute.calibration import calibrate

    if isinstance(told, kinds.Magnetometer):
        return calibrate(recording, name, "mag", magnitude=told.field_ut, progress=progress)
    rest = {"window": told.window_s, "rows_are_poses": told.rows_are_poses}
    if isinstance(told, kinds.Gyro):
        rates = np.radians(told.rates_deg_s)
        return calibrate(recording, name, "gyro", magnitude=None, rates=rates, **rest, progress=progress)
    gravity = cast("kinds.Accelerometer", told).gravity_mps2
    return calibrate(recording, name, "accel", magnitude=gravity, **rest, progress=progress)


def _outage(drive: Drive, told: kinds.Track) -> tuple[float, float] | None:
    if told.outage_s == 0.0:
        return None
    begin = told.outage_from_s
    if begin is None:
        t = drive.gnss.t[drive.gnss.fix]
        begin = 0.5 * (float(t[0] + t[-1]) - told.outage_s) if t.size else math.nan
    return begin, begin + told.outage_s
