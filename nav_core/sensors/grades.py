"""Performance classes of inertial systems and sensors, and the CEP rate (000 sections 1.3 and 1.5.3)."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from nav_core.errors import RangeError, ShapeError, TooLittleDataError
from nav_core.typing import Floats

Performance = Literal["high", "medium", "low"]
GyroGrade = Literal["inertial", "intermediate", "moderate", "below"]

NAUTICAL_MILE = 1852.0
_DEGREE_PER_HOUR = np.radians(1.0) / 3600.0
_DEGREE_PER_ROOT_HOUR = np.radians(1.0) / 60.0
_PERFORMANCES: tuple[Performance, ...] = ("high", "medium", "low")
_GYRO_GRADES: tuple[GyroGrade, ...] = ("inertial", "intermediate", "moderate", "below")


class PerformanceRange(NamedTuple):
    """One row of 000 table 1.1: up to `high` is high, from `low` on is low, medium lies about their geometric mean."""

    high: float
    low: float


PERFORMANCE: dict[str, PerformanceRange] = {
    "cep_rate": PerformanceRange(0.1 * NAUTICAL_MILE / 3600.0, 10.0 * NAUTICAL_MILE / 3600.0),
    "gyro": PerformanceRange(1e-3 * _DEGREE_PER_HOUR, 1e-1 * _DEGREE_PER_HOUR),
    "accelerometer": PerformanceRange(1e-7 * 9.80665, 1e-5 * 9.80665),
}
"""000 table 1.1 in m/s, rad/s and m/s².  The print has "≤ 1e-5 g" for low accelerometers, where ≥ is meant."""

GYRO_LIMITS: dict[str, tuple[float, float, float]] = {
    "scale": (1e-4, 1e-3, 1e-2),
    "bias_stability": (1e-2 * _DEGREE_PER_HOUR, 10.0 * _DEGREE_PER_HOUR, 1e2 * _DEGREE_PER_HOUR),
    "bias_drift": (1e-3 * _DEGREE_PER_ROOT_HOUR, 1e-1 * _DEGREE_PER_ROOT_HOUR, 10.0 * _DEGREE_PER_ROOT_HOUR),
}
"""Upper ends of the grades of 000 table 1.2: 1, rad/s and rad/√s."""


def performance(quantity: Literal["cep_rate", "gyro", "accelerometer"], value: float) -> Performance:
    """Class of a system or sensor by the U.S. Air Force's ranges (000 table 1.1).

    Parameters
    ----------
    quantity : {"cep_rate", "gyro", "accelerometer"}
    value : float
        Growth of the CEP, m/s; bias, rad/s or m/s²; >= 0.

    Returns
    -------
    {"high", "medium", "low"}

    Raises
    ------
    RangeError
        A negative value.
    """
    if not value >= 0.0:
        raise RangeError(quantity, value, ">= 0")
    # The table names one value a class; the borders lie halfway between them on its logarithmic scale.
    high, low = PERFORMANCE[quantity]
    step = (low / high) ** 0.25
    return _PERFORMANCES[int(np.searchsorted([high * step, low / step], value))]


def gyro_grade(*, scale: float = 0.0, bias_stability: float = 0.0, bias_drift: float = 0.0) -> GyroGrade:
    """Grade of a gyro: the worst that one of its figures demands (000 table 1.2).

    Parameters
    ----------
    scale : float
        Error of the scale factor.
    bias_stability : float
        From one switching on to the next, rad/s.
    bias_drift : float
        Angle random walk, rad/√s.

    Returns
    -------
    {"inertial", "intermediate", "moderate", "below"}
        "below" when a figure is beyond the table.

    Raises
    ------
    RangeError
        A negative figure.
    """
    worst = 0
    for name, value in (("scale", scale), ("bias_stability", bias_stability), ("bias_drift", bias_drift)):
        if not value >= 0.0:
            raise RangeError(name, value, ">= 0")
        worst = max(worst, int(np.searchsorted(np.array(GYRO_LIMITS[name]) * (1.0 + 1e-12), value)))
    return _GYRO_GRADES[worst]


def cep_radius(covariance: Floats, probability: float = 0.5) -> float:
    """Radius of the circle that holds a horizontal position error with a given probability.

    Parameters
    ----------
    covariance : ndarray, shape (2, 2)
        Of the error, m²; symmetric, not negative.
    probability : float
        0.5 for the CEP.

    Returns
    -------
    float
        m, to about 1e-6 of itself.

    Raises
    ------
    ShapeError, RangeError
        Not 2 x 2; probability outside 0..1; a negative variance.

    Notes
    -----
    000 section 1.3.2 speaks of the growth of the error ellipse.  The distribution of the radius is integrated over
    the ellipse of the given covariance; with equal axes the CEP is 1.1774 sigma.
    """
    from scipy.special import i0e

    P = np.asarray(covariance, dtype=np.float64)
    if P.shape != (2, 2):
        raise ShapeError("covariance", P.shape, "(2, 2)")
    if not 0.0 < probability < 1.0:
        raise RangeError("probability", probability, "0..1")
    small, large = np.linalg.eigvalsh(0.5 * (P + P.T))
    if small < -1e-12 * abs(large):
        raise RangeError("smallest variance", float(small), ">= 0")
    if large <= 0.0:
        return 0.0
    # In units of the long axis; an ellipse thinner than 1e-3 has the radius of a line to 1e-6.
    ratio = max(float(small) / float(large), 1e-6)
    thin = np.linspace(0.0, 6.0, 24_001)
    middle = 0.5 * (thin[1:] + thin[:-1])
    near, far = 0.25 * (1.0 / ratio - 1.0) * middle**2, 0.25 * (1.0 / ratio + 1.0) * middle**2
    density = middle / np.sqrt(ratio) * i0e(near) * np.exp(near - far)
    within = np.concatenate(([0.0], np.cumsum(density)))
    return float(np.sqrt(large) * np.interp(probability * within[-1], within, thin))


def cep_rate(t: Floats, errors: Floats) -> float:
    """Growth of the CEP of an inertial system over several runs.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Since each run began, s, > 0 somewhere.
    errors : ndarray, shape (runs, n, 2)
        Horizontal position errors, m.

    Returns
    -------
    float
        m/s: least squares slope through zero of the median radial error (000 section 1.3.2; figures are usually
        given in nautical miles per hour, `NAUTICAL_MILE` / 3600).

    Raises
    ------
    ShapeError, TooLittleDataError
        The shapes do not fit; no time beyond zero or no run.
    """
    t, errors = np.asarray(t, dtype=np.float64), np.asarray(errors, dtype=np.float64)
    if errors.ndim != 3 or errors.shape[1:] != (t.size, 2):
        raise ShapeError("errors", errors.shape, f"(runs, {t.size}, 2)")
    if errors.shape[0] == 0 or not np.any(t > 0.0):
        raise TooLittleDataError("errors", 0, 1)
    radius = np.median(np.hypot(errors[..., 0], errors[..., 1]), axis=0)
    return float(t @ radius / (t @ t))
