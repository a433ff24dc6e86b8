"""Hard and soft iron of a magnetometer (002 section 6.5).

With known attitudes the regression of `calibrate_reference` on `reference_vectors` gives all twelve parameters, the
alignment with the body among them (002 eq. 6.21).  Without, the readings of any motion lie on an ellipsoid.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from nav_core.sensors.calibration import Calibration
from nav_core.sensors.positions import calibrate_positions
from nav_core.typing import Floats


@dataclass(frozen=True, slots=True)
class FieldCalibration:
    """Hard and soft iron from readings all around.

    Attributes
    ----------
    calibration : Calibration
        ``reading = gain @ field + bias``: bias is the hard iron, the symmetric gain the soft iron and the scales.
    field : float
        Magnitude of the field, in the unit of the readings unless it was given in another.
    semi_axes : ndarray, shape (3,)
        Of the ellipsoid on which the readings lie, decreasing, in the unit of the readings.
    """

    calibration: Calibration
    field: float
    semi_axes: Floats


def calibrate_field(readings: Floats, field: float | None = None, *, noise: float | None = None) -> FieldCalibration:
    """Fit the ellipsoid of a magnetometer's readings.

    Parameters
    ----------
    readings : ndarray, shape (n, 3)
        Single readings in directions all over the sphere, n >= 10 (9 with `noise`).
    field : float, optional
        Magnitude of the true field, e.g. from `nav_core.earth.magnetic_field`.  Without it the scale stays open: the
        gain is then taken to leave volumes alone, ``det(gain) = 1``, and the field is the geometric mean of the
        semi-axes.
    noise : float, optional
        Standard deviation of a reading; by default taken from the residuals.

    Returns
    -------
    FieldCalibration

    Raises
    ------
    PosesError, ShapeError, NotFiniteError, RangeError
        As `calibrate_positions`.

    Notes
    -----
    A rotation between the sensor and the body cannot be seen this way; the symmetric gain has none.
    """
    found = calibrate_positions(readings, 1.0 if field is None else field, form="symmetric", noise=noise)
    size = 1.0 if field is None else field
    if field is None:
        # Fitted with a field of one; c gives it the magnitude that leaves the gain with a determinant of one.
        size = float(np.linalg.det(found.gain)) ** (1.0 / 3.0)
        values = np.concatenate((found.bias, found.values[3:] / size))
        # d ln(size) = trace(gain^-1 d gain) / 3, and an off-diagonal parameter stands in the gain twice.
        inverse = np.linalg.inv(found.gain)
        share = np.array([inverse[0, 0], inverse[1, 1], inverse[2, 2]]) / 3.0
        twice = 2.0 * np.array([inverse[0, 1], inverse[0, 2], inverse[1, 2]]) / 3.0
        slope = np.eye(9)
        slope[3:, 3:] = (np.eye(6) - np.outer(found.values[3:], np.concatenate((share, twice)))) / size
        found = replace(
            found,
            values=values,
            covariance=slope @ found.covariance @ slope.T,
            gain=found.gain / size,
            residuals=found.residuals * size,
        )
    semi_axes = size * np.asarray(np.linalg.svd(found.gain, compute_uv=False), dtype=np.float64)
    return FieldCalibration(found, size, semi_axes)
