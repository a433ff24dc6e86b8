"""A trip and the trips before it: one estimate for the installation, at the cost of the last trip."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from nav_core.mounting.confidence import CONVERGED, observability
from nav_core.mounting.fusion import TripEvidence, disagreement, joined, solved, trip_evidence
from nav_core.mounting.model import Noise, less_crown
from nav_core.mounting.moved import LEAST_ANGLE, SURE
from nav_core.mounting.quality import reason
from nav_core.mounting.whole_drive import analyse
from nav_core.records import Gnss, MountingChange, MountingEstimate
from nav_core.signal import Ticks
from nav_core.typing import Floats

DOUBTFUL = 16.3
"""Disagreement that one in a thousand trips of an untouched box reaches (three degrees of freedom)."""


class Told(NamedTuple):
    """What is known after a trip."""

    estimate: MountingEstimate
    """Of all trips together."""
    own: TripEvidence | None
    """What this trip adds; None where it cannot say anything."""
    with_past: bool
    """Whether the trips before still count: not after the box was moved."""


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
    contradicts it less clearly leaves the estimate with the past and says so.
    """
    estimate, fit = analyse(ticks, gnss, noise=noise)
    own = None if fit is None else trip_evidence(fit)
    if past is None or estimate.changes or estimate.status == "not_fixed":
        return Told(estimate, own, past is not None and not estimate.changes)
    if own is None or fit is None:
        return Told(_of(estimate, past, noise), None, with_past=True)
    chi2, angle = disagreement(past, own, noise)
    if chi2 > SURE and angle > LEAST_ANGLE and estimate.status == "ready":
        change = MountingChange(fit.begin, angle, solved(past, noise)[0], fit.R_va)
        return Told(replace(estimate, changes=(change,)), own, with_past=False)
    if chi2 > DOUBTFUL:
        doubt = _of(estimate, past, noise)
        return Told(replace(doubt, status="settling", reasons=(reason("contradiction"), *doubt.reasons)), None, True)
    return Told(_of(estimate, joined([past, own]), noise), own, with_past=True)


def _of(estimate: MountingEstimate, evidence: TripEvidence, noise: Noise) -> MountingEstimate:
    """A trip's estimate with mounting, covariance and status those of the evidence."""
    R_va, covariance = solved(evidence, noise)
    covariance[0, 0] += noise.crown**2
    sure = bool(np.sqrt(np.diag(covariance)).max() < CONVERGED)
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
