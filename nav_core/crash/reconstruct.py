"""Events of a recording, each put together from its blow, the fixes around it and the mounting."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nav_core.crash.case import Case, between, case_of
from nav_core.crash.gps_change import usable
from nav_core.crash.impact import ROUGH, Impact, impact_of
from nav_core.crash.injury import risks
from nav_core.crash.measures import indices_of, pulse_of, rebound_of, roll_of
from nav_core.crash.trajectory import driver_of, rest_of, trajectory_of
from nav_core.earth import STANDARD_GRAVITY
from nav_core.events.classify import find
from nav_core.events.driving import Manoeuvre, manoeuvres
from nav_core.events.finding import SEVERE, Finding
from nav_core.events.level import lean_before
from nav_core.events.record import ALGORITHM, Basis, CrashEvent, DeltaV, Estimate, SecondImpact, VehicleClass
from nav_core.events.scene import scene_of
from nav_core.events.trigger import MULTI_EVENT
from nav_core.records import Drive, MountingEstimate, Remark
from nav_core.timebase import ClockFit
from nav_core.typing import Floats

SEVERE_FIRST = ("rollover", "crash", "parked_impact")
"""An event of several kinds is called by the first of these."""

SPAN = 30.0
"""Context of an event that evidence must keep, before and after, s."""

FEWEST = 4
SPINS = 0.5
"""Turn rate from which it matters where in the vehicle the box sits, rad/s."""

UNFILTERED_RATE = 150.0
"""Samples per second below which aliasing must be thought of, Hz."""

AGAIN = 2.0
"""A mounting that changed later than this before an event is worked out anew from what came before, s."""

OFF = np.radians(30.0)
"""Gravity is off V's down axis by less than this on any road, rad."""


def events_of(
    drive: Drive,
    mounting: MountingEstimate,
    *,
    vehicle_class: VehicleClass,
    between: tuple[float, float] | None,
) -> tuple[CrashEvent, ...]:
    """As `nav_core.crash.reconstruct_drive`.

    Parameters
    ----------
    drive : Drive
        One recording, A-frame.
    mounting : MountingEstimate
        Of the box in it.
    vehicle_class : VehicleClass
        Sets the thresholds of harsh driving.
    between : tuple of float or None
        First and last `t0` to report, box clock, s; None for all.

    Returns
    -------
    tuple of CrashEvent
        In order of `t0`; empty with too few samples.
    """
    if drive.inertial.t.size < FEWEST:
        return ()
    case = case_of(drive, mounting)
    lags = case.lags
    scene = scene_of(case.stream, case.gnss, lags.speed, lags.sigma, vehicle_class, case.w_v, mounted=case.yaw_known)
    found = find(scene)
    events = [_of_group(case, group) for group in _grouped(case, found)]
    events += _harsh(case, vehicle_class, events)
    low, high = (-np.inf, np.inf) if between is None else between
    asked = [each for each in events if any(low <= t <= high for t in each.blows)]
    return tuple(sorted(asked, key=lambda each: each.t0))


def _grouped(case: Case, found: list[Finding]) -> list[list[Finding]]:
    """Findings that are one event: what follows a crash within five seconds is part of it."""
    t, out = case.stream.t, list[list[Finding]]()
    for each in found:
        head = out[-1][0] if out else None
        if head is not None and head.kind in SEVERE and t[each.window.zero] - t[head.window.zero] <= MULTI_EVENT:
            out[-1].append(each)
        else:
            out.append([each])
    return out


def _of_group(case: Case, group: list[Finding]) -> CrashEvent:
    """One event of findings that belong together; of several blows the strongest has the headline."""
    first = group[0]
    if first.kind not in SEVERE:
        return _plain(case, first)
    t0 = float(case.stream.t[first.window.zero])
    earlier, remarks = _mounting_then(case, t0)
    struck = [each for each in group if each.kind in SEVERE]
    blows: list[Impact] = []
    for each in struck:
        blows.append(impact_of(earlier, each.window, blows[-1] if blows else None))
    sizes = [each.cloud.resultant().value for each in blows]
    head = int(np.argmax(sizes))
    event = _severe(earlier, struck[head], blows, head)
    kinds = {each.kind for each in struck}
    kind = next(each for each in SEVERE_FIRST if each in kinds)
    return replace(event, kind=kind, quality=(*event.quality, *remarks))


