"""What is read off a blow: pulse, indices, rebound, roll."""

from __future__ import annotations

import numpy as np

from nav_core.crash.case import Case
from nav_core.crash.filters import ASI_CUTOFF, LEAST_RATE, evenly
from nav_core.crash.impact import Impact, structural
from nav_core.crash.indices import asi_1998, asi_2010, head, olc
from nav_core.events.finding import OVER, Finding
from nav_core.events.record import Estimate, Indices, Pulse
from nav_core.records import Remark
from nav_core.typing import Floats

SHOWN = 0.05
"""Kept of the pulse before time zero, s."""

OLC_RATE = 200.0
ASI_RATE = 6.0 * ASI_CUTOFF
FRONTAL = np.radians(45.0)


def pulse_of(case: Case, impact: Impact, resultant: float) -> Pulse:
    """The blow over time and its peak, mean and length.

    Parameters
    ----------
    case : Case
        The recording.
    impact : Impact
        The blow in it.
    resultant : float
        Delta-V, m/s.

    Returns
    -------
    Pulse
        Box clock from 50 ms before `t0` on; m/s² and m/s in V axes at `t0`.
    """
    blow = impact.blow
    t0 = float(blow.t[blow.zero])
    begin = int(np.searchsorted(blow.t, t0 - SHOWN))
    part = slice(begin, blow.last + 1)
    peak, name, cutoff = _peak(case, impact)
    clipped = impact.clipped[part]
    v = blow.velocity(impact.filled)[part]
    v[: blow.zero - begin] = 0.0
    spread = np.sqrt(
        np.einsum("k,kj,kj->", impact.cloud.weights, *2 * (impact.cloud.points - impact.cloud.mean,)) / 2.0
    )
    size = np.hypot(v[:, 0], v[:, 1])
    duration = float(blow.t[blow.end]) - t0
    return Pulse(
        t=blow.t[part] - t0,
        acceleration=impact.filled[part],
        recorded=blow.a[part],
        delta_v=v,
        sigma=float(spread) * np.minimum(size / max(resultant, 1e-9), 1.0),
        clipped=clipped,
        peak=peak,
        peak_lower_bound=bool(impact.clipped_samples),
        mean=resultant / max(duration, 1e-3),
        duration=duration,
        cutoff=cutoff,
        filter=name,
    )


def _peak(case: Case, impact: Impact) -> tuple[float, str, float | None]:
    """Largest horizontal recorded acceleration, the filter it was read after, and its -3 dB frequency, Hz."""
    blow = impact.blow
    inside = slice(blow.zero, blow.last + 1)
    a = structural(case, blow, blow.a)
    top = float(np.hypot(a[inside, 0], a[inside, 1]).max())
    return (top, f"none, sampled at {case.rate:.0f} Hz", None) if a is blow.a else (top, "CFC60", 100.0)


def indices_of(case: Case, impact: Impact, pdof: Estimate | None) -> tuple[Indices, tuple[Remark, ...]]:
    """Severity indices that the data allow, and why the others are not given.

    Parameters
    ----------
    case : Case
        The recording.
    impact : Impact
        The blow in it.
    pdof : Estimate or None
        rad; None of an unknown mounting.

    Returns
    -------
    indices : ndarray
        ASI without unit, OLC and PHD m/s², THIV m/s; None where not given.
    remarks : ndarray
        One for each that is not given.
    """
    if impact.clipped_samples:
        return Indices(), (Remark("indices_clipped", "ASI, OLC, THIV and PHD are not given for a clipped pulse."),)
    if impact.lacks.any:
        return Indices(), (Remark("indices_incomplete", "No severity indices of a pulse that is not whole."),)
    remarks: list[Remark] = []
    blow, rate = impact.blow, case.rate
    if pdof is None or rate < ASI_RATE:
        return Indices(), (Remark("indices_not_given", "Severity indices need the mounting and 78 Hz or more."),)
    # EN 1317's axes turn with the vehicle.
    own = np.einsum("nji,nj->ni", blow.C, impact.filled)
    stop = int(np.searchsorted(blow.t, blow.t[blow.last] + 0.5))
    a, even_rate = evenly(blow.t[:stop], own[:stop])
    if rate < LEAST_RATE[180]:
        text = f"The 13 Hz filter of ASI runs on {rate:.0f} Hz data, without the CFC 180 that needs 1800 Hz."
        remarks.append(Remark("asi_without_cfc180", text))
    thiv, phd = _head(impact, stop)
    if blow.w is None:
        remarks.append(Remark("thiv_needs_gyro", "THIV and PHD need a yaw rate."))
    elif thiv is not None and phd is None:
        remarks.append(Remark("phd_needs_rate", "PHD needs four samples in 10 ms."))
    frontal = abs(pdof.value) <= FRONTAL and rate >= OLC_RATE * (1.0 - 1e-2)
    held = olc(*_lost(impact, stop)) if frontal else None
    if held is None:
        text = "OLC is not given: the blow is not frontal, too weak, or sampled below 200 Hz."
        remarks.append(Remark("olc_not_given", text))
    return Indices(
        asi_2010=asi_2010(a, even_rate), asi_1998=asi_1998(a, even_rate), olc=held, thiv=thiv, phd=phd
    ), tuple(remarks)


