"""Telling rest from motion, and what can be read off at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.errors import OrderError, RangeError, ShapeError, TooLittleDataError
from nav_core.sensors.calibration import check_readings
from nav_core.typing import Floats, Integers


def moving_spread(values: Floats, width: int) -> Floats:
    """Standard deviation of three axes together in a window about each sample.

    Parameters
    ----------
    values : ndarray, shape (n, 3)
        Specific force or rate.
    width : int
        Samples in the window, 2..n; near the ends it is cut off.

    Returns
    -------
    ndarray, shape (n,)
        ``sqrt(var_x + var_y + var_z)``: what Tedaldi, Pretto and Menegatti 2014 watch is built of the same variances.

    Raises
    ------
    ShapeError, NotFiniteError, RangeError
    """
    v = check_readings("values", values)
    if not 2 <= width <= len(v):
        raise RangeError("width", float(width), f"2..{len(v)}")
    # Sums over the window from running sums, about the mean so that they keep their digits.
    v = v - v.mean(axis=0)
    first = np.concatenate((np.zeros((1, 3)), np.cumsum(v, axis=0)))
    second = np.concatenate(([0.0], np.cumsum(np.sum(v**2, axis=1))))
    middle = np.arange(len(v))
    low, high = np.maximum(middle - width // 2, 0), np.minimum(middle + width - width // 2, len(v))
    count = (high - low).astype(np.float64)
    mean = (first[high] - first[low]) / count[:, None]
    return np.sqrt(np.maximum((second[high] - second[low]) / count - np.sum(mean**2, axis=1), 0.0))


def static_intervals(
    t: Floats,
    values: Floats,
    *,
    window: float = 1.0,
    shortest: float = 1.0,
    quiet: float | None = None,
    factor: float = 6.0,
) -> Integers:
    """Stretches of a recording in which the sensor is at rest.

    Parameters
    ----------
    t : ndarray, shape (n,)
        s, strictly increasing, evenly spaced but for jitter.
    values : ndarray, shape (n, 3)
        Specific force or rate.
    window : float
        Over which the spread is taken, s.
    shortest : float
        Shorter stretches are dropped, s.
    quiet : float, optional
        Spread at rest: root of the summed variances of the axes.  By default the tenth percentile of the spreads, so
        that a tenth of the recording must be rest; a recording without any gives stretches of its calmest motion.
    factor : float
        Variance over that of rest up to which a sample still is at rest.

    Returns
    -------
    ndarray of int64, shape (k, 2)
        Begin and end (exclusive) of each stretch, in order.

    Raises
    ------
    ShapeError, NotFiniteError, OrderError, RangeError, TooLittleDataError
        Also when the recording is shorter than two windows, or `factor` not above 1.
    """
    t, v = np.asarray(t, dtype=np.float64), check_readings("values", values)
    if t.shape != (len(v),):
        raise ShapeError("t", t.shape, f"({len(v)},)")
    if t.size < 4:
        raise TooLittleDataError("t", int(t.size), 4)
    if not np.all(np.diff(t) > 0.0):
        raise OrderError("t", int(np.argmax(np.diff(t) <= 0.0)) + 1)
    if not factor > 1.0:
        raise RangeError("factor", factor, "> 1")
    period = (t[-1] - t[0]) / (t.size - 1)
    width = max(round(window / period), 2)
    if t.size < 2 * width:
        raise TooLittleDataError("t", int(t.size), 2 * width)
    spread = moving_spread(v, width)
    calm = float(np.quantile(spread, 0.1)) if quiet is None else quiet
    still = np.concatenate(([False], spread <= np.sqrt(factor) * calm, [False]))
    edges = np.flatnonzero(np.diff(still.astype(np.int8)))
    begin, end = edges[::2], edges[1::2]
    keep = t[end - 1] - t[begin] >= shortest
    return np.stack((begin[keep], end[keep]), axis=1).astype(np.int64)


@dataclass(frozen=True, slots=True)
class Means:
    """Means over stretches of a recording.

    Attributes
    ----------
    mean : ndarray, shape (k, 3)
    deviation : ndarray, shape (k, 3)
        Standard deviation of the samples about it.
    count : ndarray of int64, shape (k,)
    """

    mean: Floats
    deviation: Floats
    count: Integers


def interval_means(values: Floats, intervals: Integers) -> Means:
    """Mean reading in each stretch, as poses for a calibration.

    Parameters
    ----------
    values : ndarray, shape (n, 3)
    intervals : ndarray of int64, shape (k, 2)
        From `static_intervals`.

    Returns
    -------
    Means

    Raises
    ------
    ShapeError, NotFiniteError
    """
    v = check_readings("values", values)
    parts = [v[begin:end] for begin, end in intervals]
    return Means(
        np.array([part.mean(axis=0) for part in parts]).reshape(-1, 3),
        np.array([part.std(axis=0) for part in parts]).reshape(-1, 3),
        np.array([len(part) for part in parts], dtype=np.int64),
    )


@dataclass(frozen=True, slots=True)
class TurnOnBias:
    """Bias of a gyro after switching on.

    Attributes
    ----------
    bias : ndarray, shape (3,)
        rad/s, in the axes of the readings.
    covariance : ndarray, shape (3, 3)
        Of the mean, (rad/s)², from the scatter of the readings as white noise.
    count : int
        Samples.
    """

    bias: Floats
    covariance: Floats
    count: int

    def in_body(self, matrix: Floats) -> Floats:
        """The bias through a calibration's ``gain^-1``, rad/s, shape (3,) (002 eq. 6.18).

        Parameters
        ----------
        matrix : ndarray, shape (3, 3)
            ``gain^-1``; further columns are not used.

        Returns
        -------
        ndarray, shape (3,)
            rad/s, body axes.
        """
        return np.asarray(matrix, dtype=np.float64)[:, :3] @ self.bias


def turn_on_bias(t: Floats, w: Floats, *, duration: float = 2.0, limit: float = np.radians(1.0)) -> TurnOnBias:
    """Bias of a gyro as its mean over the first seconds at rest.

    Parameters
    ----------
    t : ndarray, shape (n,)
        s, strictly increasing.
    w : ndarray, shape (n, 3)
        Readings, rad/s.
    duration : float
        s; 2 in 002 section 6.3.1.
    limit : float
        Standard deviation of an axis beyond which this was no rest, rad/s.

    Returns
    -------
    TurnOnBias

    Raises
    ------
    ShapeError, NotFiniteError
    TooLittleDataError
        The recording ends before, or has fewer than 3 samples in it.
    RangeError
        The box moved.
    """
    t, v = np.asarray(t, dtype=np.float64), check_readings("w", w)
    if t.shape != (len(v),):
        raise ShapeError("t", t.shape, f"({len(v)},)")
    used = t - t[0] < duration if t.size else np.zeros(0, dtype=np.bool_)
    count = int(np.count_nonzero(used))
    # All of the samples used: it may have gone on, or ended before its time.
    if count < 3 or (count == t.size and t[-1] - t[0] < duration * (1.0 - 1.5 / count)):
        raise TooLittleDataError(f"samples within {duration:g} s", count, 3 if count < 3 else count + 1)
    part = v[used]
    scatter = part - part.mean(axis=0)
    covariance = scatter.T @ scatter / (count - 1)
    worst = float(np.sqrt(np.max(np.diag(covariance))))
    if worst > limit:
        raise RangeError("scatter of the rates, rad/s,", worst, f"<= {limit:g}: the box moved")
    return TurnOnBias(part.mean(axis=0), covariance / count, count)