def _mounting_then(case: Case, t0: float) -> tuple[Case, tuple[Remark, ...]]:
    """The case with the mounting that was valid at `t0`: none where gravity before it lies elsewhere than it should."""
    then, remarks = _before_change(case, t0)
    leans = lean_before(then.stream, t0)
    if then.mounting.R_va is None or leans is None or leans < OFF + 3.0 * float(then.sigma[:2].max()):
        return then, remarks
    unknown = replace(then.mounting, status="insufficient", R_va=None, covariance=None)
    text = (
        f"Gravity before it lies {np.degrees(leans):.0f}° off where the mounting has it: the box was turned since, or "
        "measures with another sign. Directions are not given."
    )
    return case_of(then.drive, unknown), (*remarks, Remark("mounting_disagrees", text))


def _before_change(case: Case, t0: float) -> tuple[Case, tuple[Remark, ...]]:
    """The case with the mounting before a change at or after `t0`: an estimate tells the last one, and the changes."""
    if case.mounting.R_va is None or not any(change.t > t0 - AGAIN for change in case.mounting.changes):
        return case, ()
    from nav_core.mounting import estimate_mounting

    before = estimate_mounting(between(case.drive, -np.inf, t0 - 1.0))
    text = "The box was turned by the blow or later; the mounting is that of the driving before it."
    if before.R_va is None:
        text = "The box was turned by the blow or later, and what came before does not tell how it sat."
    return case_of(case.drive, before), (Remark("mounting_before_change", text),)


def _severe(case: Case, finding: Finding, blows: list[Impact], head: int) -> CrashEvent:
    """The event of one or more blows, told of the one that has the headline."""
    impact = blows[head]
    blow, cloud, known = impact.blow, impact.cloud, impact.known
    t0, t_end = float(blow.t[blow.zero]), float(blow.t[blow.end])
    resultant = cloud.resultant()
    recorded = blow.v[impact.k]
    delta_v = DeltaV(
        longitudinal=cloud.component(0) if case.yaw_known else None,
        lateral=cloud.component(1) if case.yaw_known else None,
        resultant=resultant,
        vertical=float(blow.velocity(impact.filled)[impact.k, 2]),
        time_of_max=float(blow.t[impact.k]) - t0,
        measured=float(np.hypot(*recorded[:2])),
        from_gps=None if impact.from_gps is None else float(np.hypot(*impact.from_gps)),
    )
    pdof = cloud.pdof() if case.yaw_known else None
    pulse = pulse_of(case, impact, resultant.value)
    indices, unfit = indices_of(case, impact, pdof)
    trajectory = trajectory_of(case, blows, head)
    last = blows[-1].blow
    rest = rest_of(trajectory, t0, float(last.t[last.end]) if head or len(blows) > 1 else t0)
    return CrashEvent(
        kind=finding.kind,
        t0=t0,
        t_end=t_end,
        peak=pulse.peak,
        confidence=finding.confidence,
        basis=_basis(case, t0, impact),
        delta_v=delta_v,
        pdof=pdof,
        impact_speed=None
        if known is None
        else Estimate(known.speed, max(known.speed - 1.96 * known.sigma, 0.0), known.speed + 1.96 * known.sigma),
        rebound=rebound_of(impact) if case.yaw_known and head == 0 else None,
        pulse=pulse,
        clipped_samples=impact.clipped_samples,
        second_impacts=tuple(_other(case, each) for each in blows if each is not impact),
        rollover_angle=roll_of(case, finding, t0),
        rest=rest,
        indices=indices,
        injuries=risks(resultant, pdof) if finding.kind != "parked_impact" else (),
        trajectory=trajectory,
        driver=driver_of(case, blows[0], t0, trajectory, rest),
        quality=(
            *case.drive.remarks,
            *case.remarks,
            *finding.remarks,
            *_several(blows, head),
            *_remarks(case, impact),
            *unfit,
        ),
    )


