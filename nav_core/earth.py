"""The Earth: its ellipsoid, gravity, turning, and magnetic field.

Frames: e is Earth-centred and Earth-fixed, z through the north pole, x through Greenwich; T (n) is the local tangent
north, east, down.  Heights are above the WGS84 ellipsoid, positive upwards.  The models are the ones of
Groves 2013 ch. 2; 000 §2.5 takes the Earth for a sphere where the code has both radii of curvature.

The functions of plain arithmetic take floats or arrays alike and are also compiled into the strapdown kernels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from nav_core.errors import RangeError
from nav_core.typing import Floats, trailing

SEMI_MAJOR = 6_378_137.0
"""Equatorial radius a, m (WGS84)."""
FLATTENING = 1.0 / 298.257_223_563
"""f (WGS84)."""
ECCENTRICITY2 = FLATTENING * (2.0 - FLATTENING)
"""First eccentricity squared, e²."""
SEMI_MINOR = SEMI_MAJOR * (1.0 - FLATTENING)
"""Polar radius b, m."""
RATE = 7.292_115e-5
"""Angular rate of the Earth, rad/s (WGS84)."""
GRAVITATION = 3.986_004_418e14
"""Gravitational constant times mass GM, m³/s² (WGS84)."""
GRAVITY_EQUATOR = 9.780_325_335_9
GRAVITY_POLE = 9.832_184_937_8
"""Normal gravity on the ellipsoid, m/s² (WGS84)."""
STANDARD_GRAVITY = 9.806_65
"""The conventional g, m/s²."""
SOMIGLIANA = SEMI_MINOR * GRAVITY_POLE / (SEMI_MAJOR * GRAVITY_EQUATOR) - 1.0
"""k of Somigliana's formula."""
CENTRIFUGAL_RATIO = RATE**2 * SEMI_MAJOR**2 * SEMI_MINOR / GRAVITATION
"""m: centrifugal over gravitational acceleration at the equator."""

DEEPEST = 1.0e6
"""Distance from the Earth's centre, m, below which geodetic coordinates are not sought."""

FIELD_CELL = np.radians(0.09)
"""Side of the cells over which one magnetic field is kept, rad: 10 km along a meridian."""
FIELD_LAYER = 1000.0
"""Their height, m."""
FIRST_YEAR, LAST_YEAR = 2010.0, 2030.0


def radii(lat: Floats | float) -> tuple[Floats, Floats]:
    """Radii of curvature of the ellipsoid: along the meridian, and across it.

    Parameters
    ----------
    lat : float or ndarray, shape (...)
        Geodetic latitude, rad.

    Returns
    -------
    meridian, normal : as `lat`
        R_N and R_E, m.  Add the height before turning speeds into rates (Groves 2013 eqs. 2.105, 2.106).
    """
    bulge = 1.0 - ECCENTRICITY2 * np.sin(lat) ** 2
    normal = SEMI_MAJOR / np.sqrt(bulge)
    return normal * (1.0 - ECCENTRICITY2) / bulge, normal


def gravity(lat: Floats | float, height: Floats | float) -> Floats:
    """Normal gravity, pointing down.

    Parameters
    ----------
    lat, height : float or ndarray, shape (...)
        Geodetic latitude, rad; height above the ellipsoid, m.

    Returns
    -------
    float or ndarray, shape (...)
        m/s²: gravitation and centrifugal acceleration together (000 eq. 2.5.5).

    Notes
    -----
    Somigliana's formula, and the height to second order (Groves 2013 eqs. 2.134, 2.139).  Gravity is taken to point
    along the ellipsoid's normal also above it; the north component left out is 8e-9 /s² times height times sin(2 lat).
    """
    return gravity_at(np.sin(lat) ** 2, height)


