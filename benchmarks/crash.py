"""`make bench-crash`: 500 simulated crashes and 200 hours without one; writes docs/crash-benchmark.md.

Seeds are fixed.  Goes on where it was stopped: every crash and every half hour is a line of a file, and what has a
line by the same algorithm is not done again.  `--crashes` and `--hours` make it smaller.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from server.settings import set_numba_cache_dir

Line = dict[str, Any]
FIRST_CRASH, FIRST_HOUR, MINUTES = 100_000, 200_000, 30.0
OUT = Path(__file__).parent.parent / "docs" / "crash-benchmark.md"
LINES = Path("artifacts/bench-crash.jsonl")
NAMES = (("delta_v", "delta-V"), ("pdof", "PDOF"), ("speed", "impact speed"))


class Task(NamedTuple):
    """What a line is about."""

    kind: str
    """plain, spun, blind: crashes; ordinary: half an hour."""
    seed: int


def one(task: Task) -> Line:
    """A line of the file."""
    from nav_core.events.record import ALGORITHM
    from nav_core.simulate.crash_studies import crash, ordinary

    head = {"kind": task.kind, "seed": task.seed, "algorithm": ALGORITHM}
    if task.kind == "ordinary":
        half = ordinary(task.seed, minutes=MINUTES)
        return head | {"hours": half.hours, "shocks": half.shocks, "kinds": half.kinds, "alarms": half.alarms}
    spun = task.kind == "spun"
    found = crash(task.seed, gyro=spun, yaw_rate=3.0 if spun else 0.0, fixes=task.kind != "blind")
    return head | {
        "found": found.found,
        "seen": found.event is not None,
        "kinds": found.kinds,
        "clipped": found.clipped,
        "braked": found.braked,
        "delta_v": 100.0 * found.delta_v_error,
        "pdof": found.pdof_error_deg,
        "speed": found.speed_error_kmh,
        "covers": {name: found.covers(name) for name, _ in NAMES},
    }


def main() -> None:
    """Work off what is left, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--crashes", type=int, default=500)
    parser.add_argument("--hours", type=float, default=200.0)
    parser.add_argument("--turning", type=int, default=100, help="crashes that turn the vehicle, box with gyro")
    parser.add_argument("--blind", type=int, default=100, help="crashes without a fix from a minute before on")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="stop after")
    parser.add_argument("--lines", type=Path, default=LINES)
    parser.add_argument("--out", type=Path, default=OUT)
    args = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    set_numba_cache_dir()
    counts = {
        "plain": (FIRST_CRASH, args.crashes),
        "spun": (FIRST_CRASH + 10_000, args.turning),
        "blind": (FIRST_CRASH + 20_000, args.blind),
        "ordinary": (FIRST_HOUR, round(args.hours * 60.0 / MINUTES)),
    }
    # All kinds side by side: stopped halfway, there is half of each.
    ranked = [((k + 0.5) / n, Task(kind, first + k)) for kind, (first, n) in counts.items() for k in range(n)]
    tasks = [task for _, task in sorted(ranked)]
    args.lines.parent.mkdir(parents=True, exist_ok=True)
    done = work_off(tasks, args.lines, args.processes, 60.0 * args.minutes)
    page = "\n".join(sections([done[task] for task in tasks if task in done], len(tasks)))
    args.out.write_text(page, encoding="utf-8")
    print(page)


def work_off(tasks: list[Task], path: Path, processes: int, seconds: float) -> dict[Task, Line]:
    """The lines of all tasks, those that are not there yet added, until the time is over."""
    from nav_core.events.record import ALGORITHM

    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    done = {Task(line["kind"], line["seed"]): line for line in lines if line["algorithm"] == ALGORITHM}
    left = [task for task in tasks if task not in done]
    began, size = time.monotonic(), 8 * processes
    with path.open("a") as file, ProcessPoolExecutor(processes) as pool:
        for k in range(0, len(left), size):
            if time.monotonic() - began > seconds:
                break
            for task, line in zip(left[k : k + size], pool.map(one, left[k : k + size]), strict=True):
                file.write(json.dumps(line) + "\n")
                done[task] = line
            file.flush()
            print(f"{len(done)} of {len(tasks)}, {time.monotonic() - began:.0f} s", flush=True)
    return done


