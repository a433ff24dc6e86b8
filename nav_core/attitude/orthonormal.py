"""Making a rotation of what integration and rounding have bent (004 §"Dimostrazione ortogonalità").

The nearest rotation in the Frobenius norm; as 004 warns, it is a rotation again and no nearer to the truth: an error
of one element is spread over the others.
"""

from __future__ import annotations

import numpy as np

from nav_core.errors import RangeError
from nav_core.rotation import normalised
from nav_core.typing import Floats, trailing


def orthonormality_error(C: Floats) -> Floats:
    """004's error matrix ``E = C' C - I``, shape (..., 3, 3); zero for a rotation.

    Parameters
    ----------
    C : ndarray, shape (..., 3, 3)
        Almost a rotation.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        Symmetric.

    Raises
    ------
    ShapeError
    """
    given = trailing("C", C, 3, 3)
    return np.swapaxes(given, -1, -2) @ given - np.eye(3)


def orthonormalise_series(C: Floats, *, terms: int = 3) -> Floats:
    """Nearest rotation by 004 eq. 15: ``C (I - E/2 + 3 E²/8 - 5 E³/16 + ...)``.

    Parameters
    ----------
    C : ndarray, shape (..., 3, 3)
        Almost a rotation: every eigenvalue of ``E`` must lie within (-1, 1).
    terms : int
        Powers of E kept, >= 1; 3 is the equation as printed.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        ``C (I + E)^(-1/2)`` with an error of the order ``|E|^(terms + 1)``.

    Raises
    ------
    RangeError
        Where the series diverges.
    """
    E = orthonormality_error(C)
    largest = float(np.max(np.abs(np.linalg.eigvalsh(E)), initial=0.0))
    if largest >= 1.0:
        raise RangeError("largest eigenvalue of E", largest, "< 1, where the series converges")
    # Horner's scheme with the ratio of successive binomial coefficients of the power -1/2.
    total = np.broadcast_to(np.eye(3), E.shape)
    for k in range(terms, 0, -1):
        total = np.eye(3) - (2.0 * k - 1.0) / (2.0 * k) * E @ total
    return C @ total


def orthonormalise(C: Floats) -> Floats:
    """Nearest rotation, exactly: ``C (C' C)^(-1/2)``.

    Parameters
    ----------
    C : ndarray, shape (..., 3, 3)
        Any matrix of positive determinant.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        With ``C = U S V'`` it is ``U V'``.

    Raises
    ------
    RangeError
        Where the determinant is not positive: no rotation is near.
    """
    given = trailing("C", C, 3, 3)
    least = float(np.min(np.linalg.det(given), initial=np.inf))
    if not least > 0.0:
        raise RangeError("determinant", least, "> 0")
    U, _, Vt = np.linalg.svd(given)
    return U @ Vt


def normalise_series(q: Floats) -> Floats:
    """Quaternion of almost unit length by 004's first-order formula ``q (1 + D/2)``, ``D = 1 - |q|²``, shape (..., 4).

    What remains of a small D is 3 D²/8; `nav_core.rotation.normalised` is exact.

    Parameters
    ----------
    q : ndarray, shape (..., 4)
        Order (x, y, z, w).

    Returns
    -------
    ndarray, shape (..., 4)
        Of length 1 to first order in ``1 - |q|²``.

    Raises
    ------
    ShapeError, RangeError
        As `nav_core.rotation.normalised`.
    """
    # The exact function checks the shape and refuses zero on the way.
    unit = normalised(q)
    length = np.sum(unit * q, axis=-1, keepdims=True)
    return q * (1.0 + 0.5 * (1.0 - length**2))
