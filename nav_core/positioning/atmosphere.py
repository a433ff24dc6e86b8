"""What the atmosphere does to ranges: the ionosphere, seen by two frequencies; the troposphere (000 §5.8.5, 5.8.6)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.errors import RangeError
from nav_core.typing import Floats

L1, L2 = 1_575.42e6, 1_227.60e6
"""GPS carriers, Hz."""

LOWEST = np.radians(10.0)
"""Elevation below which Saastamoinen's formula is not meant to hold, rad."""

_B_HEIGHT = np.array([0.0, 500.0, 1000.0, 1500.0, 2000.0, 2500.0, 3000.0, 4000.0, 5000.0])
_B_PASCAL = 100.0 * np.array([1.156, 1.079, 1.006, 0.938, 0.874, 0.813, 0.757, 0.654, 0.563])
"""Saastamoinen's B against height (Hofmann-Wellenhof et al. 1992, table 6.3)."""


def ionosphere_free(first: Floats, second: Floats, f1: float = L1, f2: float = L2) -> Floats:
    """Ranges without the ionosphere's delay, from two frequencies (5.8.3).

    Parameters
    ----------
    first, second : ndarray, shape (...)
        Code or phase on the two frequencies, m.
    f1, f2 : float
        Hz, different.

    Returns
    -------
    ndarray, shape (...)
        m.  Noise grows: see `ionosphere_free_gain`.

    Raises
    ------
    RangeError
    """
    return first + ionospheric_advance(first, second, f1, f2)


def ionospheric_advance(first: Floats, second: Floats, f1: float = L1, f2: float = L2) -> Floats:
    """What to add to the first range to free it of the ionosphere: minus its delay, m (from 5.8.2).

    Parameters
    ----------
    first, second : ndarray, shape (...)
        Ranges at the two frequencies, m.
    f1, f2 : float
        Hz.

    Returns
    -------
    ndarray, shape (...)
        m.

    Raises
    ------
    RangeError
    """
    if f1 == f2:
        raise RangeError("second frequency", f2, "another than the first")
    return (first - second) * f2**2 / (f1**2 - f2**2)


def ionosphere_free_gain(f1: float = L1, f2: float = L2) -> float:
    """By how much `ionosphere_free` enlarges independent equal noise of both ranges: about 3 for L1 and L2.

    Parameters
    ----------
    f1, f2 : float
        Hz.

    Returns
    -------
    float
        Factor on the 1-sigma of either.
    """
    return float(np.hypot(f1**2, f2**2) / abs(f1**2 - f2**2))


class Air(NamedTuple):
    """Air at the antenna."""

    pressure: float
    """Pa."""
    temperature: float
    """K."""
    vapour: float
    """Partial pressure of water vapour, Pa."""


def standard_air(height: float, humidity: float = 0.5) -> Air:
    """Standard atmosphere.

    Parameters
    ----------
    height : float
        Above the sea, m, -1 to 11 km.
    humidity : float
        Relative, 0 to 1.

    Returns
    -------
    Air

    Raises
    ------
    RangeError

    Notes
    -----
    ICAO standard atmosphere; vapour by Magnus' formula with the coefficients of the WMO.
    """
    if not -1000.0 <= height <= 11000.0:
        raise RangeError("height", height, "-1 to 11 km")
    if not 0.0 <= humidity <= 1.0:
        raise RangeError("humidity", humidity, "0 to 1")
    temperature = 288.15 - 6.5e-3 * height
    pressure = 101_325.0 * (temperature / 288.15) ** 5.2559
    celsius = temperature - 273.15
    return Air(pressure, temperature, humidity * 611.2 * float(np.exp(17.62 * celsius / (243.12 + celsius))))


def saastamoinen(elevation: Floats, *, lat: float, height: float, air: Air, correction: float = 0.0) -> Floats:
    """Delay of the troposphere.

    Parameters
    ----------
    elevation : ndarray, shape (...)
        rad, at least 10°.
    lat, height : float
        Of the antenna: rad; above the sea, m, up to 5 km.
    air : Air
    correction : float
        Saastamoinen's ``delta R``, m: below 1 cm above 20° of elevation.

    Returns
    -------
    ndarray, shape (...)
        m, to take off code and phase alike.

    Raises
    ------
    RangeError

    Notes
    -----
    Saastamoinen 1973; 000 eqs. 5.8.4, 5.8.5.  The print multiplies the pressure with the vapour's term and has ``tan``
    of the zenith distance: ``P + (1255 / T + 0.005) e - B tan²`` is meant.
    """
    elevation = np.asarray(elevation, dtype=np.float64)
    if not elevation.min(initial=np.inf) >= LOWEST:
        raise RangeError("elevation", float(np.degrees(elevation.min())), "10° or more")
    if not -1000.0 <= height <= _B_HEIGHT[-1]:
        raise RangeError("height", height, "-1 to 5 km")
    zenith = 0.5 * np.pi - elevation
    bend = np.interp(height, _B_HEIGHT, _B_PASCAL)
    site = 0.0026 * np.cos(2.0 * lat) + 0.00028 * 1e-3 * height
    load = air.pressure + (1255.0 / air.temperature + 0.005) * air.vapour - bend * np.tan(zenith) ** 2
    return 0.002277e-2 * (1.0 + site) / np.cos(zenith) * load + correction
