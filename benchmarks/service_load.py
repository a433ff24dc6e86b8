"""The load on an installation, and what came of it: what `benchmarks/service.py` measures with."""

from __future__ import annotations

import asyncio
import itertools
import json
import math
import sys
import time
from collections.abc import AsyncGenerator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Self

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import httpx
import numpy as np
import orjson
import sqlalchemy as sa
from service_installation import CORES, TOKEN, Api, cpu_s, installation, start

from nav_core.simulate import Impact, Scenario, simulate
from server.database import make_engine
from server.events.window import between
from server.formats.columns import Columns
from server.formats.compact_write import write
from server.formats.drive import from_drive
from server.settings import Settings
from server.uploader import batches
from tests.e2e.service import alive, eventually

MINUTES = 20
# For how many uploads a second boxes are made before a measurement; where it takes more, they are made within it.
MOST_PER_S = 200.0
TYPES = {"compact": "application/vnd.scatola.batch", "json": "application/json"}


@cache
def bodies(encoding: str, seconds: float = 60.0) -> list[bytes]:
    """Batches of a simulated drive: 200 Hz three-axis and 4 Hz fixes."""
    drive, _ = simulate(Scenario(duration=60.0 * MINUTES, accel_rate=200.0, gnss_rate=4.0), seed=1)
    parts = list(batches(from_drive(drive), seconds))
    if encoding == "compact":
        return [write(part) for part in parts]
    return [orjson.dumps({"columns": _with_nulls(part)}) for part in parts]


def _with_nulls(part: Columns) -> dict[str, list[float | None]]:
    return {
        name: [None if math.isnan(value) else value for value in values.tolist()]
        for name, values in part.values.items()
    }


class Connection:
    """One kept-alive HTTP/1.1 connection that costs next to nothing: the client shares its core with the database."""

    def __init__(self, port: int) -> None:
        self._port = port

    async def __aenter__(self) -> Self:
        self._reader, self._writer = await asyncio.open_connection("127.0.0.1", self._port)
        return self

    async def __aexit__(self, *failure: object) -> None:
        self._writer.close()

    async def post(self, path: str, headers: dict[str, str], body: bytes) -> bytes:
        """Content of an answer; raises unless it is a success."""
        lines = [f"POST {path} HTTP/1.1", "Host: x", f"Content-Length: {len(body)}"]
        lines += [f"{name}: {value}" for name, value in headers.items()]
        self._writer.write("\r\n".join([*lines, "", ""]).encode() + body)
        head = await self._reader.readuntil(b"\r\n\r\n")
        length = int(head.lower().split(b"content-length:")[1].split(b"\r\n")[0])
        content = await self._reader.readexactly(length)
        if not head.startswith(b"HTTP/1.1 2"):
            raise ValueError(f"{head[:40]!r} {content[:300]!r}")
        return content


@dataclass
class Run:
    """What a stretch of load gave."""

    readings_each: int
    batches: int = 0
    wall_s: float = 0.0
    cpu_s: float = 0.0
    all_cpu_s: float = 0.0
    took_s: list[float] = field(default_factory=list)

    @property
    def readings(self) -> int:
        """Three-axis readings stored."""
        return self.batches * self.readings_each

    @property
    def per_s(self) -> float:
        """Batches a second."""
        return self.batches / self.wall_s

    @property
    def readings_per_s(self) -> float:
        """Readings a second."""
        return self.readings / self.wall_s

    @property
    def readings_per_cpu_s(self) -> float:
        """Readings per second of processor time of the API."""
        return self.readings / self.cpu_s

    def quantile(self, share: float) -> float:
        """So much of them took no longer, s."""
        return float(np.quantile(self.took_s, share))


async def make_box(api: Api) -> dict[str, str]:
    """Id and token of a new box."""
    async with Connection(api.port) as connection:
        headers = {"Authorization": f"Bearer {TOKEN}", "Content-Type": "application/json"}
        name = json.dumps({"name": f"box {next(api.boxes)}"}).encode()
        return orjson.loads(await connection.post("/api/v1/devices", headers, name))


