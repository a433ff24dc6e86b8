"""Accelerometers and gyros from many positions: only the input's magnitude is known (000 ch. 6, 001 section B.3)."""

from __future__ import annotations

from itertools import combinations, product
from typing import Literal, NamedTuple

import numpy as np

from nav_core.errors import PosesError, RangeError, ShapeError
from nav_core.sensors.calibration import (
    Calibration,
    Poses,
    check_reach,
    check_readings,
    check_spread,
    levenberg_marquardt,
    solution_covariance,
)
from nav_core.typing import Floats

Form = Literal["triangular", "symmetric"]


class _Parameters(NamedTuple):
    """Gain as a linear function of six parameters: ``gain = fixed + sum p_k basis_k``."""

    names: tuple[str, ...]
    fixed: Floats
    basis: Floats

    def gain(self, p: Floats) -> Floats:
        return self.fixed + np.tensordot(p, self.basis, 1)

    def of(self, gain: Floats) -> Floats:
        basis = self.basis.reshape(6, 9)
        return np.asarray(np.linalg.lstsq(basis.T, (gain - self.fixed).ravel(), rcond=None)[0], dtype=np.float64)


def _basis(*places: tuple[int, int, float]) -> Floats:
    basis = np.zeros((6, 3, 3))
    for k, (row, column, sign) in enumerate(places):
        basis[k, row, column] = sign
    return basis


_TRIANGULAR = _Parameters(
    ("b_x", "b_y", "b_z", "s_x", "s_y", "s_z", "theta_yz", "theta_zx", "theta_zy"),
    np.eye(3),
    _basis((0, 0, 1.0), (1, 1, 1.0), (2, 2, 1.0), (1, 0, -1.0), (2, 1, -1.0), (2, 0, 1.0)),
)
_UPPER = _basis((0, 0, 1.0), (1, 1, 1.0), (2, 2, 1.0), (0, 1, 1.0), (0, 2, 1.0), (1, 2, 1.0))
_SYMMETRIC = _Parameters(
    ("beta_x", "beta_y", "beta_z", "alpha_x", "alpha_y", "alpha_z", "alpha_xy", "alpha_xz", "alpha_yz"),
    np.zeros((3, 3)),
    np.maximum(_UPPER, np.swapaxes(_UPPER, 1, 2)),
)
_FORMS = {"triangular": _TRIANGULAR, "symmetric": _SYMMETRIC}


def calibrate_positions(
    readings: Floats, magnitude: Floats | float, *, form: Form = "triangular", noise: float | None = None
) -> Calibration:
    """Nine parameters from readings in many positions whose directions are not known.

    Parameters
    ----------
    readings : ndarray, shape (n, 3)
        Mean reading in each position, n >= 9 all over the sphere, and more unless `noise` is given.
    magnitude : float or ndarray, shape (n,)
        Of the true input: local gravity, the rate of a turntable, or the field.  The truth has its unit.
    form : {"triangular", "symmetric"}
        The magnitude leaves a common rotation open, so the gain has six parameters.  "triangular" is 000 eq. 6.2.7,
        with the x axis as reference: bias, scale deviation from one, and the misalignments theta_yz of the y axis
        and theta_zx, theta_zy of the z axis, rad.  "symmetric" is 001 eq. B.5: offsets and gains alpha.
    noise : float, optional
        Standard deviation of a reading; by default taken from the residuals.

    Returns
    -------
    Calibration
        Residuals: corrected magnitude less the true one.

    Raises
    ------
    PosesError
        Too few, coplanar, or missing the directions that some parameters need.
    ShapeError, NotFiniteError, RangeError
        Readings not (n, 3) or not finite; a magnitude not positive, or the `noise`.

    Notes
    -----
    000 eq. 6.2.8 and 001 eq. B.7 minimise the difference of squared magnitudes.  Here each difference of magnitudes
    is divided by its gain along the reading, so that with noise alike on all axes every residual has its variance:
    that matters for two turntable rates and for a soft iron ellipsoid.  The start comes from an ellipsoid fitted in
    closed form, so raw counts need no data sheet.
    """
    v = check_readings("readings", readings)
    check_spread(v, 9)
    given = np.asarray(magnitude, dtype=np.float64)
    if given.shape not in ((), (len(v),)):
        raise ShapeError("magnitude", given.shape, f"() or ({len(v)},)")
    size = np.broadcast_to(given, (len(v),))
    if not np.all(size > 0.0):
        raise RangeError("magnitude", float(size.min()), "> 0")
    parameters = _FORMS[form]
    # In units of the input, about the middle of the cloud: raw counts and m/s² alike, nothing cancels.
    middle, unit = v.mean(axis=0), float(size.mean())
    start = _start(v - middle, size / unit, parameters)
    weights = _weights(parameters.gain(start[3:]), v - middle - start[:3])
    minimum = levenberg_marquardt(lambda x: _residuals(x, v - middle, size / unit, weights, parameters), start)
    # The bias compares with the gain through the input's magnitude: both change a reading of one unit alike.
    covariance, freedom, condition = solution_covariance(
        minimum.jacobian, minimum.residuals, parameters.names, noise, len(v)
    )
    to_units = np.concatenate((np.ones(3), np.full(6, 1.0 / unit)))
    gain, bias = parameters.gain(minimum.x[3:]) / unit, minimum.x[:3] + middle
    corrected = np.linalg.solve(gain, (v - bias).T)
    length = np.linalg.norm(corrected, axis=0)
    check_reach((corrected / length).T)
    return Calibration(
        parameters.names,
        np.concatenate((bias, parameters.of(gain))),
        to_units[:, None] * covariance * to_units,
        gain,
        bias,
        length - size,
        freedom,
        Poses(len(v), 9, condition),
        minimum.iterations,
    )


