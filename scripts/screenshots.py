"""Pictures of the pages for README and docs: starts the demo on fresh data, waits, and looks.

.venv/bin/python scripts/screenshots.py docs/img
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from playwright.sync_api import Page, sync_playwright

SHOWN = "Iveco Daily"
ORIGIN: list[str] = []
"""Where the demo is served, once known."""
PAGES = {
    "vehicles": "/vehicles",
    "trips": "/trips",
    "events": "/events",
    "alerts": "/alerts",
    "install": "/install",
    "admin": "/admin",
    "boxes": "/admin/boxes",
    "rules": "/admin/alerts",
    "privacy": "/privacy",
    "account": "/account",
}
ON_PHONE = {"fleet": "/", "install": "/install", "events": "/events", "alerts": "/alerts"}
FLAGS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


@contextmanager
def demo_fleet() -> Generator[str]:
    """The demo on fresh data; gives the address that signs in."""
    with TemporaryDirectory() as data:
        environment = os.environ | {"SCATOLA_DATA_DIR": data, "SCATOLA_PORT": "0"}
        command = [sys.executable, "-m", "server.cli.main", "demo"]
        with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as demo:  # noqa: S603  ours
            assert demo.stdout is not None
            try:
                yield next(match[0] for line in demo.stdout if (match := re.search(r"http\S+/login\?code=\S+", line)))
            finally:
                demo.send_signal(signal.SIGINT)


def main() -> None:
    out = Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    with demo_fleet() as link:
        take(link, out)


def take(link: str, out: Path) -> None:
    """Sign in and photograph the fleet and one vehicle, on a desk and on a phone, light and dark."""
    ORIGIN[:] = [link.split("/login", maxsplit=1)[0]]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
        context = browser.new_context(viewport={"width": 1280, "height": 900})
        page = context.new_page()
        page.set_default_timeout(120_000)
        page.goto(link)
        page.get_by_role("button", name="Sign in with the code").click()
        page.get_by_role("row", name=SHOWN).get_by_text("moved", exact=True).wait_for()
        photograph(page, out / "fleet.png", settle_s=8)
        page.goto(ORIGIN[0] + "/events")
        event = page.locator("main a[href^='/events/']").first.get_attribute("href")
        page.goto(ORIGIN[0] + "/")
        page.get_by_role("link", name=SHOWN).first.click()
        page.wait_for_load_state()
        # Maps are drawn when they come into view.
        page.locator("track-map").scroll_into_view_if_needed()
        page.wait_for_timeout(8_000)
        photograph(page, out / "vehicle.png", settle_s=40, full_page=True)
        address, state = page.url, context.storage_state()
        guide(page, out, {**PAGES, "mounting": f"{page.url}/mounting"})
        replay(page, ORIGIN[0] + (event or "/events"), out / "guide-event.png")
        page.goto(address)
        analysis(page, out / "guide-workbench.png")
        page.close()
        phone = browser.new_context(viewport={"width": 390, "height": 844}, color_scheme="dark", storage_state=state)
        page = phone.new_page()
        page.set_default_timeout(120_000)
        page.goto(address)
        photograph(page, out / "vehicle-phone.png", settle_s=40)
        phone.close()
        phone = browser.new_context(viewport={"width": 390, "height": 844}, storage_state=state)
        guide(phone.new_page(), out, ON_PHONE, suffix="-phone")
        browser.close()


def guide(page: Page, out: Path, paths: dict[str, str], *, suffix: str = "") -> None:
    """Photograph pages of the user's guide."""
    page.set_default_timeout(120_000)
    for name, path in paths.items():
        page.goto(path if path.startswith("http") else ORIGIN[0] + path)
        # Pictures come into view one after the other.
        for chart in page.locator("event-map, event-charts, scene-3d").all():
            chart.scroll_into_view_if_needed()
        photograph(page, out / f"guide-{name}{suffix}.png", settle_s=25 if page.locator("scene-3d").count() else 4)


def replay(page: Page, address: str, path: Path) -> None:
    """The event's page, the replay held just after the blow."""
    page.goto(address)
    page.get_by_role("checkbox", name="Play").uncheck()
    page.get_by_role("group", name="Replay").get_by_role("slider").fill("0.5")
    photograph(page, path, settle_s=15)


def analysis(page: Page, path: Path) -> None:
    """What the four estimators make of the trip that a vehicle's page shows."""
    page.get_by_role("link", name="Analyse the trip").click()
    page.get_by_role("button", name="Analyse").click()
    page.locator("figure.graph").first.wait_for()
    photograph(page, path, settle_s=2)


def photograph(page: Page, path: Path, *, settle_s: float, full_page: bool = False) -> None:
    """Close viser's remark on software rendering, let the 3D view and the maps finish, and take the picture."""
    page.evaluate("window.scrollTo(0, 0)")  # what is out of view does not draw
    deadline = time.monotonic() + settle_s
    while time.monotonic() < deadline:
        page.wait_for_timeout(500)
        for frame in page.frames:
            notice = frame.locator(".mantine-Notification-closeButton")
            if notice.count() and notice.first.is_visible():
                notice.first.dispatch_event("click")  # under software rendering a real one waits too long
    page.evaluate("window.scrollTo(0, 0)")
    page.wait_for_timeout(2_500)
    page.screenshot(path=path, full_page=full_page)


if __name__ == "__main__":
    main()
