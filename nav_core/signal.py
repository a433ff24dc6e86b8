"""Anti-alias decimation of the inertial stream to ticks that can be added up in any order.

A box sends its recording in batches, sometimes late and out of order.  Here each sample adds to the
few ticks around it; a tick is therefore a sum, and the ticks of two batches are merged by adding.
What is stored per batch is what the estimators read, and nothing has to be conditioned twice.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d

from nav_core.errors import RangeError, ShapeError
from nav_core.records import Inertial
from nav_core.typing import Flags, Floats, Integers, kernel

TICK_RATE = 10.0
"""Default rate of the ticks, Hz."""

KERNEL_TICKS = 4
"""Full width of the Hann window, in ticks."""

VALID_SHARE = 0.4
"""A tick counts when its weight reaches this share of the heaviest within a second of it."""


@dataclass(frozen=True, slots=True)
class Ticks:
    """Weighted sums of specific force on an absolute grid of box time.

    Attributes
    ----------
    rate : float
        Ticks per second; tick `k` stands at box time ``k / rate``.
    index : ndarray of int64, shape (n,)
        Ticks that got any sample, strictly increasing.
    weight : ndarray, shape (n,)
        Sum of the window's weights.
    moment : ndarray, shape (n, 3)
        Weighted sum of specific force in the A-frame, m/s².
    square : ndarray, shape (n,)
        Weighted sum of its squared magnitude, m²/s⁴.
    """

    rate: float
    index: Integers
    weight: Floats
    moment: Floats
    square: Floats

    def __post_init__(self) -> None:
        n = self.index.size
        for name, shape in (("weight", (n,)), ("moment", (n, 3)), ("square", (n,))):
            if getattr(self, name).shape != shape:
                raise ShapeError(f"ticks.{name}", getattr(self, name).shape, str(shape))

    @property
    def t(self) -> Floats:
        """Box time of the ticks, s, shape (n,)."""
        return self.index / self.rate

    @property
    def f(self) -> Floats:
        """Specific force in the A-frame, m/s², shape (n, 3)."""
        return self.moment / self.weight[:, None]

    @property
    def scatter(self) -> Floats:
        """Root mean square of the samples about their tick, m/s², shape (n,): the vibration level."""
        mean_square = np.einsum("ij,ij->i", self.moment, self.moment) / self.weight**2
        return np.sqrt(np.maximum(self.square / self.weight - mean_square, 0.0))

    @property
    def valid(self) -> Flags:
        """Ticks with enough samples under their window, shape (n,).

        The window reaches over the edge of a gap, so the ticks there lean on one side only.  They
        are told by their weight against the heaviest tick within a second, which also holds when
        the sampling rate changes within a recording.
        """
        if self.index.size == 0:
            return np.zeros(0, dtype=np.bool_)
        heaviest = maximum_filter1d(self.weight, 2 * round(self.rate) + 1, mode="nearest")
        return self.weight >= VALID_SHARE * heaviest

    def to_arrays(self) -> dict[str, Floats | Integers]:
        """Plain arrays for storage; `from_arrays` is the way back."""
        return {
            "rate": np.array(self.rate),
            "index": self.index,
            "weight": self.weight,
            "moment": self.moment,
            "square": self.square,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Floats | Integers]) -> Ticks:
        """Ticks from what `to_arrays` gave.

        Parameters
        ----------
        arrays : Mapping[str, ndarray or Integers]
            By name; shapes as in `Ticks`.

        Returns
        -------
        Ticks
            With the same numbers.
        """
        return cls(
            rate=float(arrays["rate"]),
            index=np.asarray(arrays["index"], dtype=np.int64),
            weight=np.asarray(arrays["weight"], dtype=np.float64),
            moment=np.asarray(arrays["moment"], dtype=np.float64),
            square=np.asarray(arrays["square"], dtype=np.float64),
        )


@kernel
def _places(t: Floats, at: Floats, out: Integers) -> None:
    """Set `out` to ``np.searchsorted(t, at)`` of an `at` that does not decrease either: one walk along both."""
    j = 0
    for i in range(at.size):
        while j < t.size and t[j] < at[i]:
            j += 1
        out[i] = j


def first_not_before(t: Floats, at: Floats) -> Integers:
    """Index of the first sample that is not before each moment; for many moments faster than looking each one up.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Not decreasing, s.
    at : ndarray, shape (k,)
        Not decreasing, s.

    Returns
    -------
    ndarray of int, shape (k,)
        n where all samples are before.
    """
    out = np.empty(at.size, dtype=np.int64)
    _places(np.ascontiguousarray(t), np.ascontiguousarray(at), out)
    return out


def runs(flags: Flags) -> list[tuple[int, int]]:
    """Unbroken runs of true flags.

    Parameters
    ----------
    flags : ndarray of bool, shape (n,)

    Returns
    -------
    list of tuple of int
        Index of the first of each run, and of the first after it.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def attenuation(frequency: Floats, rate: float = TICK_RATE) -> Floats:
    """Amplitude that the decimation leaves of a vibration.

    Parameters
    ----------
    frequency : ndarray, shape (...)
        Hz.
    rate : float
        Of the ticks, Hz.

    Returns
    -------
    ndarray
        ``sinc(x) / (1 - x²)`` with ``x = frequency * W``, W the window's width in s: the transform
        of a Hann window.  At 10 ticks per second W is 0.4 s: the first zero lies at 5 Hz, zeros
        follow every 2.5 Hz and so at every multiple of the tick rate, where vibration would fold
        onto standstill; between 8 and 25 Hz no more than 0.9 % is left; 1 Hz keeps 90 %.
    """
    x = np.asarray(frequency, dtype=np.float64) * KERNEL_TICKS / rate
    denominator = 1.0 - x**2
    near_one = np.abs(denominator) < 1e-9
    return np.where(near_one, 0.5, np.sinc(x) / np.where(near_one, 1.0, denominator))


