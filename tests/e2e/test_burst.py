"""From a burst's upload to its report on the dashboard, in the embedded mode with real processes."""

from __future__ import annotations

import math
import threading
import time

import httpx
import numpy as np
import pytest

from nav_core.simulate import Impact, Scenario, simulate
from server.events.window import between
from server.formats.drive import from_drive
from server.uploader import Uploader, batches
from tests.e2e.service import Service, eventually

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

BURSTS = 12
BAR_S = 3.0
T0 = 150.0


def test_the_report_is_there_soon_after_the_burst(tmp_path):
    with Service(tmp_path / "data", "serve") as service, service.client() as admin:
        walk(service, admin)


def walk(service: Service, admin: httpx.Client):
    impact = Impact(t=T0, delta_v=32.0 / 3.6, pdof=math.radians(-20.0), duration=0.11, speed=12.0)
    drive, _ = simulate(Scenario(duration=180.0, accel_rate=200.0, impacts=(impact,)), seed=5)
    columns = from_drive(drive)
    burst = between(columns, T0 - 5.0, T0 + 5.0)
    context = list(batches(between(columns, 0.0, T0 - 10.0), 20.0))

    def box(n: int) -> tuple[str, str]:
        made = admin.post("/api/v1/devices", json={"name": f"box {n}"}).raise_for_status().json()
        return made["id"], made["token"]

    def uploader(token: str, stream: str) -> Uploader:
        return Uploader(client, token, "b-1", wait=time.sleep, stream=stream)

    with httpx.Client(base_url=service.url, timeout=20.0, trust_env=False) as client:
        boxes = [box(n) for n in range(BURSTS)]
        # The first box has driven before, so its mounting is known; the others' context is still to come.
        for sequence, batch in enumerate(context):
            uploader(boxes[0][1], "continuous").send(sequence, batch)
        known = f"/api/v1/devices/{boxes[0][0]}/installation"
        eventually(lambda: admin.get(known).json()["R_va"] is not None, within_s=60, what="the first box is mounted")

        def feed(token: str) -> None:
            for sequence, batch in enumerate(context[-3:]):
                uploader(token, "continuous").send(sequence, batch)

        took: list[float] = []
        feeders: list[threading.Thread] = []
        for device, token in boxes:
            uploader(token, "burst").send(0, burst)
            began = time.monotonic()
            (event,) = eventually(
                lambda device=device: admin.get("/api/v1/events", params={"device": device, "kind": "crash"}).json()[
                    "items"
                ],
                within_s=60,
                what="the event",
            )
            assert admin.get(f"/events/{event['id']}").raise_for_status().text.count("Change of velocity")
            assert admin.get(f"/api/v1/events/{event['id']}/report.pdf").raise_for_status().content.startswith(b"%PDF")
            took.append(time.monotonic() - began)
            # Its context arrives while the next burst is measured: a backlog must not hold that up.
            if device != boxes[0][0]:
                feeders.append(threading.Thread(target=feed, args=(token,)))
                feeders[-1].start()
        for feeder in feeders:
            feeder.join()
        p95 = float(np.quantile(took, 0.95))
        print(f"burst to report: median {np.median(took):.2f} s, p95 {p95:.2f} s, first {took[0]:.2f} s")
        first = admin.get("/api/v1/events", params={"device": boxes[0][0], "kind": "crash"}).json()["items"][0]
        assert first["basis"]["mounting_status"] in ("ready", "settling")
        assert first["delta_v_kmh"]["resultant"] == pytest.approx(32.0, rel=0.1)
    assert p95 <= BAR_S
    assert service.stop() == 0
