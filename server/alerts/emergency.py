"""The message after a crash: what EN 15722's minimum set of data asks for, as JSON, and what is not known of it.

A box of this kind places no eCall itself: the message goes to people of the organisation, who may pass it on.  It has
the standard's elements, names and units (milliarcseconds, steps of two degrees), and beside them what a rescuer wants
to know in plain units.
"""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Mapping, Sequence
from typing import Any

FRESH = dt.timedelta(hours=6)
"""A crash that becomes known later than this raises an alert, not an emergency."""
TRUSTED_S = 60.0
"""A place so many seconds from the crash is still its place, for a vehicle that may have rolled on."""

_MAS = 3_600_000.0
_UNKNOWN_DIRECTION = 255
_BEFORE_S = (5.0, 10.0)
"""Two places on the way, that tell on which carriageway the vehicle is."""
_MAX_DELTA = 511
# The standard tells M2 from M3 and N2 from N3 by mass, which nobody told us.
_VEHICLE_TYPES = {"car": "passengerVehicleClassM1", "van": "lightCommercialVehiclesClassN1"}


def emergency_message(
    told: Mapping[str, Any],
    way: Mapping[str, Sequence[Any]] | None,
    *,
    at: dt.datetime,
    now: dt.datetime,
    vehicle_class: str | None,
    fallback: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """Facts of an emergency alert from a crash's JSON and its trajectory.

    `fallback` is the last known fix of the box: ``at`` (aware datetime), ``lat_deg``, ``lon_deg``, ``course_deg``.
    """
    place = _on_the_way(way, 0.0) or _last_fix(fallback, at)
    course = _direction(way) if place is not None and place["source"] == "trajectory" else None
    if course is None and fallback is not None and place is not None and place["age_s"] <= TRUSTED_S:
        course = fallback["course_deg"]
    trusted = place is not None and place["age_s"] <= TRUSTED_S
    not_known = ["numberOfOccupants", "vehicleIdentificationNumber", "vehiclePropulsionStorageType"]
    not_known += [name for name, known in (("vehicleLocation", place), ("vehicleDirection", course)) if known is None]
    if vehicle_class not in _VEHICLE_TYPES:
        not_known.append("vehicleType")
    severity = {
        "kind": told["kind"],
        "delta_v_kmh": told["delta_v_kmh"]["resultant"],
        "delta_v_interval95_kmh": told["delta_v_interval95_kmh"]["resultant"],
        "pdof_deg": told["pdof_deg"],
        "pdof_clock": told["pdof_clock"],
        "impact_speed_kmh": told["impact_speed_kmh"],
        "peak_g": told["peak_g"],
        "clipped": told["clipped"],
        "injury": told["injury"],
        "rollover": told["kind"] == "rollover",
    }
    not_known += [name for name in ("delta_v_kmh", "pdof_deg", "impact_speed_kmh") if severity[name] is None]
    return {
        "occupants": "unknown",
        "position": place,
        "course_deg": course,
        "severity": severity,
        "delay_s": round((now - at).total_seconds(), 1),
        "msd": {
            "standard": "EN 15722 element names, as JSON; not an encoded MSD",
            "control": {
                "automaticActivation": True,
                "testCall": False,
                "positionCanBeTrusted": trusted,
                "vehicleType": _VEHICLE_TYPES.get(vehicle_class or ""),
            },
            "vehicleIdentificationNumber": None,
            "vehiclePropulsionStorageType": None,
            "timestamp": int(at.timestamp()),
            "vehicleLocation": None if place is None else _location(place),
            "vehicleDirection": _UNKNOWN_DIRECTION if course is None else round(course / 2.0) % 180,
            "recentVehicleLocationN1": _recent(way, place, _BEFORE_S[0]),
            "recentVehicleLocationN2": _recent(way, place, _BEFORE_S[1]),
            "numberOfOccupants": None,
        },
        "not_known": not_known,
    }


def _on_the_way(way: Mapping[str, Sequence[Any]] | None, t_s: float) -> dict[str, Any] | None:
    """The place of a moment, seconds from time zero."""
    if way is None or way.get("method") == "inertial" or not way["t_s"]:
        return None
    row = min(range(len(way["t_s"])), key=lambda k: abs(way["t_s"][k] - t_s))
    lat, lon = way["lat_deg"][row], way["lon_deg"][row]
    if not _known(lat) or not _known(lon) or abs(way["t_s"][row] - t_s) > 1.0:
        return None
    radius = way["ellipse_long_m"][row]
    return {
        "lat_deg": round(lat, 7),
        "lon_deg": round(lon, 7),
        "radius95_m": round(radius, 1) if _known(radius) else None,
        "age_s": 0.0,
        "source": "trajectory",
    }


def _last_fix(fallback: Mapping[str, Any] | None, at: dt.datetime) -> dict[str, Any] | None:
    if fallback is None:
        return None
    return {
        "lat_deg": round(fallback["lat_deg"], 7),
        "lon_deg": round(fallback["lon_deg"], 7),
        "radius95_m": None,
        "age_s": round(abs((at - fallback["at"]).total_seconds()), 1),
        "source": "last_fix",
    }


def _direction(way: Mapping[str, Sequence[Any]] | None) -> float | None:
    """Of travel, just before the blow turned the vehicle."""
    if way is None:
        return None
    before = [k for k, t in enumerate(way["t_s"]) if t <= 0.0 and _known(way["heading_deg"][k])]
    return (
        round(way["heading_deg"][before[-1]] % 360.0, 1) if before and way["t_s"][before[-1]] > -_BEFORE_S[1] else None
    )


def _location(place: Mapping[str, Any]) -> dict[str, int]:
    return {
        "positionLatitude": round(place["lat_deg"] * _MAS),
        "positionLongitude": round(place["lon_deg"] * _MAS),
    }


def _recent(
    way: Mapping[str, Sequence[Any]] | None, place: Mapping[str, Any] | None, before_s: float
) -> dict[str, int] | None:
    """Where it was, in steps of 100 mas from the place; None where too far for the standard's ten bits."""
    earlier = _on_the_way(way, -before_s)
    if earlier is None or place is None or place["source"] != "trajectory":
        return None
    steps = [round((earlier[name] - place[name]) * _MAS / 100.0) for name in ("lat_deg", "lon_deg")]
    if any(abs(step) > _MAX_DELTA for step in steps):
        return None
    return {"latitudeDelta": steps[0], "longitudeDelta": steps[1]}


def _known(value: object) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)