@kernel
def _accumulate(t: Floats, f: Floats, rate: float, first: int, sums: Floats) -> None:
    """Add the samples' shares of weight, force and its square to `sums`, (ticks, 5), of which the first is `first`.

    By the addition theorem the window is ``0.5 + 0.5 (c cos(turn offset) + s sin(turn offset))`` with one
    sine and cosine per sample: between two ticks it is enough to sum 1, c and s times each quantity.
    """
    half = KERNEL_TICKS // 2
    turn = 2.0 * np.pi / KERNEL_TICKS
    n, i = t.size, 0
    while i < n:
        base = np.floor(t[i] * rate)
        w1 = wc = ws = x1 = xc = xs = y1 = yc = ys = z1 = zc = zs = q1 = qc = qs = 0.0
        while i < n:
            u = t[i] * rate - base
            if u < 0.0 or u >= 1.0:
                break
            c, s = np.cos(turn * u), np.sin(turn * u)
            x, y, z = f[i, 0], f[i, 1], f[i, 2]
            q = x * x + y * y + z * z
            w1, wc, ws = w1 + 1.0, wc + c, ws + s
            x1, xc, xs = x1 + x, xc + c * x, xs + s * x
            y1, yc, ys = y1 + y, yc + c * y, ys + s * y
            z1, zc, zs = z1 + z, zc + c * z, zs + s * z
            q1, qc, qs = q1 + q, qc + c * q, qs + s * q
            i += 1
        for offset in range(1 - half, half + 1):
            a, b = 0.5 * np.cos(turn * offset), 0.5 * np.sin(turn * offset)
            k = int(base) + offset - first
            sums[k, 0] += 0.5 * w1 + a * wc + b * ws
            sums[k, 1] += 0.5 * x1 + a * xc + b * xs
            sums[k, 2] += 0.5 * y1 + a * yc + b * ys
            sums[k, 3] += 0.5 * z1 + a * zc + b * zs
            sums[k, 4] += 0.5 * q1 + a * qc + b * qs


