"""The baseline in two phases (001 §3.5): gravity levels the box, then driving straight ahead points it.

Phase one takes the tilt from specific force while the vehicle stands or keeps its speed on a straight road.
Phase two takes the yaw from what is left of the specific force when it speeds up or brakes there, with the
acceleration that the receiver's speed gives (3.10)::

    f_a = R_av (a, 0, 0) + R_av R_vt (0, 0, -g)

R_vt is that of a road of known slope and bank, or level.  The source counts the singularities of its angles,
slopes and the need of particular driving among the method's problems; here there are no angles, the other two
remain and are said in `sigma` and `reasons`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from nav_core.mounting.closed_form import level_basis
from nav_core.mounting.confidence import CONVERGED, observability
from nav_core.mounting.fixes import gps_rate, unrolled, usable_fixes
from nav_core.mounting.model import CROWN, GRAVITY
from nav_core.mounting.quality import USELESS, too_little
from nav_core.mounting.reasons import reason
from nav_core.mounting.receiver import chords, wrong_gps_unit
from nav_core.mounting.stretch import Record, gained_between, prepare
from nav_core.mounting.trouble import explained, wrong_unit
from nav_core.records import Drive, MountingEstimate, Reason
from nav_core.rotation import skew
from nav_core.signal import decimate
from nav_core.typing import Flags, Floats

REACH = 1.0
"""Rates of the receiver and means of the specific force reach this far to either side, s."""

STANDING, MOVING = 0.3, 3.0
"""Slower than the first a vehicle stands; course is trusted above the second, m/s."""

STEADY, STRAIGHT, PUSHED = 0.15, 0.15, 0.6
"""Most acceleration along and across of steady driving, and across and least along of phase two, m/s²."""

LAG = 0.3
"""The receiver's, s: the method has no means to find it."""

ROAD = np.radians(1.7)
LONG = 400.0
"""Slope and bank of a road that is taken for level, 1 sigma, rad, and the way over which they stay, m."""

KNOWN_ROAD = np.radians(0.3)
"""What remains of them on a road whose slope and bank are given, rad."""

BIAS = 6e-3 * GRAVITY
"""Of the accelerometer, which no amount of driving averages out, m/s²."""

SHORT_OF = 0.3
"""By this share the felt acceleration may differ from the receiver's."""

LEAST = 3.0
"""Of either phase, s."""


class Road(NamedTuple):
    """Slope (uphill positive) and bank (right side down positive) of the road at the fixes, rad, shape (n,)."""

    slope: Floats
    bank: Floats


class _Samples(NamedTuple):
    """What both phases read, one row a fix."""

    f: Floats
    speed: Floats
    along: Floats
    across: Floats
    span: Floats
    way: Floats


def estimate(drive: Drive, road: Road | None = None) -> MountingEstimate:
    """Mounting by the two-phase baseline.

    Parameters
    ----------
    drive : Drive
    road : Road, optional
        At the usable fixes (`fixes.usable_fixes`) of the drive; a level road by default.

    Returns
    -------
    MountingEstimate
        `converged_after` is that of the first time at which every sigma is under 2°, going through the drive
        in steps of 5 s.
    """
    ticks = decimate(drive.inertial)
    refused = wrong_unit(ticks) or wrong_gps_unit(chords(drive.gnss))
    if refused is not None:
        return _without(0.0, refused)
    record = prepare(ticks, usable_fixes(drive.gnss))
    lacks = too_little(record)
    if lacks is not None:
        return _without(0.0, lacks)
    samples = _samples(record)
    steady, pushed = _steady(samples), _pushed(samples)
    tilted = float(samples.span[steady].sum())
    shoved = float(samples.span[pushed].sum())
    progress = min(tilted / LEAST, 1.0) * (0.3 + 0.7 * min(shoved / LEAST, 1.0))
    if min(tilted, shoved) < LEAST:
        why = reason("not_driven" if tilted < LEAST else "few_events")
        return _without(0.9 * progress, *explained((why,), ticks, why.code))
    R_va, covariance = _solve(samples, steady, pushed, road)
    if not _fits_a_car(samples, pushed, R_va, road):
        return _without(0.0, *explained((reason("mismatch"),), ticks))
    sigma = np.sqrt(np.diag(covariance))
    if sigma.max() > USELESS:
        return _without(0.3, reason("few_events"))
    ready = bool(sigma.max() < CONVERGED)
    return MountingEstimate(
        "ready" if ready else "settling",
        "two-phase",
        R_va=R_va,
        covariance=covariance,
        progress=1.0 if ready else float(np.min(np.minimum(CONVERGED / sigma, 1.0)) ** 2 * 0.99),
        observability=observability(covariance),
        stable=ready,
        reliable=shoved >= LEAST,
        converged_after=_converged_after(record, samples, steady, pushed, road) if ready else None,
        reasons=() if ready else (reason("few_events" if sigma[2] >= CONVERGED else "keep_driving"),),
    )


