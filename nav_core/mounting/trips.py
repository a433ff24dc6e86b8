"""A trip and the trips before it: one estimate for the installation, at the cost of the last trip."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from nav_core.mounting.confidence import CONVERGED, observability
from nav_core.mounting.fusion import DOUBTFUL, TripEvidence, disagreement, joined, solved, trip_evidence, weakened
from nav_core.mounting.model import Noise, less_crown
from nav_core.mounting.moved import LEAST_ANGLE, SURE
from nav_core.mounting.reasons import reason
from nav_core.mounting.trouble import HANDED, MIRRORED
from nav_core.mounting.whole_drive import analyse, refused
from nav_core.records import Gnss, MountingChange, MountingEstimate
from nav_core.signal import Ticks
from nav_core.typing import Floats

UNREMARKABLE = 6.25
"""Nine in ten trips of an untouched box stay under this; what is beyond widens the covariance."""


FADED = 0.3
"""Share of its weight that the past keeps after a contradiction: the newer data are believed in the end."""


class Told(NamedTuple):
    """What is known after a trip."""

    estimate: MountingEstimate
    """Of all trips together."""
    own: TripEvidence | None
    """What this trip adds; None where it cannot say anything."""
    past_share: float
    """How much the trips before still count: nothing after the box was moved, less after a contradiction."""


def told_of(ticks: Ticks, gnss: Gnss, past: TripEvidence | None, noise: Noise) -> Told:
    """Mounting from a trip and the evidence of the trips before it.

    Parameters
    ----------
    ticks : Ticks
        Of this trip alone.
    gnss : Gnss
    past : TripEvidence, optional
        Earlier trips of the same installation, `joined`.
    noise : Noise

    Returns
    -------
    Told

    Notes
    -----
    A trip that contradicts the past beyond doubt, and is itself sure, was driven with a box that had
    been moved before: the change stands at its beginning and the past is dropped.  One that
    contradicts it less clearly, or by too little to be called a move, is joined with it all the same,
    and the more unlikely the disagreement is, the more of it is part of the stated covariance; after a
    contradiction the past counts for less.  Data that are refused stay refused, whatever
    was known before; where they show that the axes are left-handed, the past was read wrongly as well.
    """
    estimate, fit, handed, found = analyse(ticks, gnss, noise=noise)
    own = None if fit is None else trip_evidence(fit, handed, found)
    codes = {each.code for each in estimate.reasons}
    if past is None or estimate.changes or estimate.status == "not_fixed" or codes & _REFUSED:
        keeps = past is not None and not estimate.changes and "mirrored" not in codes
        return Told(estimate, own, float(keeps))
    if past.handed + handed < -MIRRORED:
        return Told(refused(reason("mirrored")), None, 0.0)
    if own is None or fit is None or found is None:
        known = _of(estimate, past, noise)
        return Told(known if "mismatch" not in codes else _doubted(known), None, 1.0)
    chi2, apart = disagreement(past, own, noise)
    angle = float(np.linalg.norm(apart))
    if chi2 > SURE and angle > LEAST_ANGLE and estimate.status == "ready":
        change = MountingChange(fit.begin, angle, solved(past, noise)[0], solved(own, noise)[0])
        return Told(replace(estimate, changes=(change,)), own, 0.0)
    unlikely = max(1.0 - UNREMARKABLE / max(chi2, 1e-9), 0.0)
    share = FADED if chi2 > DOUBTFUL else 1.0
    # The sum stays where the box was on earlier trips; where it slips it has gone all of the way since.
    apart = np.column_stack([np.sqrt(unlikely) * apart, np.diag(found.slip)])
    known = _of(estimate, joined([weakened(past, share), own]), noise, apart)
    return Told(known if share == 1.0 else _doubted(known), own, share)


_REFUSED = frozenset(
    {"wrong_unit", "no_gravity", "dead_accelerometer", "dead_axis", "mirrored", "gps_speed_unit", "gps_course_unit"}
)


def _doubted(estimate: MountingEstimate) -> MountingEstimate:
    """The estimate with the word that something does not fit."""
    told = estimate.reasons if any(each.code == "mismatch" for each in estimate.reasons) else ()
    return replace(
        estimate,
        status="settling",
        progress=min(estimate.progress, 0.99),
        reasons=told or (reason("contradiction"), *estimate.reasons),
    )


def _of(
    estimate: MountingEstimate, evidence: TripEvidence, noise: Noise, apart: Floats | None = None
) -> MountingEstimate:
    """A trip's estimate with mounting, covariance and status those of the evidence; columns of `apart` widen it."""
    R_va, covariance = solved(evidence, noise)
    covariance[0, 0] += noise.crown**2
    if apart is not None:
        covariance = covariance + apart @ apart.T
    codes = {each.code for each in estimate.reasons}
    right_handed = evidence.handed >= HANDED or "handedness_trusted" in codes
    sure = right_handed and "startled" not in codes and bool(np.sqrt(np.diag(covariance)).max() < CONVERGED)
    return replace(
        estimate,
        status="ready" if sure else "settling",
        R_va=less_crown(R_va, noise),
        covariance=covariance,
        progress=1.0 if sure else min(max(estimate.progress, _progress(covariance)), 0.99),
        observability=observability(covariance),
        reliable=estimate.reliable or sure,
        stable=estimate.stable or sure,
        reasons=tuple(each for each in estimate.reasons if not (sure and each.code in _ANSWERED)),
    )


_ANSWERED = ("no_fix", "few_fixes", "not_driven", "few_events", "no_turns", "keep_driving", "handedness_open")
"""What a trip lacks is no matter once the trips together have it."""


def _progress(covariance: Floats) -> float:
    return float(np.min(np.minimum(CONVERGED**2 / np.diag(covariance), 1.0)))
