"""How late the receiver is and whether the gyro is to be believed, before any mounting is known.

A box that is fixed somehow feels speed and course change as some fixed combination of its axes: whichever it is, the
receiver's lag is that at which the best combination leaves least.  And which axis is vertical gravity tells, so that
the gyro's turning about it can be held against the course.  Both come from sums of products, a few numbers a lag,
that a stream adds to piece by piece.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.mounting.fixes import FOLLOW_SPEED, Fixes
from nav_core.mounting.online_tally import PIECE
from nav_core.mounting.reasons import reason
from nav_core.mounting.stretch import Record, at, integrate
from nav_core.records import Reason
from nav_core.rotation import wrap
from nav_core.typing import Flags, Floats

LAGS = np.arange(0.0, 2.76, 0.25)
"""Lags that are tried, s."""

STEP = 1.0
"""Changes of speed and course are taken over this, s."""

SHORTEST, LONGEST = 0.5, 1.6
"""Steps between the fixes next to the whole seconds that are taken for one, s."""

ROLLING = 1.0
"""Slower than this a vehicle may be about to stand or to reverse, m/s."""

KEPT = 1.0 - PIECE / 300.0
KEPT_SPIN = 1.0 - PIECE / 100.0
"""Share of the sums that is left after another piece; a gyro may break on the way."""

APART = 0.4
SURE = 12.0
"""A lag is told when all that are further from it than the first, s, leave so much more: this many times the
logarithm of a likelihood ratio, twice."""

LEAST = 8.0
"""Steps."""

TURNED = 0.15
OUTDONE = 4.0
"""Bends tell when the sum of their squares exceeds the first, rad², and so many times what is the receiver's noise;
so do changes of speed in (m/s²)²."""

SHARPEST = 1.2
"""No car turns further in a step, rad: a course later than the speed is still that of the stand, which is random."""

COURSE_NOISE = 0.06
"""Of the receiver across the travel, as far as it differs from one second to the next, m/s."""


class Products(NamedTuple):
    """Sums of products of what is explained and what explains it, by lag.

    Attributes
    ----------
    among : ndarray, shape (12, k, k)
        Of what explains.
    between : ndarray, shape (12, k)
        Of both.
    square, noise, number : float
        Of what is explained: its square, the receiver's own part of that, how many there are.
    """

    among: Floats
    between: Floats
    square: float
    noise: float
    number: float

    def more(self, Y: Floats, y: Floats, noise: Floats, kept: float = KEPT) -> Products:
        """With another piece.

        Parameters
        ----------
        Y : ndarray, shape (12, n, k)
            What explains, by lag.
        y, noise : ndarray, shape (n,)
            What is explained, and the receiver's noise in it, 1 sigma.
        kept : float
            Share of the sums so far that stays.

        Returns
        -------
        Products
        """
        return Products(
            kept * self.among + np.einsum("lni,lnj->lij", Y, Y),
            kept * self.between + np.einsum("lni,n->li", Y, y),
            kept * self.square + float(y @ y),
            kept * self.noise + float(noise @ noise),
            kept * self.number + y.size,
        )

    def left(self) -> Floats:
        """What the best combination leaves of the square at each lag, shape (12,)."""
        size = np.einsum("lii->li", self.among) + 1e-12
        ridge = np.einsum("li,ij->lij", 1e-9 * size, np.eye(size.shape[1]))
        best = np.linalg.solve(self.among + ridge, self.between[:, :, None])[:, :, 0]
        return np.maximum(self.square - (best * self.between).sum(axis=1), 1e-9 * self.square + 1e-12)


def _nothing(k: int) -> Products:
    return Products(np.zeros((LAGS.size, k, k)), np.zeros((LAGS.size, k)), 0.0, 0.0, 0.0)


class Hearing(NamedTuple):
    """What has been heard so far.

    Attributes
    ----------
    until : float
        Box time, s.
    speed : Products
        Second differences of speed, and those of the integral of specific force: roads and biases drop out.
    course : Products
        Turns of the course, and the integrals of specific force and of 1 over the speed.
    spin : Products
        Turns of the course, and those of the gyro with the time that they took.
    gravity : ndarray, shape (3,)
        Sum of specific force, A-frame.
    """

    until: float = -np.inf
    speed: Products = _nothing(3)
    course: Products = _nothing(4)
    spin: Products = _nothing(4)
    gravity: Floats = np.zeros(3)


def lag_of(products: Products) -> float | None:
    """The lag at which the receiver fits the box best, s.

    Parameters
    ----------
    products : Products
        Of speed or course.

    Returns
    -------
    float or None
        None while another one may be it, or while a course has not turned out of its noise.
    """
    if products.number < LEAST or products.square - products.noise < max(TURNED, OUTDONE * products.noise):
        return None
    left = products.left()
    best = int(np.argmin(left))
    others = np.abs(LAGS - LAGS[best]) > APART
    return float(LAGS[best]) if products.number * np.log(left[others].min() / left[best]) > SURE else None


def listened(hearing: Hearing, record: Record, spin: Record | None, begin: float) -> Hearing:
    """The hearing after a piece of box time; unchanged where it has been heard or something is missing in it.

    Parameters
    ----------
    hearing : Hearing
    record, spin : Record
        Of force and angular rate, from some seconds before the piece to its end.
    begin : float
        Where the piece begins, s.

    Returns
    -------
    Hearing
    """
    grid = begin + np.arange(-STEP, PIECE + 0.5 * STEP, STEP)
    if hearing.until >= grid[-1] or record.fixes.t.size < 2 or record.t.size < 2:
        return hearing
    hearing = hearing._replace(until=float(grid[-1]))
    fixes = _near(record.fixes, grid)
    step = np.diff(fixes.t)
    told = (step > SHORTEST) & (step < LONGEST)
    rolling = told & (np.minimum(fixes.speed[1:], fixes.speed[:-1]) > ROLLING)
    force = _gains(record, fixes.t, record.f)
    if force is None or not rolling.any():
        return hearing
    steady = rolling[1:] & rolling[:-1]
    safe = np.maximum(step, SHORTEST)
    mean, pace = force / safe[:, None], np.diff(fixes.speed) / safe
    hearing = hearing._replace(
        speed=hearing.speed.more(np.diff(mean, axis=1)[:, steady], np.diff(pace)[steady], np.zeros(steady.sum())),
        gravity=KEPT * hearing.gravity + force[0, rolling].sum(axis=0),
    )
    turning = told & (np.minimum(fixes.speed[1:], fixes.speed[:-1]) > FOLLOW_SPEED)
    turning &= np.isfinite(fixes.course[1:]) & np.isfinite(fixes.course[:-1])
    return _followed(hearing, record, spin, fixes, turning) if turning.any() else hearing


def _followed(hearing: Hearing, record: Record, spin: Record | None, fixes: Fixes, turning: Flags) -> Hearing:
    """The same with what the course tells in the steps that are `turning`."""
    turn, step = wrap(np.diff(fixes.course)), np.diff(fixes.t)
    turning = turning & (np.abs(turn) < SHARPEST)
    turn = turn[turning]
    noise = np.sqrt(2.0) * COURSE_NOISE / (0.5 * (fixes.speed[1:] + fixes.speed[:-1]))[turning]
    inverse = 1.0 / np.maximum(np.interp(record.t, record.fixes.t, record.fixes.speed), FOLLOW_SPEED)
    across = _gains(record, fixes.t, np.column_stack([record.f * inverse[:, None], inverse]))
    if across is not None:
        hearing = hearing._replace(course=hearing.course.more(across[:, turning], turn, noise))
    rate = None if spin is None or spin.t.size < 2 else _gains(spin, fixes.t, spin.f)
    if rate is not None:
        timed = np.concatenate([rate, np.broadcast_to(step[:, None], (*rate.shape[:2], 1))], axis=2)
        hearing = hearing._replace(spin=hearing.spin.more(timed[:, turning], turn, noise, KEPT_SPIN))
    return hearing


def _near(fixes: Fixes, grid: Floats) -> Fixes:
    """The fix next to each moment."""
    after = np.clip(np.searchsorted(fixes.t, grid), 1, fixes.t.size - 1)
    nearest = after - (grid - fixes.t[after - 1] < fixes.t[after] - grid)
    return Fixes(*(column[nearest] for column in fixes))


def _gains(record: Record, edges: Floats, values: Floats) -> Floats | None:
    """What tick values add up to between the moments, at every lag, shape (12, n, k); None over a gap."""
    when = (edges[None, :] - LAGS[:, None]).ravel()
    total = at(record, when, integrate(record, np.column_stack([values, np.ones(record.t.size)])))
    gains = np.diff(total.reshape(LAGS.size, edges.size, -1), axis=1)
    return gains[:, :, :-1] if np.all(np.abs(gains[:, :, -1] - np.diff(edges)) < 0.05) else None


UNPROVED, TRUSTED = "unproved", "trusted"

STILL = 1e-7
"""An axis that scatters by less from step to step is dead, rad."""

PROVED = 10.0
QUIET_FOR = 30.0
"""So many steps prove a gyro by bends and, without any, by its being as quiet as the course."""

SCALE_KNOWN = 0.06
"""Deviation at which the scale is told, as a share of it."""

SCALE = 0.12
FALSE_SCALE = 0.2
"""How far the gyro's turning may be from the course's to be trusted, and must be to be wrong, as a share of it."""

BIASED = 0.06
"""Three times what is expected of a gyro's bias, rad/s: one with more is not used."""

