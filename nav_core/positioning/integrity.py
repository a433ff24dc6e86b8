"""Error budget of a range, and the protection levels of EGNOS (000 §5.8, 5.9)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from nav_core.errors import RangeError, ShapeError
from nav_core.positioning.single import design
from nav_core.typing import Floats

SINGLE_BUDGET: Mapping[str, float] = MappingProxyType(
    {
        "satellite clock": 15.0,
        "ephemerides": 40.0,
        "orbit": 5.0,
        "ionosphere": 12.0,
        "troposphere": 3.0,
        "multipath": 2.0,
        "receiver noise": 1.0,
    }
)
"""Range errors of a lone receiver in the days of selective availability, m (000 table 5.1)."""

DIFFERENTIAL_BUDGET: Mapping[str, float] = MappingProxyType(
    {
        "satellite clock": 0.1,
        "ephemerides": 1.0,
        "orbit": 0.1,
        "ionosphere": 1.0,
        "troposphere": 0.5,
        "multipath": 3.0,
        "receiver noise": 1.0,
    }
)
"""The same with corrections over a baseline of 500 km, m (000 table 5.2)."""

K_VERTICAL = 5.33
"""Vertical protection: a normal error stays within with 1 - 1e-7 (RTCA DO-229)."""
K_HORIZONTAL_APPROACH, K_HORIZONTAL_ROUTE = 6.0, 6.18
"""Horizontal protection in precision approach, and en route to non-precision approach (RTCA DO-229)."""

IONOSPHERE_HEIGHT, IONOSPHERE_EARTH = 350e3, 6_378_136.3
"""Height of the thin shell and radius of the Earth of the obliquity factor, m (RTCA DO-229 A.4.4.10.4)."""


def range_error(terms: Mapping[str, float]) -> float:
    """1-sigma of a range out of independent errors, m: the root of the sum of their squares.

    Parameters
    ----------
    terms : Mapping[str, float]
        1-sigma of each, m.

    Returns
    -------
    float
        m.

    Notes
    -----
    000 tables 5.1 and 5.2 print ``sqrt(sum / n)`` and give the sum without ``/ n``: 45 m.  The right column of table
    5.2 adds up to 3.5 m, not 3.3.
    """
    return float(np.sqrt(sum(term**2 for term in terms.values())))


def obliquity(elevation: Floats) -> Floats:
    """Slant over vertical delay of the ionosphere, the shape of `elevation` (rad; RTCA DO-229 A.4.4.10.4).

    Parameters
    ----------
    elevation : ndarray, shape (...)
        rad.

    Returns
    -------
    ndarray, shape (...)
        1 at the zenith.
    """
    ratio = IONOSPHERE_EARTH * np.cos(elevation) / (IONOSPHERE_EARTH + IONOSPHERE_HEIGHT)
    return 1.0 / np.sqrt(1.0 - ratio**2)


def sbas_sigma(elevation: Floats, *, corrections: Floats, ionosphere: Floats, receiver: Floats) -> Floats:
    """1-sigma of pseudoranges corrected by EGNOS.

    Parameters
    ----------
    elevation : ndarray, shape (n,)
        rad, above 5°.
    corrections : ndarray, shape (n,)
        1-sigma left after fast and slow corrections (UDRE), m.
    ionosphere : ndarray, shape (n,)
        1-sigma of the vertical ionospheric delay left (UIVE), m.
    receiver : ndarray, shape (n,)
        1-sigma of noise and multipath, m.

    Returns
    -------
    ndarray, shape (n,)
        m.

    Raises
    ------
    RangeError

    Notes
    -----
    000 §5.9.2; the troposphere's 0.12 m and its mapping from RTCA DO-229 A.4.2.4.
    """
    if not elevation.min(initial=np.inf) > np.radians(5.0):
        raise RangeError("elevation", float(np.degrees(elevation.min())), "more than 5°")
    troposphere = 0.12 * 1.001 / np.sqrt(0.002001 + np.sin(elevation) ** 2)
    return np.sqrt(corrections**2 + (obliquity(elevation) * ionosphere) ** 2 + troposphere**2 + receiver**2)


@dataclass(frozen=True, slots=True)
class ProtectionLevels:
    """Bounds that a position error stays within unless the system has warned.

    Attributes
    ----------
    horizontal, vertical : float
        HPL and VPL, m.
    sigma_major, sigma_vertical : float
        1-sigma along the major axis of the horizontal error ellipse, and vertically, m.
    """

    horizontal: float
    vertical: float
    sigma_major: float
    sigma_vertical: float


def protection_levels(
    satellites: Floats, receiver: Floats, sigma: Floats, *, k_horizontal: float = K_HORIZONTAL_APPROACH
) -> ProtectionLevels:
    """Horizontal and vertical protection level (000 §5.9.2; RTCA DO-229 appendix J).

    Parameters
    ----------
    satellites : ndarray, shape (n, 3)
        e frame, m.
    receiver : ndarray, shape (3,)
        e frame, m.
    sigma : ndarray, shape (n,)
        1-sigma of each corrected pseudorange, m (`sbas_sigma`); the position must use these weights.
    k_horizontal : float

    Returns
    -------
    ProtectionLevels

    Raises
    ------
    ShapeError
    """
    _, H = design(satellites, receiver)
    if sigma.shape != (H.shape[0],):
        raise ShapeError("sigma", sigma.shape, f"({H.shape[0]},)")
    covariance = np.linalg.inv(H.T @ (H / sigma[:, None] ** 2))
    major = float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    vertical = float(np.sqrt(covariance[2, 2]))
    return ProtectionLevels(k_horizontal * major, K_VERTICAL * vertical, major, vertical)
