"""Studies of the crash reconstruction: simulated crashes against their truth, and hours of driving without any."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from nav_core.crash import reconstruct_drive
from nav_core.earth import STANDARD_GRAVITY
from nav_core.events.record import CrashEvent, Estimate
from nav_core.events.trigger import AFTER_END
from nav_core.mounting import estimate_mounting
from nav_core.rotation import wrap
from nav_core.simulate.drive import simulate
from nav_core.simulate.scenario import Impact, PulseShape, RouteName, Scenario, TrueEvent, Truth
from nav_core.simulate.shocks import shaken

KMH = 3.6
ROUTES: tuple[RouteName, ...] = ("urban", "highway", "gentle", "roundabout")
SHAPES: tuple[PulseShape, ...] = ("haversine", "half_sine", "triangle")


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """One simulated crash against its truth; errors in the units named, None where there is no estimate."""

    seed: int
    full_scale_g: float
    found: bool
    kinds: tuple[str, ...]
    truth: TrueEvent
    event: CrashEvent | None
    braked: bool = False

    @property
    def clipped(self) -> bool:
        """Whether the box was at full scale."""
        return self.event is not None and self.event.clipped_samples > 0

    @property
    def delta_v_error(self) -> float:
        """Share of the true resultant."""
        delta_v = None if self.event is None else self.event.delta_v
        return float("nan") if delta_v is None else delta_v.resultant.value / self.truth.resultant - 1.0

    @property
    def pdof_error_deg(self) -> float:
        """Degrees."""
        pdof = None if self.event is None else self.event.pdof
        return float("nan") if pdof is None else float(np.degrees(wrap(np.array(pdof.value - self.truth.pdof))))

    @property
    def speed_error_kmh(self) -> float:
        """km/h."""
        speed = None if self.event is None else self.event.impact_speed
        return float("nan") if speed is None else KMH * (speed.value - self.truth.speed)

    def covers(self, name: str) -> bool | None:
        """Whether the interval of `delta_v`, `pdof` or `speed` holds the truth; None without one.

        Parameters
        ----------
        name : str
            Which of the three.

        Returns
        -------
        bool or None
            None also of a crash that was not found.
        """
        event, truth = self.event, self.truth
        if event is None or event.delta_v is None:
            return None
        if name == "delta_v":
            return _holds(event.delta_v.resultant, truth.resultant)
        if name == "pdof":
            if event.pdof is None:
                return None
            near = event.pdof.value + float(wrap(np.array(truth.pdof - event.pdof.value)))
            return _holds(event.pdof, near)
        return None if event.impact_speed is None else _holds(event.impact_speed, truth.speed)


def _holds(estimate: Estimate, truth: float) -> bool:
    return estimate.low <= truth <= estimate.high


BRAKED = 0.4
"""Share of the drivers who brake before the impact."""

FASTEST = 45.0
"""Nobody begins to brake from a higher speed, m/s."""


def crash(seed: int, *, gyro: bool = False, yaw_rate: float = 0.0, fixes: bool = True) -> Outcome:
    """Simulate one crash of the benchmark and reconstruct it.

    12-60 km/h, any direction, 70-160 ms, three shapes, ±8, 11 or 16 g at 200 Hz, 4 fixes per second, any mounting,
    which is estimated from the same five minutes.  Four drivers in ten brake before it, by 0.3-1 g for 0.5-3 s.

    Parameters
    ----------
    seed : int
        Of everything drawn.
    gyro : bool
        The box has one.
    yaw_rate : float
        Largest change of turn rate by the blow, rad/s.
    fixes : bool
        False leaves out the receiver from a minute before the blow on, once the mounting is estimated.

    Returns
    -------
    Outcome
        The truth, and the event found within half a second of it, if any.
    """
    rng = np.random.default_rng((563, seed))
    full_scale = float(rng.choice([8.0, 11.0, 16.0]))
    impact = Impact(
        t=float(rng.uniform(240.0, 270.0)),
        delta_v=float(rng.uniform(12.0, 60.0)) / KMH,
        pdof=float(rng.uniform(-np.pi, np.pi)),
        duration=float(rng.uniform(0.070, 0.160)),
        shape=SHAPES[int(rng.integers(3))],
        yaw_rate_change=yaw_rate * float(rng.uniform(-1.0, 1.0)),
        speed=float(rng.uniform(15.0, 90.0)) / KMH,
    )
    impact = _braked(impact, np.random.default_rng((89, seed)))
    scenario = Scenario(
        route=ROUTES[int(rng.integers(len(ROUTES)))],
        duration=300.0,
        accel_full_scale=full_scale * STANDARD_GRAVITY,
        impacts=(impact,),
        with_gyro=gyro,
    )
    drive, truth = simulate(scenario, seed=seed)
    mounting = estimate_mounting(drive)
    if not fixes:
        drive = replace(drive, gnss=drive.gnss.rows(drive.gnss.t < impact.t - 60.0))
    events = reconstruct_drive(drive, mounting)
    true = _true_change(truth)
    near = [each for each in events if each.severe and abs(each.t0 - true.t0) < 0.5]
    return Outcome(
        seed=seed,
        full_scale_g=full_scale,
        found=len(near) == 1 and near[0].kind == "crash",
        kinds=tuple(f"{each.kind}@{each.t0:.1f}" for each in events),
        truth=true,
        event=near[0] if near else None,
        braked=impact.braking > 0.0,
    )


def _braked(impact: Impact, rng: np.random.Generator) -> Impact:
    """The same, or one that the driver brakes for."""
    brakes, hard, seconds = rng.random() < BRAKED, rng.uniform(0.3, 1.0) * STANDARD_GRAVITY, rng.uniform(0.5, 3.0)
    if not brakes or impact.speed is None:
        return impact
    seconds = min(seconds, (FASTEST - impact.speed) / hard)
    return replace(impact, braking=float(hard), braking_time=float(seconds))


def _true_change(truth: Truth) -> TrueEvent:
    """The first event with delta-V as it is reported: at its largest until 30 ms after the end, brakes included."""
    event = truth.events[0]
    first, last = np.searchsorted(truth.t, [event.t0, event.t_end + AFTER_END])
    change = ((truth.velocity[first : last + 1] - truth.velocity[first]) @ truth.R_tv[first])[:, :2]
    x, y = change[int(np.argmax(np.hypot(*change.T)))].tolist()
    return replace(
        event,
        longitudinal=x,
        lateral=y,
        resultant=float(np.hypot(x, y)),
        pdof=float(np.arctan2(-y + 0.0, -x + 0.0)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Hours:
    """What the detector said of driving without a crash."""

    hours: float
    shocks: dict[str, int]
    kinds: dict[str, int]
    alarms: tuple[str, ...]


def ordinary(seed: int, *, minutes: float = 30.0) -> Hours:
    """Half an hour of driving with potholes, kerbs, doors, drops and braking to 1 g, and no crash.

    Parameters
    ----------
    seed : int
        Of everything drawn.
    minutes : float
        Of driving.

    Returns
    -------
    Hours
        Hours driven, shocks by name, and what was found.
    """
    rng = np.random.default_rng((1317, seed))
    full_scale = float(rng.choice([8.0, 11.0, 16.0])) * STANDARD_GRAVITY
    scenario = Scenario(
        route=ROUTES[int(rng.integers(len(ROUTES)))],
        duration=60.0 * minutes,
        accel_full_scale=full_scale,
    )
    drive, truth = simulate(scenario, seed=seed)
    rough, shocks = shaken(drive, truth, full_scale=full_scale, rng=rng)
    events = reconstruct_drive(rough, estimate_mounting(rough))
    kinds: dict[str, int] = {}
    for each in events:
        kinds[each.kind] = kinds.get(each.kind, 0) + 1
    names: dict[str, int] = {}
    for shock in shocks:
        names[shock.name] = names.get(shock.name, 0) + 1
    false = tuple(f"{each.kind} at {each.t0:.2f} s of seed {seed}" for each in events if each.severe)
    return Hours(hours=minutes / 60.0, shocks=names, kinds=kinds, alarms=false)
