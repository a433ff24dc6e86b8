"""Gauss-Newton on the evidence of both planes: from a start to the best mounting and what it rests on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from nav_core.mounting.closed_form import Start
from nav_core.mounting.echo import echo
from nav_core.mounting.model import BIAS, COURSE_LAG, MILLI_G, SPEED_LAG, TURN, UNKNOWNS, Noise, prior, turned
from nav_core.mounting.pitch_plane import Along, along_of, pitch_plane
from nav_core.mounting.stretch import PAUSE, Record, blocks_of
from nav_core.mounting.whitening import Channel, Evidence, whiten
from nav_core.mounting.yaw_plane import Across, across_of, yaw_plane
from nav_core.typing import Floats

BLOCK = 5.0
"""Length of the stretches whose evidence is kept apart, s."""

HUBER = 3.0
"""Innovations beyond this many sigmas are weighted down."""

MAX_LAG = 2.5
CLOSE = 0.1
"""A fit is at rest when a pass moves no angle and no lag by more than this many of its sigmas..."""
_LEAST = np.array([3e-3, 3e-3, 3e-3, 0.1, 0.1])
"""...or by this share of these, rad and s: what a long drive knows far better is not chased."""
_PASSES = 8
_MOVING = np.r_[np.arange(UNKNOWNS)[TURN], SPEED_LAG, COURSE_LAG]
_MAX_TURN = 0.4


class View(NamedTuple):
    """What the ticks of a record say at one mounting and one pair of lags, whatever the noise levels."""

    along: Along
    across: Across


def view_of(record: Record, R_va: Floats, lags: tuple[float, float]) -> View:
    """A record seen with a mounting.

    Parameters
    ----------
    record : Record
        Ticks, A-frame, and fixes.
    R_va : ndarray, shape (3, 3)
        From A to V.
    lags : tuple of float
        Of GPS speed and course, s.

    Returns
    -------
    View
    """
    frame = turned(record, R_va, lags[0])
    return View(along_of(record, lags[0], frame), across_of(record, lags[1], frame))


@dataclass(frozen=True, slots=True)
class Fit:
    """The best mounting of a record, and the evidence by stretches of `BLOCK` seconds.

    Attributes
    ----------
    R_va : ndarray, shape (3, 3)
    p : ndarray, shape (14,)
        The other unknowns where they came to rest (turn and lag corrections are zero).
    speed_lag, course_lag : float
        s.
    noise : Noise
        What the record was weighed with.
    gram : ndarray, shape (blocks, 15, 15)
        Whitened products at the solution, both planes together, less what sensor noise adds to them.
    misfit, count : ndarray, shape (blocks, 4)
        Squared whitened innovations and their number: speed, height, climb, course.
    prior : ndarray, shape (14,)
        Diagonal information of the unknowns before the drive.
    prior_pull : ndarray, shape (14,)
        Prior information times prior mean.
    begin : float
        Box time at which the first stretch begins, s.
    view : View
        The record as it looks from the solution.
    """

    R_va: Floats
    p: Floats
    speed_lag: float
    course_lag: float
    noise: Noise
    gram: Floats
    misfit: Floats
    count: Floats
    prior: Floats
    prior_pull: Floats
    begin: float
    view: View

    def solve(self, gram: Floats) -> tuple[Floats, Floats]:
        """Unknowns and covariance from some of the evidence, shapes (..., 14) and (..., 14, 14).

        Parameters
        ----------
        gram : ndarray, shape (..., 15, 15)
            Sum of some of `gram`.

        Returns
        -------
        solution : ndarray, shape (..., 14)
            In the units of `p`.
        covariance : ndarray, shape (..., 14, 14)
            Of it.
        """
        information = gram[..., 1:, 1:] + np.diag(self.prior + 1e-6)
        covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        pull = self.prior_pull - gram[..., 1:, 0]
        solution: Floats = np.einsum("...ij,...j->...i", covariance, pull)
        return solution, covariance

    def trips(self) -> list[slice]:
        """The stretches of each trip, in order of time; pauses of `PAUSE`, or up to a stretch less, part them."""
        told = np.flatnonzero(self.count.any(axis=1))
        ends = np.flatnonzero(np.diff(told) >= PAUSE / BLOCK)
        begins = [0, *(told[ends + 1]).tolist()]
        return [slice(begin, end) for begin, end in pairwise([*begins, self.gram.shape[0]])]


def weigh(record: Record, view: View, noise: Noise, p: Floats, limit: float, *, restart: bool = False) -> Evidence:
    """Evidence of both planes at a mounting, the four kinds of measurement side by side; see `whiten`.

    Parameters
    ----------
    record : Record
        Ticks, A-frame, and fixes.
    view : View
        Of the record, at the mounting.
    noise : Noise
        What to expect.
    p : ndarray, shape (14,)
        The unknowns, for the innovations that `limit` judges.
    limit : float
        Sigmas beyond which an innovation is weighted down.
    restart : bool
        As in `whiten`.

    Returns
    -------
    Evidence
        By stretches of `BLOCK` seconds; k = 4: speed, height, climb, course.
    """
    return _weighed(record, _planes(record, view, noise), p, limit, restart=restart)


def _planes(record: Record, view: View, noise: Noise) -> tuple[Channel, Channel]:
    return pitch_plane(record, view.along, noise), yaw_plane(record, view.across, noise)


def _weighed(
    record: Record, planes: tuple[Channel, Channel], p: Floats, limit: float, *, restart: bool = False
) -> Evidence:
    block = blocks_of(record.fixes.t, record.fixes.t[0], BLOCK)
    count = int(block[-1]) + 1
    pitch, yaw = (whiten(plane, block, count, p, limit=limit, restart=restart) for plane in planes)
    return Evidence(*(np.concatenate(pair, axis=1) for pair in zip(pitch, yaw, strict=True)))


UNCALIBRATED = 30.0 * MILLI_G
"""Bias of an accelerometer that nobody calibrated, 1 sigma, m/s²: the zero-g offset of ordinary parts' data sheets."""

