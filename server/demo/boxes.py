"""What the demo's boxes do: their routes, their mountings, and the one thing that happens to each."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from nav_core.earth import STANDARD_GRAVITY
from nav_core.records import Drive
from nav_core.simulate import Impact, Move, Scenario, simulate
from nav_core.simulate.scenario import RouteName
from nav_core.typing import Floats
from server.uploader import Encoding

_REST_S = 240.0
"""Between two drives of a box: longer than what ends a trip."""
_INTERRUPTED_S = 5.0
"""Between an interrupted drive and the next one."""
_BIAS = 5.0e-3 * STANDARD_GRAVITY
"""1 sigma of each axis of an accelerometer, m/s²."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """One box of the fleet and the drives it repeats."""

    name: str
    vehicle: str
    plate: str
    vehicle_class: str = "car"
    route: RouteName
    legs_min: tuple[float, ...]
    """Lengths of its drives, minutes; the last repeats."""
    lat_deg: float
    lon_deg: float
    encoding: Encoding = "parquet"
    accel_rate: float = 200.0
    gnss_rate: float = 4.0
    with_gyro: bool = False
    move: Move | None = None
    impact: Impact | None = None
    begins_now: bool = False
    """Whether its first drive is shown as it happens, instead of replayed from the past."""
    happens_in_leg: int = 1
    """The drive in which the move or the impact takes place."""


@dataclass(frozen=True, slots=True)
class Leg:
    """One drive of a box, from its boot to switching off."""

    number: int
    began_utc: float
    drive: Drive
    mountings: tuple[tuple[float, Floats], ...]
    """True mountings, each from a Unix time on."""


FLEET: tuple[Box, ...] = (
    Box(
        name="SC-0001",
        vehicle="Fiat Panda",
        plate="GA 101 ZZ",
        route="urban",
        legs_min=(6.0, 10.0),
        lat_deg=45.4064,
        lon_deg=11.8768,
    ),
    Box(
        name="SC-0002",
        vehicle="Alfa Romeo Giulia",
        plate="GB 202 ZZ",
        route="roundabout",
        legs_min=(5.0, 8.0),
        lat_deg=45.0703,
        lon_deg=7.6869,
        encoding="arrow",
        gnss_rate=10.0,
    ),
    Box(
        name="SC-0003",
        vehicle="Lancia Ypsilon (straight road, starts now)",
        begins_now=True,
        plate="GC 303 ZZ",
        route="straight",
        legs_min=(6.0, 8.0),
        lat_deg=44.4949,
        lon_deg=11.3426,
    ),
    Box(
        name="SC-0004",
        vehicle="Iveco Daily (box moved)",
        plate="GD 404 ZZ",
        vehicle_class="van",
        route="urban",
        legs_min=(5.0, 10.0),
        lat_deg=45.4642,
        lon_deg=9.1900,
        move=Move(t=270.0, turn=(math.radians(12.0), math.radians(-8.0), math.radians(32.0))),
    ),
    Box(
        name="SC-0005",
        vehicle="Fiat Tipo (standing)",
        plate="GE 505 ZZ",
        route="static",
        legs_min=(8.0, 20.0),
        lat_deg=43.7696,
        lon_deg=11.2558,
        encoding="csv",
        accel_rate=50.0,
        gnss_rate=1.0,
    ),
    Box(
        name="SC-0006",
        vehicle="Jeep Renegade (crash)",
        plate="GF 606 ZZ",
        route="urban",
        legs_min=(5.0, 7.0),
        lat_deg=41.9028,
        lon_deg=12.4964,
        impact=Impact(t=300.0, delta_v=32.0 / 3.6, pdof=math.radians(-20.0), duration=0.11, speed=12.0),
    ),
    Box(
        name="SC-0007",
        vehicle="Maserati Levante",
        plate="GG 707 ZZ",
        route="highway",
        legs_min=(8.0, 15.0),
        lat_deg=45.4384,
        lon_deg=10.9916,
        with_gyro=True,
        accel_rate=100.0,
    ),
    Box(
        name="SC-0008",
        vehicle="Fiat Ducato (gentle driver, starts now)",
        begins_now=True,
        plate="GH 808 ZZ",
        vehicle_class="van",
        route="gentle",
        legs_min=(6.0, 10.0),
        lat_deg=44.4056,
        lon_deg=8.9463,
        encoding="json",
        accel_rate=100.0,
    ),
    Box(
        name="SC-0009",
        vehicle="Piaggio Porter (1 Hz GPS)",
        plate="GI 909 ZZ",
        vehicle_class="van",
        route="urban",
        legs_min=(6.0, 12.0),
        lat_deg=40.8518,
        lon_deg=14.2681,
        gnss_rate=1.0,
    ),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Standpoint:
    """Where a box stands between two drives; what a later start of the demo goes on from."""

    leg: int
    utc: float
    R_va: tuple[tuple[float, ...], ...] | None = None
    """None before the first drive: drawn from the seed."""
    lat: float
    lon: float
    alt: float
    course: float | None = None


def first_standpoint(box: Box, utc: float) -> Standpoint:
    """A box that has never driven."""
    return Standpoint(leg=0, utc=utc, lat=math.radians(box.lat_deg), lon=math.radians(box.lon_deg), alt=100.0)


def has_ended(box: Box, standpoint: Standpoint) -> bool:
    """Whether the box drives no more: its vehicle crashed."""
    return box.impact is not None and standpoint.leg > box.happens_in_leg


def next_leg(box: Box, standpoint: Standpoint, *, seed: int) -> Leg:
    """The next drive of a box, from where it stands; each drive is a boot of its own."""
    happens = standpoint.leg == box.happens_in_leg
    scenario = Scenario(
        route=box.route,
        duration=60.0 * box.legs_min[min(standpoint.leg, len(box.legs_min) - 1)],
        R_va=None if standpoint.R_va is None else np.array(standpoint.R_va),
        start_lat=standpoint.lat,
        start_lon=standpoint.lon,
        start_alt=standpoint.alt,
        start_course=standpoint.course,
        start_utc=standpoint.utc,
        accel_rate=box.accel_rate,
        gnss_rate=box.gnss_rate,
        with_gyro=box.with_gyro,
        stamp_jitter=2e-4,
        moves=(box.move,) if happens and box.move is not None else (),
        impacts=(box.impact,) if happens and box.impact is not None else (),
    )
    drive, truth = simulate(replace(scenario, **_kept(scenario, seed)), seed=seed + standpoint.leg)
    bias = _BIAS * np.random.default_rng((seed, 1)).standard_normal(3)
    drive = replace(drive, inertial=replace(drive.inertial, f=drive.inertial.f + bias))
    mountings = tuple((standpoint.utc + max(t, 0.0), R_va) for t, R_va in truth.mountings)
    return Leg(standpoint.leg, standpoint.utc, drive, mountings)


def _kept(scenario: Scenario, seed: int) -> dict[str, float]:
    """What a box, its receiver and its country's roads keep from drive to drive; the bias is added afterwards."""
    rng = np.random.default_rng((seed, 0))
    speed_lag, course_lag = rng.uniform(0.0, scenario.max_drawn_lag, 2).tolist()
    # Roads fall off to the side one drives on, in a fleet that says it drives on the right.
    crown = float(rng.uniform(np.radians(0.3), np.radians(1.2)))
    return {"accel_bias": 0.0, "speed_lag": speed_lag, "course_lag": course_lag, "crown": crown}


def after(leg: Leg, t: float) -> Standpoint:
    """Where the box stands when it is switched off at box time `t` of a drive, ready for the next one."""
    gnss, utc = leg.drive.gnss, leg.began_utc + max(t, 0.0)
    known = np.flatnonzero(gnss.fix & np.isfinite(gnss.course) & (gnss.t <= max(t, gnss.t[0])))
    last = known[-1]
    R_va = next(R_va for since, R_va in reversed(leg.mountings) if since <= utc)
    return Standpoint(
        leg=leg.number + 1,
        utc=utc + (_REST_S if t >= leg.drive.inertial.t[-1] else _INTERRUPTED_S),
        R_va=tuple(tuple(row) for row in R_va.tolist()),
        lat=float(gnss.lat[last]),
        lon=float(gnss.lon[last]),
        alt=float(gnss.alt[last]),
        course=float(gnss.course[last]),
    )
