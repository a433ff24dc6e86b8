"""Checking a rotation that a caller sent; numpy alone, for the API loads no scipy."""

from __future__ import annotations

import numpy as np

# What a matrix loses that was written with four digits.
_TOLERANCE = 1e-3


def nearest_rotation(rows: list[list[float]]) -> list[list[float]]:
    """The rotation nearest to a matrix that is one but for rounding; ValueError when it is none."""
    matrix = np.array(rows, dtype=np.float64)
    if not np.isfinite(matrix).all() or np.abs(matrix).max() > 2.0:
        raise ValueError("not a rotation: its elements lie outside -1..1")
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > _TOLERANCE:
        raise ValueError("not a rotation: its rows are not orthonormal")
    if np.linalg.det(matrix) < 0.0:
        raise ValueError("not a rotation: it mirrors (determinant -1)")
    u, _, vt = np.linalg.svd(matrix)
    nearest: list[list[float]] = (u @ vt).tolist()
    return nearest
