"""An event found, before anything is worked out about it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.events.record import EventKind
from nav_core.events.trigger import Window
from nav_core.records import Remark

SEVERE = ("crash", "rollover", "parked_impact")

TURNED = np.radians(20.0)
"""A box that lies differently by so much was handled, or its vehicle lies on its side, rad."""

OVER = np.radians(55.0)
"""A vehicle that leans by so much has rolled over, rad."""


class Finding(NamedTuple):
    """An event found.

    Attributes
    ----------
    kind : EventKind
    window : Window
    confidence : float
        0..1.
    peak : float
        Largest force off its surroundings, m/s².
    remarks : tuple of Remark
    """

    kind: EventKind
    window: Window
    confidence: float
    peak: float
    remarks: tuple[Remark, ...] = ()
