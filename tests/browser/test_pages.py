"""A person's way through the pages."""

from __future__ import annotations

import datetime as dt
import io
import json
import re
import time

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import expect

from server.live.changes import announce
from server.models import Device, DeviceState, Installation
from tests.browser.scenes import wait_true
from tests.browser.seeding import add_box_without_vehicle


def pixels(locator) -> np.ndarray:
    """What an element looks like, shape (rows, columns, 3)."""
    return np.asarray(Image.open(io.BytesIO(locator.screenshot())).convert("RGB"), dtype=np.int16)


def count_near(image: np.ndarray, colour: str, tolerance: int = 40) -> int:
    """Pixels about that ``#rrggbb``."""
    wanted = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
    return int((np.abs(image - wanted).max(axis=2) < tolerance).sum())


def css(page, name: str) -> str:
    return page.evaluate(f"getComputedStyle(document.documentElement).getPropertyValue('--{name}').trim()")


def wait_drawn(locator, colour: str, at_least: int) -> None:
    """Wait until an element shows enough of a colour: a picture takes a frame, so looking again is the wait."""
    until = time.monotonic() + 30.0
    while (found := count_near(pixels(locator), colour)) < at_least:
        assert time.monotonic() < until, f"only {found} pixels of {colour}"


def test_signing_in_leads_to_the_page_that_was_asked_for(site, open_page):
    page = open_page("/vehicles", signed_in=False, expected=("/login",))
    expect(page).to_have_url(f"{site.address}/login?next=/vehicles")
    page.get_by_label("Sign-in code").fill("wrong")
    page.get_by_role("button", name="Sign in with the code").click()
    expect(page.get_by_role("alert")).to_be_visible()
    page.get_by_label("Sign-in code").fill("test-administrator")
    page.get_by_role("button", name="Sign in with the code").click()
    expect(page).to_have_url(f"{site.address}/vehicles")
    expect(page.get_by_role("link", name="Fiat Panda")).to_be_visible()
    page.get_by_role("button", name="Sign out").click()
    expect(page).to_have_url(f"{site.address}/login")
    page.goto("/")
    expect(page).to_have_url(f"{site.address}/login?next=/")


def test_the_fleet_page_says_how_every_box_stands_and_draws_a_map(open_page, screenshot):
    page = open_page("/")
    table = page.locator("#boxes")
    for name, words, sigma in (
        ("Fiat Panda", "Ready", "±0.6"),
        ("Iveco Daily", "Moved, calibrating again 62\N{NO-BREAK SPACE}%", "±3.8"),
        ("Jeep Renegade", "Box is not fixed", "not yet"),
        ("Lancia Ypsilon", "Calibrating 35\N{NO-BREAK SPACE}%", "±6.5"),
        ("Piaggio Porter", "Not calibrated yet", "not yet"),
    ):
        row = table.get_by_role("row").filter(has=page.get_by_role("link", name=name, exact=True))
        expect(row).to_contain_text(words)
        expect(row).to_contain_text(sigma)
    tiles = page.locator(".tile")
    for heading, names in (
        ("Not fixed", ["Jeep Renegade"]),
        ("Moved", ["Iveco Daily"]),
        ("Silent", ["Maserati Levante", "Piaggio Porter"]),
        ("Not calibrated", ["Iveco Daily", "Lancia Ypsilon", "Piaggio Porter"]),
    ):
        tile = tiles.filter(has=page.get_by_text(heading, exact=True))
        expect(tile.locator(".tile-number")).to_have_text(str(len(names)))
        expect(tile.locator("li")).to_have_text(names)
    fleet_map = page.locator("fleet-map")
    expect(fleet_map).to_have_attribute("data-marks", "5")
    wait_drawn(fleet_map, css(page, "good-fill"), 80)
    wait_drawn(fleet_map, css(page, "alarm-fill"), 80)
    image = pixels(fleet_map)
    assert count_near(image, css(page, "land"), 6) > 0.2 * image[..., 0].size
    assert count_near(image, css(page, "sea"), 6) > 0.1 * image[..., 0].size
    screenshot(page, "fleet")
    # Another scheme draws the whole map anew, also when the reader changes it again at once.
    for scheme in ("dark", "light", "dark"):
        page.emulate_media(color_scheme=scheme)
    for colour in ("good-fill", "alarm-fill"):
        wait_drawn(fleet_map, css(page, colour), 80)


