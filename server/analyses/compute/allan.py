"""Allan deviation and noise coefficients of a recording at rest, each axis by itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from nav_core.errors import ConstantError
from nav_core.sensors import NoiseFit, identify
from nav_core.sensors.identification import LEAST_SAMPLES, UNLIKELY
from server.analyses.compute.triads import TRIADS, UNITS, Triad, triads_of
from server.formats.columns import Columns
from server.formats.drive import DriveFileError

_UNIT_OF = {"N": "{}/√Hz", "B": "{}", "K": "{}·√Hz", "Q": "{}·s"}


class Fitted(NamedTuple):
    """The fits of a recording by column, with their units, and the document that tells of them."""

    fits: dict[str, tuple[str, NoiseFit]]
    document: dict[str, Any]


def allan(
    recording: Columns,
    name: str,
    *,
    terms: str = "NBK",
    rate: float | None = None,
    shortest: float = 0.0,
    progress: Callable[[str, float], None],
) -> Fitted:
    """Fit every axis that has samples which change; one that does not is remarked.

    `rate` (Hz) takes the samples as regular whatever their stamps say; `shortest` (s) leaves out the cluster times
    below it; `progress` is told of each column and how far this is, 0..1.
    """
    triads = triads_of(recording, as_stored=rate is not None)
    if not triads:
        raise DriveFileError(f"{name}: none of the columns f*, w*, m* has samples")
    quality: list[str] = []
    fits: dict[str, tuple[str, NoiseFit]] = {}
    for sensor, triad in triads.items():
        regular_rate, part = _regular(triad, rate, quality)
        for axis, column_name in enumerate(TRIADS[sensor]):
            progress(f"{column_name}: {len(part)} samples", len(fits) / (3 * len(triads)))
            column = np.ascontiguousarray(part[:, axis])
            try:
                fit = identify(column, regular_rate, terms=terms, shortest=shortest)
            except ConstantError as error:
                quality.append(f"{column_name} repeats itself: all means over {error.factor} samples are alike")
                continue
            if fit.likelihood < UNLIKELY:
                quality.append(
                    f"{column_name}: the curve is no sum of these terms (probability {fit.likelihood:.1g}): filtered "
                    "or disturbed samples? --shortest leaves out the cluster times that a filter smooths"
                )
            fits[column_name] = (UNITS[sensor], fit)
    if not fits:
        raise DriveFileError(f"{name}: {'; '.join(quality)}")
    document = {
        "file": name,
        "terms": terms,
        "columns": {name: _column_json(unit, fit, terms) for name, (unit, fit) in fits.items()},
        "quality": quality,
    }
    return Fitted(fits, document)


def _regular(triad: Triad, rate: float | None, quality: list[str]) -> tuple[float, np.ndarray[Any, Any]]:
    """Rate and samples to be taken as regular: all of them, or the longest stretch without a gap."""
    if rate is not None:
        quality.append(f"{triad.sensor}: taken as regular at {rate:g} Hz, whatever the stamps say")
        return rate, triad.values
    quality += triad.remarks
    if triad.t.size < 3:
        raise DriveFileError(f"{triad.sensor}: {triad.t.size} samples are too few")
    steps = np.diff(triad.t)
    breaks = np.flatnonzero(steps > 5.0 * np.median(steps)) + 1
    pieces = np.split(np.arange(triad.t.size), breaks)
    longest = max(pieces, key=len)
    if len(pieces) > 1:
        quality.append(
            f"{triad.sensor}: {len(pieces) - 1} gaps; the longest stretch between them is used, {longest.size} of "
            f"{triad.t.size} samples. If only the stamps are irregular, give --rate"
        )
    t = triad.t[longest]
    if len(pieces) > 1 and t.size < LEAST_SAMPLES:
        raise DriveFileError(
            f"{triad.sensor}: no more than {t.size} of {triad.t.size} samples without a gap, {LEAST_SAMPLES} needed; "
            "if only the stamps are irregular, give --rate"
        )
    return float((t.size - 1) / (t[-1] - t[0])), triad.values[longest]


def _column_json(unit: str, fit: NoiseFit, terms: str) -> dict[str, Any]:
    low, high = fit.band()
    coefficients = {
        name: {
            "value": value if name in terms else None,
            "interval95": [bottom, top] if name in terms else None,
            "unit": _UNIT_OF[name].format(unit),
        }
        for name, value, bottom, top in zip(fit.coefficients._fields, fit.coefficients, fit.low, fit.high, strict=True)
    }
    return {
        "unit": unit,
        "samples": fit.curve.samples,
        "rate_hz": fit.curve.rate,
        **coefficients,
        "tau_s": fit.curve.tau.tolist(),
        "sigma": fit.curve.sigma.tolist(),
        "sigma_low95": low.tolist(),
        "sigma_high95": high.tolist(),
        "sigma_model": fit.coefficients.allan_deviation(fit.curve.tau).tolist(),
        "freedom": fit.freedom.tolist(),
        "likelihood": fit.likelihood,
    }