def gravity_at(sin2_lat: Floats | float, height: Floats | float) -> Floats:
    """`gravity`, m/s², where the square of the sine of the latitude is at hand.

    Parameters
    ----------
    sin2_lat : ndarray or float, shape (...)
        Square of the sine of the latitude.
    height : ndarray or float, shape (...)
        Above the ellipsoid, m.

    Returns
    -------
    ndarray, shape (...)
        m/s², downwards (Groves 2013 §2.4).
    """
    surface = GRAVITY_EQUATOR * (1.0 + SOMIGLIANA * sin2_lat) / np.sqrt(1.0 - ECCENTRICITY2 * sin2_lat)
    linear = 2.0 * (1.0 + FLATTENING + CENTRIFUGAL_RATIO - 2.0 * FLATTENING * sin2_lat) / SEMI_MAJOR
    return surface * (1.0 - linear * height + 3.0 / SEMI_MAJOR**2 * height**2)


def earth_rate(lat: Floats | float) -> Floats:
    """Turning of e against i, in T axes, rad/s, shape (..., 3): ``(W cos lat, 0, -W sin lat)`` (004 eq. 22).

    Parameters
    ----------
    lat : ndarray or float, shape (...)
        Geodetic, rad.

    Returns
    -------
    ndarray, shape (..., 3)
        rad/s, T axes.
    """
    lat = np.asarray(lat, dtype=np.float64)
    return RATE * np.stack((np.cos(lat), np.zeros_like(lat), -np.sin(lat)), axis=-1)


def transport_rate(lat: Floats | float, height: Floats | float, velocity: Floats) -> Floats:
    """Turning of T against e, in T axes.

    Parameters
    ----------
    lat, height : float or ndarray, shape (...)
        rad, m.
    velocity : ndarray, shape (..., 3)
        North, east, down, m/s.

    Returns
    -------
    ndarray, shape (..., 3)
        rad/s: ``(v_E / (R_E + h), -v_N / (R_N + h), -v_E tan(lat) / (R_E + h))``; without bound at the poles.

    Notes
    -----
    000 eq. 2.5.23 with the two radii of curvature in place of its sphere.
    """
    v = trailing("velocity", velocity, 3)
    meridian, normal = radii(np.asarray(lat, dtype=np.float64))
    east = v[..., 1] / (normal + height)
    north = v[..., 0] / (meridian + height)
    return np.stack(np.broadcast_arrays(east, -north, -east * np.tan(lat)), axis=-1)


def tangent_axes(lat: Floats | float, lon: Floats | float) -> Floats:
    """North, east and down seen from e.

    Parameters
    ----------
    lat, lon : float or ndarray, shape (...)
        rad, broadcast.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        ``R_et``: its columns are north, east and down in e axes; ``vec_e = R_et @ vec_t``.  At a pole, north is the
        limit along the meridian `lon`.
    """
    lat, lon = np.broadcast_arrays(lat, lon)
    sl, cl, so, co = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    R = np.empty((*lat.shape, 3, 3))
    R[..., 0, 0], R[..., 0, 1], R[..., 0, 2] = -sl * co, -so, -cl * co
    R[..., 1, 0], R[..., 1, 1], R[..., 1, 2] = -sl * so, co, -cl * so
    R[..., 2, 0], R[..., 2, 1], R[..., 2, 2] = cl, 0.0, -sl
    return R


def geodetic_to_ecef(lat: Floats | float, lon: Floats | float, height: Floats | float) -> Floats:
    """Position in e, m, shape (..., 3), of geodetic coordinates in rad and m (Groves 2013 eq. 2.112).

    Parameters
    ----------
    lat, lon : ndarray or float, shape (...)
        Geodetic, WGS84, rad.
    height : ndarray or float, shape (...)
        Above the ellipsoid, m.

    Returns
    -------
    ndarray, shape (..., 3)
        e axes, m.
    """
    lat, lon, height = np.broadcast_arrays(lat, lon, height)
    _, normal = radii(np.asarray(lat, dtype=np.float64))
    across = (normal + height) * np.cos(lat)
    along = (normal * (1.0 - ECCENTRICITY2) + height) * np.sin(lat)
    return np.stack((across * np.cos(lon), across * np.sin(lon), along), axis=-1)


