"""The crash JSON of the contract, out of events.  Canonical: no clock, no environment, keys in a fixed order."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from nav_core.events.record import CrashEvent, Estimate, InjuryRisk

_KMH, _DEG, _G = 3.6, 180.0 / math.pi, 1.0 / 9.80665


def crash_json(events: Iterable[CrashEvent]) -> dict[str, Any]:
    """What `scatola crash --json` prints."""
    return {"events": [event_json(event) for event in events]}


def event_json(event: CrashEvent) -> dict[str, Any]:
    """All keys of one event of the contract, then ours."""
    delta_v, asked = event.delta_v, ("longitudinal", "lateral", "resultant")
    parts = {name: None if delta_v is None else getattr(delta_v, name) for name in asked}
    indices = event.indices
    return {
        "kind": event.kind,
        "t0_s": event.t0,
        "t_end_s": event.t_end,
        "delta_v_kmh": {name: _value(part, _KMH) for name, part in parts.items()},
        "delta_v_interval95_kmh": {name: _interval(part, _KMH) for name, part in parts.items()},
        "time_of_max_ms": None if delta_v is None else 1e3 * delta_v.time_of_max,
        "pdof_deg": _value(event.pdof, _DEG),
        "pdof_interval95_deg": _interval(event.pdof, _DEG),
        "pdof_clock": event.pdof_clock,
        "impact_speed_kmh": _value(event.impact_speed, _KMH),
        "impact_speed_interval95_kmh": _interval(event.impact_speed, _KMH),
        "peak_g": event.peak * _G,
        "clipped": event.clipped_samples > 0,
        "clipped_samples": event.clipped_samples,
        "asi": indices.asi_2010,
        "olc_g": _scaled(indices.olc, _G),
        "thiv_kmh": _scaled(indices.thiv, _KMH),
        "phd_g": _scaled(indices.phd, _G),
        "injury": _injury(event.injuries[0]) if event.injuries else None,
        "quality": [remark.code for remark in event.quality],
        "quality_details": [{"code": remark.code, "detail": remark.detail} for remark in event.quality],
        "confidence": event.confidence,
        "rebound_kmh": _value(event.rebound, _KMH),
        "rebound_interval95_kmh": _interval(event.rebound, _KMH),
        "pulse": _pulse(event),
        "indices": {
            "asi_en1317_2010": indices.asi_2010,
            "asi_en1317_1998": indices.asi_1998,
            "olc_g": _scaled(indices.olc, _G),
            "thiv_kmh": _scaled(indices.thiv, _KMH),
            "phd_g": _scaled(indices.phd, _G),
        },
        "injuries": [{"level": each.level, "population": each.population, **_injury(each)} for each in event.injuries],
        "second_impacts": [
            {
                "t0_s": each.t0,
                "t_end_s": each.t_end,
                "resultant_kmh": _value(each.resultant, _KMH),
                "resultant_interval95_kmh": _interval(each.resultant, _KMH),
                "pdof_deg": _value(each.pdof, _DEG),
                "pdof_interval95_deg": _interval(each.pdof, _DEG),
                "clipped_samples": each.clipped_samples,
            }
            for each in event.second_impacts
        ],
        "rollover_angle_deg": _value(event.rollover_angle, _DEG),
        "rollover_angle_interval95_deg": _interval(event.rollover_angle, _DEG),
        "rest": _rest(event),
        "driver": _driver(event),
        "basis": _basis(event),
    }


def _value(estimate: Estimate | None, scale: float) -> float | None:
    return None if estimate is None else scale * estimate.value


def _interval(estimate: Estimate | None, scale: float) -> list[float] | None:
    return None if estimate is None else [scale * estimate.low, scale * estimate.high]


def _scaled(value: float | None, scale: float) -> float | None:
    return None if value is None else scale * value


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _injury(risk: InjuryRisk) -> dict[str, Any]:
    p = risk.probability
    key = "p_" + risk.level.lower().rstrip("+").replace(" ", "_")
    return {"curve": risk.curve, key: p.value, "interval95": [p.low, p.high]}


def _pulse(event: CrashEvent) -> dict[str, Any] | None:
    pulse = event.pulse
    if pulse is None:
        return None
    return {
        "peak_g": pulse.peak * _G,
        "peak_is_lower_bound": pulse.peak_lower_bound,
        "mean_g": pulse.mean * _G,
        "duration_ms": 1e3 * pulse.duration,
        "filter": pulse.filter,
        "cutoff_hz": pulse.cutoff,
        "measured_delta_v_kmh": None if event.delta_v is None else _KMH * event.delta_v.measured,
        "gps_delta_v_kmh": None if event.delta_v is None else _scaled(event.delta_v.from_gps, _KMH),
    }


def _rest(event: CrashEvent) -> dict[str, Any] | None:
    rest = event.rest
    if rest is None:
        return None
    return {
        "t_s": rest.t,
        "lat": _scaled(rest.lat, _DEG),
        "lon": _scaled(rest.lon, _DEG),
        "radius95_m": rest.radius95,
        "distance_m": rest.distance,
    }


def _driver(event: CrashEvent) -> dict[str, Any] | None:
    driver = event.driver
    if driver is None:
        return None
    rows = zip(driver.t, driver.speed, driver.longitudinal, driver.lateral, driver.yaw_rate, strict=True)
    return {
        "last_5_s": [
            {
                "t_s": float(t),
                "speed_kmh": _number(_KMH * v),
                "longitudinal_mps2": _number(along),
                "lateral_mps2": _number(across),
                "yaw_rate_deg_s": _number(_DEG * rate),
            }
            for t, v, along, across, rate in rows
        ],
        "braked_from_s": driver.braked_from,
        "braking_mps2": driver.braking,
        "steered": driver.steered,
        "stopping_distance_m": driver.stopping_distance,
    }


def _basis(event: CrashEvent) -> dict[str, Any]:
    basis = event.basis
    sigma = basis.mounting_sigma
    return {
        "algorithm": basis.algorithm,
        "window_s": list(basis.window),
        "sample_rate_hz": basis.sample_rate,
        "full_scale_g": _scaled(basis.full_scale, _G),
        "mounting_status": basis.mounting_status,
        "mounting_sigma_deg": None if sigma is None else [_DEG * each for each in sigma],
        "R_va": None if basis.R_va is None else basis.R_va.tolist(),
        "gyro": basis.gyro,
        "fixes_before": basis.fixes_before,
        "fixes_after": basis.fixes_after,
        "gps_lag_s": {"speed": basis.speed_lag, "course": basis.course_lag},
        "utc_t0": basis.utc_t0,
        "utc_sigma_s": basis.utc_sigma,
    }