def _several(blows: list[Impact], head: int) -> tuple[Remark, ...]:
    """That there was more than one blow."""
    if len(blows) == 1:
        return ()
    text = f"{len(blows)} blows within {MULTI_EVENT:g} s; the numbers are of the strongest, which is number {head + 1}."
    return (Remark("multi_event", text),)


def _remarks(case: Case, impact: Impact) -> tuple[Remark, ...]:
    """What must be known of a blow's numbers."""
    out: list[Remark] = []
    blow = impact.blow
    if impact.clipped_samples and case.saturation.full_scale is not None:
        full, share = case.saturation.full_scale / STANDARD_GRAVITY, 100.0 * impact.spread
        count = impact.clipped_samples
        text = f"{count} samples at full scale ({full:.1f} g); the missing impulse is known to {share:.0f} %."
        out.append(Remark("clipped", text))
    if blow.gyro_gap > 0.0:
        text = f"The gyro says nothing for {1e3 * blow.gyro_gap:.0f} ms of the event."
        out.append(Remark("gyro_gap", text))
    if blow.w is None:
        text = "No gyro: delta-V is in the box's own axes, which turn with the vehicle."
        out.append(Remark("axes_rotating", text))
    elif float(np.abs(blow.w[blow.zero : blow.last + 1, 2]).max()) > SPINS:
        out.append(Remark("off_centre", "The vehicle turned: delta-V is that of the box, not of the centre of mass."))
    if impact.steady.span < 1.0:
        text = f"Gravity and bias are taken from {impact.steady.span:.2f} s before the blow."
        out.append(Remark("short_context", text))
    if np.linalg.norm(impact.steady.f) < 0.5 * STANDARD_GRAVITY:
        out.append(Remark("no_gravity", "The recording does not show gravity; how the vehicle stood is not told."))
    if impact.cloud.chi2 and not impact.cloud.fused:
        text = f"Delta-V by the fixes contradicts the accelerometer (chi square {impact.cloud.chi2:.0f}); not used."
        out.append(Remark("gps_disagrees", text))
    return (*out, *_sampling(case, impact))


def _sampling(case: Case, impact: Impact) -> tuple[Remark, ...]:
    """What must be known of the samples of a blow."""
    out: list[Remark] = []
    if impact.rough > ROUGH:
        text = f"Neighbouring samples differ by {100.0 * impact.rough:.0f} % of the pulse: it is sampled too slowly."
        out.append(Remark("aliasing_likely", text))
    elif case.rate < UNFILTERED_RATE:
        text = f"{case.rate:.0f} samples per second: body ringing may fold into delta-V where the box has no filter."
        out.append(Remark("aliasing_possible", text))
    lacks = impact.lacks
    if lacks.starts:
        out.append(Remark("starts_in_event", "The recording begins within the event: delta-V lacks its start."))
    if lacks.ends:
        out.append(Remark("ends_in_event", "The recording ends before the end of integration."))
    if lacks.gap > 0.0:
        text = f"{1e3 * lacks.gap:.0f} ms of samples are missing within the event; the interval is wider by them."
        out.append(Remark("gap_in_event", text))
    return tuple(out)


