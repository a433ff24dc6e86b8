"""Clipped samples: found, and the impulse they hide estimated with its spread.

Two things are known of a clipped blow.  The axes that did not clip go on measuring: a force that keeps its direction is
told whole by any of them.  And the flanks of the pulse say how it went in between: a beta-shaped pulse
``A x^p (1-x)^q``, whose exponents are free within a prior, plus a smooth departure from it that grows with the pulse
(kriging with a parametric mean).  Half-sines, haversines and triangles are near special cases; none is built in.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.crash.curve import curve_through
from nav_core.earth import STANDARD_GRAVITY
from nav_core.typing import Flags, Floats

RANGES = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 11.0, 12.0, 15.0, 16.0, 18.0, 20.0, 24.0, 25.0, 30.0, 32.0, 50.0, 100.0)
"""Measuring ranges of accelerometers as sold, g: one sample exactly at such a value is taken as clipped."""

FLAT = 1e-3
"""Samples this close to the largest are at the same value, share of it."""

RUN = 3
"""So many in a row at one value are looked at, wherever that is: a smooth peak may be so flat, sampled fast enough."""

NEAR = 9.0 * FLAT
ROUND = 2.0
"""A smooth peak is within `NEAR` of its top three times as long as within `FLAT`, being a parabola there whatever the
rate; a rail is met at a slope.  Less than so many times as long is a rail."""

ONE_STEP = 0.02
"""By so much of the larger the smaller rail may lie lower: one step of eight bits is 1 in 128."""

DIRECTION = 0.06
"""How far, at the least, the direction of a force strays within a pulse, rad, 1 sigma."""

NOISE = 1.0
"""Of a sample in a blow, vibration included, m/s²."""

LEAST = 0.08
"""Least 1 sigma of a missing impulse, share of it."""

SHAPE = 0.35
"""The same of that part which only the shape of the flanks tells: crashes have plateaus and second peaks."""


class Saturation(NamedTuple):
    """Which samples are at full scale, (n, 3), and where that is, m/s²; None when no sample shows it."""

    flags: Flags
    full_scale: float | None


def saturated(f_a: Floats, known: float | None = None) -> Saturation:
    """Samples at full scale, in the sensor's own axes.

    Parameters
    ----------
    f_a : ndarray, shape (n, 3)
        m/s².
    known : float, optional
        Full scale where the recording has shown it elsewhere, m/s².

    Returns
    -------
    Saturation
        Which samples, shape (n, 3), and at what, m/s².

    Notes
    -----
    A calibration that mixes the axes bends the flat top; then nothing is found, and nothing is claimed.
    """
    top = max(float(f_a.max(initial=0.0)), -float(f_a.min(initial=0.0)))
    nothing = Saturation(np.zeros(f_a.shape, dtype=np.bool_), None)
    if top < 1.9 * STANDARD_GRAVITY:
        return nothing
    size = np.abs(f_a)
    at_top = size >= (1.0 - FLAT) * top
    in_g = top / STANDARD_GRAVITY
    sold = min(abs(in_g - each) / each for each in RANGES) < FLAT
    expected = known is not None and top >= (1.0 - FLAT) * known
    flat, near = _longest_run(at_top, size >= (1.0 - NEAR) * top)
    rail = near < ROUND * flat if flat >= RUN else sold
    return Saturation(at_top | _lower_rail(f_a, top), top) if rail or expected else nothing


def _lower_rail(f_a: Floats, top: float) -> Flags:
    """Samples at the rail of the other sign where it lies a little lower: two's complement reaches -128 and 127."""
    found = np.zeros(f_a.shape, dtype=np.bool_)
    for side in (f_a, -f_a):
        peak = float(side.max(initial=0.0))
        if (1.0 - ONE_STEP) * top <= peak < (1.0 - FLAT) * top:
            at_peak = side >= (1.0 - FLAT) * peak
            flat, near = _longest_run(at_peak, side >= (1.0 - NEAR) * peak)
            if flat >= RUN and near < ROUND * flat:
                found |= at_peak
    return found


def _longest_run(flags: Flags, wider: Flags) -> tuple[int, int]:
    """Length of the longest run of flags in a column, and of the run of wider flags that it lies in, samples."""
    longest = around = 0
    for column, outer in zip(flags.T, wider.T, strict=True):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], column, [False]]).astype(np.int8)))
        lengths = edges[1::2] - edges[::2]
        if lengths.max(initial=0) > longest:
            k = int(np.argmax(lengths))
            longest, begin = int(lengths[k]), int(edges[2 * k])
            outside = np.concatenate([[-1], np.flatnonzero(~outer), [outer.size]])
            j = int(np.searchsorted(outside, begin))
            around = int(outside[j] - outside[j - 1]) - 1
    return longest, around


class Missing(NamedTuple):
    """What clipping hides.

    Attributes
    ----------
    a : ndarray, shape (n, 3)
        Acceleration with the estimate in place of what was clipped, m/s².
    spread : float
        1 sigma of the logarithm of the missing impulse; 0 when nothing is missing.
    misfit : float
        How far the flanks stray from the fit, against what was allowed (1: as allowed).
    stray : float
        1 sigma of the direction of what is missing, rad.
    bent : float
        How far the direction of the samples that did not clip strays from one, rms, rad.
    """

    a: Floats
    spread: float
    misfit: float
    stray: float = 0.0
    bent: float = 0.0


