"""The fleet manager's way: what needs attention, the list narrowed, kept and taken along, a vehicle and its trip."""

from __future__ import annotations

import datetime as dt
import re

import numpy as np
import pytest
import sqlalchemy as sa
from playwright.sync_api import expect

from server.live.changes import announce
from server.models import Device, DeviceState, Installation, Vehicle
from tests.browser.test_pages import css, wait_drawn

PHONE = {"width": 390, "height": 844}


def test_from_attention_to_a_kept_view_and_a_file(open_page, screenshot):
    page = open_page("/")
    page.locator(".tile").filter(has_text="Silent").get_by_role("link", name="Silent").click()
    expect(page).to_have_url(re.compile(r"show=silent"))
    rows = page.locator("#boxes tbody tr")
    expect(rows).to_have_count(2)
    expect(page.locator("fleet-map")).to_have_attribute("data-marks", "1")
    page.evaluate("window.stillTheSamePage = true")
    page.get_by_role("link", name=re.compile("^All ")).click()
    expect(rows).to_have_count(6)
    page.get_by_role("link", name="Last seen").click()
    expect(page.locator('#boxes th[aria-sort="descending"]')).to_contain_text("Last seen")
    expect(rows.last).to_contain_text("never")
    assert page.evaluate("window.stillTheSamePage")
    page.go_back()
    expect(page.locator('#boxes th[aria-sort="ascending"]')).to_contain_text("Vehicle")
    page.go_forward()
    expect(page.locator('#boxes th[aria-sort="descending"]')).to_contain_text("Last seen")

    page.get_by_text("Views").click()
    page.get_by_label("Name of the view").fill("Newest first")
    page.get_by_role("button", name="Keep").click()
    expect(page).to_have_url(re.compile(r"sort=seen"))
    page.goto("/")
    page.get_by_text("Views").click()
    page.get_by_role("link", name="Newest first").click()
    expect(page.locator('#boxes th[aria-sort="descending"]')).to_contain_text("Last seen")
    screenshot(page, "manager-list")
    with page.expect_download() as taken:
        page.get_by_role("link", name="CSV").click()
    lines = taken.value.path().read_text().splitlines()
    assert lines[0].startswith("vehicle,plate,class,box,state")
    assert len(lines) == 7
    page.get_by_text("Views").click()
    page.get_by_role("button", name="Forget the view Newest first").click()
    page.get_by_text("Views").click()
    expect(page.get_by_text("No saved view yet.")).to_be_visible()


def test_the_search_leads_to_the_vehicle(site, open_page):
    page = open_page("/events")
    page.keyboard.press("/")
    page.keyboard.type("ga101")
    page.keyboard.press("Enter")
    expect(page).to_have_url(f"{site.address}/vehicles/{site.vehicles['Fiat Panda']}")
    page.get_by_role("searchbox", name="Search for").fill("Piaggio nothing")
    page.keyboard.press("Enter")
    expect(page.locator("#boxes")).to_contain_text("Nothing fits.")


def test_keys_walk_the_list(site, open_page):
    page = open_page("/vehicles")
    page.keyboard.press("j")
    page.keyboard.press("j")
    expect(page.get_by_role("link", name="Iveco Daily")).to_be_focused()
    page.keyboard.press("k")
    expect(page.get_by_role("link", name="Fiat Panda")).to_be_focused()
    page.keyboard.press("?")
    expect(page.get_by_role("dialog")).to_be_visible()
    page.keyboard.press("Escape")
    page.keyboard.press("j")
    page.keyboard.press("Enter")
    expect(page).to_have_url(f"{site.address}/vehicles/{site.vehicles['Iveco Daily']}")


def test_language_units_and_zone_are_the_readers(site, open_page):
    page = open_page("/account", timezone_id="Asia/Tokyo")
    page.get_by_label("Language", exact=True).select_option("it")
    page.get_by_label("Units").select_option("imperial")
    page.get_by_role("button", name="Save", exact=True).click()
    expect(page.get_by_role("heading", level=1)).to_have_text("Profilo")
    page.goto(f"/vehicles/{site.vehicles['Lancia Ypsilon']}")
    expect(page.locator("#mounting")).to_contain_text("Manca ancora")
    expect(page.locator("#mounting")).to_contain_text("±6,5")
    page.goto(f"/vehicles/{site.vehicles['Fiat Panda']}")
    expect(page.locator("#trips")).to_contain_text("mph")
    expect(page.locator(".chart-head .unit").first).to_have_text("mph")
    expect(page.locator("#zone")).to_contain_text("Asia/Tokyo")
    time = page.locator("#trips time").first
    local = time.inner_text()
    page.keyboard.press("z")
    expect(page.locator("#zone")).to_contain_text("UTC")
    expect(time).not_to_have_text(local)
    page.reload()
    expect(page.locator("#zone")).to_contain_text("UTC")


