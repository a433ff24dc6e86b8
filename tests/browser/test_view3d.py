from __future__ import annotations

import datetime as dt
import math

import pytest
from playwright.sync_api import expect
from sqlalchemy import select

from nav_core.rotation import thesis_to_matrix
from server.live.changes import announce
from server.models import Device, Installation
from tests.browser.scenes import CHATTER, PATIENCE_MS, dismiss_notice, wait_coloured


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
