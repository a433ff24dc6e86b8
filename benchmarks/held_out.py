"""`make bench-held-out`: the default estimator on drives unlike those it was made with, seeds of their own.

Springs that give unlike in braking and accelerating, receivers that smooth, more straight roads than the mounting
benchmark has, and pairs of trips by one box.  Prints two tables.  Goes on where it was stopped: drives that have a
line in the file are not run again.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mounting_drives import GNSS_RATES, MILLI_G, OURS, ROUTES, Row, outcome, run_all, run_drive

from nav_core.mounting.again import BIAS_AGAIN, TURN_AGAIN
from nav_core.mounting.model import Noise
from nav_core.mounting.trips import Told, told_of
from nav_core.records import Inertial
from nav_core.signal import decimate
from nav_core.simulate import Scenario, random_rotation, simulate
from nav_core.typing import Floats

HALF_HOUR = "urban 1800 s, calibrated, no crown"
DRIVEN = {**ROUTES, HALF_HOUR: Scenario(route="urban", duration=1800.0, accel_bias=0.0, crown=0.0)}
UNLIKE = tuple(0.5 + 0.1 * step for step in range(11))
"""From half as much in braking as in accelerating to half as much again; as many as share no factor with the rates of
receivers, so that each meets each."""

SMOOTHING = 1.0
"""Time constant of the receivers that smooth, s."""


def _rows() -> Iterator[Row]:
    for name, count in (("urban 300 s", 120), (HALF_HOUR, 60)):
        yield Row(name, DRIVEN[name], count)
    yield Row("straight 300 s", DRIVEN["straight 300 s"], 480)
    for name, count in (("urban 300 s", 120), ("straight 300 s", 120), (HALF_HOUR, 60)):
        yield Row(f"{name}, unlike springs", DRIVEN[name], count, dives=UNLIKE)
    for name in ("roundabout 120 s", "urban 300 s", "urban 60 s", "straight 300 s", "highway 600 s"):
        scenario = replace(DRIVEN[name], gnss_smoothing=SMOOTHING)
        yield Row(f"{name}, smoothing {SMOOTHING:g} s", scenario, 120)


ROWS = tuple(_rows())
HEAD = "| drives | n | ready | rms x/y/z ° | error/sigma x/y/z | covered x/y/z % |\n|---|---|---|---|---|---|"


@dataclass(frozen=True)
class Pair:
    """Pairs of trips by one box in one car with one receiver, GPS at 1, 4 and 10 Hz in turn."""

    name: str
    trips: tuple[Scenario, Scenario]
    count: int = 60


def _pairs() -> Iterator[Pair]:
    first = ROUTES["urban 300 s"]
    for route, duration, smoothing in (
        ("urban", 120.0, 0.0),
        ("urban", 120.0, 1.0),
        ("urban", 60.0, 0.5),
        ("straight", 150.0, 0.5),
    ):
        second = Scenario(route=route, duration=duration)  # type: ignore[arg-type]
        trips = replace(first, gnss_smoothing=smoothing), replace(second, gnss_smoothing=smoothing)
        yield Pair(f"urban 300 s, then {route} {duration:g} s, smoothing {smoothing:g} s", trips)


PAIRS = tuple(_pairs())
PAIRS_HEAD = (
    "| two trips, known together | n | ready | rms x/y/z ° | error/sigma x/y/z | covered x/y/z % "
    "| smoothing told in both/one/neither | contradictions | moves |\n|---|---|---|---|---|---|---|---|---|"
)


def seed_of(row: int, index: int) -> int:
    """By route: one draw of roads, mountings and sensors serves all rows of it."""
    route = next(place for place, name in enumerate(DRIVEN) if ROWS[row].name.startswith(name))
    return 900_000 + 1_000 * route + index


def pair_seed(_row: int, index: int) -> int:
    """The same boxes, cars and receivers in every row."""
    return 990_000 + index


def _drawn(pair: Pair, index: int, rng: np.random.Generator) -> Iterator[tuple[Scenario, Floats]]:
    """Each trip's scenario and bias: what stays is drawn once, what comes `again` for either."""
    lags = rng.uniform(0.0, 0.6, 2)
    kept = {
        "R_va": random_rotation(rng),
        "accel_bias": 0.0,
        "gnss_rate": GNSS_RATES[index % len(GNSS_RATES)],
        "speed_lag": float(lags[0]),
        "course_lag": float(lags[1]),
    }
    crown = float(rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(0.3, 1.2)))
    bias = rng.normal(0.0, 5.0 * MILLI_G, 3)
    for trip in pair.trips:
        new = rng.normal(0.0, BIAS_AGAIN, 3)
        yield replace(trip, **kept, crown=crown + rng.normal(0.0, TURN_AGAIN[0])), bias + new


