"""A mounting out of the file that `scatola mount --json` printed.  Not for the API process: it loads scipy."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, cast

import numpy as np

from nav_core.records import MountingChange, MountingEstimate, Reason
from server.installations.result import UNSTATED_SIGMA_DEG


def read_mount_file(path: Path) -> MountingEstimate:
    """The estimate in a file; of `status` and what hangs on it only what later steps need."""
    try:
        document: Any = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} is no JSON: {error}") from error
    if not isinstance(document, dict) or "R_va" not in document:
        raise ValueError(f"{path} is not what `scatola mount --json` prints: no R_va")
    return _estimate(cast("dict[str, Any]", document), path)


def _estimate(document: dict[str, Any], path: Path) -> MountingEstimate:
    status = document.get("status", "ready")
    reasons = tuple(Reason("told", str(text)) for text in _list(document, "reasons", path))
    if document["R_va"] is None:
        unknown = status if status in ("insufficient", "not_fixed") else "insufficient"
        return MountingEstimate(status=unknown, method="whole-drive", reasons=reasons)
    try:
        R_va = np.array(document["R_va"], dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{path}: R_va is not three rows of three numbers") from None
    if R_va.shape != (3, 3) or not np.allclose(R_va @ R_va.T, np.eye(3), atol=1e-4) or np.linalg.det(R_va) < 0.0:
        raise ValueError(f"{path}: R_va is not a rotation")
    sigma, lags = _part(document, "sigma_deg", path), _part(document, "gps_lag_s", path)
    axes, changes = ("x", "y", "z"), _list(document, "changes", path)
    degrees = [_number(sigma, axis, f"{path}: sigma_deg") for axis in axes] if sigma else [UNSTATED_SIGMA_DEG] * 3
    if min(degrees) < 0.0:
        raise ValueError(f"{path}: sigma_deg is negative")
    return MountingEstimate(
        status=status if status in ("ready", "settling") else "ready",
        method="whole-drive",
        R_va=R_va,
        covariance=np.diag(np.radians(np.array(degrees, dtype=np.float64)) ** 2),
        progress=1.0,
        speed_lag=None if lags.get("speed") is None else _number(lags, "speed", f"{path}: gps_lag_s"),
        course_lag=None if lags.get("course") is None else _number(lags, "course", f"{path}: gps_lag_s"),
        changes=tuple(
            MountingChange(_number(each, "t_s", where), math.radians(_number(each, "angle_deg", where)))
            for where, each in ((f"{path}: changes[{k}]", each) for k, each in enumerate(changes))
        ),
        reasons=reasons,
    )


def _list(document: dict[str, Any], name: str, path: Path) -> list[Any]:
    """A list within the document; empty where there is none."""
    part = document.get(name) or []
    if not isinstance(part, list):
        raise ValueError(f"{path}: {name} is not a list")  # noqa: TRY004 - of the file, not of an argument
    return cast("list[Any]", part)


def _part(document: dict[str, Any], name: str, path: Path) -> dict[str, Any]:
    """An object within the document; empty where there is none."""
    part = document.get(name)
    if part is not None and not isinstance(part, dict):
        raise ValueError(f"{path}: {name} is not an object")
    return cast("dict[str, Any]", part or {})


def _number(part: Any, name: str, where: str) -> float:
    value = cast("dict[str, Any]", part).get(name) if isinstance(part, dict) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{where}.{name} is not a number")
    return float(value)