def test_the_vehicle_page_shows_mounting_history_track_and_signals(site, open_page, screenshot):
    page = open_page(f"/vehicles/{site.vehicles['Fiat Panda']}")
    mounting = page.locator("#mounting")
    expect(mounting).to_contain_text("Ready")
    expect(mounting.get_by_role("img", name="Ready, 100 per cent")).to_be_visible()
    for text in (
        "±0.6°",
        "\N{MINUS SIGN}20.0",
        "+35.0",
        "+110.0",
        "±0.35",
        "±0.42",
        "±0.61",
        "0.6° away",
        "whole-drive/1",
    ):
        expect(mounting).to_contain_text(text)
    expect(page.locator("#installations")).to_contain_text("First installation")
    expect(page.locator("#trips")).to_contain_text("under way")
    track = page.locator("track-map")
    track.scroll_into_view_if_needed()
    expect(track).to_have_attribute("data-points", "240")
    for speed in ("#3b6fd4", "#22a884"):  # standing, and as fast as in town
        wait_drawn(track, speed, 30)
    for plot, colour in (("speed", "track"), ("force", "axis-x"), ("force", "axis-y"), ("force", "axis-z")):
        wait_drawn(page.locator(f'[data-plot="{plot}"] canvas'), css(page, colour), 200)
    expect(page.get_by_role("button", name="Vehicle axes")).to_have_attribute("aria-pressed", "true")
    screenshot(page, "vehicle")
    page.emulate_media(color_scheme="dark")
    wait_drawn(track, css(page, "land"), 1000)
    wait_drawn(track, "#22a884", 30)
    wait_drawn(page.locator('[data-plot="force"] canvas'), css(page, "axis-x"), 200)


def test_dragging_over_a_chart_fetches_the_part_and_a_double_click_goes_back(site, open_page):
    page = open_page(f"/vehicles/{site.vehicles['Fiat Panda']}")
    chart = page.locator('[data-plot="force"] .u-over')
    wait_drawn(page.locator('[data-plot="force"] canvas'), css(page, "axis-z"), 200)
    chart.scroll_into_view_if_needed()
    box = chart.bounding_box()
    middle = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + 0.25 * box["width"], middle)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.50 * box["width"], middle, steps=5)
    with page.expect_response(lambda response: "/signals" in response.url and "from=" in response.url) as asked:
        page.mouse.up()
    header = signals_header(asked.value.body())
    span = dt.datetime.fromisoformat(header["to"]) - dt.datetime.fromisoformat(header["from"])
    assert span.total_seconds() == pytest.approx(15.0, abs=1.0)
    with page.expect_response(lambda response: "seconds=60" in response.url):
        chart.dblclick()
    with page.expect_response(lambda response: "frame=a" in response.url):
        page.get_by_role("button", name="Box axes").click()
    with page.expect_response(lambda response: "/signals" in response.url and "from=" in response.url):
        page.get_by_role("button", name="The trip").click()


def test_the_signals_by_keyboard(site, open_page):
    page = open_page(f"/vehicles/{site.vehicles['Fiat Panda']}")
    page.locator("track-map").scroll_into_view_if_needed()
    expect(page.locator("track-map")).to_have_attribute("data-points", "240")
    expect(page.locator("signal-chart")).to_have_attribute("data-points", re.compile("[1-9]"))
    chart = page.get_by_role("slider", name="Specific force")
    expect(chart).to_have_attribute("aria-valuetext", "The arrow keys move the cursor")
    chart.focus()
    chart.press("End")
    said = r"^\d\d:\d\d:\d\d\.\d\d x forward\s\W?\d+\.\d\d\sy right\s\W?\d+\.\d\d\sz down\s\W?\d+\.\d\d$"
    expect(chart).to_have_attribute("aria-valuetext", re.compile(said))
    last = chart.get_attribute("aria-valuetext")
    chart.press("PageDown")
    expect(chart).not_to_have_attribute("aria-valuetext", last)
    expect(chart).to_have_attribute("aria-valuetext", re.compile(said))
    expect(page.locator("track-map")).to_have_attribute("data-cursor", re.compile(r"\d"))


def signals_header(body: bytes) -> dict:
    length = int.from_bytes(body[:4], "little")
    return json.loads(body[4 : 4 + length])


