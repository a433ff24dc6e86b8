"""What comes anew in every trip: part of the bias, of the receiver's lags, of the roads' bank and of the load."""

from __future__ import annotations

import numpy as np

from nav_core.mounting.model import BIAS, COURSE_LAG, MILLI_G, SPEED_LAG, TURN, UNKNOWNS
from nav_core.typing import Floats

BIAS_AGAIN = 2.0 * MILLI_G
"""How much of the bias is new in every trip (temperature, switching on), 1 sigma, m/s²."""

TURN_AGAIN = np.radians([0.25, 0.3, 0.1])
"""The same of the mounting about V x (the roads' mean bank), y (the load tilts the car) and z, rad."""

LAG_AGAIN = 0.2
"""And of the receiver's lags, s."""


def without_own(gram: Floats) -> Floats:
    """Evidence with a trip's own deviations of the unknowns summed out.

    Parameters
    ----------
    gram : ndarray, shape (15 + k, 15 + k)
        Products of the whitened innovations, of their derivatives to the unknowns and to k others.

    Returns
    -------
    ndarray, shape (15 + k, 15 + k)
    """
    again = np.zeros(UNKNOWNS)
    again[TURN], again[BIAS], again[[SPEED_LAG, COURSE_LAG]] = TURN_AGAIN, BIAS_AGAIN, LAG_AGAIN
    own = np.flatnonzero(again) + 1
    inner = gram[np.ix_(own, own)] + np.diag(again[own - 1] ** -2.0)
    cross = gram[:, own]
    return gram - cross @ np.linalg.solve(inner, cross.T)
