"""How far an axis of the box may point elsewhere: the region drawn around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from nav_core.rotation import skew
from nav_core.typing import Floats, Integers

# A two-dimensional Gaussian lies within this many sigmas with 95 % probability.
SIGMAS_95 = float(np.sqrt(-2.0 * np.log(0.05)))
_WIDEST = np.radians(85.0)


def axis_ellipse(axis: Floats, sigma: Floats) -> tuple[Floats, Floats]:
    """The 95 % region of a direction whose frame is uncertain by a small rotation.

    Parameters
    ----------
    axis : ndarray, shape (3,)
        Unit vector in the V-frame.
    sigma : ndarray, shape (3,)
        1-sigma of the small rotation about V x, y, z, rad.

    Returns
    -------
    half_angles : ndarray, shape (2,)
        Semi-axes of the ellipse of directions, rad, the smaller first; at most 85°.
    directions : ndarray, shape (2, 3)
        Unit vectors across `axis` along which they lie.

    Notes
    -----
    To first order the axis moves by ``e x axis``, so its covariance is ``[axis]x P [axis]x^T``;
    a rotation about the axis itself does not move it.
    """
    across = skew(axis)
    values, vectors = np.linalg.eigh(across @ np.diag(np.square(sigma)) @ across.T)
    # The eigenvalue along the axis itself is zero; drop the eigenvector that is most parallel to it.
    order = [index for index in range(3) if index != int(np.argmax(np.abs(axis @ vectors)))]
    half_angles = SIGMAS_95 * np.sqrt(np.maximum(values[order], 0.0))
    return np.minimum(half_angles, _WIDEST), vectors[:, order].T


def widest_deg(R_va: Sequence[Sequence[float]], sigma_deg: Mapping[str, float]) -> list[float]:
    """Half the opening of the 95 % cone of the box's x, y, z axis where it is widest, degrees."""
    sigma = np.radians([sigma_deg[axis] for axis in "xyz"])
    return [float(np.degrees(axis_ellipse(axis, sigma)[0][1])) for axis in np.array(R_va).T]


def cone(axis: Floats, sigma: Floats, length: float, facets: int = 48) -> tuple[Floats, Integers]:
    """Vertices (apex first, at the origin) and triangles of the elliptic cone around `axis`."""
    half_angles, directions = axis_ellipse(axis, sigma)
    turn = np.linspace(0.0, 2.0 * np.pi, facets, endpoint=False)
    lean = np.stack([half_angles[0] * np.cos(turn), half_angles[1] * np.sin(turn)], axis=1)
    angle = np.linalg.norm(lean, axis=1)
    towards = (lean / np.maximum(angle, 1e-12)[:, None]) @ directions
    rim = length * (np.cos(angle)[:, None] * axis + np.sin(angle)[:, None] * towards)
    here = np.arange(1, facets + 1)
    faces = np.stack([np.zeros(facets, dtype=np.int64), here, np.roll(here, -1)], axis=1)
    return np.concatenate([np.zeros((1, 3)), rim]), faces.astype(np.int64)
