"""The driver: how fast a route is taken, as a control polygon of the speed over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from nav_core.simulate.route import CELL, Route
from nav_core.simulate.scenario import Impact
from nav_core.simulate.spline import MARGIN, Spline
from nav_core.typing import Floats

STEP = 0.1
"""Of the speed's control polygon, s."""

_LOOK_AHEAD = 1.0
_STRONGEST = (-3.9, 2.7)
_STANDS = 0.15
_COAST_BEFORE_IMPACT = 0.5
_STRAIGHT_BEFORE_IMPACT = 1.5
_APPROACH = 20.0
"""How long before an impact the driver leaves the route's intentions for the impact's speed, s."""


@dataclass(frozen=True, slots=True)
class _Schedule:
    """When an impact takes over from the route, and the speed it asks for."""

    approach: float = np.inf
    straight: float = np.inf
    coast: float = np.inf
    speed: float | None = None
    """On approach, before any braking."""
    brake: float = np.inf
    braking: float = 0.0


@dataclass(slots=True)
class _Driver:
    """Where the driver is, how fast, and which stop comes next."""

    route: Route
    cap: list[float]
    v: float
    a: float = 0.0
    s: float = 0.0
    stop: int = 0
    stood: float = 0.0

    def target(self, cell: int, restraint: float) -> float:
        """Speed that the road and the next stop allow now, m/s."""
        ahead = min(int((self.s + self.v * _LOOK_AHEAD) / CELL), len(self.cap) - 1)
        target = min(self.cap[cell], self.cap[ahead]) * restraint
        if self.stop == len(self.route.stops):
            return target
        where, seconds = self.route.stops[self.stop]
        room = where - self.s - self.v * _LOOK_AHEAD
        if self.v == 0.0 and room < CELL:
            self.stood += STEP
            if self.stood > seconds:
                self.stop, self.stood = self.stop + 1, 0.0
        return min(target, (1.8 * float(self.route.brake[cell]) * max(room, 0.0)) ** 0.5)

    def pursue(self, target: float, lowest: float, highest: float, jerk: float) -> None:
        """One step towards a speed within limits of acceleration and jerk."""
        wanted = min(max((target - self.v) / _LOOK_AHEAD, lowest), highest)
        self.a = min(max(wanted, self.a - jerk * STEP), self.a + jerk * STEP)
        self.v += self.a * STEP
        if self.v < _STANDS and target < _STANDS:
            self.v, self.a = 0.0, 0.0


def drive_along(
    route: Route, impact: Impact | None, start: float, end: float, rng: np.random.Generator
) -> tuple[Spline, float]:
    """Speed over time from `start` to `end`, box clock, s.

    The driver keeps to the caps of the road under him and a second ahead, stops where the route
    says so, limits his jerk, and never takes quite the speed he is allowed.

    Parameters
    ----------
    route : Route
        Caps of speed, m/s, over distance, m.
    impact : Impact or None
        The first; None without.
    start, end : float
        Box clock, s.
    rng : Generator
        Advanced.

    Returns
    -------
    speed : Spline
        m/s over s; never negative; exactly constant from shortly before the `impact` on, or of one that
        is braked for, from shortly after its start.
    straight_from : float
        Distance, m, from which the road must be straight because an impact takes over; inf without one.
    """
    count = int(np.ceil((end - start) / STEP)) + 4
    restraint = _restraint(count, rng)
    plan = _schedule(impact)
    early = plan.speed is not None and plan.approach < start
    driver = _Driver(route, route.cap.tolist(), plan.speed if early and plan.speed is not None else route.speed)
    speeds: list[float] = []
    straight_from = np.inf
    for k in range(count):
        t = start + (k - MARGIN) * STEP
        speeds.append(driver.v)
        driver.s += driver.v * STEP
        if t >= plan.straight:
            straight_from = min(straight_from, driver.s)
        if t >= plan.brake:
            driver.v = max(driver.v - plan.braking * STEP, 0.0) if t < plan.coast else driver.v
            continue
        if t >= plan.coast:
            continue
        cell = min(int(driver.s / CELL), len(driver.cap) - 1)
        brake = float(route.brake[cell])
        jerk = 2.0 * brake + 1.0
        if t >= plan.approach and plan.speed is not None:
            driver.pursue(plan.speed, *_STRONGEST, jerk)
            if abs(plan.speed - driver.v) < _STANDS:
                driver.v, driver.a = plan.speed, 0.0
        elif t >= route.wait:
            lowest, highest = max(-1.25 * brake, _STRONGEST[0]), min(float(route.throttle[cell]), _STRONGEST[1])
            driver.pursue(driver.target(cell, restraint[k]), lowest, highest, jerk)
    return Spline(start, STEP, np.array(speeds)), straight_from


def _schedule(impact: Impact | None) -> _Schedule:
    if impact is None:
        return _Schedule()
    approach = np.inf if impact.speed is None else impact.t - _APPROACH
    straight = min(approach, impact.t - _STRAIGHT_BEFORE_IMPACT)
    if impact.speed is None or impact.braking * impact.braking_time == 0.0:
        return _Schedule(approach, straight, impact.t - _COAST_BEFORE_IMPACT, impact.speed)
    faster = impact.speed + impact.braking * impact.braking_time
    return _Schedule(approach, straight, impact.t, faster, impact.t - impact.braking_time, impact.braking)


def _restraint(count: int, rng: np.random.Generator) -> list[float]:
    """Share of the allowed speed that the driver takes, slowly varying within 0.94..1."""
    keep = np.exp(-STEP / 5.0)
    noise: Floats = np.asarray(lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal(count)))
    return (0.97 + 0.03 * np.tanh(noise)).tolist()
