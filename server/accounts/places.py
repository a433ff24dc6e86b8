"""Where a vehicle is, as a caller may see it; every position that leaves the service passes here.

Without `location.read`, `location.coarse` gives the middle of a cell about a kilometre wide: 0.01° of latitude
(1.11 km) and as much of longitude as makes the cell square there.  The grid is fixed, so that many positions of a
vehicle that stands tell no more than one.  Without either nothing is told.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from server.accounts.caller import Caller

CELL_DEG = 0.01
_POLE_DEG = 89.0

Sight = Literal["exact", "coarse", "none"]


@dataclass(frozen=True, slots=True)
class Place:
    """A position, degrees, WGS84."""

    lat_deg: float
    lon_deg: float


def sight_of(caller: Caller) -> Sight:
    """How well a caller may see where vehicles are."""
    if caller.may("location.read"):
        return "exact"
    return "coarse" if caller.may("location.coarse") else "none"


def seen(lat_deg: float | None, lon_deg: float | None, sight: Sight) -> Place | None:
    """A position as it may be told; None where there is none, or none to be told."""
    if lat_deg is None or lon_deg is None or sight == "none":
        return None
    if sight == "exact":
        return Place(lat_deg, lon_deg)
    lat = _middle(min(max(lat_deg, -_POLE_DEG), _POLE_DEG), CELL_DEG)
    # As many cells as fit a whole turn: else the seam at 180° would cut one.
    across = 360.0 / math.floor(360.0 * math.cos(math.radians(lat)) / CELL_DEG)
    # The cell that begins at 180° is the one that begins at -180°.
    lon = math.remainder(_middle(math.remainder(lon_deg, 360.0), across), 360.0)
    return Place(round(lat, 5), round(lon, 5))


def _middle(value: float, size: float) -> float:
    return (math.floor(value / size) + 0.5) * size
