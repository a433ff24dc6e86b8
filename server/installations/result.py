"""The mount JSON of the contract, out of an estimate.  Not for the API process: it loads scipy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from nav_core.records import MountingEstimate, MountingMethod, MountingStatus
from nav_core.rotation import matrix_to_thesis


def mount_json(estimate: MountingEstimate) -> dict[str, Any]:
    """All keys of `scatola mount --json`, plus `percent` and `reason_codes`."""
    sigma = estimate.sigma
    test = estimate.self_test
    return {
        "status": estimate.status,
        "method": estimate.method,
        "R_va": None if estimate.R_va is None else estimate.R_va.tolist(),
        "euler_deg": None if estimate.R_va is None else _named(matrix_to_thesis(estimate.R_va), "theta", "phi", "psi"),
        "sigma_deg": None if sigma is None else _named(sigma, "x", "y", "z"),
        "observability": estimate.observability,
        "stable": estimate.stable,
        "reliable": estimate.reliable,
        "self_test": None
        if test is None
        else {"passed": test.passed, "drift_mps": test.drift, "duration_s": test.duration},
        "converged_after_s": estimate.converged_after,
        "gps_lag_s": {"speed": estimate.speed_lag, "course": estimate.course_lag},
        "changes": [{"t_s": change.t, "angle_deg": float(np.degrees(change.angle))} for change in estimate.changes],
        "reasons": [reason.text for reason in estimate.reasons],
        "reason_codes": [reason.code for reason in estimate.reasons],
        "percent": round(100.0 * estimate.progress),
    }


UNSTATED_SIGMA_DEG = 1.0
"""Of a mounting that somebody set without saying how well it was measured."""


def estimate_of(result: Mapping[str, Any]) -> MountingEstimate:
    """The estimate that a mount JSON tells of, as far as later steps need it."""
    status = cast("MountingStatus", result.get("status", "insufficient"))
    known = status in ("ready", "settling") and result.get("R_va") is not None
    sigma: Mapping[str, float] = result.get("sigma_deg") or dict.fromkeys("xyz", UNSTATED_SIGMA_DEG)
    lags: Mapping[str, float | None] = result.get("gps_lag_s") or {}
    return MountingEstimate(
        status if known else "insufficient" if status != "not_fixed" else "not_fixed",
        cast("MountingMethod", result.get("method", "whole-drive")),
        R_va=np.array(result["R_va"], dtype=np.float64) if known else None,
        covariance=np.diag([np.radians(sigma[axis]) ** 2 for axis in "xyz"]) if known else None,
        stable=bool(result.get("stable")),
        reliable=bool(result.get("reliable")),
        speed_lag=lags.get("speed"),
        course_lag=lags.get("course"),
    )


def _named(angles: np.ndarray[Any, np.dtype[np.float64]], *names: str) -> dict[str, float]:
    return {name: float(np.degrees(angle)) for name, angle in zip(names, angles, strict=True)}