ROUGH = 0.05
"""What a gyro may leave of the course in a step beside the receiver's noise, rad, 1 sigma."""

BENT = 0.03
FAR = 0.4
"""Where the squares of the bends add up to less than the first, rad², a scale is wrong when it is off by the second."""

ALIKE = 0.8
"""Squared correlation with the course under which a gyro has no scale, and turns of its own accord if it turns."""

AS_GOOD = 0.1
"""Lags whose squared correlation falls short of the best by less are as good: the beginning of a bend fits many, each
with its scale.  Of those the one nearest 1 counts."""

UNITS = {"degrees a second": 180.0 / np.pi, "thousandths of a degree a second": 180e3 / np.pi}
UNIT_SHARE = 0.25


def gyro_of(hearing: Hearing) -> str | Reason:
    """What is to be thought of the gyro.

    Parameters
    ----------
    hearing : Hearing

    Returns
    -------
    str or Reason
        `UNPROVED`, `TRUSTED`, or why it is to be left out: ``gyro_dead``, ``gyro_unit``, ``gyro_wrong`` or
        ``gyro_noisy``.
    """
    spin, size = hearing.spin, float(np.linalg.norm(hearing.gravity))
    if spin.number < PROVED or size == 0.0:
        return UNPROVED
    among, between = spin.among, spin.between
    scatter = np.diag(among[0])[:3] - among[0, :3, 3] ** 2 / among[0, 3, 3]
    if scatter.min() < spin.number * STILL**2:
        return reason("gyro_dead")
    down = -hearing.gravity / size
    # The gyro's turning about the vertical as `scale` times the course's and a bias, at every lag.
    time, drift = among[:, 3, 3], between[:, 3]
    bends = spin.square - drift**2 / time
    both = between[:, :3] @ down - (among[:, :3, 3] @ down) * drift / time
    own = np.einsum("i,lij,j->l", down, among[:, :3, :3], down) - (among[:, :3, 3] @ down) ** 2 / time
    bias = float(np.median((among[:, :3, 3] @ down - drift) / time))
    real, usual = bends - spin.noise, abs(bias) < BIASED
    correlation = both**2 / (bends * np.maximum(own, 1e-12))
    lag = int(np.argmax(correlation))
    alike = float(correlation[lag])
    rough = spin.number * ROUGH**2 + 4.0 * spin.noise
    if real[lag] <= OUTDONE * spin.noise:  # too few bends for a scale: held against the course as it is
        if float((own - 2.0 * both + bends).min()) > rough:
            return reason("gyro_noisy")
        return TRUSTED if usual and spin.number > QUIET_FOR else UNPROVED
    left = float(own[lag] * (1.0 - alike))
    if alike < ALIKE:
        return reason("gyro_noisy") if left > rough else UNPROVED
    scales = (both / real)[correlation > alike - AS_GOOD]
    scale = float(scales[np.argmin(np.abs(scales - 1.0))])
    known = left / spin.number < (SCALE_KNOWN * max(abs(scale), 1.0)) ** 2 * real[lag]
    return _of_scale(scale, FALSE_SCALE if real[lag] > BENT else FAR, usual=usual) if known else UNPROVED


