"""Estimators of the mounting side by side on one drive: how each came to its answer (001 figures 5.3-5.12)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, replace
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np

from nav_core.errors import TooLittleDataError
from nav_core.mounting import estimate_mounting
from nav_core.mounting.online import advance, begin
from nav_core.mounting.online_stream import chunks_of
from nav_core.mounting.online_verdict import assess
from nav_core.mounting.thesis import ThesisRun, run_thesis
from nav_core.mounting.thesis_model import N_STATES
from nav_core.records import Drive, Gnss, Inertial, MountingEstimate, MountingMethod
from nav_core.rotation import angle_between, error_between, matrix_to_thesis, quaternion_to_matrix, rotvec_to_matrix
from nav_core.typing import Floats
from server.installations.result import mount_json

METHODS: tuple[MountingMethod, ...] = ("mekf", "two-phase", "online", "whole-drive")
LOOKS = {"whole-drive": 16, "two-phase": 40, "online": 120}
"""How often a method is asked what it would say if the drive had ended there."""
DRAWN = 400
_STEP = 1e-4

R = TypeVar("R", Inertial, Gnss)
Progress = Callable[[str, float], None]


class Moment(NamedTuple):
    """What a method said at a time of the box's clock."""

    t: float
    R_va: Floats
    covariance: Floats
    observability: float | None


def compare(
    drive: Drive,
    *,
    methods: Sequence[MountingMethod] = METHODS,
    traffic_side: Literal["left", "right"] | None = None,
    reference: Floats | None = None,
    progress: Progress,
) -> dict[str, Any]:
    """Every method's answer and the way to it.

    `reference` is a mounting known from elsewhere; without one, what the whole drive says in the end stands in, else
    the surest of the others.
    """
    found: dict[str, tuple[MountingEstimate, list[Moment]]] = {}
    thesis: ThesisRun | None = None
    for number, method in enumerate(methods):
        progress(method, number / len(methods))
        found[method] = (estimate_mounting(drive, method=method, traffic_side=traffic_side), [])
        if method == "mekf":
            thesis = _thesis(drive)
            moments = [] if thesis is None else _of_thesis(thesis)
        elif method == "online":
            moments = _online(drive)
        else:
            moments = _by_prefixes(drive, method, traffic_side, progress, number / len(methods), len(methods))
        found[method] = (found[method][0], moments)
    known = reference if reference is not None else _best({name: one for name, (one, _) in found.items()})
    return {
        "reference": {
            "R_va": None if known is None else known.tolist(),
            "euler_deg": None if known is None else np.degrees(matrix_to_thesis(known)).tolist(),
            "from": "none" if known is None else "given" if reference is not None else "estimate",
        },
        "methods": {name: _told(one, moments, known) for name, (one, moments) in found.items()},
        "observability": None if thesis is None else _observability(drive, thesis, known),
    }


def _best(estimates: dict[str, MountingEstimate]) -> Floats | None:
    """The whole drive's mounting, else that of the smallest sigma."""
    known = {name: (one.R_va, one.sigma) for name, one in estimates.items()}
    if "whole-drive" in known and known["whole-drive"][0] is not None:
        return known["whole-drive"][0]
    sure = [(float(sigma.max()), R_va) for R_va, sigma in known.values() if R_va is not None and sigma is not None]
    return min(sure, key=lambda one: one[0])[1] if sure else None


def _thesis(drive: Drive) -> ThesisRun | None:
    try:
        return run_thesis(drive)
    except TooLittleDataError:
        return None


def _rows(count: int) -> list[int]:
    return np.unique(np.linspace(0, count - 1, min(count, DRAWN)).astype(int)).tolist() if count else []


def _of_thesis(run: ThesisRun) -> list[Moment]:
    history = run.history
    return [
        Moment(
            float(run.steps.t[row]),
            quaternion_to_matrix(history.q_A[row]),
            history.mounting_covariance[row],
            float(history.observability[row]),
        )
        for row in _rows(run.done)
    ]


def _online(drive: Drive) -> list[Moment]:
    state, moments = begin(), []
    span = _span(drive)
    for chunk in chunks_of(drive, max((span[1] - span[0]) / LOOKS["online"], 1.0)):
        state = advance(state, chunk)
        if chunk.gnss.t.size:
            moments += _moment(float(chunk.gnss.t[-1]), assess(state))
    return moments


