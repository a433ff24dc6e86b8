"""Strapdown navigation: position, velocity and attitude from what accelerometers and gyros measure.

``increments`` turns samples into rotation vectors and velocity changes of an interval, ``mechanisation`` integrates
them over the Earth in one of the frames of 000 §2.5 (its compiled steps are in ``kernels``,
``wander_kernels`` and ``cartesian_kernels``), ``planar`` has the
two-dimensional systems of §2.2, and ``drift`` says how errors grow (000 eq. 6.1.3).

The body frame b is whatever axes the sensors have: A for the box, V once its mounting is known.
"""

from nav_core.strapdown.drift import Drift, ResidualErrors, position_drift
from nav_core.strapdown.increments import Increments, from_integrals, from_rates
from nav_core.strapdown.mechanisation import Frame, Navigation, Track, mechanise
from nav_core.strapdown.planar import PlanarStart, PlanarTrack, navigate_meridian, navigate_plane

__all__ = [
    "Drift",
    "Frame",
    "Increments",
    "Navigation",
    "PlanarStart",
    "PlanarTrack",
    "ResidualErrors",
    "Track",
    "from_integrals",
    "from_rates",
    "mechanise",
    "navigate_meridian",
    "navigate_plane",
    "position_drift",
]
