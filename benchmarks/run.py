"""`make bench`: what the hot paths cost on this machine, best of a few runs, and the peers on the same data.

Prints a table; with `--write docs/performance.md` it becomes that page.  Each area's script also runs alone.
"""

from __future__ import annotations

import argparse
import os
import platform
from pathlib import Path
from tempfile import TemporaryDirectory

from timing import Row, best, markdown, print_rows

from nav_core.records import Drive
from server.settings import set_numba_cache_dir

PREFACE = """# Performance

Written by `make bench WRITE=docs/performance.md`. Machine: {machine}. Each figure is the shortest of several runs in
one process, compilation not counted; where a peer is named, both worked on the same data in the same run. Other work
on the machine makes single figures up to twice as large.
"""


def main() -> None:
    """Measure and print, area by area."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, metavar="PAGE.md")
    page = parser.parse_args().write
    set_numba_cache_dir()
    import attitude
    import navigation
    import sensors
    import strapdown
    import whole_process

    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    print(machine)
    sections = [PREFACE.format(machine=machine)]
    for title, rows in (
        ("Service", service),
        ("Strapdown", strapdown.rows),
        ("Sensors", sensors.rows),
        ("Attitude", attitude.rows),
        ("GPS/INS and Kalman filters", navigation.rows),
        ("Whole processes (processor time): start, imports, data, work", whole_process.rows),
    ):
        found = rows()
        print_rows(found)
        sections.append(markdown(title, found))
    if page is not None:
        page.write_text("\n".join(sections), encoding="utf-8")


def service() -> list[Row]:
    """Mounting, conditioning and formats."""
    from nav_core.mounting import estimate_mounting, whole_drive
    from nav_core.mounting.online_verdict import estimate as estimate_online
    from nav_core.signal import decimate
    from nav_core.simulate import Scenario, simulate
    from server.formats import compact, compact_write
    from server.formats.columns import Columns
    from server.formats.drive import from_drive, read_drive_file, to_drive, write_drive_file

    hour, _ = simulate(Scenario(route="urban", duration=3600.0), seed=1)
    batch = from_drive(simulate(Scenario(route="urban", duration=60.0), seed=1)[0])
    packed = batch.to_parquet()
    small = compact_write.write(batch)
    ticks = decimate(hour.inertial)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "hour.parquet"
        write_drive_file(path, from_drive(hour))
        return [
            Row("simulate 300 s at 200 Hz", best(lambda: simulate(Scenario(duration=300.0), seed=2)), "s"),
            Row("decimate 1 h of 200 Hz to 10 Hz", best(lambda: decimate(hour.inertial)), "s"),
            Row(
                "whole-drive estimate, 1 h of ticks",
                best(lambda: whole_drive.estimate(ticks, hour.gnss), repeat=3),
                "s",
            ),
            Row(
                "Parquet file of 1 h at 200 Hz to a mounting",
                best(lambda: estimate_mounting(read_drive_file(path)), repeat=3),
                "s",
                "≤ 0.6 s",
            ),
            Row("thesis filter, 1 h at 4 Hz, per fix", 1e6 * thesis_steps(hour), "µs", "≤ 2 µs"),
            Row("online estimate, 1 h at 200 Hz with decimation", best(lambda: estimate_online(hour), repeat=2), "s"),
            Row("online filters, 1000 boxes by one fix in one call", 1e3 * online_fleet(hour), "ms", "≤ 6 ms"),
            Row(
                "Parquet batch of 60 s at 200 Hz to a drive", best(lambda: to_drive(Columns.from_parquet(packed))), "s"
            ),
            Row(
                "compact batch of 60 s at 200 Hz to columns",
                1e3 * best(lambda: compact.read(small, max_decoded_bytes=None)),
                "ms",
            ),
        ]


def thesis_steps(drive: Drive) -> float:
    """Seconds for a step of the thesis' filter, over a whole drive."""
    from nav_core.mounting.thesis import initial_states
    from nav_core.mounting.thesis_kernel import filter_drive
    from nav_core.mounting.thesis_model import CORRECTED, Tuning, measurement_vectors

    steps = measurement_vectors(drive)
    start = initial_states(steps, Tuning(), CORRECTED)[0]
    return best(lambda: filter_drive(steps, *(a.copy() for a in start), Tuning(), CORRECTED)) / steps.t.size


def online_fleet(drive: Drive, boxes: int = 1000) -> float:
    """Seconds for one call that takes every box of a fleet past its next fix."""
    import numpy as np

    from nav_core.mounting.online import advance, begin
    from nav_core.mounting.online_hypotheses import stack
    from nav_core.mounting.online_kernel import run
    from nav_core.mounting.online_model import Tuning
    from nav_core.mounting.online_rows import HORIZON, ready_fixes, records_of, rows_of
    from nav_core.mounting.online_stream import chunks_of

    state = begin()
    for chunk in chunks_of(drive, 60.0)[:5]:
        state = advance(state, chunk)
    later = chunks_of(drive, 60.0)[5]
    record, _ = records_of(later.ticks, None, later.gnss)
    since = float(record.fixes.t[20])
    ready = ready_fixes(record.fixes, since, float(record.fixes.t[22]) + HORIZON)
    rows, _ = rows_of(record, None, None, ready, state.lags, Tuning())
    filters, first, last, stacked = stack([state.filters] * boxes, [rows[1:2]] * boxes)
    return best(lambda: run(filters, stacked, first, last, Tuning(), np.zeros((0, 4))))


if __name__ == "__main__":
    main()
