"""`make bench`: what the hot paths cost on this machine, in one process, best of a few runs.

Prints a table; the figures that the README and docs quote come from here.
"""

from __future__ import annotations

import os
import platform
from pathlib import Path
from tempfile import TemporaryDirectory

from timing import best

from server.settings import set_numba_cache_dir


def main() -> None:
    """Measure and print, area by area; each area's script also runs alone."""
    set_numba_cache_dir()
    import attitude
    import navigation
    import sensors
    import strapdown

    print(f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}")
    for rows in (service, strapdown.rows, sensors.rows, attitude.rows, navigation.rows):
        for name, value, unit in rows():
            print(f"{name:<60}{value:>12.4g} {unit}")


def service() -> list[tuple[str, float, str]]:
    """Mounting, conditioning and formats."""
    from nav_core.mounting import estimate_mounting, whole_drive
    from nav_core.mounting.thesis import estimate_thesis
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
    steps = hour.gnss.t.size
    with TemporaryDirectory() as folder:
        path = Path(folder) / "hour.parquet"
        write_drive_file(path, from_drive(hour))
        return [
            ("simulate 300 s at 200 Hz", best(lambda: simulate(Scenario(duration=300.0), seed=2)), "s"),
            ("decimate 1 h of 200 Hz to 10 Hz", best(lambda: decimate(hour.inertial)), "s"),
            ("whole-drive estimate, 1 h of ticks", best(lambda: whole_drive.estimate(ticks, hour.gnss), repeat=3), "s"),
            (
                "Parquet file of 1 h at 200 Hz to a mounting",
                best(lambda: estimate_mounting(read_drive_file(path)), repeat=3),
                "s",
            ),
            ("thesis filter, 1 h at 4 Hz, per fix", 1e6 * best(lambda: estimate_thesis(hour)) / steps, "µs"),
            (
                "compact batch of 60 s at 200 Hz to columns",
                1e3 * best(lambda: compact.read(small, max_decoded_bytes=None)),
                "ms",
            ),
            ("Parquet batch of 60 s at 200 Hz to a drive", best(lambda: to_drive(Columns.from_parquet(packed))), "s"),
        ]


if __name__ == "__main__":
    main()
