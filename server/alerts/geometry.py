"""Fences on the ground: how far a place is inside or outside.

A circle is measured on the mean sphere.  A polygon's sides are straight in latitude and longitude, as GeoJSON has
them (RFC 7946 §3.1.1), so what is inside is exact; how far, in metres, is told in the plane scaled at its middle,
good to a few per cent, where only tens of metres matter.  Longitudes are taken as differences within half a turn,
so a fence may lie across the date line.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from server.trips.track import EARTH_M

Floats = NDArray[np.float64]

METRES_PER_DEGREE = math.radians(1.0) * EARTH_M
MAX_REACH_M = 100_000.0
MAX_LAT_DEG = 80.0
MAX_CORNERS = 500


class FenceError(ValueError):
    """A fence that encloses nothing, or nobody knows what."""


class Circle:
    """All that lies within a radius."""

    def __init__(self, lat_deg: float, lon_deg: float, radius_m: float) -> None:
        if abs(lat_deg) > MAX_LAT_DEG or not 0.0 < radius_m <= MAX_REACH_M:
            raise FenceError(f"a circle lies within {MAX_LAT_DEG:g}° of latitude, its radius within {MAX_REACH_M:g} m")
        self._middle, self._radius_m = (lat_deg, lon_deg), radius_m

    @property
    def size_m(self) -> float:
        """A length that tells how wide it is."""
        return 2.0 * self._radius_m

    def outside_m(self, lat_deg: Floats, lon_deg: Floats) -> Floats:
        """Distance to the edge, m, negative inside; shape as given."""
        lat0, lon0 = np.radians(self._middle)
        lat, lon = np.radians(lat_deg), np.radians(lon_deg)
        half = np.sin(0.5 * (lat - lat0)) ** 2 + np.cos(lat0) * np.cos(lat) * np.sin(0.5 * (lon - lon0)) ** 2
        return 2.0 * EARTH_M * np.arcsin(np.sqrt(np.clip(half, 0.0, 1.0))) - self._radius_m


class Polygon:
    """What a closed line of corners encloses; the line does not cross itself."""

    def __init__(self, corners: Sequence[tuple[float, float]]) -> None:
        open_line = list(corners[:-1] if len(corners) > 1 and corners[0] == corners[-1] else corners)
        if not 3 <= len(set(open_line)) == len(open_line) <= MAX_CORNERS:
            raise FenceError(f"a polygon has 3 to {MAX_CORNERS} different corners")
        lat, lon = np.array(open_line, dtype=np.float64).T
        # The first corner serves to unroll the longitudes before a middle can be taken.
        unrolled = lon[0] + _turn(lon - lon[0])
        self._middle = float(0.5 * (lat.min() + lat.max())), float(0.5 * (unrolled.min() + unrolled.max()))
        if np.abs(lat).max() > MAX_LAT_DEG:
            raise FenceError(f"a polygon lies within {MAX_LAT_DEG:g}° of latitude")
        self._north, self._east = _plane(self._middle, lat, lon)
        if np.hypot(self._north, self._east).max() > MAX_REACH_M:
            raise FenceError(f"a corner is more than {MAX_REACH_M:g} m from the polygon's middle")
        if _crosses_itself(self._north, self._east):
            raise FenceError("the polygon's line crosses or touches itself")
        north, east = np.append(self._north, self._north[0]), np.append(self._east, self._east[0])
        self._area_m2 = 0.5 * abs(float((north[:-1] * east[1:] - north[1:] * east[:-1]).sum()))
        if self._area_m2 < 1.0:
            raise FenceError("the polygon encloses less than a square metre")

    @property
    def size_m(self) -> float:
        """A length that tells how wide it is."""
        return math.sqrt(self._area_m2)

    def outside_m(self, lat_deg: Floats, lon_deg: Floats) -> Floats:
        """Distance to the edge, m, negative inside; shape as given."""
        north, east = _plane(self._middle, lat_deg, lon_deg)
        nearest = np.full(north.shape, np.inf)
        crossings = np.zeros(north.shape, dtype=np.bool_)
        for a, b in pairwise([*range(self._north.size), 0]):
            n0, e0, n1, e1 = self._north[a], self._east[a], self._north[b], self._east[b]
            along = ((north - n0) * (n1 - n0) + (east - e0) * (e1 - e0)) / ((n1 - n0) ** 2 + (e1 - e0) ** 2)
            along = np.clip(along, 0.0, 1.0)
            way = np.hypot(n0 + along * (n1 - n0) - north, e0 + along * (e1 - e0) - east)
            nearest = np.minimum(nearest, way)
            # Even-odd rule: a ray to the east; half-open in north, so a corner counts once.
            spans = (n0 > north) != (n1 > north)
            if n0 != n1:
                crossings ^= spans & (east < e0 + (north - n0) / (n1 - n0) * (e1 - e0))
        return np.where(crossings, -nearest, nearest)


Fence = Circle | Polygon


def margin_m(fence: Fence, wanted_m: float) -> float:
    """How far past the edge a place must be to count: never so far that a small fence has no inside."""
    return min(wanted_m, fence.size_m / 8.0)


def passages(outside_m: Floats, margin: float, inside: bool | None) -> tuple[list[tuple[int, bool]], bool | None]:
    """Where a track passes the edge: row and whether it is inside from there; and where it is at the end.

    Within `margin` of the edge the track stays what it was, so that a parked vehicle whose fixes wander
    over the edge passes nothing.  From the first clear place on it is known (`inside` None until then);
    becoming known is no passage.
    """
    found: list[tuple[int, bool]] = []
    for row in np.flatnonzero(np.abs(outside_m) > margin).tolist():
        now = bool(outside_m[row] < 0.0)
        if inside is not None and now != inside:
            found.append((row, now))
        inside = now
    return found, inside


def _turn(degrees: Floats) -> Floats:
    """The same difference of longitude within half a turn."""
    return (degrees + 180.0) % 360.0 - 180.0


def _plane(middle: tuple[float, float], lat_deg: Floats, lon_deg: Floats) -> tuple[Floats, Floats]:
    """Metres north and east of the middle."""
    north = METRES_PER_DEGREE * (np.asarray(lat_deg) - middle[0])
    east = METRES_PER_DEGREE * math.cos(math.radians(middle[0])) * _turn(np.asarray(lon_deg) - middle[1])
    return north, east


def _crosses_itself(north: Floats, east: Floats) -> bool:
    """Whether two sides that are not neighbours meet."""
    count = north.size
    n1, e1 = np.roll(north, -1), np.roll(east, -1)

    def side(k: int, pn: Floats, pe: Floats) -> Floats:
        """Twice the area of the triangle of side k and a place: which side of it the place is on."""
        return (n1[k] - north[k]) * (pe - east[k]) - (e1[k] - east[k]) * (pn - north[k])

    for k in range(count - 2):
        others = np.arange(k + 2, count - (k == 0))
        begin, end = side(k, north[others], east[others]), side(k, n1[others], e1[others])
        mine = [
            (n1[others] - north[others]) * (pe - east[others]) - (e1[others] - east[others]) * (pn - north[others])
            for pn, pe in ((north[k], east[k]), (n1[k], e1[k]))
        ]
        touching = (begin * end <= 0.0) & (mine[0] * mine[1] <= 0.0)
        # All four zero: on one line; they meet where their boxes do.
        apart = (np.maximum(north[others], n1[others]) < min(north[k], n1[k])) | (
            np.minimum(north[others], n1[others]) > max(north[k], n1[k])
        )
        apart |= (np.maximum(east[others], e1[others]) < min(east[k], e1[k])) | (
            np.minimum(east[others], e1[others]) > max(east[k], e1[k])
        )
        if bool((touching & ~apart).any()):
            return True
    return False
