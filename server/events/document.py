"""The document of an event: everything that is said of it and what that rests on, ready to be written canonically.

It holds no clock and no random id but the box's, so the same inputs give the same bytes.  Reports, exports and
pages are made from it alone: none of them needs the numerics.
"""

from __future__ import annotations

from importlib import metadata
from typing import Any

import numpy as np

from nav_core.crash.edr import element_table
from nav_core.events.record import CrashEvent, Pulse
from nav_core.events.way import Trajectory
from nav_core.typing import Floats
from server.events.canonical import sha256
from server.events.result import event_json

SCHEMA = "scatola-event-1"

_G = 9.80665


def document_of(event: CrashEvent, inputs: dict[str, Any], *, device_id: str, boot: str) -> dict[str, Any]:
    """The document of one event; `inputs` says which batches, mounting and settings it was computed from."""
    return {
        "schema": SCHEMA,
        "software": {"name": "scatola", "version": metadata.version("scatola")},
        "algorithm": event.basis.algorithm,
        "subject": {"device_id": device_id, "boot": boot},
        "inputs": {**inputs, "sha256": sha256(inputs)},
        "event": event_json(event),
        "curves": {
            "pulse": None if event.pulse is None else _pulse(event.pulse),
            "trajectory": None if event.trajectory is None else _trajectory(event.trajectory),
        },
        "edr": [
            {
                "table": element.table,
                "name": element.name,
                "unit": element.unit,
                "recorded": element.recorded,
                "times_s": list(element.times),
                "values": list(element.values),
                "interval95": None if element.interval is None else list(element.interval),
                "note": element.note,
            }
            for element in element_table(event)
        ],
    }


def _column(values: Floats) -> list[float]:
    return np.asarray(values, dtype=np.float64).tolist()


def _pulse(pulse: Pulse) -> dict[str, Any]:
    axes = {
        f"{name}_{axis}": _column(scale * values[:, k])
        for name, values, scale in (
            ("acceleration_g", pulse.acceleration, 1.0 / _G),
            ("recorded_g", pulse.recorded, 1.0 / _G),
            ("delta_v_kmh", pulse.delta_v, 3.6),
        )
        for k, axis in enumerate("xyz")
    }
    return {"t_s": _column(pulse.t), **axes, "sigma_kmh": _column(3.6 * pulse.sigma), "clipped": pulse.clipped.tolist()}


def _trajectory(way: Trajectory) -> dict[str, Any]:
    ellipses = np.array([way.ellipse(k) for k in range(way.t.size)]).reshape(-1, 3)
    return {
        "method": way.method,
        "t_s": _column(way.t),
        "lat_deg": _column(np.degrees(way.lat)),
        "lon_deg": _column(np.degrees(way.lon)),
        "north_m": _column(way.position[:, 0]),
        "east_m": _column(way.position[:, 1]),
        "ellipse_long_m": _column(ellipses[:, 0]),
        "ellipse_short_m": _column(ellipses[:, 1]),
        "ellipse_deg": _column(np.degrees(ellipses[:, 2])),
        "speed_kmh": _column(3.6 * way.speed),
        "speed_sigma_kmh": _column(3.6 * way.speed_sigma),
        "heading_deg": _column(np.degrees(way.heading)),
        "heading_sigma_deg": _column(np.degrees(way.heading_sigma)),
        "along_mps2": _column(way.acceleration[:, 0]),
        "across_mps2": _column(way.acceleration[:, 1]),
    }
