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


@pytest.mark.parametrize("name", PATHS)
def test_axe_width_contrast_and_language(site, open_page, screenshot, name):
    path = PATHS[name]
    for vehicle, vehicle_id in site.vehicles.items():
        path = path.replace(f"{{{vehicle}}}", vehicle_id).replace(f"[{vehicle}]", box_in(site, vehicle_id))
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