async def parcels(api: Api, encoding: str, boxes: list[dict[str, str]]) -> AsyncGenerator[tuple[dict[str, str], bytes]]:
    """Batches without end of one box after the other; each sends its drive once, so no blob is there already.

    A connection has boxes of its own: a box sends its next batch when the last is acknowledged.
    """
    while True:
        box = boxes.pop() if boxes else await make_box(api)
        for sequence, body in enumerate(bodies(encoding)):
            yield headers_of(box["token"], "b", sequence, encoding), body


async def fleet(api: Api, batches: float, connections: int) -> list[dict[str, str]]:
    """Boxes for so many batches: they are there before the clock runs, for it is uploads that are measured."""
    return [await make_box(api) for _ in range(connections + math.ceil(batches / MINUTES))]


def headers_of(token: str, boot: str, sequence: int, encoding: str = "compact") -> dict[str, str]:
    """What an upload says of itself."""
    return {
        "Authorization": f"Bearer {token}",
        "Idempotency-Key": f"{boot}/{sequence}",
        "Content-Type": TYPES[encoding],
    }


async def saturate(api: Api, encoding: str, seconds: float, *, connections: int = 8) -> Run:
    """As much as goes: every connection sends the next batch when the last is acknowledged."""
    run = Run(200 * 60)

    async def client(until: float) -> None:
        source = parcels(api, encoding, boxes)
        async with Connection(api.port) as connection:
            while time.perf_counter() < until:
                headers, body = await anext(source)
                began = time.perf_counter()
                await connection.post("/api/v1/batches", headers, body)
                run.took_s.append(time.perf_counter() - began)
                run.batches += 1

    bodies(encoding)
    boxes: list[dict[str, str]] = []
    await client(time.perf_counter() + 1.0)  # warm
    boxes += await fleet(api, MOST_PER_S * seconds, connections)
    run = Run(200 * 60)
    began, cpu, all_cpu = time.perf_counter(), api.cpu_s(), api.all_cpu_s()
    await asyncio.gather(*(client(began + seconds) for _ in range(connections)))
    run.wall_s, run.cpu_s = time.perf_counter() - began, api.cpu_s() - cpu
    run.all_cpu_s = api.all_cpu_s() - all_cpu
    return run


async def paced(api: Api, encoding: str, seconds: float, per_s: float, *, connections: int = 32) -> Run:
    """At a rate, whether or not earlier ones were answered; what waits for a connection waits."""
    run = Run(200 * 60)
    due = iter(np.arange(0.0, seconds, 1.0 / per_s))
    boxes = await fleet(api, per_s * seconds, connections)
    began = time.perf_counter()

    async def client() -> None:
        source = parcels(api, encoding, boxes)
        async with Connection(api.port) as connection:
            for at in due:
                headers, body = await anext(source)
                await asyncio.sleep(max(0.0, began + at - time.perf_counter()))
                await connection.post("/api/v1/batches", headers, body)
                run.took_s.append(time.perf_counter() - began - at)
                run.batches += 1

    await asyncio.gather(*(client() for _ in range(connections)))
    run.wall_s = time.perf_counter() - began
    return run


async def fill(api: Api, count: int) -> None:
    """So many 5-minute batches of one drive, four of them a box."""
    parts = bodies("compact", 300.0)
    async with Connection(api.port) as connection:
        for number in range(count):
            if number % len(parts) == 0:
                box = await make_box(api)
            sequence = number % len(parts)
            await connection.post("/api/v1/batches", headers_of(box["token"], "b", sequence), parts[sequence])


@dataclass
class Worked:
    """What working off took, from the first result to the last."""

    wall_s: float
    cpu_s: float


def work_off(environment: dict[str, str], count: int, workers: int) -> Worked:
    """Let workers work off what waits; starting them is not counted."""
    engine = make_engine(
        Settings(data_dir=Path(environment["SCATOLA_DATA_DIR"]), database_url=environment["SCATOLA_DATABASE_URL"])
    )
    due = sa.text("SELECT count(*) FROM batch WHERE processed_at IS NULL")

    def waiting() -> int:
        with engine.connect() as connection:
            return int(connection.scalar(due) or 0)

    assert waiting() == count
    running = [start(["-m", "server.cli.main", "worker"], environment, set(CORES)) for _ in range(workers)]
    try:
        eventually(lambda: waiting() < count, within_s=120, what="the first result")
        began, cpu, left = time.perf_counter(), sum(cpu_s(each.pid) for each in running), waiting()
        eventually(lambda: waiting() == 0, within_s=3600, what="all is worked off")
        share = count / max(1, left)  # scaled to all: what was done before the clock began is left out
        took = Worked(share * (time.perf_counter() - began), share * (sum(cpu_s(each.pid) for each in running) - cpu))
    finally:
        for each in running:
            each.terminate()
        for each in running:
            each.wait(30)
        engine.dispose()
    return took


