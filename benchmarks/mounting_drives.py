"""The drives of the mounting benchmark and what each estimator makes of them; a line of JSON a drive."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Protocol, TypeVar

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from nav_core.mounting import estimate_mounting
from nav_core.mounting.bound import mounting_bound
from nav_core.records import Drive, MountingEstimate
from nav_core.rotation import error_between
from nav_core.simulate import Scenario, faults, simulate
from nav_core.typing import Floats

METHODS = ("whole-drive", "online", "mekf", "two-phase")
OURS = METHODS[:1]
GNSS_RATES = (1.0, 4.0, 10.0)
MILLI_G = 9.80665e-3


LOOSE: tuple[Callable[[Drive, int], Drive], ...] = (
    lambda drive, seed: faults.swaying(drive, np.radians(5.0), 2.0, seed),
    lambda drive, seed: faults.swaying(drive, np.radians(10.0), 20.0, seed),
    lambda drive, seed: faults.swaying(drive, np.radians(7.0), 60.0, seed),
    lambda drive, seed: faults.slipping(drive, np.radians(1.0), seed),
    lambda drive, seed: faults.tumbling(drive, 15.0, np.radians(15.0), seed),
    lambda drive, seed: faults.tumbling(drive, 40.0, np.radians(30.0), seed),
)
"""Six ways in which a box may be loose: it rattles, sways, swings slowly, slips, is thrown a little or far."""

SEAS = (0.0, 0.3, 1.0, 2.0)
"""From a lake to a rough sea."""


def loosened(drive: Drive, index: int, seed: int) -> Drive:
    """One of `LOOSE` in turn."""
    return LOOSE[index % len(LOOSE)](drive, seed)


def aboard(drive: Drive, index: int, seed: int) -> Drive:
    """A crossing as long as the drive instead of it."""
    lasting = float(drive.inertial.t[-1] - drive.inertial.t[0])
    return faults.sailing(lasting, seed, sea=SEAS[index % len(SEAS)])


@dataclass(frozen=True)
class Row:
    """A set of drives with common conditions; GPS at 1, 4 and 10 Hz in turn unless the scenario is `fixed`.

    With `spoilt` there is no truth: the estimate must never be `ready`.
    """

    name: str
    scenario: Scenario
    count: int
    methods: tuple[str, ...] = OURS
    fixed: bool = False
    spoilt: Callable[[Drive, int, int], Drive] | None = None
    dives: tuple[float, ...] = (1.0,)
    """What the springs of each drive in turn give in braking, as a share of what they give in accelerating."""

    def scenarios(self) -> Iterator[Scenario]:
        """One scenario a drive."""
        for index in range(self.count):
            rate = self.scenario.gnss_rate if self.fixed else GNSS_RATES[index % len(GNSS_RATES)]
            yield replace(self.scenario, gnss_rate=rate, dive=self.dives[index % len(self.dives)])


def _route(name: str, duration: float, **changes: Any) -> Scenario:
    return Scenario(route=name, duration=duration, **changes)  # type: ignore[arg-type]


ROUTES = {
    "urban 300 s": _route("urban", 300.0),
    "urban 60 s": _route("urban", 60.0),
    "roundabout 120 s": _route("roundabout", 120.0),
    "straight 300 s": _route("straight", 300.0),
    "highway 600 s": _route("highway", 600.0),
    "gentle 300 s": _route("gentle", 300.0),
}

ROWS = (
    *(Row(name, scenario, 200 if name == "urban 300 s" else 150, METHODS) for name, scenario in ROUTES.items()),
    *(
        Row(f"{name}, accelerometer {rate:g} Hz", replace(scenario, accel_rate=rate), 30)
        for name, scenario in ROUTES.items()
        for rate in (100.0, 50.0, 10.0)
    ),
    *(
        Row(f"{name}, bias {bias:g} mg", replace(scenario, accel_bias=bias * MILLI_G), 30)
        for name, scenario in ROUTES.items()
        for bias in (0.0, 30.0)
    ),
    Row("urban 1800 s, calibrated, no crown", _route("urban", 1800.0, accel_bias=0.0, crown=0.0), 30),
    Row("standing 300 s", _route("static", 300.0), 60),
    Row("urban 300 s, 4 Hz GPS", ROUTES["urban 300 s"], 40, METHODS, fixed=True),
    Row("roundabout 120 s, 4 Hz GPS", ROUTES["roundabout 120 s"], 40, METHODS, fixed=True),
    Row("highway 600 s, 4 Hz GPS", ROUTES["highway 600 s"], 40, METHODS, fixed=True),
    Row("loose box, urban 300 s", ROUTES["urban 300 s"], 90, spoilt=loosened),
    Row("loose box, straight 300 s", ROUTES["straight 300 s"], 60, spoilt=loosened),
    Row("loose box, highway 600 s", ROUTES["highway 600 s"], 60, spoilt=loosened),
    Row("ferry, 300 s", _route("static", 300.0), 40, spoilt=aboard),
    Row("ferry, 1800 s", _route("static", 1800.0), 20, spoilt=aboard),
)


def seed_of(row: int, index: int) -> int:
    """Fixed; two drives that once raised an alarm are tests as well (`test_mounting_moved`)."""
    return 500_000 + 1_000 * row + index


def outcome(found: MountingEstimate, R_va: Floats | None) -> dict[str, Any]:
    """Status, error and sigma of an estimate, as far as there are any."""
    error = sigma = None
    if found.R_va is not None and found.sigma is not None and R_va is not None:
        error = np.degrees(error_between(found.R_va, R_va)).tolist()
        sigma = np.degrees(found.sigma).tolist()
    return {"status": found.status, "error_deg": error, "sigma_deg": sigma}


def run_drive(job: Row, index: int, seed: int) -> dict[str, Any]:
    """Simulate one drive of a row, bound it, and estimate it by every method of the row."""
    scenario = next(islice(job.scenarios(), index, None))
    drive, truth = simulate(scenario, seed=seed)
    R_va = truth.R_va
    if job.spoilt is not None:
        drive, R_va = job.spoilt(drive, index, seed), None
    out: dict[str, Any] = {
        "row": job.name,
        "index": index,
        "gnss_rate": scenario.gnss_rate,
        "crown_deg": float(np.degrees(truth.crown)),
        "bound_deg": np.degrees(np.sqrt(np.diag(mounting_bound(scenario, seed=seed)))).tolist(),
        "results": {},
    }
    for method in job.methods:
        found = estimate_mounting(drive, method=method)  # type: ignore[arg-type]
        out["results"][method] = {
            **outcome(found, R_va),
            "converged_after_s": found.converged_after,
            "changes": len(found.changes),
            "reasons": [reason.code for reason in found.reasons],
        }
    return out


def stored(path: Path) -> list[dict[str, Any]]:
    """What earlier runs left."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []


