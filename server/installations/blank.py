"""The mount JSON before there is anything to say."""

from __future__ import annotations

from typing import Any

_REASONS = {
    "first": ("no_data", "No data from this box yet."),
    "moved": ("moved", "The box was moved: drive on until its new mounting is known."),
    "swapped": ("swapped", "The box is new in this vehicle: drive off."),
}

REASON_CODES = tuple(code for code, _ in _REASONS.values())


def blank_result(beginning: str = "first") -> dict[str, Any]:
    """All keys of the mount JSON, `insufficient`, with nothing known of an installation that began so."""
    code, reason = _REASONS[beginning]
    return {
        "status": "insufficient",
        "method": "whole-drive",
        "R_va": None,
        "euler_deg": None,
        "sigma_deg": None,
        "observability": None,
        "stable": False,
        "reliable": False,
        "self_test": None,
        "converged_after_s": None,
        "gps_lag_s": {"speed": None, "course": None},
        "changes": [],
        "reasons": [reason],
        "reason_codes": [code],
        "percent": 0,
    }