def _lost(impact: Impact, stop: int) -> tuple[Floats, Floats]:
    blow = impact.blow
    v = blow.velocity(impact.filled)
    part = slice(blow.zero, stop)
    return blow.t[part] - blow.t[blow.zero], -v[part, 0]


def _head(impact: Impact, stop: int) -> tuple[float | None, float | None]:
    blow = impact.blow
    if blow.w is None:
        return None, None
    part = slice(blow.zero, stop)
    return head(blow.t[part] - blow.t[blow.zero], impact.filled[part], blow.C[part], blow.w[part])


def rebound_of(impact: Impact) -> Estimate | None:
    """Speed backwards along the old heading after the blow, m/s; None when the vehicle did not move backwards.

    Parameters
    ----------
    impact : Impact
        The blow, with the speed before it where known.

    Returns
    -------
    Estimate or None
        m/s, more than 0.
    """
    known, cloud = impact.known, impact.cloud
    if known is None:
        return None
    back = Estimate(*(-(known.speed + x) for x in _three(cloud.component(0), known.sigma)))
    return back if back.value > 0.0 and float(cloud.mean[0]) < 0.0 and known.speed > 1.0 else None


def _three(change: Estimate, sigma: float) -> tuple[float, float, float]:
    """Value, upper and lower end of a change with a further error."""
    low, high = change.value - change.low, change.high - change.value
    return (
        change.value,
        change.value + float(np.hypot(high, 1.96 * sigma)),
        change.value - float(np.hypot(low, 1.96 * sigma)),
    )


def roll_of(case: Case, finding: Finding, t0: float) -> Estimate | None:
    """Largest roll within ten seconds, rad, positive right side down; None of a vehicle that stayed upright.

    With a gyro the integral of the roll rate, which counts whole turns; else from where gravity points at rest.

    Parameters
    ----------
    case : Case
        The recording.
    finding : Finding
        Of the event: what the forces looked like.
    t0 : float
        Box clock, s.

    Returns
    -------
    Estimate or None
        rad.
    """
    t = case.stream.t
    if case.w_v is not None:
        first, last = np.searchsorted(t, [t0 - 1.0, t0 + 10.0])
        w = np.nan_to_num(case.w_v[first:last, 0])
        roll = np.cumsum(w * case.stream.step[first:last])
        if roll.size == 0 or np.abs(roll).max() < OVER:
            return None
        value = float(roll[np.argmax(np.abs(roll))])
        spread = np.radians(3.0) + 0.05 * abs(value)
        return Estimate(value, value - 1.96 * spread, value + 1.96 * spread)
    down = case.stream.mean(t0 + 3.0, t0 + 6.0)
    if finding.kind != "rollover" or down is None:
        return None
    value = float(np.arctan2(-down[1], -down[2]))
    return Estimate(value, value - np.radians(15.0), value + np.radians(15.0)) if abs(value) > OVER else None
