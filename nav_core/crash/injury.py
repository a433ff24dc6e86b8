"""Injury risk by published curves of delta-V, each named with its population; the interval is delta-V's alone.

The curves disagree by factors; none is the truth, and none knows belt, age or airbags unless it says so.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.events.record import Estimate, InjuryRisk

MPH = 0.44704


class Curve(NamedTuple):
    """Logistic risk ``1 / (1 + exp(-(a + b dv / unit)))``.

    Attributes
    ----------
    name, population, level : str
    a, b : float
    unit : float
        Of delta-V in the curve, m/s.
    sector : {"all", "frontal", "rear"}
        PDOF for which it holds.
    """

    name: str
    population: str
    level: str
    a: float
    b: float
    unit: float = MPH
    sector: str = "all"


_NHTSA = "front-seat occupants of cars in US tow-away crashes (Wang 2022, DOT HS 813 219)"
_TUM = "as shipped with TUM's ethical trajectory planning, population not stated"
_GIDAS = "German in-depth accident study, as shipped with TUM's ethical trajectory planning"

CURVES = (
    Curve("NHTSA-2022-all", _NHTSA, "MAIS3+", -6.9540, 0.1637),
    Curve("NHTSA-2022-all", _NHTSA, "MAIS2+", -5.1331, 0.1479),
    Curve("NHTSA-2022-all", _NHTSA, "fatal", -8.9819, 0.1603),
    Curve("NHTSA-2022-frontal", _NHTSA, "MAIS3+", -6.9774, 0.1620, sector="frontal"),
    Curve("NHTSA-2022-rear", _NHTSA, "MAIS3+", -8.0329, 0.1793, sector="rear"),
    Curve("TUM-logistic", _TUM, "MAIS3+", -4.591, 0.185, unit=1.0),
    Curve("GIDAS", _GIDAS, "MAIS3+", -5.820, 0.292, unit=1.0),
)
"""The first is the one that is quoted alone."""

SECTORS = {"frontal": (-45.0, 45.0), "rear": (135.0, 225.0)}
"""PDOF from..to of a sector, degrees; the whole interval must lie in it."""


def probability(curve: Curve, delta_v: float) -> float:
    """Probability of an injury of the curve's level at `delta_v`, m/s.

    Parameters
    ----------
    curve : Curve
        One of `CURVES`.
    delta_v : float
        Resultant, m/s.

    Returns
    -------
    float
        0 to 1.
    """
    return float(1.0 / (1.0 + np.exp(-(curve.a + curve.b * delta_v / curve.unit))))


def risks(delta_v: Estimate, pdof: Estimate | None) -> tuple[InjuryRisk, ...]:
    """Risk by every curve that holds for a direction, the quoted one first.

    Parameters
    ----------
    delta_v : Estimate
        Resultant, m/s.
    pdof : Estimate or None
        rad; None of an unknown mounting: then only curves for any direction hold.

    Returns
    -------
    tuple of InjuryRisk
        With the probabilities at the value and at both ends of the interval.
    """
    out: list[InjuryRisk] = []
    for curve in CURVES:
        if curve.sector != "all" and not _within(pdof, *SECTORS[curve.sector]):
            continue
        value, low, high = (probability(curve, each) for each in (delta_v.value, delta_v.low, delta_v.high))
        out.append(
            InjuryRisk(
                curve=curve.name,
                population=curve.population,
                level=curve.level,
                probability=Estimate(value, low, high),
            )
        )
    return tuple(out)


def _within(pdof: Estimate | None, begin: float, end: float) -> bool:
    if pdof is None:
        return False
    low, high = np.degrees(pdof.low), np.degrees(pdof.high)
    return any(begin <= low + turn and high + turn <= end for turn in (0.0, 360.0))