def meridian_of(p: Floats | float, z: Floats | float) -> tuple[Floats, Floats, Floats]:
    """Geodetic latitude and height in the meridian plane.

    Parameters
    ----------
    p, z : float or ndarray, shape (...)
        Distance from the axis (>= 0) and from the plane of the equator, m; further than `DEEPEST` from the centre.

    Returns
    -------
    sin_lat, cos_lat, height : as `p`

    Notes
    -----
    Bowring's iteration on the tangent of the parametric latitude (Bowring 1976), by sine and cosine so that
    equator and poles are ordinary points; three rounds reach rounding from `DEEPEST` up to any height.
    """
    # `up` over `out` is the tangent of the latitude; it starts as it would be on the ellipsoid itself.
    up, out = 1.0 * z, (1.0 - ECCENTRICITY2) * p
    for _ in range(3):
        sine, cosine = (1.0 - FLATTENING) * up, out
        length = np.sqrt(sine * sine + cosine * cosine)
        up = z + ECCENTRICITY2 / (1.0 - FLATTENING) * SEMI_MAJOR * (sine / length) ** 3
        out = p - ECCENTRICITY2 * SEMI_MAJOR * (cosine / length) ** 3
    length = np.sqrt(up * up + out * out)
    sin_lat, cos_lat = up / length, out / length
    height = p * cos_lat + z * sin_lat - SEMI_MAJOR * np.sqrt(1.0 - ECCENTRICITY2 * sin_lat * sin_lat)
    return sin_lat, cos_lat, height


def ecef_to_geodetic(r_e: Floats) -> tuple[Floats, Floats, Floats]:
    """Geodetic coordinates of positions in e.

    Parameters
    ----------
    r_e : ndarray, shape (..., 3)
        m; at least `DEEPEST` from the centre, else `RangeError`.

    Returns
    -------
    lat, lon, height : ndarray, shape (...)
        rad in [-pi/2, pi/2], rad in [-pi, pi], m.  On the axis the longitude is 0.
    """
    r = trailing("r_e", r_e, 3)
    depth = np.sqrt(np.min(np.sum(r**2, axis=-1), initial=np.inf))
    if not depth >= DEEPEST:
        raise RangeError("distance from the Earth's centre", float(depth), f">= {DEEPEST:g} m")
    sin_lat, cos_lat, height = meridian_of(np.hypot(r[..., 0], r[..., 1]), r[..., 2])
    return np.arctan2(sin_lat, cos_lat), np.arctan2(r[..., 1], r[..., 0]), height


def geodetic_to_tangent(
    lat: Floats | float, lon: Floats | float, height: Floats | float, origin: tuple[float, float, float]
) -> Floats:
    """North, east and down of an origin.

    Parameters
    ----------
    lat, lon, height : float or ndarray, shape (...)
        rad, rad, m.
    origin : tuple of float
        Latitude, longitude, height of the origin.

    Returns
    -------
    ndarray, shape (..., 3)
        m, straight lines in the origin's T axes (no curving with the Earth).
    """
    from_origin = geodetic_to_ecef(lat, lon, height) - geodetic_to_ecef(*origin)
    return from_origin @ tangent_axes(origin[0], origin[1])


def tangent_to_geodetic(r_t: Floats, origin: tuple[float, float, float]) -> tuple[Floats, Floats, Floats]:
    """Inverse of `geodetic_to_tangent`: latitude, longitude (rad) and height (m), each of shape (...).

    Parameters
    ----------
    r_t : ndarray, shape (..., 3)
        North, east, down of the origin, m.
    origin : tuple of float
        Latitude, longitude, rad, and height, m.

    Returns
    -------
    lat : ndarray, shape (...)
        rad.
    lon : ndarray, shape (...)
        rad.
    height : ndarray, shape (...)
        Above the ellipsoid, m.

    Raises
    ------
    ShapeError
    """
    r_e = trailing("r_t", r_t, 3) @ tangent_axes(origin[0], origin[1]).T + geodetic_to_ecef(*origin)
    return ecef_to_geodetic(r_e)


def decimal_year(utc: float) -> float:
    """Year and the share of it gone by, UTC, of Unix seconds.

    Parameters
    ----------
    utc : float
        Unix time, s.

    Returns
    -------
    float
        As 2026.25.
    """
    day = np.datetime64(round(utc), "s")
    first = day.astype("datetime64[Y]")
    begin, end = first.astype("datetime64[s]"), (first + 1).astype("datetime64[s]")
    return 1970.0 + float(first.astype(np.int64)) + float((day - begin) / (end - begin))


