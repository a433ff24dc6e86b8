"""How long the pages take: a fleet of thousands, and hours of samples, in Chromium on a service with a seeded database.

.venv/bin/python benchmarks/pages.py [--vehicles 5000] [--hours 6] [--serve] [--pictures FOLDER]
"""

from __future__ import annotations

import argparse
import datetime as dt
import random
import shutil
import statistics
import sys
import threading
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import uvicorn
from playwright.sync_api import Page, sync_playwright
from sqlalchemy import insert
from sqlalchemy.orm import Session

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from server.accounts.service import ensure_organisation
from server.app import create_app
from server.formats.columns import Columns
from server.migrations import upgrade
from server.models import Batch, Boot, Device, DeviceState, Installation, Trip, Vehicle, new_id
from server.settings import Settings
from server.store import BlobStore, blob_key

TOKEN = "measure"  # noqa: S105  of a service that nobody else reaches
RATE_HZ, BATCH_S = 200.0, 60.0
FLAGS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
TURN = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]


def seed_many(session: Session, organisation_id: str, count: int, *, now: dt.datetime) -> list[Device]:
    """Vehicles with boxes all over Italy, in all states, each with a month of trips."""
    draw = random.Random(1)  # noqa: S311  a fleet, not a secret
    result = {
        "R_va": TURN,
        "sigma_deg": {"x": 0.3, "y": 0.4, "z": 0.6},
        "reasons": [],
        "reason_codes": [],
        "percent": 100,
    }
    devices: list[Device] = []
    rows: list[Any] = []
    trips: list[dict[str, Any]] = []
    for number in range(count):
        seen = now - dt.timedelta(seconds=draw.choice((5, 40, 3600, 90_000)))
        vehicle = Vehicle(id=new_id(), organisation_id=organisation_id, name=f"Van {number:05d}", created_at=now)
        vehicle.plate = f"G{chr(65 + number % 26)} {number % 1000:03d} {chr(65 + number // 26 % 26)}X"
        device = Device(
            id=new_id(), organisation_id=organisation_id, name=f"SC-{number:05d}", token_hash=f"{number:064d}",
            created_at=now, vehicle_id=vehicle.id, last_seen_at=seen,
        )  # fmt: skip
        devices.append(device)
        status = draw.choice(("ready", "ready", "ready", "settling", "insufficient", "not_fixed"))
        common = {"device_id": device.id, "vehicle_id": vehicle.id, "algorithm": "seed/1", "input_sha256": "0" * 64}
        moved = draw.random() < 0.05
        rows += [
            DeviceState(
                device_id=device.id, updated_at=seen, position_at=seen, lat_deg=draw.gauss(44.0, 1.2),
                lon_deg=draw.gauss(11.0, 1.2), speed_mps=draw.uniform(0, 30), course_rad=0.0,
            ),
            Installation(
                **common, began_at=now - dt.timedelta(days=30), updated_at=seen, status=status, progress=draw.random(),
                beginning="moved" if moved else "first", result={**result, "status": status},
            ),
        ]  # fmt: skip
        for day in range(20):
            began = now - dt.timedelta(days=day, hours=draw.uniform(0, 12))
            trips.append(
                {
                    "id": new_id(), "organisation_id": organisation_id, "device_id": device.id, "boot": "b",
                    "vehicle_id": vehicle.id, "t_first_s": 0.0, "t_last_s": 1800.0, "began_at": began,
                    "ended_at": began + dt.timedelta(minutes=30), "under_way": False, "moving_s": 1500.0,
                    "distance_m": draw.uniform(1e3, 4e4), "position_distance_m": 1.0, "max_speed_mps": 30.0,
                    "algorithm": "seed/1", "input_sha256": "0" * 64,
                }
            )  # fmt: skip
        session.add(vehicle)
    session.flush()
    session.add_all(devices)
    session.flush()
    session.add_all(rows)
    session.flush()
    session.execute(insert(Trip), trips)
    return devices


def seed_hours(session: Session, store: BlobStore, device: Device, hours: float, *, now: dt.datetime) -> None:
    """Three axes at 200 Hz and speed at 4 Hz, in batches of a minute, until now; a blow of 12 g halfway."""
    rng = np.random.default_rng(2)
    total = hours * 3600.0
    session.add(
        Boot(
            device_id=device.id, boot="b1", ordinal=1, utc_offset_s=now.timestamp() - total, utc_sigma_s=0.1,
            utc_source="gnss", arrival_offset_s=0.0, t_first_s=0.0, t_last_s=total,
        )
    )  # fmt: skip
    for sequence in range(round(total / BATCH_S)):
        t = sequence * BATCH_S + np.arange(0.0, BATCH_S, 1.0 / RATE_HZ)
        f = np.round((rng.normal(0.0, 0.4, (t.size, 3)) + np.sin(t / 60.0)[:, None]) / 0.0024) * 0.0024
        f[:, 2] -= 9.81
        if sequence == round(total / BATCH_S / 2):
            f[100, 0] = 118.0
        speed = np.where(np.arange(t.size) % 50 == 0, 15.0 + 10.0 * np.sin(t / 300.0), np.nan)
        part = Columns({"t": t, "fx": f[:, 0], "fy": f[:, 1], "fz": f[:, 2], "speed": speed})
        data = part.to_parquet()
        key = blob_key(device.organisation_id, device.id, part.column_sha256(), "parquet")
        store.put(key, data)
        session.add(
            Batch(
                organisation_id=device.organisation_id, device_id=device.id, stream="continuous", boot="b1",
                sequence=sequence, media_type="application/vnd.apache.parquet", body_sha256="0" * 64,
                column_sha256=part.column_sha256(), blob_key=key, stored_bytes=len(data), rows=part.rows,
                t_first_s=float(t[0]), t_last_s=float(t[-1]), received_at=now, chain_index=sequence,
                chain_sha256="0" * 64, processed_at=now,
            )
        )  # fmt: skip


