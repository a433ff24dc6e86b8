"""The mounting in 3D: drawn, walked through, and missed with dignity."""

from __future__ import annotations

import datetime as dt
import re
import time

import numpy as np
import pytest
import sqlalchemy as sa
from playwright.sync_api import expect

from nav_core.rotation import matrix_to_thesis, rotvec_to_matrix
from server.models import Device, Installation, MountingRevision
from tests.browser.scenes import CHATTER, PATIENCE_MS, wait_coloured
from tests.browser.seeding import MOUNT

TURN = rotvec_to_matrix(np.array([0.0, 0.0, np.radians(38.0)]))


def estimate(R_va, sigma, status, reasons=()):
    euler = dict(zip(("theta", "phi", "psi"), np.degrees(matrix_to_thesis(R_va)).tolist(), strict=True))
    return {
        "status": status, "method": "whole-drive", "R_va": R_va.tolist(), "euler_deg": euler,
        "sigma_deg": dict(zip("xyz", sigma, strict=True)), "observability": 0.9, "reasons": list(reasons),
        "reason_codes": [], "percent": 100 if status == "ready" else 50,
    }  # fmt: skip


@pytest.fixture
def moved_box(site) -> str:
    """The first box was moved ten minutes ago, and its mounting came back in four steps."""
    now = dt.datetime.now(dt.UTC)
    with site.database.transaction() as session:
        device = session.scalars(sa.select(Device).where(Device.vehicle_id == site.vehicles["Fiat Panda"])).one()
        first = session.scalars(sa.select(Installation).where(Installation.device_id == device.id)).one()
        moved_at = now - dt.timedelta(minutes=10)
        first.ended_at = first.updated_at = moved_at
        session.execute(sa.delete(MountingRevision).where(MountingRevision.installation_id == first.id))
        common = {"algorithm": "whole-drive/2", "input_sha256": "1" * 64}
        after = TURN @ MOUNT
        steps = [
            ("settling", 0.2, (4.0, 5.0, 14.0), ["Make two turns."]),
            ("settling", 0.5, (1.5, 1.8, 6.0), ["Make one more turn."]),
            ("settling", 0.8, (0.7, 0.8, 2.4), ["Brake once more."]),
            ("ready", 1.0, (0.4, 0.5, 0.9), []),
        ]
        last = estimate(after, steps[-1][2], "ready")
        row = Installation(
            device_id=device.id, vehicle_id=device.vehicle_id, began_at=moved_at, updated_at=now, beginning="moved",
            moved_angle_rad=float(np.radians(38.0)), status="ready", progress=1.0, result=last, **common,
        )  # fmt: skip
        session.add(row)
        session.flush()
        for k, (status, progress, sigma, reasons) in enumerate(steps):
            at = moved_at + dt.timedelta(minutes=2 * k + 1)
            session.add(
                MountingRevision(
                    installation_id=row.id, data_at=at, created_at=at, status=status, progress=progress,
                    result=estimate(after, sigma, status, reasons), **common,
                )
            )  # fmt: skip
        return device.id


def state_of(page, url):
    return page.request.get(url).json()


@pytest.mark.usefixtures("viewer")
def test_the_history_is_walked_through_in_picture_and_words(open_page, screenshot, moved_box):
    began = time.monotonic()
    page = open_page(f"/devices/{moved_box}/mounting", expected=CHATTER)
    page.set_default_timeout(PATIENCE_MS)
    scene = page.locator("scene-3d")
    expect(scene).to_have_attribute("data-state", "open", timeout=PATIENCE_MS)
    connected = time.monotonic() - began
    drawn = wait_coloured(page.locator("scene-3d iframe"), lambda drawn: min(drawn.values()) > 150)
    print(f"connected after {connected:.1f} s, drawn after {time.monotonic() - began:.1f} s: {drawn}")
    # Scene state: all that the page's legend names.
    state = page.locator("scene-3d iframe").evaluate("frame => new URL('state', frame.src).href")
    told = state_of(page, state)
    parts = {"vehicle", "v_frame", "a_frame", "t_frame", "box", "cones", "gravity", "force"}
    assert parts <= set(told["drawn"])
    assert np.array(told["R_va"]) == pytest.approx(TURN @ MOUNT)
    assert np.linalg.norm(told["f_v_mps2"]) == pytest.approx(9.8, abs=3.0)
    narrow = np.array(told["cones_deg"])
    # A mere picture: viser's panel would show the ticket.
    expect(page.frame_locator("scene-3d iframe").locator(".mantine-Paper-root:visible")).to_have_count(0)
    screenshot(page, "mounting-now")

    # The earliest step after the move: wide cones, words for the driver, the box before it.
    slider = page.get_by_label("Through the history")
    ordered = page.locator("#moment").get_attribute("data-steps").split()
    assert len(ordered) == 6
    page.get_by_label("Where it was before a move").check()
    slider.fill("1")
    expect(page.locator("#moment")).to_contain_text("Make two turns.")
    expect(page.locator("#moment")).to_contain_text("Moved, calibrating again")
    expect(page.locator("#moment")).to_contain_text("38.0°")
    expect(scene).to_have_attribute("data-drawn", re.compile("before"))
    told = state_of(page, state)
    assert told["step"] == ordered[1]
    assert (np.array(told["cones_deg"])[:, 1] > 5.0 * narrow[:, 1]).all()
    assert f"step={ordered[1]}" in page.url, "every view has an address"
    screenshot(page, "mounting-before")
    page.get_by_role("link", name="Later").click()
    expect(page.locator("#moment")).to_contain_text("Make one more turn.")
    expect(slider).to_have_value("2")
    # The same in words: a row for each step, and what the arrows are.
    expect(page.locator("#table tbody tr")).to_have_count(6)
    expect(page.locator("#feels")).to_contain_text("specific force, measured")
    expect(page.locator("#feels")).to_contain_text("9.81")


@pytest.mark.usefixtures("viewer")
def test_a_viewer_that_goes_away_is_said_and_comes_back(site, open_page, moved_box, screenshot):
    phone = {"width": 390, "height": 844}
    page = open_page(f"/devices/{moved_box}/mounting", expected=(*CHATTER, "WebSocket"), viewport=phone)
    page.set_default_timeout(PATIENCE_MS)
    scene = page.locator("scene-3d")
    expect(scene).to_have_attribute("data-state", "open", timeout=PATIENCE_MS)
    screenshot(page, "mounting-phone")
    there = site.app.state.viewer_url
    site.app.state.viewer_url = "http://127.0.0.1:9"
    expect(page.get_by_text("The connection to the 3D view was lost")).to_be_visible(timeout=PATIENCE_MS)
    screenshot(page, "mounting-lost")
    page.get_by_role("button", name="Try again").click()
    expect(page.get_by_text("The 3D view is not running")).to_be_visible()
    site.app.state.viewer_url = there
    page.get_by_role("button", name="Try again").click()
    expect(scene).to_have_attribute("data-state", "open", timeout=PATIENCE_MS)
