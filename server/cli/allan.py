"""`scatola allan`: Allan deviation and noise coefficients of a recording at rest."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from server.cli.progress import progress
from server.settings import set_numba_cache_dir

if TYPE_CHECKING:
    from nav_core.sensors import NoiseFit


def allan(args: argparse.Namespace) -> int:
    """`scatola allan`."""
    set_numba_cache_dir()
    from server.analyses.compute.allan import allan as fitted
    from server.formats.drive import read_drive_columns

    recording = read_drive_columns(args.file)
    found = fitted(
        recording,
        str(args.file),
        terms=args.terms.upper(),
        rate=args.rate,
        shortest=args.shortest,
        progress=lambda text, _: progress(text),
    )
    progress("")
    found.document["quality"][:0] = [remark.detail for remark in recording.remarks]
    if args.plot is not None:
        _plot(args.plot, found.fits)
    print(json.dumps(found.document) if args.json else _in_words(found.document))
    return 0


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

    from server.analyses.compute.triads import TRIADS, UNITS

    sensors = [sensor for sensor, names in TRIADS.items() if set(names) & set(fits)]
    figure = Figure(figsize=(6.5 * len(sensors), 5.0), layout="constrained")
    panels = figure.subplots(1, len(sensors), squeeze=False)[0]
    for sensor, panel in zip(sensors, panels, strict=True):
        for number, name in enumerate(TRIADS[sensor]):
            if name not in fits:
                continue
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
