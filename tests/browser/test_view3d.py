from __future__ import annotations

import datetime as dt
import math
import re
import time

import numpy as np
import pytest
from playwright.sync_api import expect
from sqlalchemy import select

from nav_core.rotation import thesis_to_matrix
from server.live.changes import announce
from server.models import Device, Installation
from tests.browser.scenes import CHATTER, PATIENCE_MS, wait_coloured


@pytest.mark.usefixtures("viewer")
def test_the_vehicle_page_shows_the_box_in_its_vehicle_and_follows_it(site, open_page, screenshot):
    name = "Lancia Ypsilon"
    page = open_page(f"/vehicles/{site.vehicles[name]}", expected=CHATTER)
    page.set_default_timeout(PATIENCE_MS)
    scene = page.locator("scene-3d")
    expect(scene).to_have_attribute("data-state", "open", timeout=PATIENCE_MS)
    expect(scene).to_have_attribute("data-drawn", re.compile("cones"), timeout=PATIENCE_MS)
    picture = page.locator("scene-3d iframe")
    # A mere picture: viser's own panel and notices speak English only.
    expect(page.frame_locator("scene-3d iframe").locator(".mantine-Paper-root:visible")).to_have_count(0)
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
    state = picture.evaluate("frame => new URL('state', frame.src).href")
    until = time.monotonic() + PATIENCE_MS / 1000.0
    while not np.allclose(page.request.get(state).json()["R_va"], turned):
        assert time.monotonic() < until, "the scene does not follow"


@pytest.mark.usefixtures("viewer")
def test_the_charts_cursor_is_one_with_the_scene(site, open_page, screenshot):
    page = open_page(f"/vehicles/{site.vehicles['Fiat Panda']}", expected=CHATTER)
    page.set_default_timeout(PATIENCE_MS)
    scene = page.locator("scene-3d")
    expect(scene).to_have_attribute("data-state", "open", timeout=PATIENCE_MS)
    state = page.locator("scene-3d iframe").evaluate("frame => new URL('state', frame.src).href")
    expect(page.locator("signal-chart")).to_have_attribute("data-points", re.compile("[1-9]"))
    over = page.locator('[data-plot="force"] .u-over')
    over.scroll_into_view_if_needed()
    over.hover(position={"x": 300, "y": 60})
    shown = page.locator('.chart-key [data-now^="force"]')
    expect(shown.first).to_have_text(re.compile(r"\d\.\d\d"))
    wanted = [float(text.replace("\N{MINUS SIGN}", "-")) for text in shown.all_inner_texts()]
    until = time.monotonic() + PATIENCE_MS / 1000.0
    while not np.allclose(page.request.get(state).json()["f_v_mps2"] or [0.0, 0.0, 0.0], wanted, atol=0.011):
        assert time.monotonic() < until, "the arrow is not that of the cursor"
    screenshot(page, "vehicle-cursor")


@pytest.mark.usefixtures("viewer")
def test_an_unknown_mounting_is_said_and_not_drawn(site, open_page, screenshot):
    phone = {"width": 390, "height": 800}
    page = open_page(f"/vehicles/{site.vehicles['Jeep Renegade']}", expected=CHATTER, viewport=phone)
    page.set_default_timeout(PATIENCE_MS)
    expect(page.locator("#mounting")).to_contain_text("Box is not fixed")
    page.locator("scene-3d").scroll_into_view_if_needed()
    expect(page.locator("scene-3d")).to_have_attribute("data-drawn", re.compile("unknown"), timeout=PATIENCE_MS)
    # The vehicle's axes are there, the box is not.
    drawn = wait_coloured(page.locator("scene-3d iframe"), lambda drawn: drawn["red"] > 100)
    assert drawn["orange"] < 30
    screenshot(page, "vehicle-view3d-phone")
