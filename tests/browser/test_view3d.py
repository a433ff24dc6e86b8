from __future__ import annotations

import datetime as dt
import io
import logging
import math
import socket
import threading
import time
from collections.abc import Callable, Generator

import numpy as np
import pytest
import rich
import uvicorn
from PIL import Image
from playwright.sync_api import FrameLocator, Locator, expect
from sqlalchemy import select

from nav_core.rotation import thesis_to_matrix
from server.live.changes import announce
from server.models import Device, Installation
from server.view3d.viewer import create_viewer

# Software rendering on a busy machine: viser's page needs seconds to come up.
PATIENCE_MS = 90_000
# What viser's client says of its own libraries and of a machine without a graphics card.
CHATTER = ("THREE.", "WebGL", "GL Driver")


@pytest.fixture
def viewer(site, settings) -> Generator[None]:
    """A viewer behind the site, as `scatola serve` runs it."""
    rich.reconfigure(quiet=True)
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    config = uvicorn.Config(
        create_viewer(settings), host="127.0.0.1", port=port, log_config=None, timeout_graceful_shutdown=2
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    site.app.state.viewer_url = f"http://127.0.0.1:{port}"
    yield
    server.should_exit = True
    thread.join(10.0)
    rich.reconfigure(quiet=False)


def coloured(picture: bytes) -> dict[str, int]:
    """How many pixels are clearly red, green, blue and orange."""
    rgb = np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")).astype(int)
    r, g, b = rgb[..., 0], rgb[..., 1], rgb[..., 2]
    return {
        "red": int(((r > g + 60) & (np.abs(g - b) < 45)).sum()),
        "green": int(((g > r + 40) & (g > b + 15)).sum()),
        "blue": int(((b > r + 60) & (b > g + 25)).sum()),
        "orange": int(((r > g + 40) & (g > b + 35)).sum()),
    }


def wait_coloured(scene: Locator, enough: Callable[[dict[str, int]], bool]) -> dict[str, int]:
    """Colours of a scene once there is enough of them: a picture takes a frame, so looking again is the wait."""
    until = time.monotonic() + PATIENCE_MS / 1000.0
    while True:
        drawn = coloured(scene.screenshot(timeout=PATIENCE_MS))
        if enough(drawn) or time.monotonic() > until:
            assert enough(drawn), drawn
            return drawn


def dismiss_notice(frame: FrameLocator) -> None:
    """Close viser's notice about software rendering: it covers the scene, and its stripe is orange."""
    notice = frame.locator(".mantine-Notification-closeButton").first
    notice.click(timeout=PATIENCE_MS)
    expect(notice).to_be_hidden(timeout=PATIENCE_MS)


@pytest.mark.usefixtures("viewer")
def test_the_vehicle_page_shows_the_box_in_its_vehicle_and_follows_it(site, open_page, screenshot):
    name = "Lancia Ypsilon"
    page = open_page(f"/vehicles/{site.vehicles[name]}", expected=CHATTER)
    page.set_default_timeout(PATIENCE_MS)
    frame = page.frame_locator("scene-3d iframe")
    expect(frame.get_by_text("Calibrating · 35 %").first).to_be_visible(timeout=PATIENCE_MS)

    dismiss_notice(frame)
    picture = page.locator("scene-3d iframe")
    wait_coloured(picture, lambda drawn: min(drawn.values()) > 150)
    screenshot(page, "vehicle-view3d")

    turned = thesis_to_matrix(math.radians(100.0), 0.3, -0.4)
    with site.database.transaction() as session:
        device = session.scalars(select(Device).where(Device.vehicle_id == site.vehicles[name])).one()
        installation = session.scalars(select(Installation).where(Installation.device_id == device.id)).one()
        installation.status, installation.progress = "ready", 1.0
        sigma = {"x": 0.3, "y": 0.4, "z": 0.7}
        installation.result = {
            **installation.result, "status": "ready", "R_va": turned.tolist(), "sigma_deg": sigma, "reasons": [],
        }  # fmt: skip
        now = dt.datetime.now(dt.UTC)
        announce(session, "installation", at=now, organisation_id=device.organisation_id, device_id=device.id)
    expect(frame.get_by_text("Ready · ±0.7°").first).to_be_visible(timeout=PATIENCE_MS)


@pytest.mark.usefixtures("viewer")
def test_an_unknown_mounting_is_said_and_not_drawn(site, open_page, screenshot):
    phone = {"width": 390, "height": 800}
    page = open_page(f"/vehicles/{site.vehicles['Jeep Renegade']}", expected=CHATTER, viewport=phone)
    frame = page.frame_locator("scene-3d iframe")
    expect(frame.get_by_text("Box is not fixed").first).to_be_visible(timeout=PATIENCE_MS)
    expect(frame.locator(".mounting-words")).to_be_hidden()
    dismiss_notice(frame)
    # The vehicle's axes are there, the box is not.
    drawn = wait_coloured(page.locator("scene-3d iframe"), lambda drawn: drawn["red"] > 100)
    assert drawn["orange"] < 30
    screenshot(page, "vehicle-view3d-phone")