CLOCKS = """(() => {
  // Seconds by the page's own clock, from the beginning of its navigation.
  const look = () => {
    const live = document.getElementById("live")?.dataset.state === "on";
    if (live) window.liveAt ??= performance.now() / 1000;
    if (live && document.querySelector("#boxes tbody tr")) window.listAt ??= performance.now() / 1000;
    if (document.querySelector("fleet-map[data-marks]")) window.marksAt ??= performance.now() / 1000;
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
  // From the press of a button or the end of a drag to the frame after the one that draws what was asked for.
  let began = 0;
  const begin = () => {
    began = performance.now();
    document.querySelector("signal-chart")?.removeAttribute("data-points");
  };
  addEventListener("mouseup", begin, true);
  new MutationObserver((changes) => {
    if (began && changes.some((one) => one.attributeName === "data-points" && one.target.dataset.points))
      requestAnimationFrame(() => requestAnimationFrame(() => {
        window.drawnIn = (performance.now() - began) / 1000; began = 0; window.drawn = (window.drawn ?? 0) + 1;
      }));
  }).observe(document, { subtree: true, attributes: true, attributeFilter: ["data-points"] });
})()"""


def measure(page: Page, address: str, device: Device) -> dict[str, float]:
    """Seconds; the middle of several where it is repeated."""
    found: dict[str, float] = {}

    def opened(name: str, path: str, mark: str, repeat: int = 5) -> None:
        spans = []
        for _ in range(repeat):
            page.goto(address + path, wait_until="commit")
            page.wait_for_function(f"window.{mark}")
            spans.append(page.evaluate(f"window.{mark}"))
        found[name] = statistics.median(spans)

    page.goto(address)  # what is kept by the browser is there from now on, as for whoever comes back
    opened("fleet page: list usable, live", "/", "listAt")
    opened("fleet page: marks handed to the map", "/", "marksAt")
    opened("fleet page sorted by distance", "/?sort=distance&down=1", "listAt")
    opened("vehicle page: usable, live", f"/vehicles/{device.vehicle_id}", "liveAt")
    chart = page.locator("signal-chart")
    chart.scroll_into_view_if_needed()
    page.wait_for_function("document.querySelector('signal-chart').dataset.points")

    def window(press: Any) -> float:
        before = page.evaluate("window.drawn ?? 0")
        press()
        page.wait_for_function(f"window.drawn > {before}")
        return page.evaluate("window.drawnIn")

    six = page.locator('signal-chart button[value="21600"]')
    found["signals: 6 h of 200 Hz, three axes, the first time"] = window(six.click)
    found["signals: the same again"] = statistics.median(window(six.click) for _ in range(3))
    over = page.locator('[data-plot="force"] .u-over')
    box = over.bounding_box()
    assert box is not None

    def zoom() -> None:
        page.mouse.move(box["x"] + 0.42 * box["width"], box["y"] + 60)
        page.mouse.down()
        page.mouse.move(box["x"] + 0.62 * box["width"], box["y"] + 60)
        page.mouse.up()

    spans = [window(zoom) for _ in range(8)]
    found["signals: a zoom, the middle of eight"] = statistics.median(spans)
    found["signals: a zoom, the slowest of eight"] = max(spans)
    return found


def main() -> None:
    """Seed, serve, measure, print."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--vehicles", type=int, default=5000)
    asked.add_argument("--hours", type=float, default=6.0)
    asked.add_argument("--serve", action="store_true", help="leave the service running and do not measure")
    options = asked.parse_args()
    with TemporaryDirectory() as data:
        settings = Settings(data_dir=Path(data), admin_token=TOKEN)  # type: ignore[arg-type]
        upgrade(settings)
        app = create_app(settings)
        now = dt.datetime.now(dt.UTC)
        with app.state.database.transaction() as session:
            organisation_id = ensure_organisation(session, now=now).id
            devices = seed_many(session, organisation_id, options.vehicles, now=now)
            seed_hours(session, app.state.store, devices[0], options.hours, now=now)
        server = uvicorn.Server(
            uvicorn.Config(app, host="127.0.0.1", port=8123 if options.serve else 0, log_config=None)
        )
        thread = threading.Thread(target=server.run, daemon=True)
        thread.start()
        while not server.started:
            time.sleep(0.01)
        address = f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
        if options.serve:
            print(address, devices[0].vehicle_id, flush=True)
            thread.join()
            return
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
            # Waiting for a function evaluates it in the page, which the pages' own policy forbids.
            context = browser.new_context(viewport={"width": 1280, "height": 900}, bypass_csp=True)
            context.add_init_script(CLOCKS)
            context.request.post(f"{address}/api/v1/auth/session", data={"code": TOKEN})
            for name, seconds in measure(context.new_page(), address, devices[0]).items():
                print(f"| {name} | {seconds:.3f} s |", flush=True)
            browser.close()
        server.should_exit = True
        thread.join(10.0)


if __name__ == "__main__":
    main()
