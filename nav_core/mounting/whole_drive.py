"""The whole-drive estimator: the product's default answer to "how does this box sit?"."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from nav_core.mounting.blows import Blow, blows, cut_out
from nav_core.mounting.confidence import CONVERGED, Confidence, assess, observability
from nav_core.mounting.fixes import usable_fixes
from nav_core.mounting.fusion import solved, trip_evidence
from nav_core.mounting.model import COURSE_LAG, SPEED_LAG, Noise, less_crown
from nav_core.mounting.moved import Piece, pieces_of, startled
from nav_core.mounting.quality import (
    LAG_KNOWN,
    SWAY,
    WANDER,
    Verdict,
    after_fit,
    before_fit,
    excitation,
    gravity_wander,
    loosely_held,
    refusal,
    sway,
)
from nav_core.mounting.reasons import reason
from nav_core.mounting.receiver import late
from nav_core.mounting.refine import Fit
from nav_core.mounting.self_test import self_test
from nav_core.mounting.solution import Solution
from nav_core.mounting.stretch import Record, prepare
from nav_core.mounting.trouble import (
    BENDS,
    FOLLOWED,
    HANDED,
    MIRRORED,
    TRUSTED_AFTER,
    came_back,
    explained,
    handedness,
    inspect,
)
from nav_core.records import Gnss, MountingChange, MountingEstimate, Reason
from nav_core.rotation import angle_between
from nav_core.signal import Ticks
from nav_core.typing import Floats

LOOSE = Verdict("not_fixed", 0.0, False, (reason("loose"),))


class Analysis(NamedTuple):
    """An estimate, the fit behind it, which there is when the mounting is known, and what speaks for its hand."""

    estimate: MountingEstimate
    fit: Fit | None
    handed: float = 0.0
    """Twice the log of likelihoods in favour of right-handed axes; see `trouble.handedness`."""
    found: Confidence | None = None
    """In the fit, where there is one."""


def estimate(ticks: Ticks, gnss: Gnss, *, noise: Noise | None = None) -> MountingEstimate:
    """Mounting of a box from a whole recording.

    Parameters
    ----------
    ticks : Ticks
        Decimated specific force, A-frame; merged from as many batches as there are.
    gnss : Gnss
    noise : Noise, optional
        Prior knowledge; ordinary cars, roads and receivers by default.

    Returns
    -------
    MountingEstimate
        Sigmas include what the drive cannot tell (accelerometer bias, mean bank of the roads).
        Where the box was moved, the last mounting with the earlier changes.  Crashes, and standing
        after them, are left out.
    """
    return analyse(ticks, gnss, noise=noise).estimate


def analyse(ticks: Ticks, gnss: Gnss, *, noise: Noise | None = None) -> Analysis:
    """`estimate`, with the fit that it rests on: what the trip has to say to later ones.

    Parameters
    ----------
    ticks : Ticks
        Of the specific force, A-frame, m/s².
    gnss : Gnss
        Fixes of the drive.
    noise : Noise, optional
        What to expect; of ordinary cars, roads and receivers where not given.

    Returns
    -------
    Analysis
        The estimate, and the fit where there is one.
    """
    noise = noise or Noise()
    fixes = usable_fixes(gnss)
    trouble = inspect(ticks, gnss, fixes)
    if trouble.refused is not None:
        return Analysis(_without(refusal(trouble.refused)), None)
    remarks = trouble.remarks
    found_blows = blows(ticks, fixes)
    record = cut_out(prepare(ticks, fixes), (*found_blows, *trouble.left_out))
    verdict = before_fit(record, excitation(record))
    if verdict is not None:
        return Analysis(_without(verdict, remarks=remarks), None)
    pieces = pieces_of(record, noise)
    last = pieces[-1]
    bends = excitation(last.record).across > BENDS
    handed = handedness(last.record, last.solution, noise) if bends else 0.0
    if handed < -MIRRORED:
        return Analysis(_without(refusal(reason("mirrored")), remarks=remarks), None, handed)
    if loosely_held(len(pieces) - 1, record) or _loose(pieces):
        return Analysis(_without(LOOSE, remarks=remarks), None)
    known_of = [_known(piece.solution.fit, noise) for piece in pieces]
    changes = _changes(pieces, [mounting for mounting, _ in known_of], found_blows)
    offered = excitation(last.record)
    R_va, found = known_of[-1]
    verdict = before_fit(last.record, offered) or after_fit(last.solution.start, found, offered)
    if verdict.status in ("insufficient", "not_fixed"):
        unlike_a_car = any(each.code == "mismatch" for each in verdict.reasons)
        if changes and unlike_a_car:
            verdict = LOOSE
        found_wanting = _without(verdict, changes, remarks)
        return Analysis(replace(found_wanting, reasons=explained(found_wanting.reasons, ticks)), None)
    if startled(last.solution.fit):
        verdict = verdict.held_back("startled")
    if handed < HANDED:
        if bends or offered.followed <= TRUSTED_AFTER:
            unfollowed = offered.followed < FOLLOWED * offered.moving
            verdict = verdict.held_back("no_course" if unfollowed else "handedness_open")
        else:
            remarks += (reason("handedness_trusted"),)
    fit = last.solution.fit
    speed_lag, course_lag = _known_lags(last.solution)
    remarks += late(speed_lag, course_lag if bends else None)
    remarks += (reason("slipping"),) if found.slip.any() else ()
    remarks += came_back([piece.solution.fit.R_va for piece in pieces])
    before_moving = offered.first_moving - fit.begin
    known = MountingEstimate(
        status=verdict.status,
        method="whole-drive",
        R_va=less_crown(R_va, noise),
        covariance=found.covariance,
        progress=verdict.progress,
        observability=found.observability,
        stable=found.stable,
        reliable=verdict.reliable,
        self_test=self_test(last.record, fit),
        converged_after=None if found.converged_after is None else max(found.converged_after - before_moving, 0.0),
        speed_lag=speed_lag,
        course_lag=course_lag,
        changes=changes,
        reasons=(*verdict.reasons, *remarks),
    )
    return Analysis(known, fit, handed, found)


def refused(why: Reason) -> MountingEstimate:
    """No mounting, and why.

    Parameters
    ----------
    why : Reason
        What is wrong with the data.

    Returns
    -------
    MountingEstimate
        `insufficient`.
    """
    return _without(refusal(why))


def _loose(pieces: list[Piece]) -> bool:
    """Whether the last piece is loose, or follows a loose one that was driven longer: that has yet to be outlived."""
    if _sways(pieces[-1]):
        return True
    quiet = excitation(pieces[-1].record).moving
    return any(_sways(piece) and excitation(piece.record).moving > quiet for piece in pieces[:-1])


def _sways(piece: Piece) -> bool:
    return gravity_wander(piece.logged) > WANDER or bool((sway(piece.solution.fit) > SWAY).any())


def _known(fit: Fit, noise: Noise) -> tuple[Floats, Confidence]:
    """The mounting and what is known of its error; several trips in one fit may deviate, each in its own way."""
    found = assess(fit)
    if len(fit.trips()) == 1:
        return fit.R_va, found
    R_va, covariance = solved(trip_evidence(fit, found=found), noise)
    covariance[[0, 1, 2], [0, 1, 2]] += [noise.crown**2, 0.0, 0.0] + (0.5 * found.slip) ** 2
    sure = bool((np.sqrt(np.diag(covariance)) < CONVERGED).all())
    return R_va, replace(
        found,
        covariance=covariance,
        observability=observability(covariance),
        converged_after=found.converged_after if sure else None,
    )


def _changes(pieces: list[Piece], mountings: list[Floats], spoiled: tuple[Blow, ...]) -> tuple[MountingChange, ...]:
    return tuple(
        MountingChange(_turned_at(one.record, other.record, spoiled), angle_between(after, before), before, after)
        for (one, before), (other, after) in pairwise(zip(pieces, mountings, strict=True))
    )


def _turned_at(before: Record, after: Record, spoiled: tuple[Blow, ...]) -> float:
    """When the box was turned between two pieces, s: by a blow where there was one, else as driving resumes."""
    begin, end = float(before.fixes.t[-1]), float(after.fixes.t[0])
    return next((blow.t for blow in spoiled if begin <= blow.t <= end), end)


def _known_lags(solution: Solution) -> tuple[float | None, float | None]:
    """How late slow changes of speed and course come, if the drive tells; a straight road is silent on the course's."""
    fit = solution.fit
    _, covariance = fit.solve(fit.gram.sum(0))
    sigma = np.sqrt(np.diag(covariance))
    return (
        fit.speed_lag + solution.smoothing if sigma[SPEED_LAG] < LAG_KNOWN else None,
        fit.course_lag + solution.smoothing if sigma[COURSE_LAG] < LAG_KNOWN else None,
    )


def _without(
    verdict: Verdict, changes: tuple[MountingChange, ...] = (), remarks: tuple[Reason, ...] = ()
) -> MountingEstimate:
    return MountingEstimate(
        status=verdict.status,
        method="whole-drive",
        progress=verdict.progress,
        reliable=verdict.reliable,
        changes=changes,
        reasons=(*verdict.reasons, *remarks),
    )
