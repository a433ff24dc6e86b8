"""What holds on every page: axe finds nothing serious, nothing overflows, both languages and schemes are whole.

Whoever adds a page adds its path here.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import expect
from sqlalchemy import select

from server.models import Device
from tests.browser.scenes import wait_true
from tests.browser.test_pages import CONTRAST
from tests.conftest import missing_service

AXE = Path(__file__).resolve().parents[2] / "node_modules" / "axe-core" / "axe.min.js"


def axe_source() -> str:
    """The script, which `npm ci` brings; `make test` alone needs no Node."""
    if not AXE.exists():
        missing_service("axe-core is not there: npm ci --ignore-scripts")
    return AXE.read_text()


RUN_AXE = """async () => {
  const found = await axe.run(document, { resultTypes: ["violations"], iframes: false });
  return found.violations.filter((v) => v.impact === "serious" || v.impact === "critical")
    .map((v) => `${v.id}: ${v.nodes.slice(0, 3).map((n) => n.html.slice(0, 160)).join(" | ")}`);
}"""


def keep(page, screenshot, name):
    """Pictures at desk and phone width, both schemes; nothing overflows, nothing is hard to read, axe is content."""
    page.evaluate(axe_source())
    page.evaluate("scrollTo(0, 0)")
    for width, which in ((1280, "desk"), (390, "phone")):
        page.set_viewport_size({"width": width, "height": 844})
        wait_true(page, "document.documentElement.scrollWidth <= window.innerWidth")
        for scheme in ("dark", "light"):
            page.emulate_media(color_scheme=scheme)
            assert page.evaluate(CONTRAST) == []
            screenshot(page, f"{name}-{which}-{scheme}")
        assert page.evaluate(RUN_AXE) == []
    page.set_viewport_size({"width": 1280, "height": 800})


PATHS = {
    "login": "/login",
    "fleet": "/",
    "fleet-filtered": "/?show=moved&sort=seen&down=1",
    "vehicles": "/vehicles",
    "vehicles-none": "/vehicles?q=nothing+like+it",
    "vehicle": "/vehicles/{Fiat Panda}",
    "vehicle-moved": "/vehicles/{Iveco Daily}",
    "vehicle-new": "/vehicles/{Piaggio Porter}",
    "mounting": "/vehicles/{Fiat Panda}/mounting",
    "mounting-moved": "/vehicles/{Iveco Daily}/mounting?before=true",
    "certificate": "/devices/[Fiat Panda]/certificate",
    "install": "/install?code=nothing",
    "install-box": "/install/[Fiat Panda]?q=a",
    "install-drive": "/install/[Iveco Daily]/drive",
    "install-level": "/install/[Fiat Panda]/level",
    "events": "/events?show=all",
    "workbench": "/workbench",
    "live": "/devices/[Fiat Panda]/live",
    "trips": "/trips",
    "admin": "/admin",
    "admin-boxes": "/admin/boxes",
    "admin-alerts": "/admin/alerts",
    "admin-rule": "/admin/alerts/rules/new?kind=geofence",
    "admin-channel": "/admin/alerts/channels/new?kind=webhook",
    "admin-work": "/admin/work",
    "admin-versions": "/admin/versions",
    "users": "/users",
    "audit": "/audit",
    "account": "/account",
    "alerts": "/alerts?show=all",
    "how": "/how#delta-v",
    "privacy": "/privacy",
    "events-none": "/events?q=nothing+like+it&review=open",
    "trips-none": "/trips?q=nothing+like+it",
    "missing": "/vehicles/nowhere",
}


def box_in(site, vehicle_id: str) -> str:
    """Id of the box in a vehicle."""
    with site.database.reading() as session:
        return session.scalars(select(Device.id).where(Device.vehicle_id == vehicle_id)).one()


def address(site, path: str) -> str:
    """A path with the ids that its names stand for."""
    for vehicle, vehicle_id in site.vehicles.items():
        path = path.replace(f"{{{vehicle}}}", vehicle_id).replace(f"[{vehicle}]", box_in(site, vehicle_id))
    return path


@pytest.mark.parametrize("name", PATHS)
def test_axe_width_contrast_and_language(site, open_page, screenshot, name):
    path = address(site, PATHS[name])
    inside = name not in ("login", "missing")
    page = open_page(path, signed_in=name != "login", expected=("404",), locale="it-IT")
    if inside:
        expect(page.locator("#live")).to_have_attribute("data-state", "on")
    assert page.locator("html").get_attribute("lang") == "it"
    # The policy of the pages lets no foreign script in; the test's own comes in from outside the page.
    page.evaluate(axe_source())
    for width in (320, 390, 768, 1280):
        page.set_viewport_size({"width": width, "height": 844})
        wait_true(page, "document.documentElement.scrollWidth <= window.innerWidth")
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            assert page.evaluate(CONTRAST) == []
            if width in (390, 1280):
                screenshot(page, f"{name}-{'phone' if width == 390 else 'desk'}-{scheme}")
        if width in (390, 1280):
            assert page.evaluate(RUN_AXE) == []
    if name.startswith("vehicle") and inside:
        page.emulate_media(media="print")
        assert not page.locator(".top").is_visible()


UNFOCUSED = """() => {
  window.sign = (e) => {
    const { outlineStyle, outlineWidth, outlineColor, boxShadow } = getComputedStyle(e);
    return [outlineStyle, outlineWidth, outlineColor, boxShadow].join();
  };
  window.unfocused = new Map([...document.querySelectorAll("body *")].map((e) => [e, sign(e)]));
  document.activeElement.blur();
}"""
# Where the focus is: what it is, whether it shows, in what part of the page, and where on the screen.
STOP = """() => {
  const e = document.activeElement;
  if (!e || e === document.body) return null;
  const before = window.lastStop;
  window.lastStop = e;
  // A row of a list is framed as one.
  const framed = [e, ...["tr", ".search"].map((s) => e.closest(s)).filter(Boolean)];
  const shows = framed.some((one) => {
    const drawn = sign(one), { outlineStyle, outlineWidth, boxShadow } = getComputedStyle(one);
    const marked = (outlineStyle !== "none" && parseFloat(outlineWidth) > 0) || boxShadow !== "none";
    return marked && drawn !== unfocused.get(one);
  });
  const { left, top, right, bottom } = e.getBoundingClientRect();
  const middle = (from, to, most) => Math.min(Math.max((from + to) / 2, 0), most - 1);
  const hit = document.elementFromPoint(middle(left, right, innerWidth), middle(top, bottom, innerHeight));
  const inside = right > 0 && bottom > 0 && left < innerWidth && top < innerHeight;
  const part = (one) => one.closest("form, tr, nav, header, table, .menu-sheet, .filters, section");
  const words = e.ariaLabel || e.textContent || e.getAttribute("name") || "";
  return {
    what: `${e.tagName.toLowerCase()}${e.id && "#" + e.id}.${e.className} ${words.trim().slice(0, 40)}`,
    same: e === before,
    later: !before || !!(before.compareDocumentPosition(e) & Node.DOCUMENT_POSITION_FOLLOWING),
    sibling: !!before && part(e) === part(before),
    shows: shows || e.tagName === "IFRAME",
    seen: inside && !!hit && (e.contains(hit) || hit.contains(e)),
    box: [left + scrollX, top + scrollY, right + scrollX, bottom + scrollY],
  };
}"""
MOST_STOPS = 250
IN_A_FRAME = 40
"""Stops that a 3D view, or the parts of a date, may take."""


def walk_by_keyboard(page) -> list[str]:
    """Press Tab through the whole page; what is wrong with its stops."""
    page.evaluate(UNFOCUSED)
    wrong: list[str] = []
    stops, held = [], 0
    while len(stops) < MOST_STOPS:
        page.keyboard.press("Tab")
        stop = page.evaluate(STOP)
        if stop is None or (stops and not stop["same"] and not stop["later"] and stop["what"] == stops[0]["what"]):
            break
        held = held + 1 if stop["same"] else 0
        if held > IN_A_FRAME:
            return [*wrong, f"holds the focus: {stop['what']}"]
        if stop["same"]:
            continue
        if not stop["shows"]:
            wrong.append(f"does not show the focus: {stop['what']}")
        if not stop["seen"]:
            wrong.append(f"focused out of sight: {stop['what']} {stop['box']}")
        if not stop["later"]:
            wrong.append(f"out of order: {stop['what']}")
        elif stops and stop["sibling"]:
            left, top, _, bottom = stop["box"]
            before_left, before_top, _, before_bottom = stops[-1]["box"]
            if bottom <= before_top or (top < before_bottom and before_top < bottom and left < before_left - 1):
                wrong.append(f"before {stops[-1]['what']} for the eye: {stop['what']}")
        stops.append(stop)
    else:
        wrong.append("no end")
    assert len(stops) > 8
    return wrong


WALKED = ("vehicles", "vehicle", "install", "workbench", "admin-alerts", "privacy", "users")


@pytest.mark.parametrize("name", WALKED)
def test_the_keyboard_reaches_everything_in_order(site, open_page, name):
    page = open_page(address(site, PATHS[name]))
    expect(page.locator("#live")).to_have_attribute("data-state", "on")
    assert walk_by_keyboard(page) == []


def test_menus_dialogs_and_buttons_by_keyboard(open_page):
    page = open_page("/vehicles")
    expect(page.locator("#live")).to_have_attribute("data-state", "on")
    views, name = page.locator("details.menu > summary"), page.get_by_label("Name of the view")
    for key in ("Enter", "Space"):
        views.focus()
        page.keyboard.press(key)
        expect(name).to_be_visible()
        page.keyboard.press("Tab")
        expect(name).to_be_focused()
        page.keyboard.press("Escape")
        expect(name).not_to_be_visible()
        expect(views).to_be_focused()
    page.keyboard.press("?")
    expect(page.get_by_role("dialog")).to_be_visible()
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).not_to_be_visible()
    expect(views).to_be_focused()
    page.locator("#zone").focus()
    pressed = "localStorage.getItem('scatola:utc') === '1'"
    assert not page.evaluate(pressed)
    page.keyboard.press("Enter")
    assert page.evaluate(pressed)
    page.keyboard.press("Space")
    assert not page.evaluate(pressed)