UNCALIBRATED_SHARE = 0.2
"""Of all boxes, before the drive has spoken."""


def likely_bias(noise: Noise, gram: Floats, lags: tuple[float, float]) -> Noise:
    """The bias prior after the drive has shown some of the bias.

    A box is calibrated or it is not, and its three axes are alike: what is seen of one (the vertical
    one shows in the magnitude of gravity) tells of the others.  The evidence for each grade is the
    likelihood of the drive with all unknowns but the grade integrated out.

    Parameters
    ----------
    noise : Noise
        Its `bias` is that of a calibrated box.
    gram : ndarray, shape (15, 15)
        All evidence of the drive, without prior.
    lags : tuple of float
        Where it was linearised, s.

    Returns
    -------
    Noise
        With the mean variance of both grades as the bias's.
    """
    diagonal, mean = prior(noise, lags)
    others = np.delete(np.arange(UNKNOWNS), np.arange(UNKNOWNS)[BIAS])
    rest = np.ix_(1 + others, 1 + others)
    inner = gram[rest] + np.diag(diagonal[others] + 1e-6)
    cross = gram[1:, 1:][BIAS][:, others]
    pull = (diagonal * mean - gram[1:, 0])[others]
    A = gram[1:, 1:][BIAS, BIAS] - cross @ np.linalg.solve(inner, cross.T)
    y = -gram[1:, 0][BIAS] - cross @ np.linalg.solve(inner, pull)
    grades = np.array([noise.bias, max(UNCALIBRATED, noise.bias)])
    score = np.log([1.0 - UNCALIBRATED_SHARE, UNCALIBRATED_SHARE])
    for grade, sigma in enumerate(grades):
        posterior = A + np.eye(3) / sigma**2
        told = float(y @ np.linalg.solve(posterior, y))
        score[grade] += 0.5 * (told - float(np.linalg.slogdet(sigma**2 * posterior)[1]))
    weight = np.exp(score - score.max())
    return replace(noise, bias=float(np.sqrt(weight @ grades**2 / weight.sum())))


LEAST_SHARE = 0.05
"""Of the evidence for a turn that is taken for signal when it looks like nothing but noise."""


def _informative(planes: tuple[Channel, Channel], gram: Floats) -> Floats:
    """Root of the share of each column's evidence that is signal, shape (15,); see `echo`.

    A turn about x acts through the lateral force on the climb and the vertical one on the course; about
    y through the vertical one on the speed and the longitudinal one on the climb; about z through the
    lateral one on the speed and the longitudinal one on the course.
    """
    pitch, yaw = planes
    along, climb = echo(pitch)
    (across,) = echo(yaw)
    noisy = np.array([climb + across, along + climb, along + across])
    share = np.ones(1 + UNKNOWNS)
    share[1:4] = np.sqrt(np.clip(1.0 - noisy / np.maximum(np.diag(gram)[1:4], 1e-12), LEAST_SHARE, 1.0))
    return share


def refine(record: Record, start: Start, noise: Noise, p: Floats | None = None, *, within: float = CLOSE) -> Fit:
    """Maximum a posteriori mounting.

    Parameters
    ----------
    record : Record
    start : Start
        Within some tens of degrees of the truth.
    noise : Noise
    p : ndarray, shape (14,), optional
        Where the unknowns are likely to end; given, outliers are told from the first pass on.
    within : float
        When to stop, in sigmas of the step; see `CLOSE`.

    Returns
    -------
    Fit
    """
    R_va, lags = start.R_va, (start.speed_lag, start.course_lag)
    at = np.zeros(UNKNOWNS) if p is None else p.copy()
    at[TURN] = at[[SPEED_LAG, COURSE_LAG]] = 0.0
    number = 0
    while True:
        view = view_of(record, R_va, lags)
        planes = _planes(record, view, noise)
        evidence = _weighed(record, planes, at, HUBER if number or p is not None else np.inf)
        gram = evidence.gram.sum((0, 1))
        suited = likely_bias(noise, gram, lags)
        diagonal, mean = prior(suited, lags)
        covariance = np.linalg.inv(gram[1:, 1:] + np.diag(diagonal + 1e-6))
        at = covariance @ (diagonal * mean - gram[1:, 0])
        least = np.maximum(np.sqrt(np.diag(covariance)[_MOVING]), _LEAST)
        settled = bool((np.abs(at[_MOVING]) < within * least).all())
        turn = at[TURN] * min(1.0, _MAX_TURN / max(float(np.linalg.norm(at[TURN])), 1e-9))
        shift = at[[SPEED_LAG, COURSE_LAG]]
        number += 1
        if number == _PASSES or (settled and (number > 1 or p is not None)):
            break
        R_va = Rotation.from_rotvec(turn).as_matrix() @ R_va
        lags = (float(np.clip(lags[0] + shift[0], 0.0, MAX_LAG)), float(np.clip(lags[1] + shift[1], 0.0, MAX_LAG)))
        at[TURN] = at[[SPEED_LAG, COURSE_LAG]] = 0.0
    share = _informative(planes, gram)  # the bias alone is suited otherwise, and no plane depends on that
    return Fit(
        R_va=R_va,
        p=at,
        speed_lag=lags[0],
        course_lag=lags[1],
        noise=suited,
        gram=evidence.gram.sum(1) * np.outer(share, share),
        misfit=evidence.misfit(at),
        count=evidence.number,
        prior=diagonal,
        prior_pull=diagonal * mean,
        begin=float(record.fixes.t[0]),
        view=view,
    )