@dataclass
class Streamed:
    """What a streaming fleet saw."""

    boxes: int
    batches: int = 0
    reports_s: list[float] = field(default_factory=list)
    memory: list[tuple[int, float]] = field(default_factory=list)
    """Batches so far and resident memory of the API, MB, every few seconds."""

    def quantile(self, share: float) -> float:
        """So much of them took no longer, s."""
        return float(np.quantile(self.reports_s, share))

    def growth_mb(self) -> float:
        """Slope of the memory over the second half of the time, MB per 10 000 batches."""
        batches, memory_mb = np.array(self.memory[len(self.memory) // 2 :]).T
        return 1e4 * float(np.polyfit(batches, memory_mb, 1)[0])


async def stream_with_crashes(*, boxes: int, minutes: float) -> Streamed:
    """Boxes send a minute a minute; every few seconds one more sends a crash and its report is waited for."""
    found = Streamed(boxes)
    impact = Impact(t=150.0, delta_v=32.0 / 3.6, pdof=math.radians(-20.0), duration=0.11, speed=12.0)
    drive, _ = simulate(Scenario(duration=180.0, accel_rate=200.0, impacts=(impact,)), seed=5)
    burst = write(between(from_drive(drive), 145.0, 155.0))
    parts = bodies("compact")
    with installation("SQLite", whole=True) as api:
        tokens = [(await make_box(api))["token"] for _ in range(boxes)]
        until = time.monotonic() + 60.0 * minutes

        async def box(number: int) -> None:
            await asyncio.sleep(60.0 * number / boxes)
            for sequence in itertools.count():
                begins = time.monotonic()
                if begins >= until:
                    return
                async with Connection(api.port) as connection:
                    body = parts[sequence % len(parts)]
                    await connection.post(
                        "/api/v1/batches",
                        headers_of(tokens[number], f"b{sequence // len(parts)}", sequence % len(parts)),
                        body,
                    )
                found.batches += 1
                await asyncio.sleep(max(0.0, begins + 60.0 - time.monotonic()))

        async def crashes() -> None:
            while time.monotonic() < until - 10.0:
                found.reports_s.append(await _crash_to_report(api, burst))
                await asyncio.sleep(5.0)

        async def memory() -> None:
            while time.monotonic() < until:
                found.memory.append((found.batches, api.memory_mb()))
                await asyncio.sleep(min(5.0, minutes))

        await asyncio.gather(memory(), crashes(), *(box(number) for number in range(boxes)))
        assert alive(api.process.pid)
    return found


async def _crash_to_report(api: Api, burst: bytes) -> float:
    """Seconds from the burst's upload to its report in hand."""
    made = await make_box(api)
    began = time.monotonic()
    async with Connection(api.port) as connection:
        headers = headers_of(made["token"], "b", 0) | {"Scatola-Stream": "burst"}
        await connection.post("/api/v1/batches", headers, burst)
    admin = {"Authorization": f"Bearer {TOKEN}"}
    async with httpx.AsyncClient(base_url=api.url, headers=admin, timeout=30.0, trust_env=False) as client:
        while True:
            asked = {"device": made["id"], "kind": "crash"}
            items = (await client.get("/api/v1/events", params=asked)).raise_for_status().json()["items"]
            if items:
                report = await client.get(f"/api/v1/events/{items[0]['id']}/report.pdf")
                assert report.raise_for_status().content.startswith(b"%PDF")
                return time.monotonic() - began
            if time.monotonic() - began > 120.0:
                raise TimeoutError("no report within two minutes")
            await asyncio.sleep(0.1)