def _samples(record: Record) -> _Samples:
    """Rates of the receiver by central differences, and the specific force in the mean over the same time."""
    fixes = record.fixes
    t, reach = fixes.t, max(REACH, 1.01 * float(np.median(np.diff(fixes.t))))
    edges = np.column_stack([t - LAG - reach, t - LAG + reach]).ravel()
    gains = gained_between(record, edges, [np.ones(record.t.size), *record.f.T])[::2]
    lasted = gains[:, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        f = gains[:, 1:] / lasted[:, None]
    f[np.abs(lasted - 2.0 * reach) > 0.15] = np.nan
    turn_rate = np.where(fixes.speed > MOVING, gps_rate(t, unrolled(fixes.course), reach), 0.0)
    span = np.minimum(np.diff(t, prepend=t[0]), 2.0 * reach)
    return _Samples(
        f, fixes.speed, gps_rate(t, fixes.speed, reach), fixes.speed * turn_rate, span, np.cumsum(fixes.speed * span)
    )


def _steady(samples: _Samples) -> Flags:
    """Standing, or straight on at a constant speed."""
    calm = (np.abs(samples.along) < STEADY) & (np.abs(samples.across) < STRAIGHT)
    sure = (samples.speed < STANDING) | (samples.speed > MOVING)
    return calm & sure & np.isfinite(samples.f).all(axis=1)


def _pushed(samples: _Samples) -> Flags:
    """Speeding up or braking straight ahead."""
    calm = (np.abs(samples.along) > PUSHED) & (np.abs(samples.across) < STRAIGHT)
    return calm & (samples.speed > MOVING) & np.isfinite(samples.f).all(axis=1)


def _gravity(road: Road | None, rows: Flags) -> Floats:
    """Specific force of a vehicle at rest on the road, V axes, m/s², shape (k, 3)."""
    count = int(rows.sum())
    slope, bank = (np.zeros(count), np.zeros(count)) if road is None else (road.slope[rows], road.bank[rows])
    return GRAVITY * np.stack([np.sin(slope), np.sin(bank) * np.cos(slope), -np.cos(bank) * np.cos(slope)], axis=1)


def _solve(samples: _Samples, steady: Flags, pushed: Flags, road: Road | None) -> tuple[Floats, Floats]:
    """Mounting and covariance: the tilt of phase one, the yaw of phase two, the tilt once more on the known yaw."""
    level = level_basis(samples.f[steady])
    rest = _gravity(road, steady)
    R_va = level
    for _ in range(3):
        felt = samples.f[pushed] @ R_va.T - _gravity(road, pushed)
        a = samples.along[pushed]
        # 3.10 with the tilt known: the horizontal rest is (a, 0), turned by the yaw that is missing.
        yaw = np.arctan2(float(a @ felt[:, 1]), float(a @ felt[:, 0]))
        R_va = Rotation.from_rotvec([0.0, 0.0, -yaw]).as_matrix() @ R_va
        lean = (samples.f[steady] @ R_va.T).mean(axis=0)
        wanted = rest.mean(axis=0)
        axis = np.cross(lean / np.linalg.norm(lean), wanted / np.linalg.norm(wanted))
        R_va = (np.eye(3) + skew(axis) + 0.5 * skew(axis) @ skew(axis)) @ R_va
        R_va = Rotation.from_matrix(R_va).as_matrix()
    return R_va, _covariance(samples, steady, pushed, samples.f[pushed] @ R_va.T - _gravity(road, pushed), road)


def _fits_a_car(samples: _Samples, pushed: Flags, R_va: Floats, road: Road | None) -> bool:
    """Whether the force along the travel grows with the receiver's acceleration, one for one."""
    felt = (samples.f[pushed] @ R_va.T - _gravity(road, pushed))[:, 0]
    a = samples.along[pushed]
    weight = float(a @ a)
    strength = float(a @ felt) / weight
    independent = max(float(samples.span[pushed].sum()) / (2.0 * REACH), 1.0)
    sigma = float(np.sqrt(np.mean((felt - strength * a) ** 2) * a.size / weight / independent))
    return abs(strength - 1.0) < max(SHORT_OF, 3.0 * sigma)


def _covariance(samples: _Samples, steady: Flags, pushed: Flags, felt: Floats, road: Road | None) -> Floats:
    """Slope and bank are one draw every `LONG` metres; bias and crown are drawn once.

    A tilt error presses equally on speeding up and on braking; what is left of it in the yaw is the balance of
    the two, `lopsided`.
    """
    unknown = ROAD if road is None else KNOWN_ROAD
    draws = 1.0 + np.ptp(samples.way[steady]) / LONG if np.any(samples.speed[steady] > MOVING) else 1.0
    bias = BIAS / GRAVITY
    crown = 0.0 if road is not None else CROWN
    roll = unknown**2 / draws + crown**2 + bias**2
    pitch = unknown**2 / draws + bias**2
    a = samples.along[pushed]
    weight = float(a @ a)
    independent = max(float(samples.span[pushed].sum()) / (2.0 * REACH), 1.0)
    lopsided = (float(a.sum()) / weight) ** 2
    scatter = float(np.mean(felt[:, 1] ** 2)) + (GRAVITY * unknown) ** 2 / 2.0
    yaw = scatter * a.size / weight / independent + lopsided * GRAVITY**2 * roll
    return np.diag([roll, pitch + np.radians(0.1) ** 2, yaw + np.radians(0.1) ** 2])


def _converged_after(
    record: Record, samples: _Samples, steady: Flags, pushed: Flags, road: Road | None
) -> float | None:
    """Time from the first moving fix until every sigma stays under `CONVERGED`, s."""
    t = record.fixes.t
    moving = samples.speed > MOVING
    first = float(t[np.argmax(moving)])
    good: float | None = None
    for until in np.append(np.arange(first + 5.0, t[-1], 5.0), t[-1]):
        heard = t <= until
        rest, push = steady & heard, pushed & heard
        enough = samples.span[rest].sum() >= LEAST and samples.span[push].sum() >= LEAST
        sigma = np.inf
        if enough:
            _, covariance = _solve(samples, rest, push, road)
            sigma = float(np.sqrt(np.diag(covariance)).max())
        if sigma >= CONVERGED:
            good = None
        elif good is None:
            good = float(until) - first
    return good


def _without(progress: float, *why: Reason) -> MountingEstimate:
    return MountingEstimate("insufficient", "two-phase", progress=progress, reasons=why)