def test_the_map_follows_and_reframes(site, open_page):
    page = open_page("/")
    expect(page.locator("fleet-map")).to_have_attribute("data-marks", "5")
    now = dt.datetime.now(dt.UTC)
    with site.database.transaction() as session:
        vehicle = Vehicle(organisation_id=site.organisation_id, name="Far away", created_at=now)
        session.add(vehicle)
        session.flush()
        device = Device(
            organisation_id=site.organisation_id, name="SC-far", token_hash="f" * 64, created_at=now,
            vehicle_id=vehicle.id, last_seen_at=now,
        )  # fmt: skip
        session.add(device)
        session.flush()
        session.add(DeviceState(device_id=device.id, updated_at=now, position_at=now, lat_deg=64.1, lon_deg=-21.9))
        announce(session, "device", at=now, organisation_id=site.organisation_id, device_id=device.id)
    expect(page.locator("fleet-map")).to_have_attribute("data-marks", "6")
    # Greenland comes into view only when the map is framed anew around Iceland and Italy.
    wait_drawn(page.locator("fleet-map"), css(page, "unknown-fill"), 30)


def test_a_trip_is_chosen_and_its_cursor_is_one(site, open_page, screenshot):
    page = open_page(f"/vehicles/{site.vehicles['Fiat Panda']}")
    track = page.locator("track-map")
    track.scroll_into_view_if_needed()
    expect(track).to_have_attribute("data-points", "240")
    page.locator("#trips tbody a").first.click()
    expect(page).to_have_url(re.compile(r"trip="))
    page.get_by_role("button", name="The trip").click()
    expect(page).to_have_url(re.compile(r"from=.*to="))
    wait_drawn(page.locator('[data-plot="force"] canvas'), css(page, "axis-z"), 200)
    over = page.locator('[data-plot="speed"] .u-over')
    over.scroll_into_view_if_needed()
    over.hover(position={"x": 300, "y": 60})
    expect(track).to_have_attribute("data-cursor", re.compile(r"\d+"))
    address = page.url
    page.goto(address)
    expect(page.locator("signal-chart")).to_have_attribute("data-points", re.compile(r"[1-9]"))
    screenshot(page, "manager-vehicle")
    for words in ("100 Hz", "32 °C", "not recorded", "Some rows came out of order and were sorted."):
        expect(page.locator("#health")).to_contain_text(words)
    expect(page.locator("#progress").get_by_role("img")).to_have_accessible_name("1-sigma fell from 40.0° to 0.6°")
    page.set_viewport_size(PHONE)
    screenshot(page, "manager-vehicle-phone")


def test_a_mounting_is_set_by_hand_with_a_reason(site, open_page):
    page = open_page(f"/vehicles/{site.vehicles['Piaggio Porter']}")
    for name, value in (("θ", "10"), ("φ", "-20"), ("ψ", "30")):
        page.get_by_label(re.compile(f"^{name}")).fill(value)
    button = page.get_by_role("button", name="Set this mounting")
    button.click()
    expect(page.locator("#installations")).to_contain_text("Not yet")  # the browser asks for the reason first
    page.get_by_label("Reason").fill("measured with a level")
    button.click()
    expect(page.locator("#installations")).to_contain_text("Set by hand: measured with a level")
    expect(page.locator("#mounting")).to_contain_text("Ready")
    expect(page.locator("#mounting")).to_contain_text("+30.0")
    with site.database.reading() as session:
        row = session.scalars(
            sa.select(Installation).where(Installation.vehicle_id == site.vehicles["Piaggio Porter"])
        ).one()
        assert row.beginning == "manual"
        assert np.degrees(np.arccos((np.trace(row.result["R_va"]) - 1.0) / 2.0)) == pytest.approx(36.6, abs=1.5)
        assert row.result["sigma_deg"] == {"x": 1.0, "y": 1.0, "z": 1.0}


def test_the_rail_of_a_phone(open_page):
    page = open_page("/", viewport=PHONE)
    rail = page.get_by_role("navigation", name="Sections")
    expect(rail.get_by_role("link", name="Administration")).to_be_hidden()
    rail.get_by_text("More").click()
    rail.get_by_role("link", name="Administration").click()
    expect(page.get_by_role("heading", level=1)).to_have_text("Administration")
