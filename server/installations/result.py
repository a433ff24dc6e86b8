"""The mount JSON of the contract, out of an estimate.  Not for the API process: it loads scipy."""

from __future__ import annotations

from typing import Any

import numpy as np

from nav_core.records import MountingEstimate
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


def _named(angles: np.ndarray[Any, np.dtype[np.float64]], *names: str) -> dict[str, float]:
    return {name: float(np.degrees(angle)) for name, angle in zip(names, angles, strict=True)}
