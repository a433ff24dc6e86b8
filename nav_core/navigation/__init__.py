"""GPS and inertial sensors together: where the vehicle went, how it stood, and how sure that is.

``inertial_gnss`` is the filter of the product, 15 error states and 5 of the receiver, with smoothing and the
constraints of a wheeled vehicle; ``position_velocity`` is the 12-state filter of 000 §7.7.2, which needs no gyro;
``outage`` finds and judges the stretches without GPS.  ``fixes`` says which fixes to believe, ``epochs`` lays out the
record, ``kernels`` holds the compiled filter with its ``rows`` and ``gates``, and ``reference`` the same in matrices.
"""

from nav_core.navigation.fixes import Receiver
from nav_core.navigation.inertial_gnss import NoGyroError, navigate
from nav_core.navigation.outage import hidden, inside, miss, outages, radius
from nav_core.navigation.position_velocity import navigate_without_gyro
from nav_core.navigation.solution import Solution
from nav_core.navigation.vehicle import Vehicle

__all__ = [
    "NoGyroError",
    "Receiver",
    "Solution",
    "Vehicle",
    "hidden",
    "inside",
    "miss",
    "navigate",
    "navigate_without_gyro",
    "outages",
    "radius",
]