def run_pair(pair: Pair, index: int, seed: int) -> dict[str, Any]:
    """The second trip of a pair with what the first one left."""
    told: list[Told] = []
    smoothed: list[bool] = []
    past = R_va = None
    for number, (scenario, bias) in enumerate(_drawn(pair, index, np.random.default_rng((seed, 7)))):
        drive, truth = simulate(scenario, seed=2 * seed + number)
        now = told_of(decimate(Inertial(drive.inertial.t, drive.inertial.f + bias)), drive.gnss, past, Noise())
        told.append(now)
        R_va, past, late = truth.R_va, now.own, now.estimate.speed_lag
        smoothed.append(now.own is not None and late is not None and late > now.own.speed_lag)
    found = told[-1].estimate
    result = {
        **outcome(found, R_va),
        "contradicts": told[-1].past_share < 1.0,
        "changes": len(found.changes),
        "smoothed": sum(smoothed),
    }
    return {"row": pair.name, "index": index, "results": {OURS[0]: result}}


def pair_line(name: str, entries: list[dict[str, Any]]) -> str:
    """One row of the table of pairs."""
    found = [entry["results"][OURS[0]] for entry in entries]
    told = "/".join(str(sum(each["smoothed"] == trips for each in found)) for trips in (2, 1, 0))
    against = sum(each["contradicts"] for each in found)
    return f"{line(name, entries)} {told} | {against} | {sum(each['changes'] for each in found)} |"


def line(name: str, entries: list[dict[str, Any]]) -> str:
    """One row of the table; `error/sigma` is the root of the mean square."""
    found = [entry["results"][OURS[0]] for entry in entries]
    known = [each for each in found if each["error_deg"] is not None]
    ready = 100.0 * np.mean([each["status"] == "ready" for each in found])
    error, sigma = (np.array([each[key] for each in known]).reshape(-1, 3) for key in ("error_deg", "sigma_deg"))
    over = error / sigma
    return (
        f"| {name} | {len(entries)} | {ready:.0f} % | {_three(_rms(error), 3)} | {_three(_rms(over), 2)} "
        f"| {_three(100.0 * np.mean(np.abs(over) <= 1.96, axis=0), 1)} |"
    )


def _rms(values: Floats) -> Floats:
    return np.sqrt(np.mean(values**2, axis=0))


def _three(values: Floats, digits: int) -> str:
    return "/".join(f"{value:.{digits}f}" for value in values)


def main() -> None:
    """Run what is missing, then print."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    options.add_argument("--out", type=Path, default=Path("artifacts/held-out.jsonl"))
    chosen = options.parse_args()
    done = run_all(chosen.out, run_drive, ROWS, seed_of, workers=chosen.workers)
    print(file=sys.stderr)
    print(HEAD)
    for row in ROWS:
        print(line(row.name, [entry for entry in done if entry["row"] == row.name]))
    done = run_all(chosen.out, run_pair, PAIRS, pair_seed, workers=chosen.workers)
    print(f"\n{PAIRS_HEAD}")
    for pair in PAIRS:
        print(pair_line(pair.name, [entry for entry in done if entry["row"] == pair.name]))


if __name__ == "__main__":
    main()
