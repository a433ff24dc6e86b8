"""The thesis' estimator: its Kalman filter and the program around it, from a drive to a mounting (001 ch. 4-6).

`run_thesis` gives everything that figures and later analysis need, `estimate_thesis` the product's answer.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from nav_core.errors import TooLittleDataError
from nav_core.mounting.confidence import CONVERGED
from nav_core.mounting.receiver import chords, wrong_gps_unit
from nav_core.mounting.thesis_flow import TEST_DURATION, WINDOW, FlowChart, follow_flow_chart
from nav_core.mounting.thesis_kernel import filter_drive, restart_vehicle
from nav_core.mounting.thesis_model import (
    LEVEL_TILT,
    MOVING,
    N_STATES,
    THESIS_PERIOD,
    YAW_STEP,
    Errata,
    ErrataName,
    Steps,
    Tuning,
    errata_named,
    measurement_vectors,
)
from nav_core.mounting.trouble import wrong_unit
from nav_core.records import Drive, MountingEstimate, Reason, SelfTest
from nav_core.signal import decimate
from nav_core.typing import Floats

LEVELLING = 5.0
"""s of specific force that level the corrected start."""

SURE = np.radians(5.0)
"""rad; a mounting with a larger sigma about any axis is not ready, whatever the program's flags say."""

REASONS = {
    "no_fix": "No usable satellite fixes with accelerometer data yet.",
    "not_moving": "The vehicle has not moved yet: drive off.",
    "too_short": "Drive on: another {0:.0f} s are needed.",
    "no_turns": "Make a few turns at junctions or a roundabout.",
    "not_stable": "The estimate still moves: drive on with some turns and braking.",
    "self_test_running": "Checking the estimate against GPS speed: drive on for {0:.0f} s.",
    "self_test_failed": "The estimate failed its check against GPS speed by {0:.1f} m/s: drive on.",
    "unsure": "The check is passed, but the estimate may still be {0:.0f}° off: drive on with turns and braking.",
    "filter_lost": "The calculation broke down, and its estimate with it: this method cannot follow the drive.",
}
"""What each status means to a driver; a number fills the braces."""


class Start(NamedTuple):
    """State, covariance and reference quaternions before the first row."""

    x: Floats
    P: Floats
    q_V: Floats
    q_A: Floats


class History(NamedTuple):
    """The filter after each row; NaN from the row on at which it was lost.

    Attributes
    ----------
    q_A, q_V : ndarray, shape (n, 4)
        Reference quaternions (x, y, z, w) of ``R_va`` and ``R_tv``.
    motion : ndarray, shape (n, 3)
        v_x [m/s], a_x [m/s²], omega_z [rad/s].
    mounting_covariance : ndarray, shape (n, 3, 3)
        Of the small rotation about the V axes, rad².  The factor 2 in 4.25 makes `a_A` the rotation vector
        to second order, so it is the block of P as it stands.
    largest_eigenvalue : ndarray, shape (n,)
        Of ``n P / tr P`` (5.3), between 1 and n = 9, in the mixed SI units of the state; looked at every 10 s.
    chi2 : ndarray, shape (n,)
        Squared normalised innovations of the row, summed over its seven measurements.
    """

    q_A: Floats
    q_V: Floats
    motion: Floats
    mounting_covariance: Floats
    largest_eigenvalue: Floats
    chi2: Floats

    @property
    def observability(self) -> Floats:
        """``(1 - lmax / trace) n / (n - 1)``, 0..1 with 1 for well observed, shape (n,)."""
        return (1.0 - self.largest_eigenvalue / N_STATES) * N_STATES / (N_STATES - 1.0)


class ThesisRun(NamedTuple):
    """A drive through the thesis' program."""

    steps: Steps
    history: History
    flow: FlowChart
    done: int
    """Rows before the filter was lost; all of them unless the equations are the printed ones."""


