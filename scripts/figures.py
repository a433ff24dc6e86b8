"""Figures of 000 chapter 9, drawn anew from simulated sensors: drift at rest, and a drive of 250 m in 30 s.

.venv/bin/python scripts/figures.py docs/img
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from nav_core.navigation.position_velocity import THESIS_MEASUREMENT, Noise, run
from nav_core.simulate.platform_studies import drift_at_rest

AXES = ("north", "east", "down")
BIAS = np.array([0.02, 0.03, 0.5])
"""Of the accelerometer in local axes, m/s²: 000 sees about 0.5 along z."""


def rest(rng: np.random.Generator) -> Figure:
    """Figures 9.22-9.27: 100 s at rest with raw and with filtered rates."""
    drift = drift_at_rest(rng)
    t = 100.0 * np.arange(1, len(drift.filtered) + 1) / len(drift.filtered)
    figure: Any = Figure(figsize=(10.0, 3.6), layout="constrained")
    raw, filtered = figure.subplots(1, 2)
    raw.plot(t, 1e-3 * drift.unfiltered, label=AXES)
    raw.set(title="rates as measured", ylabel="position [km]", xlabel="time [s]")
    filtered.plot(t, drift.filtered, label=AXES)
    filtered.set(title="rates filtered", ylabel="position [m]", xlabel="time [s]")
    for axes in (raw, filtered):
        axes.legend()
        axes.grid(alpha=0.3)
    ends = (np.abs(drift.unfiltered[-1]).round(0), np.abs(drift.filtered[-1]).round(1))
    print(f"at rest, after 100 s: unfiltered {ends[0]} m, filtered {ends[1]} m")
    return figure


def drive(rng: np.random.Generator) -> Figure:
    """Figures 9.31-9.36: a nearly straight 250 m, specific force integrated alone and with a fix a second."""
    t = np.arange(0.0, 30.0 + 1e-9, 0.025)
    acceleration = np.zeros((t.size, 3))
    acceleration[(t >= 2.5) & (t < 7.5), 0] = 2.0
    measured = acceleration + BIAS + 0.03 * rng.standard_normal(acceleration.shape)
    truth, free = (motion_of(t, each) for each in (acceleration, measured))
    fixes = slice(0, None, 40)
    z = truth[fixes] + np.sqrt(THESIS_MEASUREMENT) * rng.standard_normal((len(t[fixes]), 6))
    noise = Noise(position=1e-3, velocity=1e-3, acceleration=1e-3, bias=1e-4, start=10.0)
    residual = run(t[fixes], z - free[fixes], np.tile(THESIS_MEASUREMENT, (len(z), 1)), noise).x[:, :6]
    aided = free[fixes] + residual

    figure: Any = Figure(figsize=(10.0, 5.6), layout="constrained")
    grid = figure.subplots(2, 3, sharex=True)
    for i, name in enumerate(AXES):
        for axes, column, unit in ((grid[0, i], 3 + i, "velocity [m/s]"), (grid[1, i], i, "position [m]")):
            axes.plot(t, truth[:, column], color="0.6", lw=3, label="truth")
            axes.plot(t, free[:, column], color="tab:red", label="accelerometer alone")
            axes.plot(t[fixes], aided[:, column], ".-", color="tab:blue", label="12 states, a fix a second")
            axes.set(ylabel=unit, title=name if unit.startswith("v") else None)
            axes.grid(alpha=0.3)
        grid[1, i].set(xlabel="time [s]")
    grid[0, 0].legend(fontsize="small")
    off = [np.abs(each[-1, :3] - truth[-1, :3]).round(1) for each in (free, aided)]
    print(f"drive of {truth[-1, 0]:.0f} m: off at the end by {off[0]} m alone, {off[1]} m with fixes")
    return figure


def motion_of(t: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """Position and velocity, (n, 6), of an acceleration integrated twice."""
    step = t[1] - t[0]
    velocity = np.cumsum(acceleration, axis=0) * step
    return np.hstack((np.cumsum(velocity, axis=0) * step, velocity))


def main() -> None:
    folder = Path(sys.argv[1])
    rest(np.random.default_rng(1)).savefig(folder / "drift-at-rest.png", dpi=100)
    drive(np.random.default_rng(2)).savefig(folder / "drive-250m.png", dpi=100)


if __name__ == "__main__":
    main()