def sections(lines: list[Line], wanted: int) -> Iterator[str]:
    """The page."""
    of = {kind: [line for line in lines if line["kind"] == kind] for kind in ("plain", "spun", "blind", "ordinary")}
    yield from ("# Crash benchmark", "", "Written by `make bench-crash` (benchmarks/crash.py); seeds are fixed.")
    if len(lines) < wanted:
        yield f"\n**Not finished: {len(lines)} of {wanted} crashes and half hours.** Run it again to go on."
    for title, part in (
        ("Simulated crashes", of["plain"]),
        ("Those of them that the driver braked for, by 0.3-1 g for up to 3 s", [x for x in of["plain"] if x["braked"]]),
        ("Crashes that turn the vehicle by up to 3 rad/s, box with gyro", of["spun"]),
        ("Crashes without a fix from a minute before on", of["blind"]),
    ):
        yield from ("", f"## {title}", "", *crashes(part))
    yield from ("", "## Driving without a crash", "", *quiet(of["ordinary"]), "")


def crashes(lines: list[Line]) -> list[str]:
    """Table of errors and coverage."""
    import numpy as np

    seen = [line for line in lines if line["seen"]]
    sets = [[line for line in seen if line["clipped"] is clipped] for clipped in (False, True)]

    def row(name: str, cell: Callable[[list[Line]], str]) -> str:
        return f"| {name} | " + " | ".join(cell(each) for each in sets) + " |"

    def errors(name: str, unit: str) -> Callable[[list[Line]], str]:
        def cell(each: list[Line]) -> str:
            sizes = np.abs([line[name] for line in each])
            if not np.isfinite(sizes).any():
                return "not told"
            return f"{np.nanmedian(sizes):.2f} / {np.nanquantile(sizes, 0.9):.2f} / {np.nanmax(sizes):.1f} {unit}"

        return cell

    def held_by(each: list[Line], name: str) -> list[bool]:
        return [line["covers"][name] for line in each if line["covers"][name] is not None]

    def meant(name: str) -> bool:
        held = held_by(seen, name)
        return not held or 0.90 <= np.mean(held) <= 0.99

    def cover(name: str) -> Callable[[list[Line]], str]:
        def cell(each: list[Line]) -> str:
            held = held_by(each, name)
            return f"{100.0 * np.mean(held):.1f} % of {len(held)}" if held else "not told"

        return cell

    outside = [f"{label} {cover(name)(seen)}" for name, label in NAMES if not meant(name)]
    return [
        f"{sum(line['found'] for line in lines)} of {len(lines)} found. 12-60 km/h, any direction, 70-160 ms,",
        "haversine, half-sine and triangle, ±8, 11 or 16 g at 200 Hz, 4 fixes per second, any mounting, estimated from",
        f"the same five minutes. {sum(line['braked'] for line in lines)} of the drivers braked.",
        "",
        "| | unclipped | clipped |",
        "|---|---|---|",
        row("crashes", lambda each: str(len(each))),
        row("delta-V error, median / p90 / worst", errors("delta_v", "%")),
        row("PDOF error, median / p90 / worst", errors("pdof", "°")),
        row("impact speed error, median / p90 / worst", errors("speed", "km/h")),
        *(row(f"{label} within its 95 % interval", cover(name)) for name, label in NAMES),
        "",
        "All together: " + ", ".join(f"{label} {cover(name)(seen)}" for name, label in NAMES) + ".",
        *([f"Outside of the 90-99 % that are meant (docs/crash.md): {', '.join(outside)}."] if outside else []),
        *(f"\nNot found: seed {line['seed']}: {', '.join(line['kinds'])}" for line in lines if not line["found"]),
    ]


def quiet(lines: list[Line]) -> list[str]:
    """What happened and what was said of it."""
    shocks, kinds = Counter[str](), Counter[str]()
    for line in lines:
        shocks.update(line["shocks"])
        kinds.update(line["kinds"])
    alarms = list(chain.from_iterable(line["alarms"] for line in lines))
    total = sum(line["hours"] for line in lines)
    return [
        f"{total:.0f} hours, {len(alarms)} false alarms of a crash, rollover or parked impact.",
        "",
        "What the road and people did: " + ", ".join(f"{count} {name}" for name, count in sorted(shocks.items())) + ".",
        "",
        "What was reported: " + ", ".join(f"{count} {name}" for name, count in sorted(kinds.items())) + ".",
        *(f"- {alarm}" for alarm in alarms),
    ]


if __name__ == "__main__":
    main()