def test_what_is_missing_is_said_and_nothing_is_made_up(site, open_page, screenshot):
    page = open_page(f"/vehicles/{site.vehicles['Lancia Ypsilon']}")
    expect(page.locator("#mounting")).to_contain_text("Still missing")
    expect(page.locator("#mounting")).to_contain_text("Make two turns.")
    expect(page.locator("#mounting").get_by_role("img", name="Calibrating, 35 per cent")).to_be_visible()
    expect(page.locator(".chart-words")).to_have_text("Not yet: no samples in this window")
    page.locator("track-map").scroll_into_view_if_needed()
    expect(page.locator("track-map")).to_contain_text("Not yet: no trip to show")
    expect(page.locator("track-map")).to_have_attribute("data-place", re.compile(r"^\d+\.\d+ \d+\.\d+$"))
    screenshot(page, "vehicle-calibrating")
    page.goto(f"/vehicles/{site.vehicles['Piaggio Porter']}")
    expect(page.locator("#mounting .missing")).to_have_count(6)
    expect(page.locator("#mounting")).to_contain_text("No data from this box yet.")
    expect(page.locator("#installations")).to_contain_text("Not yet")


def test_a_moved_box_has_two_installations(site, open_page):
    page = open_page(f"/vehicles/{site.vehicles['Iveco Daily']}")
    rows = page.locator("#installations tbody tr")
    expect(rows).to_have_count(2)
    expect(rows.nth(0)).to_contain_text("Box was moved 34°")
    expect(rows.nth(1)).to_contain_text("First installation")


def test_the_page_follows_changes_without_a_reload(site, open_page):
    page = open_page(f"/vehicles/{site.vehicles['Lancia Ypsilon']}")
    expect(page.locator("#live")).to_have_attribute("data-state", "on")
    page.evaluate("window.stillTheSamePage = true")
    now = dt.datetime.now(dt.UTC)
    with site.database.transaction() as session:
        device = session.query(Device).filter_by(vehicle_id=site.vehicles["Lancia Ypsilon"]).one()
        installation = session.query(Installation).filter_by(device_id=device.id).one()
        installation.status, installation.progress, installation.updated_at = "ready", 1.0, now
        session.get(DeviceState, device.id).speed_mps = 20.0
        announce(session, "installation", at=now, organisation_id=site.organisation_id, device_id=device.id)
    expect(page.locator("#mounting")).to_contain_text("Ready")
    expect(page.locator("#heading")).to_contain_text("72 km/h")
    assert page.evaluate("window.stillTheSamePage")


def test_a_box_on_the_shelf_has_a_page(site, open_page):
    with site.database.transaction() as session:
        device_id = add_box_without_vehicle(session, site.organisation_id, now=dt.datetime.now(dt.UTC))
    page = open_page(f"/devices/{device_id}")
    expect(page.get_by_role("heading", level=1)).to_have_text("SC-spare")
    expect(page.locator("#heading")).to_contain_text("never seen")


def test_an_unknown_vehicle_is_said_in_words(open_page):
    page = open_page(f"/vehicles/{'0' * 32}", expected=("404",))
    expect(page.get_by_role("heading", level=1)).to_have_text("There is no such page")


CONTRAST = """() => {
  const channel = (v) => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const light = ([r, g, b]) => 0.2126 * channel(r) + 0.7152 * channel(g) + 0.0722 * channel(b);
  const parse = (s) => s.match(/[\\d.]+/g).map(Number);
  const ground = (e) => {
    for (; e; e = e.parentElement) {
      const c = parse(getComputedStyle(e).backgroundColor);
      if (c.length === 3 || c[3] === 1) return c;
    }
    return [255, 255, 255];
  };
  const poor = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const e = walker.currentNode.parentElement, text = walker.currentNode.textContent.trim();
    if (!text || !e.checkVisibility() || e.closest(":disabled, .maplibregl-map, svg")) continue;
    const [a, b] = [light(parse(getComputedStyle(e).color)), light(ground(e))];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (ratio < 4.5) poor.push(`${ratio.toFixed(2)} ${e.className || e.tagName}: ${text}`);
  }
  return poor;
}"""


@pytest.mark.parametrize("name", ["login", "fleet", "vehicles", "Fiat Panda", "Iveco Daily"])
def test_every_width_fits_and_every_text_has_contrast(site, open_page, screenshot, name):
    paths = {"login": "/login", "fleet": "/", "vehicles": "/vehicles"}
    page = open_page(paths.get(name) or f"/vehicles/{site.vehicles[name]}", signed_in=name != "login")
    if name != "login":
        expect(page.locator("#live")).to_have_attribute("data-state", "on")
    for width in (320, 390, 768, 1440):
        page.set_viewport_size({"width": width, "height": 844})
        wait_true(page, "document.documentElement.scrollWidth <= window.innerWidth")
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            assert page.evaluate(CONTRAST) == []
        if width in (390, 1440):
            screenshot(page, f"{name.lower().replace(' ', '-')}-{width}")
