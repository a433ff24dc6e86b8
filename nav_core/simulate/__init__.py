"""Simulated drives with exact truth: roads, a driver, a vehicle, a box in it, and blows to both.

``route`` lays out roads, ``driver`` takes them, ``vehicle`` moves exactly, ``impact`` strikes,
``instruments`` record, ``drive`` puts them together; ``scenario`` holds what goes in and the truth
that comes out, ``spline`` the smooth functions all of it is made of.
"""

from nav_core.simulate.drive import random_rotation, simulate
from nav_core.simulate.scenario import (
    Impact,
    Move,
    PulseShape,
    RouteName,
    Scenario,
    TrueEvent,
    Truth,
)

__all__ = [
    "Impact",
    "Move",
    "PulseShape",
    "RouteName",
    "Scenario",
    "TrueEvent",
    "Truth",
    "random_rotation",
    "simulate",
]
