"""A driving-style score from harsh events per distance, with what chance alone would do to it.

``rate = 100 n / d`` events per 100 km, ``score = 100 * 2 ** (-rate / HALVING)``: none is 100, `HALVING` events per
100 km are 50, twice as many 25.  The events are counted, so their number is taken as Poisson's: the 95 % interval of
the mean is the exact one (Garwood 1936), and the score's interval is the formula at its ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

HALVING = 5.0
"""Events per 100 km at which the score is 50."""
MIN_KM = 100.0
"""Below, a single event more or less would move the score by 13 points and more."""
FORMULA = "score = 100 * 2^(-rate/5), rate = harsh braking, acceleration and cornering events per 100 km"


@dataclass(frozen=True)
class Score:
    """A score and what it rests on; None where the distance is not enough."""

    events: int
    kilometres: float
    per_100_km: float | None
    per_100_km_interval95: tuple[float, float] | None
    score: float | None
    score_interval95: tuple[float, float] | None


def score_of(events: int, kilometres: float) -> Score:
    """Score of so many events on so many kilometres."""
    if kilometres < MIN_KM:
        return Score(events, kilometres, None, None, None, None)
    low, high = (100.0 * mean / kilometres for mean in poisson_interval95(events))
    rate = 100.0 * events / kilometres
    return Score(events, kilometres, rate, (low, high), _score(rate), (_score(high), _score(low)))


def _score(rate: float) -> float:
    return 100.0 * 2.0 ** (-rate / HALVING)


def poisson_interval95(count: int) -> tuple[float, float]:
    """Exact 95 % interval of a Poisson mean of which `count` was seen."""
    low = 0.0 if count == 0 else _solve(lambda mean: 1.0 - _at_most(count - 1, mean), 0.025)
    high = _solve(lambda mean: 1.0 - _at_most(count, mean), 0.975)
    return low, high


def _at_most(count: int, mean: float) -> float:
    """Chance of `count` or fewer."""
    if mean <= 0.0:
        return 1.0
    # The largest term first, the others by their ratios: exact far out in both tails.
    top = min(count, int(mean))
    total = term = 1.0
    for k in range(top, 0, -1):
        term *= k / mean
        total += term
        if term < 1e-17 * total:
            break
    term = 1.0
    for k in range(top + 1, count + 1):
        term *= mean / k
        total += term
        if term < 1e-17 * total:
            break
    return min(1.0, total * math.exp(top * math.log(mean) - mean - math.lgamma(top + 1)))


def _solve(rising: Callable[[float], float], wanted: float) -> float:
    """Where a rising function of a mean has a value."""
    low, high = 0.0, 1.0
    while rising(high) < wanted:
        low, high = high, 2.0 * high
    while high - low > 1e-12 * high:
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        low, high = (middle, high) if rising(middle) < wanted else (low, middle)
    return 0.5 * (low + high)