def _basis(case: Case, t0: float, impact: Impact | None) -> Basis:
    stream, mounting = case.stream, case.mounting
    first, last = np.searchsorted(stream.t, [t0 - SPAN, t0 + SPAN])
    known, seen = (None, None) if impact is None else (impact.known, impact.seen)
    sigma = mounting.sigma
    clock = case.clock
    return Basis(
        algorithm=ALGORITHM,
        window=(float(stream.t[first]), float(stream.t[max(int(last) - 1, 0)])),
        sample_rate=case.rate,
        full_scale=case.saturation.full_scale,
        mounting_status=mounting.status,
        mounting_sigma=None if sigma is None else (float(sigma[0]), float(sigma[1]), float(sigma[2])),
        R_va=mounting.R_va,
        gyro=case.w_v is not None if impact is None else impact.blow.w is not None,
        fixes_before=0 if known is None else known.fixes,
        fixes_after=0 if seen is None else seen.fixes,
        speed_lag=mounting.speed_lag,
        course_lag=mounting.course_lag,
        utc_t0=None if clock is None else float(clock.utc(np.array(t0))),
        utc_sigma=None if clock is None else _utc_sigma(case, clock, t0),
    )


def _utc_sigma(case: Case, clock: ClockFit, t0: float) -> float:
    """1 sigma of the UTC of a moment, s: how late fixes come is not told by their own times (`fit_clock`)."""
    fit = np.hypot(clock.sigma, clock.drift_sigma * (t0 - clock.t_ref))
    return float(np.linalg.norm([fit, case.lags.speed, case.lags.sigma]))


def _other(case: Case, impact: Impact) -> SecondImpact:
    blow = impact.blow
    return SecondImpact(
        t0=float(blow.t[blow.zero]),
        t_end=float(blow.t[blow.end]),
        resultant=impact.cloud.resultant(),
        pdof=impact.cloud.pdof() if case.yaw_known else None,
        clipped_samples=impact.clipped_samples,
    )


def _plain(case: Case, finding: Finding) -> CrashEvent:
    """An event of which no more is said than what it was."""
    t = case.stream.t
    t0 = float(t[finding.window.zero])
    flags = case.saturation.flags[finding.window.zero : finding.window.last + 1]
    return CrashEvent(
        kind=finding.kind,
        t0=t0,
        t_end=float(t[finding.window.end]),
        peak=finding.peak,
        confidence=finding.confidence,
        basis=_basis(case, t0, None),
        clipped_samples=int(flags.any(axis=1).sum()),
        quality=(*case.drive.remarks, *case.remarks, *finding.remarks),
    )


def _harsh(case: Case, vehicle_class: VehicleClass, events: list[CrashEvent]) -> list[CrashEvent]:
    """Harsh driving, outside of what is an event already."""
    if not case.yaw_known:
        return []
    taken = [(each.begins - 0.3, each.ends + (10.0 if each.severe else 0.5)) for each in events]
    found = [
        each
        for drive, R_va in _mounted(case)
        for each in manoeuvres(drive.inertial, R_va, usable(drive.gnss), case.lags.speed, vehicle_class)
    ]

    def apart(each: Manoeuvre) -> bool:
        return all(each.end < begin or each.begin > end for begin, end in taken)

    return [
        CrashEvent(
            kind=each.kind,
            t0=each.begin,
            t_end=each.end,
            peak=each.peak,
            confidence=0.9,
            basis=_basis(case, each.begin, None),
            quality=(*case.drive.remarks, *case.remarks),
        )
        for each in found
        if apart(each)
    ]


def _mounted(case: Case) -> list[tuple[Drive, Floats]]:
    """The recording cut where the box was turned, each part with the mounting of its time, those without left out."""
    changes = sorted(case.mounting.changes, key=lambda each: each.t)
    if not changes:
        return [(case.drive, case.R_va)]
    edges = [-np.inf, *(each.t for each in changes), np.inf]
    # What one change says of the time after it, the next one may say of the time before it.
    after = [None, *(each.after for each in changes[:-1]), case.R_va]
    before = [*(each.before for each in changes), None]
    out: list[tuple[Drive, Floats]] = []
    for k, (one, other) in enumerate(zip(after, before, strict=True)):
        R_va = one if other is None else other
        if R_va is not None:
            out.append((between(case.drive, edges[k], edges[k + 1]), R_va))
    return out