class Job(Protocol):
    """Drives with common conditions."""

    @property
    def name(self) -> str:
        """What the line of a drive goes by."""
        ...

    @property
    def count(self) -> int:
        """Of drives."""
        ...


J = TypeVar("J", bound=Job)


def run_all(
    path: Path,
    run: Callable[[J, int, int], dict[str, Any]],
    jobs: Sequence[J],
    seeds: Callable[[int, int], int],
    *,
    workers: int = 2,
) -> list[dict[str, Any]]:
    """Every drive of the jobs that the file does not hold yet; progress on standard error.

    `run` is told job, index and seed; `seeds` gives the latter for place of the job and index.
    """
    done = stored(path)
    known = {(entry["row"], entry["index"]) for entry in done}
    todo = [
        (job, index, seeds(row, index))
        for row, job in enumerate(jobs)
        for index in range(job.count)
        if (job.name, index) not in known
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file, ProcessPoolExecutor(workers) as pool:
        futures = [pool.submit(run, *each) for each in todo]
        for future in as_completed(futures):
            entry = future.result()
            file.write(json.dumps(entry) + "\n")
            file.flush()
            done.append(entry)
            print(f"\r{len(done)} of {len(known) + len(todo)} drives", end="", file=sys.stderr, flush=True)
    return done