def accumulate_reference(t: Floats, f: Floats, rate: float) -> Ticks:
    """What `decimate` computes, in plain array code.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Box clock, s.
    f : ndarray, shape (n, 3)
        Specific force, m/s².
    rate : float
        Of the ticks, Hz.

    Returns
    -------
    Ticks
        Only those with weight.
    """
    half = KERNEL_TICKS // 2
    base = np.floor(t * rate).astype(np.int64)
    offsets = np.arange(1 - half, half + 1)
    k = base[:, None] + offsets
    w = 0.5 + 0.5 * np.cos(2.0 * np.pi / KERNEL_TICKS * (t[:, None] * rate - k))
    index, place = np.unique(k, return_inverse=True)
    place = place.reshape(k.shape)
    columns = np.column_stack([np.ones(t.size), f, np.einsum("ij,ij->i", f, f)])
    sums = np.zeros((index.size, 5))
    for j in range(k.shape[1]):
        np.add.at(sums, place[:, j], w[:, j, None] * columns)
    return _nonempty(rate, index, sums)


def _nonempty(rate: float, index: Integers, sums: Floats) -> Ticks:
    # A tick touched by the zero of the window alone has no weight to divide by.
    keep = sums[:, 0] > 1e-9
    sums = sums[keep]
    return Ticks(rate, index[keep], sums[:, 0].copy(), sums[:, 1:4].copy(), sums[:, 4].copy())


def decimate(inertial: Inertial, rate: float = TICK_RATE) -> Ticks:
    """Low-pass and decimate specific force onto the absolute tick grid.

    Parameters
    ----------
    inertial : Inertial
        Any sampling, regular or not, from about the tick rate upwards.
    rate : float
        Ticks per second, Hz.

    Returns
    -------
    Ticks
        Hann-weighted sums over `KERNEL_TICKS` ticks, see `attenuation`.  The window is symmetric:
        no delay.  A gap leaves ticks out or light, it is never bridged.

    Raises
    ------
    RangeError
        If `rate` is not positive.
    """
    if not rate > 0.0:
        raise RangeError("rate", rate, "> 0")
    half = KERNEL_TICKS // 2
    t = inertial.t
    if t.size == 0:
        return _nonempty(rate, np.zeros(0, dtype=np.int64), np.zeros((0, 5)))
    pieces = np.flatnonzero(np.diff(t) > 60.0) + 1  # a dense grid over a night of silence would be all holes
    parts: list[Ticks] = []
    for piece in np.split(np.arange(t.size), pieces):
        part = slice(piece[0], piece[-1] + 1)
        first = int(np.floor(t[part][0] * rate)) + 1 - half
        count = int(np.floor(t[part][-1] * rate)) + half + 1 - first
        sums = np.zeros((count, 5))
        _accumulate(t[part], inertial.f[part], float(rate), first, sums)
        parts.append(_nonempty(rate, np.arange(first, first + count), sums))
    return parts[0] if len(parts) == 1 else merge(parts)


def merge(parts: Iterable[Ticks]) -> Ticks:
    """Ticks of several pieces of one stream, added up.

    Parameters
    ----------
    parts : iterable of Ticks
        Of one rate, in any order.  At least one.

    Returns
    -------
    Ticks
        Equal, up to rounding, to the decimation of the joined stream.

    Raises
    ------
    RangeError
        If the rates differ.
    ShapeError
        If there are no parts.
    """
    pieces = list(parts)
    if not pieces:
        raise ShapeError("parts", (0,), "at least one")
    rate = pieces[0].rate
    for piece in pieces:
        if piece.rate != rate:
            raise RangeError("rate", piece.rate, f"{rate:g}")
    if len(pieces) == 1:
        return pieces[0]
    index, place = np.unique(np.concatenate([piece.index for piece in pieces]), return_inverse=True)
    values = np.concatenate([np.column_stack([p.weight, p.moment, p.square]) for p in pieces])
    sums = np.empty((index.size, 5))
    for j in range(5):
        sums[:, j] = np.bincount(place, values[:, j], minlength=index.size)
    return _nonempty(rate, index, sums)
