"""`make bench-moved`: false and missed alarms of a moved box over thousands of hours at decimated rate.

Goes on where it was stopped: every day of driving is a line of a file, and what has a line is not done
again.  Days draw trips, roads, rates, sensors and temperature from their own number; the service's way
of looking again and again as data comes in is part of it.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path
from typing import Any

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np  # noqa: E402  after the number of threads is set

LOOK_S = 600.0
"""The service looks this often in terms of data, and at the end."""

WEIGHTS = {"urban": 0.45, "gentle": 0.25, "highway": 0.2, "straight": 0.05, "roundabout": 0.05}
MILLI_G = 9.80665e-3

DETECTION = {
    # name: angle in degrees, axes, seconds after the move within which it must be found, bar
    "10 deg, any axis": (10.0, "xyz", 300.0, 0.99),
    "5 deg of tilt": (5.0, "xy", 300.0, 0.95),
    "5 deg of yaw": (5.0, "z", 1800.0, 0.95),
}


def quiet_day(seed: int) -> dict[str, Any]:
    """A day without a move: how many hours, how many looks, what was cried."""
    from nav_core.mounting.whole_drive import estimate
    from nav_core.signal import decimate
    from nav_core.simulate.days import DECIMATED, day

    rng = np.random.default_rng((seed, 5))
    trips = []
    left = 3600.0
    while left > 0.0:
        duration = float(min(max(rng.lognormal(np.log(1100.0), 0.7), 240.0), 3600.0))
        trips.append(
            replace(
                DECIMATED,
                route=str(rng.choice(list(WEIGHTS), p=list(WEIGHTS.values()))),
                duration=duration,
                slope=float(rng.choice([0.02, 0.03, 0.05])),
                gnss_rate=1.0,
                accel_bias=float(rng.choice([0.0, 5.0, 30.0])) * MILLI_G,
                accel_bias_drift=float(rng.choice([0.0, 10.0])) * MILLI_G,
            )
        )
        left -= duration
    gnss_rate = float(rng.choice([1.0, 1.0, 4.0, 10.0]))
    drive = day([replace(trip, gnss_rate=gnss_rate) for trip in trips], seed=seed).drive
    ticks = decimate(drive.inertial)
    hours = sum(trip.duration for trip in trips) / 3600.0
    false: list[list[float]] = []
    looks = slipping = 0
    for until in _looks(drive.gnss.t):
        found = estimate(_ticks_until(ticks, until), _fixes_until(drive.gnss, until))
        looks += 1
        slipping += any(each.code == "slipping" for each in found.reasons)
        false += [[until, change.t, float(np.degrees(change.angle))] for change in found.changes]
    return {"kind": "quiet", "seed": seed, "hours": hours, "looks": looks, "slipping": slipping, "false": false}


def moved_day(task: tuple[str, int]) -> dict[str, Any]:
    """A drive in town with one move, while driving or parked between trips: whether it is found in time."""
    from nav_core.mounting.whole_drive import estimate
    from nav_core.signal import decimate
    from nav_core.simulate import Move, random_rotation
    from nav_core.simulate.days import DECIMATED, before_start, day

    name, seed = task
    degrees, axes, within, _ = DETECTION[name]
    rng = np.random.default_rng((seed, 6))
    R_va = random_rotation(rng)
    axis = R_va.T @ np.eye(3)["xyz".index(axes[seed % len(axes)])] if seed % 2 else _among(R_va, axes, rng)
    turn = np.radians(degrees) * axis
    parked = bool(rng.random() < 0.5)
    base = replace(DECIMATED, gnss_rate=float(rng.choice([1.0, 4.0, 10.0])), accel_bias=5.0 * MILLI_G)
    first = replace(base, R_va=R_va, duration=float(rng.uniform(600.0, 1800.0)))
    if parked:
        made = day([first, replace(base, duration=within, moves=(before_start(turn),))], seed=seed)
        moved_at = made.mountings[-1][0]
    else:
        moved_at = first.duration
        move = Move(t=moved_at, turn=(float(turn[0]), float(turn[1]), float(turn[2])))
        made = day([replace(first, duration=moved_at + within, moves=(move,))], seed=seed)
    found = estimate(decimate(made.drive.inertial), made.drive.gnss)
    near = [change for change in found.changes if abs(change.t - moved_at) < 0.5 * within]
    return {
        "kind": name,
        "seed": seed,
        "parked": parked,
        "found": bool(near),
        "late": float(near[0].t - moved_at) if near else None,
        "angle": float(np.degrees(near[0].angle)) if near else None,
        "others": len(found.changes) - len(near[:1]),
    }


def _among(R_va: Any, axes: str, rng: np.random.Generator) -> Any:
    """A direction among these V axes, in A."""
    direction = rng.standard_normal(3) * [letter in axes for letter in "xyz"]
    return R_va.T @ (direction / np.linalg.norm(direction))


def _looks(t: Any) -> list[float]:
    """Times of looking: every `LOOK_S` of data, and the end."""
    data = np.cumsum(np.minimum(np.diff(t, prepend=t[0]), 2.0))
    number = np.floor(data / LOOK_S)
    return [*t[1:][np.diff(number) > 0].tolist(), float(t[-1]) + 1.0]


def _ticks_until(ticks: Any, until: float) -> Any:
    keep = ticks.t <= until
    return replace(
        ticks, index=ticks.index[keep], weight=ticks.weight[keep], moment=ticks.moment[keep], square=ticks.square[keep]
    )


def _fixes_until(gnss: Any, until: float) -> Any:
    keep = gnss.t <= until
    return replace(gnss, **{n: getattr(gnss, n)[keep] for n in ("t", "lat", "lon", "alt", "speed", "course", "fix")})


def one(task: tuple[str, int]) -> dict[str, Any]:
    """A line of the file."""
    return quiet_day(task[1]) if task[0] == "quiet" else moved_day(task)


def summary(lines: list[dict[str, Any]]) -> Iterator[str]:
    """What the lines add up to, as rows of a table."""
    quiet = [line for line in lines if line["kind"] == "quiet"]
    hours, false = sum(line["hours"] for line in quiet), sum(bool(line["false"]) for line in quiet)
    # Rule of three: what a run without an event says at 95 %.
    bound = 3.0 / max(hours, 1e-9) if false == 0 else float("nan")
    looks = sum(line["looks"] for line in quiet)
    yield (
        f"| false alarms | 0 in 3000 h | {false} in {hours:.0f} h ({len(quiet)} days, {looks} looks); "
        f"rate below {1e3 * bound:.2f} per 1000 h at 95 % |"
    )
    slipping = sum(line.get("slipping", 0) for line in quiet)
    yield f"| remark `slipping` at a fixed box | - | at {100.0 * slipping / max(looks, 1):.2f} % of the looks |"
    for name, (_, _, within, bar) in DETECTION.items():
        rows = [line for line in lines if line["kind"] == name]
        if rows:
            found = [row for row in rows if row["found"]]
            late = np.abs([row["late"] for row in found])
            share = 100.0 * len(found) / len(rows)
            yield (
                f"| {name} within {within / 60.0:.0f} min | {100.0 * bar:.0f} % | {share:.1f} % "
                f"of {len(rows)} (parked {_share(rows, parked=True)}, driving {_share(rows, parked=False)}); "
                f"moment within {np.median(late):.0f} s in half, {np.percentile(late, 95.0):.0f} s in 95 %; "
                f"{sum(row['others'] > 0 for row in rows)} cut more often than moved |"
            )


def _share(rows: list[dict[str, Any]], *, parked: bool) -> str:
    part = [row["found"] for row in rows if row["parked"] is parked]
    return f"{100.0 * np.mean(part):.1f} %" if part else "none"


def main() -> None:
    """Work off what is left, print progress, sum up."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--hours", type=float, default=3000.0, help="of quiet driving")
    options.add_argument("--moves", type=int, default=400, help="of each kind")
    options.add_argument("--first-seed", type=int, default=0)
    options.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    options.add_argument("--minutes", type=float, default=float("inf"), help="stop after")
    options.add_argument("--out", type=Path, default=Path("artifacts/bench-moved.jsonl"))
    chosen = options.parse_args()
    chosen.out.parent.mkdir(parents=True, exist_ok=True)
    lines = [json.loads(line) for line in chosen.out.read_text().splitlines()] if chosen.out.exists() else []
    done = {(line["kind"], line["seed"]) for line in lines}
    hours = sum(line["hours"] for line in lines if line["kind"] == "quiet")
    moves = [(name, chosen.first_seed + k) for k in range(chosen.moves) for name in DETECTION]
    quiet = (("quiet", chosen.first_seed + k) for k in range(10**9))
    tasks = (task for task in chain(moves, quiet) if task not in done)
    began = time.monotonic()
    started_with = hours
    with chosen.out.open("a") as file, multiprocessing.get_context("spawn").Pool(chosen.workers) as pool:
        while hours < chosen.hours and time.monotonic() - began < 60.0 * chosen.minutes:
            for line in pool.imap_unordered(one, list(islice(tasks, 8 * chosen.workers))):
                file.write(json.dumps(line) + "\n")
                file.flush()
                lines.append(line)
                hours += line.get("hours", 0.0)
            spent = time.monotonic() - began
            pace = (hours - started_with) / spent
            rest = f"{(chosen.hours - hours) / pace / 60.0:.0f} min left" if pace > 0.0 else "moves first"
            print(
                f"{len(lines)} lines, {hours:.0f} of {chosen.hours:.0f} h, {spent / 60.0:.1f} min, {rest}", flush=True
            )
    for row in summary(lines):
        print(row)
    for line in lines:
        if line["kind"] == "quiet" and line["false"]:
            print("false alarm:", json.dumps(line))


if __name__ == "__main__":
    main()
