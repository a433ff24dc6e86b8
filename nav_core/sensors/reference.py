"""Twelve parameters of a triad against a known input (002 sections 6.2-6.5, 000 eq. 6.2.3)."""

from __future__ import annotations

import numpy as np

from nav_core.attitude.euler_rates import body_rate
from nav_core.errors import OrderError, PosesError, ShapeError, TooLittleDataError
from nav_core.rotation import euler_to_matrix
from nav_core.sensors.calibration import WORST_CONDITION, Calibration, Poses, check_readings
from nav_core.typing import Floats, trailing

_NAMES = (
    *("b_x", "b_y", "b_z", "k_x", "k_y", "k_z"),
    *("alpha_yz", "alpha_zy", "alpha_xz", "alpha_zx", "alpha_xy", "alpha_yx"),
)
# Place and sign in the matrix of 6.3 of the misalignments, in the order of the names.
_MISALIGNMENTS = ((0, 1, -1.0), (0, 2, 1.0), (1, 0, 1.0), (1, 2, -1.0), (2, 0, -1.0), (2, 1, 1.0))


def calibrate_reference(readings: Floats, truth: Floats) -> Calibration:
    """Bias, scale and six misalignments of a triad from readings of a known input.

    Parameters
    ----------
    readings : ndarray, shape (n, 3)
        Single readings or means, n >= 5, with errors alike over the whole set, axis by axis.
    truth : ndarray, shape (n, 3)
        The input in the body axes, exact: from `reference_rates`, `reference_vectors`, or a levelled table.

    Returns
    -------
    Calibration
        Parameters of 002 eq. 6.10: bias in the unit of the readings, scale k in readings per truth, and
        alpha_ij, the rotation of sense axis i about body axis j, rad.  Residuals: corrected less true, shape (n, 3).

    Raises
    ------
    PosesError
        Fewer than 5, or inputs that lie in a plane.
    ShapeError, NotFiniteError

    Notes
    -----
    002 eq. 6.16 regresses the truth on the readings.  The noise is in the readings, so that shrinks every gain by the
    ratio of noise to signal, which does not go away with more data.  Here the readings are regressed on the truth
    (000 eq. 6.2.3) and the result inverted.  6.11 is used as corrected in docs/equations.md.
    """
    y, x = check_readings("readings", readings), check_readings("truth", truth)
    if x.shape != y.shape:
        raise ShapeError("truth", x.shape, str(y.shape))
    if len(x) < 5:
        raise PosesError("5 are needed", len(x), np.inf)
    # In units of the input's size, so that the bias compares with the gain.
    unit = float(np.sqrt(np.mean(np.sum(x**2, axis=1)))) or 1.0
    X = np.column_stack((np.ones(len(x)), x / unit))
    _, sizes, axes = np.linalg.svd(X, full_matrices=False)
    condition = float(sizes[0] / sizes[-1]) if sizes[-1] > 0.0 else np.inf
    if condition > WORST_CONDITION:
        direction = axes[-1, 1:] / max(float(np.linalg.norm(axes[-1, 1:])), 1e-300)
        raise PosesError(
            f"the inputs are coplanar; nothing excites the direction ({', '.join(f'{d:.2f}' for d in direction)})",
            len(x),
            condition,
        )
    inverse = (axes.T / sizes**2) @ axes
    solution = inverse @ X.T @ y
    left = y - X @ solution
    freedom = len(x) - 4
    to_units = np.array([1.0, 1.0 / unit, 1.0 / unit, 1.0 / unit])
    rows = solution.T * to_units
    unit_covariance = to_units[:, None] * inverse * to_units
    covariance = np.zeros((3, 4, 3, 4))
    for axis in range(3):
        covariance[axis, :, axis, :] = left[:, axis] @ left[:, axis] / freedom * unit_covariance
    bias, gain = rows[:, 0], rows[:, 1:]
    values, slope = _named(gain, bias)
    return Calibration(
        _NAMES,
        values,
        slope @ covariance.reshape(12, 12) @ slope.T,
        gain,
        bias,
        (y - bias) @ np.linalg.inv(gain).T - x,
        freedom,
        Poses(len(x), 5, condition),
    )


def _named(gain: Floats, bias: Floats) -> tuple[Floats, Floats]:
    """Parameters of 6.10 and their derivative by the rows (bias, gain) of the regression, shapes (12,) and (12, 12).

    ``gain^-1 = T K^-1`` with ones on the diagonal of T: the diagonal holds 1/k, the rest ±alpha/k of its column.
    """
    W = np.linalg.inv(gain)
    diagonal = np.diag(W)
    values = np.concatenate((bias, 1.0 / diagonal, [sign * W[i, j] / W[j, j] for i, j, sign in _MISALIGNMENTS]))
    slope = np.zeros((12, 3, 4))
    slope[np.arange(3), np.arange(3), 0] = 1.0
    for row in range(3):
        for column in range(3):
            # d(gain^-1) = -gain^-1 d(gain) gain^-1
            dW = -np.outer(W[:, row], W[column])
            slope[3:6, row, 1 + column] = -np.diag(dW) / diagonal**2
            slope[6:, row, 1 + column] = [
                sign * (dW[i, j] * W[j, j] - W[i, j] * dW[j, j]) / W[j, j] ** 2 for i, j, sign in _MISALIGNMENTS
            ]
    return values, slope.reshape(12, 12)


def reference_vectors(euler: Floats, vector: Floats) -> Floats:
    """A known vector of the T-frame in the body axes: gravity or the Earth's field at known attitudes.

    Parameters
    ----------
    euler : ndarray, shape (n, 3)
        Roll, pitch, yaw of the body, rad.
    vector : ndarray, shape (3,)
        North, east, down: ``(0, 0, -g)`` for specific force at rest, or the field.

    Returns
    -------
    ndarray, shape (n, 3)
        002 eqs. 6.19 and 6.22.

    Raises
    ------
    ShapeError
    """
    roll, pitch, yaw = trailing("euler", euler, 3).T
    return trailing("vector", vector, 3) @ euler_to_matrix(roll, pitch, yaw)


def reference_rates(t: Floats, euler: Floats, *, smoothing: float | None = None) -> Floats:
    """Body rates of a table whose angles are read by encoders.

    Parameters
    ----------
    t : ndarray, shape (n,)
        s, strictly increasing, n >= 5.
    euler : ndarray, shape (n, 3)
        Roll, pitch, yaw without jumps by 2 pi, rad.
    smoothing : float, optional
        Weight of the spline's roughness, s³; by default chosen by cross-validation, which takes about a second for
        a thousand samples.  0: passes through every angle.

    Returns
    -------
    ndarray, shape (n, 3)
        rad/s (002 section 6.3, eq. 6.13): angles smoothed by a cubic spline, its derivative turned into body axes.

    Raises
    ------
    ShapeError, OrderError, TooLittleDataError
    """
    from scipy.interpolate import make_smoothing_spline

    t, angles = np.asarray(t, dtype=np.float64), trailing("euler", euler, 3)
    if angles.shape != (t.size, 3):
        raise ShapeError("euler", angles.shape, f"({t.size}, 3)")
    if t.size < 5:
        raise TooLittleDataError("euler", int(t.size), 5)
    if not np.all(np.diff(t) > 0.0):
        raise OrderError("t", int(np.argmax(np.diff(t) <= 0.0)) + 1)
    splines = [make_smoothing_spline(t, column, lam=smoothing) for column in angles.T]
    smooth = np.column_stack([spline(t) for spline in splines])
    return body_rate(smooth, np.column_stack([spline.derivative()(t) for spline in splines]))
