"""`scatola allan`: Allan deviation and noise coefficients of a recording at rest."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from server.cli.progress import progress
from server.cli.triads import TRIADS, UNITS, Triad, read_triads
from server.formats.drive import DriveFileError
from server.settings import set_numba_cache_dir

if TYPE_CHECKING:
    from nav_core.sensors import NoiseFit

_UNIT_OF = {"N": "{}/√Hz", "B": "{}", "K": "{}·√Hz", "Q": "{}·s"}


def allan(args: argparse.Namespace) -> int:
    """`scatola allan`."""
    set_numba_cache_dir()
    from nav_core.sensors import identify
    from nav_core.sensors.identification import UNLIKELY

    triads = read_triads(args.file)
    if not triads:
        raise DriveFileError(f"{args.file}: none of the columns f*, w*, m* has samples")
    quality: list[str] = []
    fits: dict[str, tuple[str, NoiseFit]] = {}
    for sensor, triad in triads.items():
        rate, part = _regular(triad, args.rate, quality)
        for axis, name in enumerate(TRIADS[sensor]):
            progress(f"{name}: {len(part)} samples")
            column = np.ascontiguousarray(part[:, axis])
            fit = identify(column, rate, terms=args.terms.upper(), shortest=args.shortest)
            if fit.likelihood < UNLIKELY:
                quality.append(
                    f"{name}: the curve is no sum of these terms (probability {fit.likelihood:.1g}): filtered or "
                    "disturbed samples? --shortest leaves out the cluster times that a filter smooths"
                )
            fits[name] = (UNITS[sensor], fit)
    progress("")
    result = {
        "file": str(args.file),
        "terms": args.terms.upper(),
        "columns": {name: _column_json(unit, fit, args.terms.upper()) for name, (unit, fit) in fits.items()},
        "quality": quality,
    }
    if args.plot is not None:
        _plot(args.plot, fits)
    print(json.dumps(result) if args.json else _in_words(result))
    return 0


def _regular(triad: Triad, rate: float | None, quality: list[str]) -> tuple[float, np.ndarray[Any, Any]]:
    """Rate and samples to be taken as regular: all of them, or the longest stretch without a gap."""
    if rate is not None:
        quality.append(f"{triad.sensor}: taken as regular at {rate:g} Hz, whatever the stamps say")
        return rate, triad.values
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
    if t.size < 3:
        raise DriveFileError(f"{triad.sensor}: no stretch without a gap; if only the stamps are irregular, give --rate")
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
        "freedom": fit.freedom.tolist(),
        "likelihood": fit.likelihood,
    }


def _in_words(result: dict[str, Any]) -> str:
    lines: list[str] = []
    for name, column in result["columns"].items():
        lines.append(f"{name}: {column['samples']} samples at {column['rate_hz']:.4g} Hz")
        for term in "NBKQ":
            entry = column[term]
            if entry["value"] is not None:
                low, high = entry["interval95"]
                lines.append(f"  {term} = {entry['value']:.4g} {entry['unit']}   95 %: {low:.4g} .. {high:.4g}")
    return "\n".join([*lines, *(f"- {remark}" for remark in result["quality"])])


def _plot(path: Path, fits: dict[str, tuple[str, NoiseFit]]) -> None:
    """One panel a sensor: curve with its band, and the fitted model."""
    from matplotlib.figure import Figure

    sensors = [sensor for sensor, names in TRIADS.items() if names[0] in fits]
    figure = Figure(figsize=(6.5 * len(sensors), 5.0), layout="constrained")
    panels = figure.subplots(1, len(sensors), squeeze=False)[0]
    for sensor, panel in zip(sensors, panels, strict=True):
        for number, name in enumerate(TRIADS[sensor]):
            fit = fits[name][1]
            low, high = fit.band()
            panel.loglog(fit.curve.tau, fit.curve.sigma, color=f"C{number}", label=name)
            panel.fill_between(fit.curve.tau, low, high, color=f"C{number}", alpha=0.2, linewidth=0)
            model = fit.coefficients.allan_deviation(fit.curve.tau)
            panel.loglog(fit.curve.tau, model, color=f"C{number}", linestyle="--", linewidth=1)
        panel.set_xlabel("cluster time τ [s]")
        panel.set_ylabel(f"Allan deviation [{UNITS[sensor]}]")
        panel.set_title(f"{sensor}: measured with 95 % band, fitted dashed")
        panel.grid(visible=True, which="both", alpha=0.3)
        panel.legend()
    figure.savefig(path, dpi=150)
