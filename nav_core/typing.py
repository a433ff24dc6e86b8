"""Array types, and the one typed door to the compiler."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from nav_core.errors import NotFiniteError, ShapeError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

P = ParamSpec("P")
R = TypeVar("R")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a numerical kernel at its first call; the machine code is cached on disk.

    Numba is imported here and not above, so that a process that only needs the records
    (the API) never loads it.

    Parameters
    ----------
    function : Callable[P, R]
        Of numbers, arrays and named tuples of them.

    Returns
    -------
    Callable[P, R]
        To be called alike.
    """
    from numba import njit

    return njit(cache=True, error_model="numpy")(function)  # pyright: ignore[reportReturnType]  keeps the signature


def trailing(name: str, values: Floats, *axes: int) -> Floats:
    """`values` as floats whose last axes are `axes`, with any leading ones; else `ShapeError` under this name.

    Parameters
    ----------
    name : str
        What it is, for the error.
    values : ndarray, shape (..., *axes)
        In any unit.
    *axes : int
        Lengths of the last axes.

    Returns
    -------
    ndarray, shape (..., *axes)
        The same numbers.

    Raises
    ------
    ShapeError
    """
    array = np.asarray(values, dtype=np.float64)
    if array.shape[array.ndim - len(axes) :] != axes or array.ndim < len(axes):
        raise ShapeError(name, array.shape, f"(..., {', '.join(map(str, axes))})")
    return array


def finite(name: str, values: Floats) -> Floats:
    """`values` where all of them are numbers; else `NotFiniteError` under this name.

    Parameters
    ----------
    name : str
        What they are, for the error.
    values : ndarray, shape (n, ...)
        In any unit.

    Returns
    -------
    ndarray, shape (n, ...)
        The same array.

    Raises
    ------
    NotFiniteError
        With the first index along the first axis.
    """
    good = np.isfinite(values)
    if not good.all():
        raise NotFiniteError(name, int(np.argwhere(~good)[0][0]))
    return values