def _of_scale(scale: float, false: float, *, usual: bool) -> str | Reason:
    """What is to be thought of a gyro that turns `scale` times as much as the course; `false` is too far from 1."""
    if abs(scale - 1.0) < false:
        return TRUSTED if usual and abs(scale - 1.0) < SCALE else UNPROVED
    for name, many in UNITS.items():
        if abs(abs(scale) / many - 1.0) < UNIT_SHARE:
            return reason("gyro_unit", name)
    return reason("gyro_wrong")


def gyro_since(before: str | Reason, hearing: Hearing) -> str | Reason:
    """What is to be thought of a gyro of which something was thought before.

    One that was wrong stays left out, and one that was trusted is so until it is wrong.

    Parameters
    ----------
    before : str or Reason
        Of `gyro_of`.
    hearing : Hearing

    Returns
    -------
    str or Reason
    """
    now = gyro_of(hearing)
    return before if isinstance(now, str) and before != UNPROVED else now


MISSED = 0.5
"""A filter whose lag is off by more than this begins anew at the right one, s: it would take a minute to get there,
and drop the right mounting on the way."""


def right_lags(hearing: Hearing, lags: tuple[float, float]) -> tuple[float, float]:
    """The lags of speed and course at which filters should stand, s.

    Parameters
    ----------
    hearing : Hearing
    lags : tuple of float
        At which they stand, s.

    Returns
    -------
    tuple of float
        `lags` themselves where they are near, or nothing tells.
    """
    told = (lag_of(hearing.speed), lag_of(hearing.course))
    near = [at if lag is None or abs(lag - at) <= MISSED else lag for lag, at in zip(told, lags, strict=True)]
    return near[0], near[1]
