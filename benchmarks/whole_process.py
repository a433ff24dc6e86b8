"""What a process costs from its start to its end, for ours and for the peers, on the same file.

`python benchmarks/whole_process.py JOB FILE` is one such process; without arguments the table is printed.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from timing import Row, print_rows


def allan(data: dict[str, np.ndarray]) -> None:
    """Allan deviation, ours."""
    from nav_core.sensors import allan_deviation

    allan_deviation(data["x"], 100.0)


def allantools(data: dict[str, np.ndarray]) -> None:
    """Allan deviation at the same cluster times."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import allantools

    allantools.oadev(data["x"], rate=100.0, data_type="freq", taus=data["taus"])


def attitude(data: dict[str, np.ndarray]) -> None:
    """Error-state filter over the readings, ours."""
    from nav_core.attitude.error_state import Direction, GyroNoise, Start, estimate, mean_rates

    start = Start.of(np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), 1e-3, 1e-4)
    seen = [
        Direction(np.array([0.0, 0.0, -9.81]), data["f"], 0.03),
        Direction(np.array([22.5, 0.0, 41.8]), data["m"], 0.2),
    ]
    estimate(start, mean_rates(data["w"]), 0.01, GyroNoise(1e-4, 1e-5), directions=seen)


def ahrs(data: dict[str, np.ndarray]) -> None:
    """Extended Kalman filter of ahrs over the same readings."""
    from ahrs.filters import EKF

    EKF(gyr=data["w"][1:], acc=-data["f"], mag=1e3 * data["m"], frequency=100.0, frame="NED")


JOBS = {"allan": allan, "allantools": allantools, "attitude": attitude, "ahrs": ahrs}


def took(job: str, path: Path, *, repeat: int = 3) -> float:
    """Least processor time of a few processes after one that may compile, s: other work on the machine adds little."""
    durations = []
    for _ in range(repeat + 1):
        began = spent()
        subprocess.run([sys.executable, __file__, job, str(path)], check=True)  # noqa: S603  our own script
        durations.append(spent() - began)
    return min(durations[1:])


def spent() -> float:
    """Processor time of the children so far, s."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def rows() -> list[Row]:
    """Both on 1e6 samples of noise, and on a minute of readings at 100 Hz."""
    from nav_core.sensors import allan_deviation
    from nav_core.simulate import platform

    rng = np.random.default_rng(1)
    x = rng.standard_normal(1_000_000)
    truth = platform.by_hand(60.0, 100.0, np.radians([5.0, 7.0, 10.0]), rng)
    readings = platform.measure(truth, platform.Instruments(), rng)
    with TemporaryDirectory() as folder:
        noise, hand = Path(folder) / "noise.npz", Path(folder) / "hand.npz"
        np.savez(noise, x=x, taus=allan_deviation(x, 100.0).tau)
        np.savez(hand, w=readings.w, f=readings.f, m=readings.m)
        ours, theirs = took("attitude", hand), took("ahrs", hand, repeat=1)
        return [
            Row("Allan deviation of 1e6 samples", took("allan", noise), "s"),
            Row("the same by allantools", took("allantools", noise), "s"),
            Row("attitude filter, a minute at 100 Hz", ours, "s"),
            Row("ahrs EKF on the same readings", theirs, "s"),
            Row("ahrs over ours", theirs / ours, "x"),
        ]


if __name__ == "__main__":
    if len(sys.argv) > 1:
        from server.settings import set_numba_cache_dir

        set_numba_cache_dir()
        JOBS[sys.argv[1]](dict(np.load(sys.argv[2])))
    else:
        print_rows(rows())
