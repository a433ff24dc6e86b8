"""What is said of an event: frozen records in SI and radians, every number with its interval.

`CrashEvent` is the whole of it.  What a recording cannot tell is None, never a default.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from nav_core.errors import RangeError, ShapeError
from nav_core.events.way import Driver, Rest, Trajectory
from nav_core.records import Remark
from nav_core.typing import Flags, Floats

EventKind = Literal[
    "crash",
    "harsh_braking",
    "harsh_acceleration",
    "harsh_cornering",
    "road_shock",
    "handling",
    "rollover",
    "parked_impact",
]
VehicleClass = Literal["car", "van", "truck", "bus", "motorcycle"]

ALGORITHM = "crash-3"
"""Version of the detection and reconstruction; it changes whenever the same input may give other numbers."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number and the interval that holds the truth with 95 %.

    Attributes
    ----------
    value, low, high : float
        SI or rad; ``low <= value <= high``.  Of an angle the ends may pass ±pi.
    """

    value: float
    low: float
    high: float

    def __post_init__(self) -> None:
        for name in ("value", "low", "high"):
            object.__setattr__(self, name, float(getattr(self, name)))
        if not self.low <= self.value <= self.high:
            raise RangeError("estimate", self.value, f"{self.low:g}..{self.high:g}")


@dataclass(frozen=True, slots=True, kw_only=True)
class DeltaV:
    """Change of velocity of the box in the V axes at `t0`.

    Attributes
    ----------
    longitudinal, lateral : Estimate, optional
        Components at the time of the maximum resultant, m/s.  None when the mounting's yaw is unknown.
    resultant : Estimate
        Largest horizontal change, m/s.
    vertical : float
        Down, at the same time, m/s.
    time_of_max : float
        From `t0`, s.
    measured : float
        Resultant of the samples as recorded, nothing added for clipping, m/s: the least it can have been.
    from_gps : float, optional
        Resultant from the fixes before and after alone, m/s.
    """

    longitudinal: Estimate | None
    lateral: Estimate | None
    resultant: Estimate
    vertical: float
    time_of_max: float
    measured: float
    from_gps: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Pulse:
    """The blow over time, from shortly before `t0` to the end of integration.

    Attributes
    ----------
    t : ndarray, shape (n,)
        From `t0`, s.
    acceleration : ndarray, shape (n, 3)
        V axes at `t0`, gravity and bias removed, m/s²; where clipped, the estimate that `delta_v` rests on.
    recorded : ndarray, shape (n, 3)
        The same without any estimate: samples as recorded.
    delta_v : ndarray, shape (n, 3)
        Integral of `acceleration` from `t0`, m/s; 0 before.
    sigma : ndarray, shape (n,)
        1 sigma of each horizontal component of `delta_v`, m/s.
    clipped : ndarray of bool, shape (n,)
        Samples of which any axis was at full scale.
    peak : float
        Largest horizontal magnitude of `acceleration`, m/s², at the bandwidth `cutoff`.
    peak_lower_bound : bool
        The peak lies where samples were clipped: the recorded one is only a lower bound.
    mean : float
        Resultant delta-V over `duration`, m/s².
    duration : float
        From `t0` to the end of the event by 49 CFR 563, s.
    cutoff : float, optional
        -3 dB frequency of the filter that `peak` was read after, Hz; None where unfiltered.
    filter : str
        ``"CFC60"`` or what was used in its place.
    """

    t: Floats
    acceleration: Floats
    recorded: Floats
    delta_v: Floats
    sigma: Floats
    clipped: Flags
    peak: float
    peak_lower_bound: bool
    mean: float
    duration: float
    cutoff: float | None
    filter: str

    def __post_init__(self) -> None:
        n = self.t.size
        for name, shape in (("acceleration", (n, 3)), ("recorded", (n, 3)), ("delta_v", (n, 3)), ("clipped", (n,))):
            if getattr(self, name).shape != shape:
                raise ShapeError(f"pulse.{name}", getattr(self, name).shape, str(shape))


@dataclass(frozen=True, slots=True, kw_only=True)
class SecondImpact:
    """Another blow of the same event, before or after the one that has the headline.

    Blows that start within 5 s of the first are one multi-event of 49 CFR 563; each has its own time zero and
    delta-V, and the strongest is the one that a `CrashEvent` tells of.

    Attributes
    ----------
    t0, t_end : float
        Time zero and end of this blow, box clock, s.
    resultant : Estimate
        Its own delta-V, m/s.
    pdof : Estimate, optional
        rad, in the V axes at its own `t0`, held from there by the gyro; without one in the box's own.
    clipped_samples : int
    """

    t0: float
    t_end: float
    resultant: Estimate
    pdof: Estimate | None
    clipped_samples: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Indices:
    """Severity indices, each only where the data allow; the reasons for the others are in `quality`.

    Attributes
    ----------
    asi_2010, asi_1998 : float, optional
        Acceleration severity index of EN 1317-1 by its 13 Hz filter and by its 50 ms mean.
    olc : float, optional
        Occupant load criterion (Euro NCAP TB 027), m/s².
    thiv, phd : float, optional
        Theoretical head impact velocity, m/s, and post-impact head deceleration, m/s² (EN 1317-1).
    """

    asi_2010: float | None = None
    asi_1998: float | None = None
    olc: float | None = None
    thiv: float | None = None
    phd: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class InjuryRisk:
    """Probability of an injury by one published curve; the interval is that of delta-V alone.

    Attributes
    ----------
    curve, population : str
        Name of the curve, and whom it describes.
    level : str
        e.g. ``"MAIS3+"``.
    probability : Estimate
    """

    curve: str
    population: str
    level: str
    probability: Estimate


@dataclass(frozen=True, slots=True, kw_only=True)
class Basis:
    """What the numbers rest on: the hooks of provenance that the numerics know.

    Attributes
    ----------
    algorithm : str
        `ALGORITHM` of this version.
    window : tuple of float
        Box clock of the first and last sample that took part, s: what evidence must keep.
    sample_rate : float
        Of the pulse, Hz.
    full_scale : float, optional
        Where the accelerometer clips, m/s²; None when no sample showed it.
    mounting_status : str
    mounting_sigma : tuple of float, optional
        1 sigma about V x, y, z, rad.
    R_va : ndarray, shape (3, 3), optional
        The mounting used.
    gyro : bool
    fixes_before, fixes_after : int
        That took part in the delta-V and the impact speed.
    speed_lag, course_lag : float, optional
        s.
    utc_t0 : float, optional
        Unix time of `t0` by the box clock's fit to GPS, s; `utc_sigma` its 1 sigma.
    utc_sigma : float, optional
    """

    algorithm: str
    window: tuple[float, float]
    sample_rate: float
    full_scale: float | None
    mounting_status: str
    mounting_sigma: tuple[float, float, float] | None
    R_va: Floats | None
    gyro: bool
    fixes_before: int
    fixes_after: int
    speed_lag: float | None
    course_lag: float | None
    utc_t0: float | None = None
    utc_sigma: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CrashEvent:
    """An event and everything said of it.

    Harsh driving, road shocks and handling carry `kind`, times, `peak`, `basis` and `quality`; the rest is for
    crashes, rollovers and parked impacts.

    Attributes
    ----------
    kind : EventKind
    t0, t_end : float
        Box clock, s: time zero and end of event by 49 CFR 563; of several blows, those of the strongest.
    peak : float
        Largest magnitude: of the pulse (`Pulse.peak`) or of the manoeuvre, m/s².
    confidence : float
        0..1, that it is of this kind.
    delta_v : DeltaV, optional
    pdof : Estimate, optional
        rad in (-pi, pi], clockwise from straight ahead; the ends of the interval may pass ±pi.
    impact_speed : Estimate, optional
        m/s.
    rebound : Estimate, optional
        Speed at which the vehicle moved backwards along its old heading after the impact, m/s; None unless it did.
    pulse : Pulse, optional
    clipped_samples : int
    second_impacts : tuple of SecondImpact
        The other blows of the event, in order of time.
    rollover_angle : Estimate, optional
        Largest roll, positive right side down, rad; beyond ±pi for more than half a turn.
    rest : Rest, optional
    indices : Indices
    injuries : tuple of InjuryRisk
        The first is that of the contract's `injury`.
    trajectory : Trajectory, optional
    driver : Driver, optional
    basis : Basis
    quality : tuple of Remark
        What a reader must know, e.g. ``axes_rotating``, ``clipped``, ``no_gps``.
    """

    kind: EventKind
    t0: float
    t_end: float
    peak: float
    basis: Basis
    confidence: float = 1.0
    delta_v: DeltaV | None = None
    pdof: Estimate | None = None
    impact_speed: Estimate | None = None
    rebound: Estimate | None = None
    pulse: Pulse | None = None
    clipped_samples: int = 0
    second_impacts: tuple[SecondImpact, ...] = ()
    rollover_angle: Estimate | None = None
    rest: Rest | None = None
    indices: Indices = Indices()
    injuries: tuple[InjuryRisk, ...] = ()
    trajectory: Trajectory | None = None
    driver: Driver | None = None
    quality: tuple[Remark, ...] = ()

    @property
    def pdof_clock(self) -> int | None:
        """Clock direction 1..12; None without a PDOF."""
        return None if self.pdof is None else round(float(np.degrees(self.pdof.value)) / 30.0) % 12 or 12

    @property
    def blows(self) -> tuple[float, ...]:
        """Time zero of every blow, box clock, s, in order."""
        return tuple(sorted([self.t0, *(each.t0 for each in self.second_impacts)]))

    @property
    def begins(self) -> float:
        """Time zero of the first blow, box clock, s."""
        return self.blows[0]

    @property
    def ends(self) -> float:
        """End of the last blow, box clock, s."""
        return max([self.t_end, *(each.t_end for each in self.second_impacts)])

    @property
    def severe(self) -> bool:
        """Whether this is an event to reconstruct and to keep, not a mere manoeuvre."""
        return self.kind in ("crash", "rollover", "parked_impact")