def _weights(gain: Floats, v: Floats) -> Floats:
    """What a magnitude's error is multiplied with to be the reading's own: one over the gradient's length.

    Taken at the start, which is right to the size of the noise, and then held.
    """
    u = np.linalg.solve(gain, v.T)
    return 1.0 / np.linalg.norm(np.linalg.solve(gain.T, u / np.linalg.norm(u, axis=0)), axis=0)


def _residuals(x: Floats, v: Floats, size: Floats, weights: Floats, parameters: _Parameters) -> tuple[Floats, Floats]:
    """Weighted ``|gain^-1 (v - b)| - size`` and its derivative; the weights are held fixed."""
    inverse = np.linalg.pinv(parameters.gain(x[3:]))
    u = (v - x[:3]) @ inverse.T
    length = np.linalg.norm(u, axis=1)
    # d|u|/db = -(u/|u|)' gain^-1, and d|u|/dp_k = -(u/|u|)' gain^-1 basis_k u.
    along = -(weights / np.maximum(length, 1e-300))[:, None] * (u @ inverse)
    return weights * (length - size), np.column_stack((along, np.einsum("ni,kij,nj->nk", along, parameters.basis, u)))


def _start(v: Floats, size: Floats, parameters: _Parameters) -> Floats:
    """Bias and gain of the ellipsoid ``v'Pv - 2 v'q + c = size²`` through readings about their middle."""
    x, y, z = v.T
    quadratic = np.column_stack((x * x, y * y, z * z, 2.0 * x * y, 2.0 * x * z, 2.0 * y * z))
    if np.ptp(size) < 1e-6 * size.mean():
        # With one magnitude c cannot be told from the scale: fit with one on the right, then set the scale.
        p, q, constant = _quadric(np.column_stack((quadratic, -2.0 * v)), np.ones(len(v)))
    else:
        p, q, constant = _quadric(np.column_stack((quadratic, -2.0 * v, np.ones(len(v)))), size**2)
    shape = np.array([[p[0], p[3], p[4]], [p[3], p[1], p[5]], [p[4], p[5], p[2]]])
    if np.linalg.eigvalsh(shape)[0] <= 0.0:
        raise PosesError("they lie on no ellipsoid; directions are missing, or the box was moved", len(v), np.inf)
    bias: Floats = np.asarray(np.linalg.solve(shape, q), dtype=np.float64)
    if constant is None:
        shape *= float(size.mean()) ** 2 / (1.0 + float(bias @ shape @ bias))
    if parameters is _TRIANGULAR:
        gain: Floats = np.asarray(np.linalg.cholesky(np.linalg.inv(shape)), dtype=np.float64)
    else:
        sizes, axes = np.linalg.eigh(shape)
        gain = np.asarray((axes / np.sqrt(sizes)) @ axes.T, dtype=np.float64)
    return np.concatenate((bias, parameters.of(gain)))


def _quadric(design: Floats, right: Floats) -> tuple[Floats, Floats, float | None]:
    scale = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    x = np.linalg.lstsq(design / scale, right, rcond=None)[0] / scale
    return x[:6], x[6:9], float(x[9]) if x.size == 10 else None


def six_positions(up: Floats, down: Floats, magnitude: float) -> tuple[Floats, Floats]:
    """Bias and scale of each axis, from pointing it exactly up and exactly down.

    Parameters
    ----------
    up, down : ndarray, shape (3,)
        Mean reading of each axis with the input along and against it.
    magnitude : float
        Of the input.

    Returns
    -------
    bias, scale : ndarray, shape (3,)
        Scale as deviation from one.

    Raises
    ------
    ShapeError, RangeError
        Not three readings; `magnitude` not positive.

    Notes
    -----
    000 eqs. 6.2.1 and 6.2.2, whose numerator is printed as the sum where ``up - down - 2k`` is meant.  Misalignment
    is not seen, and levelling errors enter in the second order.
    """
    if not magnitude > 0.0:
        raise RangeError("magnitude", magnitude, "> 0")
    high, low = np.asarray(up, dtype=np.float64), np.asarray(down, dtype=np.float64)
    for name, values in (("up", high), ("down", low)):
        if values.shape != (3,):
            raise ShapeError(name, values.shape, "(3,)")
    return 0.5 * (high + low), (high - low - 2.0 * magnitude) / (2.0 * magnitude)


def eighteen_directions() -> Floats:
    """Input directions of the 18-position method, unit vectors, shape (18, 3): faces and edges of a cube.

    000 section 6.2.1, eqs. 6.2.4-6.2.5.  With `calibrate_reference` they are the directions that the table is
    levelled for; with `calibrate_positions` they need only be about right.
    """
    faces = [sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    edges = [
        (a * first + b * second) / np.sqrt(2.0)
        for first, second in combinations(np.eye(3), 2)
        for a, b in product((1.0, -1.0), repeat=2)
    ]
    return np.array(faces + edges)
