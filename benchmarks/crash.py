"""`make bench-crash`: 500 simulated crashes and 200 hours without one; writes docs/crash-benchmark.md.

Seeds are fixed.  Work is spread over processes; `--crashes` and `--hours` make it smaller.
"""

from __future__ import annotations

import argparse
import os
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from server.settings import set_numba_cache_dir

if TYPE_CHECKING:
    from nav_core.simulate.crash_studies import Hours, Outcome

T = TypeVar("T")
FIRST_CRASH, FIRST_HOUR, MINUTES = 100_000, 200_000, 30.0
OUT = Path(__file__).parent.parent / "docs" / "crash-benchmark.md"


def main() -> None:
    """Run both studies and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--crashes", type=int, default=500)
    parser.add_argument("--hours", type=float, default=200.0)
    parser.add_argument("--turning", type=int, default=100, help="crashes that turn the vehicle, box with gyro")
    parser.add_argument("--blind", type=int, default=100, help="crashes without a fix from a minute before on")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path, default=OUT)
    args = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    set_numba_cache_dir()
    from nav_core.simulate.crash_studies import crash, ordinary

    began = time.perf_counter()
    plain = run(crash, range(FIRST_CRASH, FIRST_CRASH + args.crashes), args.processes)
    first = FIRST_CRASH + 10_000
    spun = run(partial(crash, gyro=True, yaw_rate=3.0), range(first, first + args.turning), args.processes)
    first += 10_000
    blind = run(partial(crash, fixes=False), range(first, first + args.blind), args.processes)
    halves = range(FIRST_HOUR, FIRST_HOUR + round(args.hours * 60.0 / MINUTES))
    hours = run(partial(ordinary, minutes=MINUTES), halves, args.processes)
    lines = ["# Crash benchmark", "", "Written by `make bench-crash` (benchmarks/crash.py); seeds are fixed.", ""]
    lines += ["## Simulated crashes", "", *crashes(plain), ""]
    braked = [each for each in plain if each.braked]
    lines += ["## Of these, those that the driver braked for, by 0.3-1 g for up to 3 s", "", *crashes(braked), ""]
    lines += ["## Crashes without a fix from a minute before on", "", *crashes(blind), ""]
    lines += ["## Crashes that turn the vehicle by up to 3 rad/s, box with gyro", "", *crashes(spun), ""]
    lines += ["## Driving without a crash", "", *quiet(hours), ""]
    args.out.write_text("\n".join(lines), encoding="utf-8")
    print("\n".join(lines))
    print(f"{time.perf_counter() - began:.0f} s with {args.processes} processes")


def run(function: Callable[[int], T], seeds: Sequence[int], processes: int) -> list[T]:
    """The function of every seed, in order."""
    with ProcessPoolExecutor(processes) as pool:
        return list(pool.map(function, seeds, chunksize=4))


def crashes(outcomes: list[Outcome]) -> list[str]:
    """Table of errors and coverage."""
    import numpy as np

    found = sum(each.found for each in outcomes)
    rows = [
        f"{found} of {len(outcomes)} found. 12-60 km/h, any direction, 70-160 ms, haversine, half-sine and triangle,",
        "±8, 11 or 16 g at 200 Hz, 4 fixes per second, any mounting, estimated from the same five minutes.",
        f"{sum(each.braked for each in outcomes)} of the drivers braked.",
        "",
        "| | unclipped | clipped |",
        "|---|---|---|",
    ]
    seen = [each for each in outcomes if each.event is not None]
    sets = ([each for each in seen if not each.clipped], [each for each in seen if each.clipped])

    def row(name: str, cell: Callable[[list[Outcome]], str]) -> None:
        rows.append(f"| {name} | " + " | ".join(cell(each) if each else "-" for each in sets) + " |")

    def both(values: list[float], unit: str) -> str:
        sizes = np.abs(np.array(values))
        if np.isnan(sizes).all():
            return "not told"
        return f"{np.nanmedian(sizes):.2f} / {np.nanquantile(sizes, 0.9):.2f} / {np.nanmax(sizes):.1f} {unit}"

    def cover(name: str) -> Callable[[list[Outcome]], str]:
        def cell(each: list[Outcome]) -> str:
            held = [value for value in (one.covers(name) for one in each) if value is not None]
            return f"{100.0 * np.mean(held):.1f} % of {len(held)}" if held else "not told"

        return cell

    row("crashes", lambda each: str(len(each)))
    row("delta-V error, median / p90 / worst", lambda each: both([100.0 * one.delta_v_error for one in each], "%"))
    row("PDOF error, median / p90 / worst", lambda each: both([one.pdof_error_deg for one in each], "°"))
    row("impact speed error, median / p90 / worst", lambda each: both([one.speed_error_kmh for one in each], "km/h"))
    row("delta-V within its 95 % interval", cover("delta_v"))
    row("PDOF within its 95 % interval", cover("pdof"))
    row("impact speed within its 95 % interval", cover("speed"))
    names = (("delta_v", "delta-V"), ("pdof", "PDOF"), ("speed", "impact speed"))
    parts = ", ".join(f"{label} {cover(name)(seen)}" for name, label in names)
    missed = [f"- seed {each.seed}: {', '.join(each.kinds) or 'nothing'}" for each in outcomes if not each.found]
    return [*rows, "", f"Within their intervals, all together: {parts}.", *(["", *missed] if missed else [])]


def quiet(hours: list[Hours]) -> list[str]:
    """What happened and what was said of it."""
    shocks, kinds = Counter[str](), Counter[str]()
    for each in hours:
        shocks.update(each.shocks)
        kinds.update(each.kinds)
    alarms = [alarm for each in hours for alarm in each.alarms]
    total = sum(each.hours for each in hours)
    return [
        f"{total:.0f} hours, {len(alarms)} false alarms of a crash, rollover or parked impact.",
        "",
        "What the road and people did: " + ", ".join(f"{count} {name}" for name, count in sorted(shocks.items())) + ".",
        "",
        "What was reported: " + ", ".join(f"{count} {name}" for name, count in sorted(kinds.items())) + ".",
        *(["", *(f"- {alarm}" for alarm in alarms)] if alarms else []),
    ]


if __name__ == "__main__":
    main()
