"""Gravity and bias before a moment, without fixes: told apart from braking and bends by what is upright.

Braking looks like a slope.  But a box whose mounting is known stands upright but for the road's slope, and gravity
alone is not larger than gravity.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.earth import STANDARD_GRAVITY
from nav_core.events.trigger import Stream
from nav_core.typing import Floats

LOOK_BACK = 20.0
"""So far back gravity and bias are looked for, s."""

PIECE = 0.5
"""Vibration averages out over so long, s."""

SHORT = 0.1
"""Pieces of a recording that holds little besides a blow, s."""

OWN = 0.3
"""1 sigma of how much slope and bias differ from their median of the seconds before, m/s²."""

SLOPE = 0.4
"""1 sigma of slope and bias along each horizontal axis of a vehicle, m/s²."""

PLAIN = 0.4
"""The force of a vehicle that neither brakes nor turns is this close to gravity, m/s²."""


class Gravity(NamedTuple):
    """Specific force of gravity and bias, m/s², (3,); 1 sigma of each horizontal one; time it is taken from, s."""

    f: Floats
    sigma: float
    span: float


def pieces(t: Floats, f: Floats, length: float = PIECE) -> Floats:
    """Means of the force over half seconds, shape (k, 3); a recording shorter than that is one piece.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Box clock, s, increasing.
    f : ndarray, shape (n, 3)
        Specific force, any axes, m/s².
    length : float
        Of a piece, s.

    Returns
    -------
    ndarray, shape (k, 3)
        m/s²; pieces with less than half the samples of the fullest are left out.
    """
    if t.size == 0:
        return np.zeros((0, 3))
    edges = np.flatnonzero(np.diff(np.floor((t - t[-1] - 1e-9) / length), prepend=-np.inf))
    count = np.diff(np.append(edges, t.size))
    means: Floats = np.add.reduceat(f, edges, axis=0) / count[:, None]
    return means[count >= 0.5 * count.max()]


def is_plain(f: Floats) -> bool:
    """Whether a mean force (3,) is what gravity alone would be.

    Parameters
    ----------
    f : ndarray, shape (3,)
        Specific force, any axes, m/s².

    Returns
    -------
    bool
        Whether its size is within `PLAIN` of standard gravity.
    """
    return bool(abs(float(np.linalg.norm(f)) - STANDARD_GRAVITY) < PLAIN)


def usual_force(t: Floats, f: Floats, lengths: tuple[float, ...] = (PIECE,)) -> Floats:
    """Median force of the half seconds that show gravity alone, else of all samples.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Box clock, s, increasing.
    f : ndarray, shape (n, 3)
        Specific force, any axes, m/s²; at least one sample.
    lengths : tuple of float
        Of the pieces to look at, s: where none of the first length shows gravity alone, those of the next.

    Returns
    -------
    ndarray, shape (3,)
        In the axes of `f`, m/s².
    """
    for length in lengths:
        means = pieces(t, f, length)
        plain = means[np.abs(np.linalg.norm(means, axis=1) - STANDARD_GRAVITY) < PLAIN]
        if plain.size:
            break
    else:
        plain = f
    usual: Floats = np.median(plain, axis=0)
    return usual


def gravity_before(stream: Stream, t: float, tilt: float | None = None) -> Gravity | None:
    """Gravity and bias from the seconds before a moment.

    Parameters
    ----------
    stream : Stream
    t : float
        Box clock, s.
    tilt : float, optional
        1 sigma of how upright the stream's axes are, rad; None where they are not known to be.

    Returns
    -------
    Gravity or None
        None without a sample.
    """
    first, last = np.searchsorted(stream.t, [t - LOOK_BACK, t])
    if last == first:
        return None
    use = first + np.flatnonzero(stream.calm[first:last])
    if use.size == 0 or stream.t[use[-1]] - stream.t[use[0]] < PIECE:  # a recording that begins just before a blow
        use = np.arange(first, last)
    means = pieces(stream.t[use], stream.f[use])
    f: Floats = np.median(means, axis=0)
    span = min(float(stream.t[use[-1]] - stream.t[use[0]]), PIECE * means.shape[0])
    if tilt is None:
        # Braking by `a` makes the force larger than gravity.
        larger = max(float(np.linalg.norm(f)) - PLAIN, STANDARD_GRAVITY)
        sigma = float(np.hypot(OWN, np.sqrt(larger**2 - STANDARD_GRAVITY**2)))
        return Gravity(f, sigma, span)
    # More than a slope is driving.
    sigma = float(np.hypot(OWN, max(float(np.hypot(f[0], f[1])) - 2.0 * SLOPE, 0.0)))
    upright = float(np.hypot(SLOPE, STANDARD_GRAVITY * tilt))
    share = upright**2 / (upright**2 + sigma**2)
    return Gravity(np.array([share * f[0], share * f[1], f[2]]), float(np.sqrt(share)) * sigma, span)


def lean_before(stream: Stream, t: float) -> float | None:
    """How far gravity lies off V's down axis in the seconds before a moment, rad.

    Parameters
    ----------
    stream : Stream
        V axes.
    t : float
        Box clock, s.

    Returns
    -------
    float or None
        0 to pi; None of less than a second that shows gravity alone.
    """
    first, last = np.searchsorted(stream.t, [t - LOOK_BACK, t - PIECE])
    means = pieces(stream.t[first:last], stream.f[first:last])
    plain = means[np.abs(np.linalg.norm(means, axis=1) - STANDARD_GRAVITY) < PLAIN]
    if plain.shape[0] * PIECE < 1.0:
        return None
    down: Floats = np.median(plain, axis=0)
    return float(np.arccos(np.clip(-down[2] / max(float(np.linalg.norm(down)), 1e-9), -1.0, 1.0)))
