"""Roads to drive on: curvature, speed limits, stops, slope and bank, all over distance.

A route is laid out cell by cell along the distance driven.  Turning is a property of the road,
so a vehicle that stands still cannot turn, whatever the driver or an impact does to its speed.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter

from nav_core.simulate.scenario import RouteName, Scenario
from nav_core.simulate.spline import Spline
from nav_core.typing import Floats

CELL = 2.0
"""Length of a cell of the road, m."""

LEAD = 300.0
"""Road before the start of the drive, m: an impact may push the vehicle backwards."""

_SLOPE_KNOT = 25.0
_BANK_KNOT = 8.0
_TOP_SPEED: dict[RouteName, float] = {
    "static": 1.0,
    "straight": 22.0,
    "urban": 14.0,
    "gentle": 13.0,
    "highway": 36.0,
    "roundabout": 12.0,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Route:
    """A road and what its driver intends on it; one value per cell unless said otherwise.

    Attributes
    ----------
    curvature : ndarray, shape (n,)
        Control polygon over distance, 1/m, positive to the right.
    cap : ndarray, shape (n,)
        Highest speed from which all limits ahead can be met, m/s.
    throttle, brake : ndarray, shape (n,)
        Strongest intended acceleration and deceleration, m/s², both positive.
    stops : tuple of (float, float)
        Distance, m, and time to stand there, s.
    wait : float
        Time before setting off, s.
    speed : float
        At the start, m/s.
    """

    curvature: Floats
    cap: Floats
    throttle: Floats
    brake: Floats
    stops: tuple[tuple[float, float], ...]
    wait: float
    speed: float


@dataclass(slots=True)
class _Layout:
    """A road under construction."""

    throttle_now: float = 2.0
    brake_now: float = 2.0
    limit_now: float = 10.0
    curvature: list[float] = field(default_factory=list)
    limit: list[float] = field(default_factory=list)
    throttle: list[float] = field(default_factory=list)
    brake: list[float] = field(default_factory=list)
    stops: list[tuple[float, float]] = field(default_factory=list)
    side: float = 1.0

    @property
    def length(self) -> float:
        return CELL * len(self.curvature)

    def mood(self, *, limit: float, throttle: float, brake: float) -> None:
        """What the driver does from here on."""
        self.limit_now, self.throttle_now, self.brake_now = limit, throttle, brake

    def straight(self, length: float, limit: float | None = None) -> None:
        """Straight road, optionally slower."""
        count = max(int(length / CELL), 1)
        self._lay([0.0] * count, self.limit_now if limit is None else limit)

    def bend(self, angle: float, radius: float, lateral: float) -> None:
        """Bend by `angle`, rad, positive right, with eased ends, taken with `lateral` m/s² at most."""
        ease = float(np.clip(0.4 * radius, 3.0 * CELL, 120.0))
        length = abs(angle) * radius + ease
        count = max(int(np.ceil(length / CELL)), 3)
        inner = (np.arange(count) + 0.5) * CELL
        ramp = np.clip(np.minimum(inner, count * CELL - inner) / ease, 0.0, 1.0)
        curvature = angle * ramp / (CELL * ramp.sum())
        self._lay(curvature.tolist(), min(self.limit_now, float(np.sqrt(lateral / np.abs(curvature).max()))))

    def turn(self, rng: np.random.Generator) -> float:
        """Side of the next turn, +1 right: rather the other than the last, as trips do not end in spirals."""
        if rng.random() < 0.65:
            self.side = -self.side
        return self.side

    def stop(self, seconds: float) -> None:
        """Stop here for so long."""
        self.stops.append((self.length, seconds))
        self.straight(3.0 * CELL)

    def _lay(self, curvature: list[float], limit: float) -> None:
        count = len(curvature)
        self.curvature += curvature
        self.limit += [limit] * count
        self.throttle += [self.throttle_now] * count
        self.brake += [self.brake_now] * count


def lay_out(scenario: Scenario, rng: np.random.Generator) -> Route:
    """Draw a route of the scenario's kind, long enough for its duration.

    Parameters
    ----------
    scenario : Scenario
        Says route, duration and impacts.
    rng : Generator
        Advanced.

    Returns
    -------
    Route
        Curvature, 1/m, and caps of speed, m/s, by cells of the way.
    """
    layout = _Layout()
    needed = _TOP_SPEED[scenario.route] * (scenario.duration + 30.0) + 200.0
    for impact in scenario.impacts:
        needed += 30.0 * (impact.speed or 0.0)
    wait, speed = float(rng.uniform(3.0, 8.0)), 0.0
    side = layout.side = _either(rng)
    while layout.length < needed:
        match scenario.route:
            case "static":
                layout.mood(limit=0.0, throttle=1.0, brake=1.0)
                layout.straight(needed)
            case "straight":
                _straight_block(layout, rng)
            case "urban":
                _urban_block(layout, rng)
            case "gentle":
                _gentle_block(layout, rng)
            case "highway":
                _highway_block(layout, rng)
                wait = 0.0
            case "roundabout":
                _roundabout_block(layout, rng, side)
    cap = _reachable(np.array(layout.limit), np.array(layout.brake))
    if scenario.route == "highway":
        speed = float(cap[0])
    return Route(
        curvature=np.array(layout.curvature),
        cap=cap,
        throttle=np.array(layout.throttle),
        brake=np.array(layout.brake),
        stops=tuple(layout.stops),
        wait=wait,
        speed=speed,
    )


def _either(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _straight_block(layout: _Layout, rng: np.random.Generator) -> None:
    layout.mood(limit=rng.uniform(8.0, 20.0), throttle=rng.uniform(0.9, 2.6), brake=rng.uniform(1.0, 3.3))
    layout.straight(rng.uniform(120.0, 420.0))
    if rng.random() < 0.4:
        layout.stop(rng.uniform(3.0, 20.0))


def _urban_block(layout: _Layout, rng: np.random.Generator) -> None:
    top = rng.choice([8.3, 11.1, 13.9])
    layout.mood(limit=top * rng.uniform(0.85, 1.0), throttle=rng.uniform(1.0, 2.6), brake=rng.uniform(1.2, 3.3))
    layout.straight(rng.uniform(40.0, 160.0))
    if rng.random() < 0.35:
        layout.bend(_either(rng) * np.radians(rng.uniform(10.0, 40.0)), rng.uniform(60.0, 200.0), 2.5)
        layout.straight(rng.uniform(20.0, 80.0))
    if rng.random() < 0.3:
        # A slower road user, a crossing, a hump.
        layout.straight(rng.uniform(15.0, 40.0), limit=layout.limit_now * rng.uniform(0.3, 0.7))
        layout.straight(rng.uniform(30.0, 80.0))
    if rng.random() < 0.4:
        layout.stop(rng.uniform(2.0, 25.0))
    if rng.random() < 0.76:
        angle = np.radians(rng.normal(90.0, 6.0))
        layout.bend(layout.turn(rng) * angle, rng.uniform(7.0, 14.0), rng.uniform(1.6, 3.3))


def _gentle_block(layout: _Layout, rng: np.random.Generator) -> None:
    layout.mood(limit=rng.uniform(7.0, 12.5), throttle=rng.uniform(0.4, 0.8), brake=rng.uniform(0.4, 0.9))
    layout.straight(rng.uniform(60.0, 240.0))
    if rng.random() < 0.25:
        layout.stop(rng.uniform(3.0, 20.0))
    angle = np.radians(rng.uniform(25.0, 95.0))
    layout.bend(layout.turn(rng) * angle, rng.uniform(15.0, 70.0), rng.uniform(0.5, 1.0))


def _highway_block(layout: _Layout, rng: np.random.Generator) -> None:
    layout.mood(limit=rng.uniform(26.0, 35.5), throttle=rng.uniform(0.3, 0.9), brake=rng.uniform(0.4, 1.0))
    for _ in range(int(rng.integers(1, 4))):
        layout.straight(rng.uniform(200.0, 1200.0))
        angle = np.radians(rng.uniform(5.0, 35.0))
        layout.bend(_either(rng) * angle, rng.uniform(900.0, 3000.0), 2.0)


def _roundabout_block(layout: _Layout, rng: np.random.Generator, side: float) -> None:
    """Entry, one lap or more, exit; `side` is +1 where traffic keeps right and circles to the left."""
    layout.mood(limit=rng.uniform(8.0, 11.5), throttle=rng.uniform(1.0, 2.4), brake=rng.uniform(1.2, 3.0))
    layout.straight(rng.uniform(40.0, 110.0))
    lateral = rng.uniform(1.6, 3.3)
    deflection = np.radians(rng.uniform(35.0, 55.0))
    layout.bend(side * deflection, rng.uniform(15.0, 25.0), lateral)
    # In all 0, 90, 180 or 270 degrees off the road one came from, after the laps.
    turned = np.radians(360.0 * rng.integers(1, 3) + 90.0 * rng.integers(-1, 3)) + 2.0 * deflection
    layout.bend(-side * turned, rng.uniform(12.0, 20.0), lateral)
    layout.bend(side * deflection, rng.uniform(15.0, 25.0), lateral)
    if rng.random() < 0.2:
        layout.straight(30.0)
        layout.stop(rng.uniform(2.0, 8.0))


def _reachable(limit: Floats, brake: Floats) -> Floats:
    """Highest speed per cell from which every later limit is met with the intended braking."""
    # v² may fall by 2 ∫ brake ds; the running minimum from behind is over all cells ahead.
    energy = 2.0 * CELL * np.cumsum(0.9 * brake)
    ahead = np.minimum.accumulate((limit**2 + energy)[::-1])[::-1]
    return np.sqrt(ahead - energy)


def over_distance(values: Floats) -> Spline:
    """Spline over distance, m from the start, of one control value per cell, with straight road before and after.

    Parameters
    ----------
    values : ndarray, shape (n,)
        One per cell of `CELL` m, in any unit.

    Returns
    -------
    Spline
        Over m, in that unit.
    """
    lead = np.zeros(int(LEAD / CELL))
    return Spline(-LEAD + 1.5 * CELL, CELL, np.concatenate((lead, values, lead)))


def draw_slope(grade: float, length: float, rng: np.random.Generator) -> Spline:
    """Slope angle over distance, rad: waves of 400 m to 4 km whose 1 sigma is `grade`.

    Parameters
    ----------
    grade : float
        As a tangent.
    length : float
        Of the way, m.
    rng : Generator
        Advanced.

    Returns
    -------
    Spline
        rad over m, uphill positive.
    """
    at = np.arange(-LEAD, length + LEAD, _SLOPE_KNOT)
    waves = 12
    number = 2.0 * np.pi / np.geomspace(400.0, 4000.0, waves)
    angle = grade * np.sqrt(2.0 / waves) * np.sin(np.outer(at, number) + rng.uniform(0.0, 2.0 * np.pi, waves)).sum(1)
    return Spline(-LEAD + _SLOPE_KNOT, _SLOPE_KNOT, np.arctan(angle))


def draw_bank(sigma: float, correlation: float, crown: float, length: float, rng: np.random.Generator) -> Spline:
    """Bank over distance, rad: `crown` plus a first-order process of 1 sigma `sigma`, smooth below 8 m.

    Parameters
    ----------
    sigma, crown : float
        rad.
    correlation : float
        m.
    length : float
        Of the way, m.
    rng : Generator
        Advanced.

    Returns
    -------
    Spline
        rad over m, right side down positive.
    """
    count = int((length + 2.0 * LEAD) / _BANK_KNOT) + 4
    keep = np.exp(-_BANK_KNOT / correlation)
    drive = rng.standard_normal(count) * np.sqrt(1.0 - keep**2)
    drive[0] = rng.standard_normal()
    values: Floats = np.asarray(lfilter([1.0], [1.0, -keep], drive))
    return Spline(-LEAD + _BANK_KNOT, _BANK_KNOT, crown + sigma * values)