def restore(t: Floats, a: Floats, H: Floats, clipped: Flags, unsure: float = 0.0) -> Missing:
    """Estimate the acceleration behind clipped samples.

    Parameters
    ----------
    t : ndarray, shape (n,)
        s.
    a : ndarray, shape (n, 3)
        Acceleration as recorded, V axes at time zero, less what is not of the blow, m/s².
    H : ndarray, shape (n, 3, 3)
        The sensor's axes from those of `a`, each sample.
    clipped : ndarray of bool, shape (n, 3)
        By sensor axis.
    unsure : float
        1 sigma of what was taken off `a`, m/s².

    Returns
    -------
    Missing
    """
    y = np.einsum("nij,nj->ni", H, a)
    u, s, variance, bent = _one_direction(y, H, clipped, unsure)
    stray = max(DIRECTION, bent)
    along = np.einsum("nij,j->ni", H, u)
    sign = np.sign(y)
    # A clipped axis says that the force along u is at least this.
    reach = np.where(clipped & (sign * along > 0.15), np.abs(y) / np.maximum(sign * along, 0.15), 0.0)
    bound = reach.max(axis=1)
    any_clipped = clipped.any(axis=1)
    told = np.isfinite(s) & (~any_clipped | (variance < (0.3 * np.maximum(s, bound)) ** 2))
    curve = curve_through(t, np.where(told, s, np.nan), variance, bound)
    full = np.where(any_clipped, np.maximum(curve.expected, bound), 0.0)
    filled = y.copy()
    estimate = full[:, None] * along
    beyond = clipped & (np.abs(estimate) > np.abs(y)) & (np.sign(estimate) == sign)
    filled[beyond] = estimate[beyond]
    added = np.einsum("nji,nj->ni", H, filled - y)
    weights = np.where(any_clipped, np.gradient(t), 0.0)
    along_u = weights * (added @ u)
    impulse = float(along_u.sum())
    if impulse <= 0.0:
        return Missing(a, 0.0, curve.misfit, 0.0, bent)
    # What is missing along u, sample by sample, and how much of the curve's spread falls on it.
    share = np.clip((added @ u) / np.maximum(full, 1e-9), 0.0, 1.0)
    guessed = float(along_u[~told].sum())
    # An axis that hardly feels the force, where no other is left to tell, makes as much larger what is not of it.
    seen = np.where(clipped, 0.0, along**2).sum(axis=1)
    off = unsure * float((weights / np.sqrt(np.clip(seen, 0.01, 1.0)))[told].sum() + weights[~told].sum())
    parts = [curve.sigma(weights * share), stray * impulse, LEAST * impulse, SHAPE * guessed, off]
    return Missing(
        a + added, float(np.sqrt(np.log1p((np.linalg.norm(parts) / impulse) ** 2))), curve.misfit, stray, bent
    )


def _one_direction(y: Floats, H: Floats, clipped: Flags, unsure: float) -> tuple[Floats, Floats, Floats, float]:
    """The direction the force keeps, its size at each sample with variance, and how far it strays, rms, rad.

    Alternating least squares over the axes that did not clip.  The size is NaN where none tells it.
    """
    free = ~clipped
    whole = free.all(axis=1)
    strong = np.linalg.norm(y, axis=1) > 0.3 * np.linalg.norm(y, axis=1).max(initial=0.0)
    start = whole & strong if np.any(whole & strong) else strong
    back = np.einsum("nji,nj->ni", H[start], y[start])
    u = np.linalg.svd(back, full_matrices=False)[2][0]
    u = u if float((back @ u).sum()) > 0.0 else -u
    s = np.zeros(y.shape[0])
    seen = np.zeros(y.shape[0])
    for _ in range(12):
        along = np.einsum("nij,j->ni", H, u)
        seen = np.where(free, along**2, 0.0).sum(axis=1)
        s = np.where(free, along * y, 0.0).sum(axis=1) / np.maximum(seen, 1e-6)
        weight = np.where(free, 1.0 / (NOISE**2 + (DIRECTION * np.maximum(s, 0.0)[:, None]) ** 2), 0.0)
        weight *= (seen > 0.02)[:, None]
        rows = H * s[:, None, None]
        N = np.einsum("ni,nij,nik->jk", weight, rows, rows) + 1e-9 * np.eye(3)
        u = np.linalg.solve(N, np.einsum("ni,nij,ni->j", weight, rows, y))
        u /= np.linalg.norm(u)
    along = np.einsum("nij,j->ni", H, u)
    off = np.where(free, y - s[:, None] * along, 0.0)
    loud = whole & (s > 0.3 * s.max(initial=1e-9))
    ratio = np.sqrt(np.einsum("ni,ni->n", off[loud], off[loud]) / 2.0) / np.maximum(s[loud], 1e-9)
    bent = float(np.sqrt(np.mean(ratio**2))) if loud.any() else 3.0 * DIRECTION
    stray = max(DIRECTION, bent)
    variance = (NOISE**2 + unsure**2 + np.where(whole, 0.0, (stray * np.maximum(s, 0.0)) ** 2)) / np.maximum(seen, 1e-6)
    return u, np.where(seen > 0.01, s, np.nan), variance, bent