def _by_prefixes(
    drive: Drive,
    method: MountingMethod,
    traffic_side: Literal["left", "right"] | None,
    progress: Progress,
    begun: float,
    methods: int,
) -> list[Moment]:
    moments: list[Moment] = []
    ends = list(_ends(drive, LOOKS[method]))
    for number, end in enumerate(ends):
        progress(method, begun + number / len(ends) / methods)
        moments += _moment(end, estimate_mounting(_until(drive, end), method=method, traffic_side=traffic_side))
    return moments


def _ends(drive: Drive, count: int) -> Iterator[float]:
    first, last = _span(drive)
    yield from np.linspace(first, last, count + 1)[1:].tolist()


def _span(drive: Drive) -> tuple[float, float]:
    t = np.concatenate([drive.inertial.t, drive.gnss.t])
    return (float(t.min()), float(t.max())) if t.size else (0.0, 0.0)


def _until(drive: Drive, end: float) -> Drive:
    """The drive as it was known at `end`."""
    return replace(drive, inertial=_cut(drive.inertial, end), gnss=_cut(drive.gnss, end))


def _cut(record: R, end: float) -> R:
    rows = int(np.searchsorted(record.t, end, side="right"))
    columns = {each.name: getattr(record, each.name) for each in fields(record)}
    return replace(record, **{name: None if values is None else values[:rows] for name, values in columns.items()})


def _moment(t: float, estimate: MountingEstimate) -> list[Moment]:
    if estimate.R_va is None or estimate.covariance is None:
        return []
    return [Moment(t, estimate.R_va, estimate.covariance, estimate.observability)]


def _told(estimate: MountingEstimate, moments: list[Moment], known: Floats | None) -> dict[str, Any]:
    apart = None if known is None or estimate.R_va is None else float(np.degrees(angle_between(estimate.R_va, known)))
    return {
        "result": mount_json(estimate),
        "apart_deg": apart,
        "course": {
            "t_s": [moment.t for moment in moments],
            "euler_deg": _angles(moments, known),
            "about_v_deg": [] if known is None else [_about(moment.R_va, known) for moment in moments],
            "sigma_v_deg": [np.degrees(np.sqrt(np.diag(moment.covariance))).tolist() for moment in moments],
            "observability": [moment.observability for moment in moments],
        },
    }


def _about(R_va: Floats, known: Floats) -> list[float]:
    """The small rotation about the V axes that separates an estimate from the reference, degrees."""
    return np.degrees(error_between(R_va, known)).tolist()


def _angles(moments: list[Moment], known: Floats | None) -> dict[str, Any]:
    """Theta, phi, psi with their sigmas, each on the turn that is nearest to the reference's."""
    if not moments:
        return {"angles": [], "sigma": []}
    angles = np.array([matrix_to_thesis(moment.R_va) for moment in moments])
    middle = angles[-1] if known is None else matrix_to_thesis(known)
    angles = middle + np.mod(angles - middle + np.pi, 2.0 * np.pi) - np.pi
    sigma = np.array([_sigma_of_angles(moment) for moment in moments])
    return {"angles": np.degrees(angles).tolist(), "sigma": np.degrees(sigma).tolist()}


def _sigma_of_angles(moment: Moment) -> Floats:
    """1-sigma of theta, phi, psi, rad: differences along the V axes; at most a half turn, near the singular phi."""
    at = np.array(matrix_to_thesis(moment.R_va))
    J = np.empty((3, 3))
    for axis in range(3):
        turned = matrix_to_thesis(rotvec_to_matrix(_STEP * np.eye(3)[axis]) @ moment.R_va)
        J[:, axis] = (np.mod(np.array(turned) - at + np.pi, 2.0 * np.pi) - np.pi) / _STEP
    return np.minimum(np.sqrt(np.maximum(np.diag(J @ moment.covariance @ J.T), 0.0)), np.pi)


def _observability(drive: Drive, run: ThesisRun, known: Floats | None) -> dict[str, Any]:
    """Figures 5.3-5.7: the largest eigenvalue of the normalised covariance, with what the vehicle did meanwhile."""
    rows = _rows(run.done)
    force = None if known is None else (run.steps.f[rows] @ known.T)[:, 0].tolist()
    at = np.searchsorted(drive.gnss.t, run.steps.t[rows]).clip(max=drive.gnss.t.size - 1)
    course = np.degrees(drive.gnss.course[at])
    return {
        "states": N_STATES,
        "t_s": run.steps.t[rows].tolist(),
        "largest_eigenvalue": run.history.largest_eigenvalue[rows].tolist(),
        "course_deg": [None if np.isnan(value) else float(value) for value in course],
        "forward_mps2": force,
    }
