"""`make bench-service`: the whole service under load, in processes, data folders and servers of its own.

.venv/bin/python benchmarks/service.py [PART ...] [--short] [--minutes M] [--write docs/service-benchmark.md]

Parts: ingest, rows, worker, crash, restore; all when none is named. The API is one process on the first core;
client, PostgreSQL and RabbitMQ have the others. A page that is there keeps the sections of parts that do not run.
"""

from __future__ import annotations

import argparse
import asyncio
import datetime as dt
import os
import platform
import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import service_load as load
import service_rows
from service_installation import OTHERS, Api, installation
from timing import Row, markdown, print_rows

from server.backup.archive import backup, restore
from server.settings import Settings
from tests.e2e.servers import OwnPostgres, OwnRabbit

PREFACE = """# The service under load

Written by `make bench-service WRITE=docs/service-benchmark.md`; `benchmarks/service.py` has the parts, each
selectable. Every table says on what machine and under which load it was taken: where the load average is above one or
two, other work shared the cores, and rates and latencies are those of what was left. "By processor time" is what one
core gives when nothing else wants it: the readings over the processor time that the API process spent on them.
"""
PARTS = ("ingest", "rows", "worker", "crash", "restore")


def main() -> None:
    """Measure part by part."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--short", action="store_true", help="seconds instead of minutes")
    parser.add_argument("--minutes", type=float, help="of the fleet that streams (30, short 1)")
    parser.add_argument("--write", type=Path, metavar="PAGE.md")
    args = parser.parse_args()
    if unknown := set(args.parts) - set(PARTS):
        parser.error(f"no such part: {', '.join(sorted(unknown))}")
    # The API's processes are put on the first core when they start; all else stays off it.
    os.sched_setaffinity(0, OTHERS)
    for part in args.parts or PARTS:
        before = os.getloadavg()[0]
        title, rows = MEASURES[part](args)
        print(f"\n{title}")
        print_rows(rows)
        machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
        loads = f"load average {before:.1f} before, {os.getloadavg()[0]:.1f} after"
        told = f"{dt.datetime.now(dt.UTC):%Y-%m-%d}, {machine}; {loads}"
        how = f"`python benchmarks/service.py {part}{' --short' if args.short else ''}`"
        if args.write:
            _keep(args.write, title, f"{markdown(title, rows)}\n{told}; {how}\n")


def _keep(page: Path, title: str, section: str) -> None:
    """Put a section into a page in place of an earlier one of that title."""
    text = page.read_text(encoding="utf-8") if page.exists() else PREFACE
    old = re.compile(rf"## {re.escape(title)}\n.*?(?=\n## |\Z)", re.DOTALL)
    text = old.sub(lambda _: section, text) if old.search(text) else f"{text}\n{section}"
    page.write_text(text, encoding="utf-8")


def ingest(args: argparse.Namespace) -> tuple[str, list[Row]]:
    """Readings a second, and latency at 70 % of that, by database and format; boxes are registered before."""
    seconds = 8.0 if args.short else 30.0
    rows: list[Row] = []
    for database in ("SQLite", "PostgreSQL"):
        for encoding, bar in (("compact", "≥ 1.5 M/s"), ("json", "≥ 0.3 M/s")):
            with installation(database) as api:
                full = asyncio.run(load.saturate(api, encoding, seconds))
                paced = asyncio.run(load.paced(api, encoding, seconds, 0.7 * full.per_s))
            what = f"{database}, {encoding}"
            rows += [
                Row(f"{what}: three-axis readings a second", full.readings_per_s / 1e6, "M/s", bar),
                Row(f"{what}: the same by processor time", full.readings_per_cpu_s / 1e6, "M/s"),
                Row(f"{what}: median at 70 % of that", 1e3 * paced.quantile(0.5), "ms"),
                Row(f"{what}: p99 at 70 % of that", 1e3 * paced.quantile(0.99), "ms", "≤ 150 ms"),
            ]
    return "Ingest, one API process on one core", rows


def rows_side_by_side(args: argparse.Namespace) -> tuple[str, list[Row]]:
    """Columns in blobs against a row per reading, the same bodies in one run."""
    seconds = 8.0 if args.short else 30.0
    with installation("PostgreSQL") as api:
        ours = asyncio.run(load.saturate(api, "compact", seconds))
        bytes_ours = api.stored_bytes() / ours.readings
    ours_per_cpu = ours.readings / ours.all_cpu_s
    rows = [
        Row("columns: readings a second", ours.readings_per_s / 1e6, "M/s"),
        Row("columns: bytes per reading on disk, blobs and tables", bytes_ours, "B", "≤ 4 B"),
    ]
    with service_rows.serving(service_rows.NOTHING) as rival:
        ceiling = asyncio.run(load.saturate(rival, "compact", seconds))
    rows.append(Row("received and decoded, nothing stored: readings a second", ceiling.readings_per_s / 1e6, "M/s"))
    for how, bar in (("row", "≥ 10 x"), ("array", "")):
        with service_rows.serving(how) as rival:
            theirs = asyncio.run(load.saturate(rival, "compact", seconds))
            bytes_theirs = service_rows.stored_bytes(rival) / theirs.readings
        name = service_rows.WRITERS[how]
        rows += [
            Row(f"{name}: readings a second", theirs.readings_per_s / 1e6, "M/s"),
            Row(
                f"columns over {name}, processor time with PostgreSQL's",
                ours_per_cpu * theirs.all_cpu_s / theirs.readings,
                "x",
            ),
            Row(f"columns over {name}", ours.readings_per_s / theirs.readings_per_s, "x", bar),
            Row(f"nothing stored over {name}: the ceiling", ceiling.readings_per_s / theirs.readings_per_s, "x"),
            Row(f"{name}: bytes per reading on disk, table and index", bytes_theirs, "B"),
        ]
    return "A row per reading by COPY, side by side", rows


def worker(args: argparse.Namespace) -> tuple[str, list[Row]]:
    """From 500 waiting 5-minute batches to updated mountings; the API is stopped."""
    count = 60 if args.short else 500
    took: dict[int, load.Worked] = {}
    for workers in (1, 2):
        with OwnRabbit(OTHERS) as rabbit, installation("PostgreSQL", broker_url=rabbit.url) as api:
            asyncio.run(load.fill(api, count))
            api.stop()
            took[workers] = load.work_off(api.environment, count, workers)
    one, two = took[1], took[2]
    return "Worker, 5-minute batches of 200 Hz to mountings", [
        Row("one worker: batches a second", count / one.wall_s, "/s"),
        Row("one worker: batches per second of processor time", count / one.cpu_s, "/s", "≥ 20 a core"),
        Row("two workers: batches a second", count / two.wall_s, "/s"),
        Row("processor time a batch, two workers over one", two.cpu_s / one.cpu_s, "x", "≤ 1.15 x"),
        Row("wall time, one worker over two", one.wall_s / two.wall_s, "x"),
    ]


def crash(args: argparse.Namespace) -> tuple[str, list[Row]]:
    """500 boxes send a minute a minute; now and then one has crashed. Memory of the API the while."""
    minutes = args.minutes or (1.0 if args.short else 30.0)
    found = asyncio.run(load.stream_with_crashes(boxes=100 if args.short else 500, minutes=minutes))
    return "Crash to report while a fleet streams", [
        Row("boxes that stream", found.boxes, ""),
        Row("batches acknowledged", found.batches, ""),
        Row("crashes", len(found.reports_s), ""),
        Row("burst sent to report read, median", found.quantile(0.5), "s"),
        Row("burst sent to report read, p95", found.quantile(0.95), "s", "≤ 5 s"),
        Row("minutes", minutes, ""),
        Row("memory of the API after half of the time", found.memory[len(found.memory) // 2][1], "MB"),
        Row("its growth over the second half, per 10 000 batches", found.growth_mb(), "MB", "flat"),
        Row("the most", max(mb for _, mb in found.memory), "MB", "≤ 400 MB"),
    ]


def restored(args: argparse.Namespace) -> tuple[str, list[Row]]:
    """A backup while uploads go on, and what comes back."""
    seconds = 6.0 if args.short else 30.0
    rows: list[Row] = []
    for database in ("SQLite", "PostgreSQL"):
        with installation(database) as api, OwnPostgres(OTHERS) as other:
            into = {"database_url": other.url} if database == "PostgreSQL" else {"database_url": None}
            settings = Settings(data_dir=api.folder / "data", database_url=api.database_url)
            out = api.folder / "backup"
            content, run = asyncio.run(_backed_up(api, settings, out, seconds))
            back = restore(Settings(data_dir=api.folder / "other", **into), out)
            rows += [
                Row(f"{database}: batches stored meanwhile", run.batches, ""),
                Row(f"{database}: equal by content hash", float(back.content_sha256 == content), "", "1"),
            ]
    return "Restore of a backup taken under load", rows


async def _backed_up(api: Api, settings: Settings, out: Path, seconds: float) -> tuple[str, load.Run]:
    """Hash of a backup's content, and what was stored meanwhile."""
    streaming = asyncio.create_task(load.saturate(api, "compact", seconds, connections=2))
    await asyncio.sleep(seconds / 3)  # so that there is something to keep
    taken = await asyncio.to_thread(backup, settings, out, now=dt.datetime.now(dt.UTC))
    return taken.content_sha256, await streaming


MEASURES = {"ingest": ingest, "rows": rows_side_by_side, "worker": worker, "crash": crash, "restore": restored}

if __name__ == "__main__":
    main()
