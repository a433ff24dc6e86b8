"""Time base: order, gaps, jitter, stale fixes, the box clock against UTC, and lags between series.

A box stamps everything with its own clock.  These functions say how good the stamps are, and mend
what can be mended without inventing data.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from nav_core.errors import ShapeError, TooLittleDataError
from nav_core.records import Gnss, Remark
from nav_core.typing import Flags, Floats, Integers


class Ordered(NamedTuple):
    """Rows in order of time, and what had to be done for it."""

    keep: Integers
    """Indices of the rows to keep, in order of time."""
    remarks: tuple[Remark, ...]


def in_order(t: Floats) -> Ordered:
    """Bring rows into strict order of time.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Stamps, s.

    Returns
    -------
    Ordered
        A stable order; of rows with the same stamp the first is kept.  Remarks
        ``rows_out_of_order`` and ``rows_repeated`` count what was found.
    """
    if t.size == 0:
        return Ordered(np.zeros(0, dtype=np.int64), ())
    order = np.argsort(t, kind="stable")
    fresh = np.concatenate([[True], np.diff(t[order]) > 0.0])
    remarks: list[Remark] = []
    late = int(np.count_nonzero(t < np.maximum.accumulate(t)))
    if late:
        remarks.append(Remark("rows_out_of_order", f"{late} of {t.size} rows came out of order and were sorted."))
    repeated = int(np.count_nonzero(~fresh))
    if repeated:
        remarks.append(Remark("rows_repeated", f"{repeated} of {t.size} rows repeated a time and were dropped."))
    return Ordered(order[fresh].astype(np.int64), tuple(remarks))


class Gap(NamedTuple):
    """A hole in a series."""

    begin: float
    end: float
    """Last stamp before and first after it, s."""


def gaps(t: Floats, longest: float | None = None) -> tuple[Gap, ...]:
    """Holes in a series of stamps.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Increasing, s.
    longest : float, optional
        Longest step that is no gap, s; five times the median step by default.

    Returns
    -------
    tuple of Gap
    """
    if t.size < 2:
        return ()
    steps = np.diff(t)
    limit = 5.0 * float(np.median(steps)) if longest is None else longest
    return tuple(Gap(float(t[i]), float(t[i + 1])) for i in np.flatnonzero(steps > limit))


@dataclass(frozen=True, slots=True)
class Jitter:
    """How regular a series is.

    Attributes
    ----------
    rate : float
        One over the median step, Hz.
    spread : float
        Half the width that holds the middle 68 % of the steps, s.
    shortest, longest : float
        Extreme steps, s.
    """

    rate: float
    spread: float
    shortest: float
    longest: float


def jitter(t: Floats) -> Jitter:
    """Regularity of a series of stamps.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Increasing, s; at least two.

    Returns
    -------
    Jitter
        Hz and s.

    Raises
    ------
    TooLittleDataError
        With fewer than two stamps.
    """
    if t.size < 2:
        raise TooLittleDataError("t", t.size, 2)
    steps = np.diff(t)
    low, middle, high = np.percentile(steps, [16.0, 50.0, 84.0])
    return Jitter(float(1.0 / middle), float(0.5 * (high - low)), float(steps.min()), float(steps.max()))


STANDING = 0.5
"""Up to this speed a vehicle may stand, and a receiver well repeat itself, m/s."""


def stale(gnss: Gnss) -> Flags:
    """Fixes that only repeat the one before.

    Parameters
    ----------
    gnss : Gnss

    Returns
    -------
    ndarray of bool, shape (n,)
        True where the receiver's own time did not advance, or, where it is unknown or mostly stands
        still while the rest changes, where nothing at all changed although the vehicle moves.  A
        parked vehicle may well repeat itself.
    """
    repeat = np.zeros(gnss.t.size, dtype=np.bool_)
    if gnss.t.size < 2:
        return repeat
    same = np.ones(gnss.t.size - 1, dtype=np.bool_)
    for column in (gnss.lat, gnss.lon, gnss.speed, gnss.course):
        same &= (np.diff(column) == 0.0) | (np.isnan(column[1:]) & np.isnan(column[:-1]))
    same &= gnss.speed[1:] > STANDING
    if gnss.utc is not None:
        dated = np.isfinite(gnss.utc[1:]) & np.isfinite(gnss.utc[:-1])
        fresh = dated & ~same & (gnss.speed[1:] > STANDING)
        if np.count_nonzero(np.diff(gnss.utc)[fresh] <= 0.0) > 0.5 * np.count_nonzero(fresh):
            dated[:] = False  # whole seconds at several fixes a second, or a time that is not known yet
        same = np.where(dated, np.diff(gnss.utc) <= 0.0, same)
    repeat[1:] = same & gnss.fix[1:] & gnss.fix[:-1]
    return repeat


@dataclass(frozen=True, slots=True)
class ClockFit:
    """The box clock against UTC: ``utc = utc_ref + (1 + drift) (t - t_ref)``.

    Attributes
    ----------
    t_ref : float
        Box clock in the middle of the data, s.
    utc_ref : float
        Unix time at `t_ref`, s.
    drift : float
        By which share UTC runs faster than the box clock.
    sigma : float
        Of `utc_ref`, s; `drift_sigma` of the drift.
    drift_sigma : float
    scatter : float
        Robust standard deviation of the single fixes, s: mostly the jitter of their arrival.
    """

    t_ref: float
    utc_ref: float
    drift: float
    sigma: float
    drift_sigma: float
    scatter: float

    def utc(self, t: Floats) -> Floats:
        """Unix time of box times, s.

        Parameters
        ----------
        t : ndarray, shape (n,)
            Box clock, s.

        Returns
        -------
        ndarray, shape (n,)
            Unix time, s.
        """
        return self.utc_ref + (1.0 + self.drift) * (t - self.t_ref)


_DRIFT_PRIOR = 5e-4
"""Worst quartz, share: what a short recording cannot tell is taken from here."""


def fit_clock(t: Floats, utc: Floats) -> ClockFit:
    """Robust line through (box time, UTC) of the fixes.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Box clock, s.
    utc : ndarray, shape (n,)
        Unix time of the fix, s; NaN where unknown.

    Returns
    -------
    ClockFit
        By least squares with Huber weights, drift held by a prior of 5e-4.

    Raises
    ------
    ShapeError
        If the lengths differ.
    TooLittleDataError
        Without a single dated fix.

    Notes
    -----
    A fix describes a moment before its arrival; the receiver's lag stays in `utc_ref`.
    """
    if t.shape != utc.shape:
        raise ShapeError("utc", utc.shape, str(t.shape))
    dated = np.isfinite(utc)
    if not dated.any():
        raise TooLittleDataError("utc", 0, 1)
    t, utc = t[dated], utc[dated]
    t_ref, base = float(np.median(t)), float(np.median(utc - t))
    x, y = t - t_ref, (utc - t) - base
    line = _weighted_line(x, y, np.ones(t.size))
    for _ in range(12):
        weight = np.minimum(1.0, 1.5 * line.scatter / np.maximum(np.abs(line.residual), 1e-12))
        line = _weighted_line(x, y, weight)
    return ClockFit(
        t_ref=t_ref,
        utc_ref=base + t_ref + line.offset,
        drift=line.drift,
        sigma=line.sigma,
        drift_sigma=line.drift_sigma,
        scatter=line.scatter,
    )


def fit_pulses(t: Floats, coarse: ClockFit, *, lag: float = 0.0, longest_error: float = 0.4) -> ClockFit:
    """Clock by the receiver's pulse per second, which has no lag (000 §§7.1.1, 9).

    Parameters
    ----------
    t : ndarray, shape (n,)
        Box clock at the pulses, s; some may be missing.
    coarse : ClockFit
        Of the fixes (`fit_clock`): says which second each pulse begins.
    lag : float
        Of the fixes, s, as far as it is known (`MountingEstimate.speed_lag`): to half a second, or the seconds are
        counted wrong.
    longest_error : float
        s from a whole second beyond which a pulse could belong to either and is left out.

    Returns
    -------
    ClockFit
        The difference of its `utc` and that of `coarse` is the lag of the fixes.

    Raises
    ------
    TooLittleDataError
        Without a pulse that can be told.
    """
    said = coarse.utc(t) + lag
    second = np.round(said)
    return fit_clock(t, np.where(np.abs(said - second) <= longest_error, second, np.nan))


class _Line(NamedTuple):
    residual: Floats
    offset: float
    drift: float
    scatter: float
    sigma: float
    drift_sigma: float


def _weighted_line(x: Floats, y: Floats, weight: Floats) -> _Line:
    A = np.array([[weight.sum(), weight @ x], [weight @ x, weight @ x**2]])
    b = np.array([weight @ y, weight @ (x * y)])
    first = np.linalg.lstsq(A, b, rcond=None)[0]
    # Stamps of a millisecond's resolution are no better than that, however well they agree.
    scatter = max(1.4826 * float(np.median(np.abs(y - first[0] - first[1] * x))), 3e-4)
    covariance = np.linalg.inv(A / scatter**2 + np.diag([0.0, _DRIFT_PRIOR**-2]))
    offset, drift = covariance @ b / scatter**2
    sigma, drift_sigma = np.sqrt(np.diag(covariance))
    return _Line(
        residual=y - offset - drift * x,
        offset=float(offset),
        drift=float(drift),
        scatter=scatter,
        sigma=float(sigma),
        drift_sigma=float(drift_sigma),
    )


def lag_between(t: Floats, late: Floats, t_reference: Floats, reference: Floats, lags: Floats) -> tuple[float, Floats]:
    """Lag at which a late series follows a reference best.

    Parameters
    ----------
    t, late : ndarray, shape (n,)
        Stamps, s, and the late series.
    t_reference, reference : ndarray, shape (m,)
        Stamps, s, and the series it follows, up to a factor and an offset.
    lags : ndarray, shape (k,)
        Increasing, evenly spaced lags to try, s.

    Returns
    -------
    lag : float
        Between the grid's points by a parabola through the three best residuals, s.
    residual : ndarray, shape (k,)
        Share of the late series' variance that is left at each lag.

    Raises
    ------
    TooLittleDataError
        With fewer than three lags or samples.
    """
    if lags.size < 3:
        raise TooLittleDataError("lags", lags.size, 3)
    if t.size < 3 or t_reference.size < 3:
        raise TooLittleDataError("samples", min(t.size, t_reference.size), 3)
    # The same samples at every lag, so that the residuals compare.
    inside = (t - lags[-1] >= t_reference[0]) & (t - lags[0] <= t_reference[-1])
    if np.count_nonzero(inside) < 3:
        raise TooLittleDataError("samples", int(np.count_nonzero(inside)), 3)
    y = late[inside] - late[inside].mean()
    shifted = np.stack([np.interp(t[inside] - lag, t_reference, reference) for lag in lags])
    X = shifted - shifted.mean(axis=1, keepdims=True)
    total = float(y @ y)
    explained = (X @ y) ** 2 / np.maximum(np.einsum("ij,ij->i", X, X), 1e-30)
    residual = 1.0 - explained / max(total, 1e-30)
    best = int(np.clip(np.argmin(residual), 1, lags.size - 2))
    left, middle, right = residual[best - 1 : best + 2]
    curvature = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / curvature if curvature > 0.0 else 0.0
    return float(lags[best] + np.clip(shift, -1.0, 1.0) * (lags[1] - lags[0])), residual