def initial_states(steps: Steps, tuning: Tuning, errata: Errata) -> tuple[Start, ...]:
    """Start values of 001 §5.2, or their correction.

    Printed: x = 0, both quaternions the identity, ``P = Q_w``.  Corrected (`errata.start`): the vehicle level and
    on its course at its speed, the box levelled by the first seconds of specific force, and its yaw, of which
    nothing is known, in four directions: one of them is within 45°, where the linearisation holds.

    Parameters
    ----------
    steps : Steps
    tuning : Tuning
    errata : Errata

    Returns
    -------
    tuple of Start
    """
    x, P = np.zeros(N_STATES), np.zeros((N_STATES, N_STATES))
    q_V, q_A = np.array([0.0, 0.0, 0.0, 1.0]), np.array([0.0, 0.0, 0.0, 1.0])
    if errata.start:
        restart_vehicle(x, P, q_V, steps.velocity[0], float(steps.speed[0]))
        first = steps.t <= steps.t[0] + LEVELLING
        q_level = levelled(steps.f[first].mean(axis=0))
        P[6:, 6:] = np.diag([LEVEL_TILT**2, LEVEL_TILT**2, YAW_STEP**2])
        yaws = Rotation.from_rotvec(np.outer(np.arange(4) * YAW_STEP, [0.0, 0.0, 1.0]))
        return tuple(Start(x, P, q_V, q) for q in (yaws * Rotation.from_quat(q_level)).as_quat())
    T = THESIS_PERIOD
    P[:2, :2] = tuning.acceleration * np.array([[T**3 / 3.0, T**2 / 2.0], [T**2 / 2.0, T]])
    P[2:, 2:] = np.diag([tuning.turn, *[tuning.attitude] * 3, *[tuning.mounting] * 3])
    return (Start(x, P, q_V, q_A),)


def levelled(f_a: Floats) -> Floats:
    """Quaternion of the shortest rotation that takes a specific force at rest to the V-frame's ``-z``.

    Parameters
    ----------
    f_a : ndarray, shape (3,)
        Mean specific force, m/s².

    Returns
    -------
    ndarray, shape (4,)
        (x, y, z, w); its yaw is arbitrary.
    """
    up = f_a / np.linalg.norm(f_a)
    cross = np.cross(up, [0.0, 0.0, -1.0])
    q = np.array([*cross, 1.0 - up[2]])
    if np.linalg.norm(q) < 1e-6:
        return np.array([1.0, 0.0, 0.0, 0.0])
    return q / np.linalg.norm(q)


def run_thesis(
    drive: Drive,
    *,
    errata: ErrataName | Errata = "corrected",
    tuning: Tuning | None = None,
    start: Start | None = None,
) -> ThesisRun:
    """Run the thesis' filter and program over a drive and keep everything.

    Parameters
    ----------
    drive : Drive
    errata : {"corrected", "printed"} or Errata
    tuning : Tuning, optional
        Default: table 5.1.
    start : Start, optional
        Default: the best of `initial_states`, by the sum of squared normalised innovations.

    Returns
    -------
    ThesisRun

    Raises
    ------
    TooLittleDataError
        Fewer than two usable fixes.
    """
    chosen, tuned = errata_named(errata), tuning or Tuning()
    steps = measurement_vectors(drive, chosen)
    starts = initial_states(steps, tuned, chosen) if start is None else (start,)
    runs = [_filtered(steps, begin, tuned, chosen) for begin in starts]
    done, history = min(runs, key=lambda run: float(np.nansum(run[1].chi2)))
    return ThesisRun(steps, history, follow_flow_chart(steps, history.q_A), done)


def _filtered(steps: Steps, start: Start, tuning: Tuning, errata: Errata) -> tuple[int, History]:
    x, P, q_V, q_A = (a.copy() for a in start)
    done, *columns = filter_drive(steps, x, P, q_V, q_A, tuning, errata)
    return done, History(*columns)