@dataclass(frozen=True, slots=True)
class MagneticField:
    """The Earth's magnetic field at a place.

    Attributes
    ----------
    north, east, down : float
        µT, T axes.
    """

    north: float
    east: float
    down: float

    @property
    def vector(self) -> Floats:
        """North, east, down, µT, shape (3,)."""
        return np.array([self.north, self.east, self.down])

    @property
    def strength(self) -> float:
        """µT."""
        return float(np.linalg.norm(self.vector))

    @property
    def declination(self) -> float:
        """Of the horizontal field from true north, clockwise, rad: course = magnetic course + declination."""
        return float(np.arctan2(self.east, self.north))

    @property
    def inclination(self) -> float:
        """Below the horizontal, rad."""
        return float(np.arctan2(self.down, np.hypot(self.north, self.east)))


def magnetic_field(lat: float, lon: float, height: float, year: float) -> MagneticField:
    """World Magnetic Model at a place and moment.

    Parameters
    ----------
    lat, lon, height : float
        rad, rad, m above the ellipsoid, -1 to 850 km.
    year : float
        Decimal year, 2010 to 2030, see `decimal_year`.  Each model serves its own five years.

    Returns
    -------
    MagneticField

    Notes
    -----
    About 0.5 ms; `magnetic_field_near` remembers.  The model itself is good to about 0.15 µT and 0.4° of
    declination, and knows nothing of the iron around a vehicle.
    """
    from pygeomag import GeoMag

    if not FIRST_YEAR <= year < LAST_YEAR:
        raise RangeError("year", year, f"{FIRST_YEAR:g} to {LAST_YEAR:g}")
    if not -1e3 <= height <= 850e3:
        raise RangeError("height", height, "-1 to 850 km")
    # A model holds scratch values between calls, so each call has one of its own: threads may ask at once.
    model = GeoMag(coefficients_data=_coefficients(int(year)))
    found = model.calculate(float(np.degrees(lat)), float(np.degrees(lon)), 1e-3 * height, year)
    return MagneticField(1e-3 * found.x, 1e-3 * found.y, 1e-3 * found.z)


def magnetic_field_near(lat: float, lon: float, height: float, year: float) -> MagneticField:
    """World Magnetic Model at the middle of the cell that holds a place, remembered per cell and day.

    Parameters and errors as `magnetic_field`.  Cells are 10 km north and about as much east, and 1 km high.  Below 60°
    of latitude the field at their middle differs by less than 0.08 µT, which is 0.3° of declination where 15 µT
    are horizontal; towards the poles the axes themselves turn within a cell.

    Parameters
    ----------
    lat, lon : float
        Geodetic, rad.
    height : float
        Above the ellipsoid, m.
    year : float
        As 2026.25.

    Returns
    -------
    MagneticField
        Field in T axes, µT, and its declination, rad.
    """
    row = round(lat / FIELD_CELL)
    # Columns narrow towards the poles as the parallels do; the pole itself is one cell.
    columns = max(round(2.0 * np.pi * np.cos(row * FIELD_CELL) / FIELD_CELL), 1)
    column = round(lon / (2.0 * np.pi) * columns)
    return _remembered(row, column % columns, columns, round(height / FIELD_LAYER), int(year * 365.25))


@lru_cache(maxsize=4096)
def _remembered(row: int, column: int, columns: int, layer: int, day: int) -> MagneticField:
    lat = float(np.clip(row * FIELD_CELL, -0.5 * np.pi, 0.5 * np.pi))
    year = float(np.clip((day + 0.5) / 365.25, FIRST_YEAR, np.nextafter(LAST_YEAR, 0.0)))
    return magnetic_field(lat, 2.0 * np.pi * column / columns, layer * FIELD_LAYER, year)


def _coefficients(year: int) -> tuple[object, object]:
    from pygeomag.wmm import wmm_2010, wmm_2015v2, wmm_2020, wmm_2025

    models = (wmm_2010.WMM_2010, wmm_2015v2.WMM_2015v2, wmm_2020.WMM_2020, wmm_2025.WMM_2025)
    return models[(year - int(FIRST_YEAR)) // 5]