def estimate_thesis(drive: Drive, *, errata: ErrataName | Errata = "corrected") -> MountingEstimate:
    """Mounting by the thesis' filter and program.

    Parameters
    ----------
    drive : Drive
    errata : {"corrected", "printed"} or Errata
        The printed equations are kept for comparison; see docs/equations.md.

    Returns
    -------
    MountingEstimate
        The latest moving average.  `ready`: a mounting saved when STABLE and RELIABLE met has passed the test
        routine, where the thesis' program ends, and every sigma is under `SURE` by now: the routine is nearly
        blind to yaw, so that its pass alone says little, and the filter goes on after it.  `settling`: not so
        far, but after a curve.  `insufficient`: before that; on a straight road this filter cannot tell the
        box's yaw from the vehicle's.  The covariance is the filter's own, which knows nothing of accelerometer
        bias and of the road's persistent bank.
    """
    refused = wrong_unit(decimate(drive.inertial)) or wrong_gps_unit(chords(drive.gnss))
    if refused is not None:
        return MountingEstimate("insufficient", "mekf", reasons=(refused,))
    try:
        run = run_thesis(drive, errata=errata)
    except TooLittleDataError:
        return MountingEstimate("insufficient", "mekf", reasons=(_reason("no_fix"),))
    flow, last = run.flow, run.done - 1
    trial = flow.trials[-1] if flow.trials else None
    reliable = bool(trial) or bool(last >= 0 and flow.reliable[last])
    stable = bool(last >= 0 and flow.stable[last]) or flow.finished is not None
    sound = _is_sound(run)
    known = sound and reliable and bool(np.isfinite(flow.mean[last, 0]))
    test = None
    if trial is not None and trial.complete:
        test = SelfTest(trial.passed, trial.drift, trial.duration)
    progress = 0.3 * min(1.0, run.done / WINDOW) + 0.2 * stable + 0.2 * reliable
    if trial is not None and not trial.complete:
        progress += 0.3 * min(1.0, trial.duration / TEST_DURATION)
    ready = flow.finished is not None and _sigma(run).max() < SURE
    status = "insufficient" if not known else "ready" if ready else "settling"
    return MountingEstimate(
        status,
        "mekf",
        R_va=Rotation.from_quat(flow.mean[last]).as_matrix() if known else None,
        covariance=run.history.mounting_covariance[last] if known else None,
        progress=1.0 if status == "ready" else min(progress, 0.95),
        observability=float(run.history.observability[last]) if sound else None,
        stable=stable,
        reliable=reliable,
        self_test=test,
        converged_after=_converged_after(run),
        reasons=_reasons(run),
    )


def _is_sound(run: ThesisRun) -> bool:
    """Whether the filter lasted and its covariance was one throughout; the printed 4.23 does not keep it so."""
    if run.done < run.steps.t.size:
        return False
    return bool(np.linalg.eigvalsh(run.history.mounting_covariance)[:, 0].min() > 0.0)


def _sigma(run: ThesisRun) -> Floats:
    """The filter's own sigma about the V axes by now, rad, shape (3,)."""
    return np.sqrt(np.diag(run.history.mounting_covariance[run.done - 1]))


def _converged_after(run: ThesisRun) -> float | None:
    """Time from the first row, the first moving fix, until every sigma stays under 2°, s."""
    wide = np.einsum("kii->ki", run.history.mounting_covariance).max(axis=1) >= CONVERGED**2
    wide |= ~np.isfinite(run.history.chi2)
    first = int(np.flatnonzero(wide)[-1]) + 1 if wide.any() else 0
    return None if first == wide.size else float(run.steps.t[first] - run.steps.t[0])


def _reasons(run: ThesisRun) -> tuple[Reason, ...]:
    """What keeps the estimate from being ready."""
    flow, n = run.flow, run.steps.t.size
    if not _is_sound(run):
        return (_reason("filter_lost"),)
    if flow.finished is not None:
        doubt = float(_sigma(run).max())
        return () if doubt < SURE else (_reason("unsure", np.degrees(doubt)),)
    if run.steps.speed.max() < MOVING:
        return (_reason("not_moving"),)
    reasons: list[Reason] = []
    if n < WINDOW:
        reasons.append(_reason("too_short", (WINDOW - n) * THESIS_PERIOD))
    if flow.trials:
        trial = flow.trials[-1]
        if trial.complete:
            reasons.append(_reason("self_test_failed", trial.drift))
        else:
            reasons.append(_reason("self_test_running", max(TEST_DURATION - trial.duration, 0.0)))
    if not flow.reliable[-1]:
        reasons.append(_reason("no_turns"))
    if n >= WINDOW and not flow.stable[-1]:
        reasons.append(_reason("not_stable"))
    return tuple(reasons)


def _reason(code: str, number: float = 0.0) -> Reason:
    return Reason(code, REASONS[code].format(number))
