"""A real browser on the real pages of a service with a small fleet.

Whatever a test does, it fails if its page asked another host for anything, broke the content
security policy or logged an error.
"""

from __future__ import annotations

import datetime as dt
import logging
import os
import shutil
import socket
import threading
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import pytest
import rich
import uvicorn
from fastapi import FastAPI
from playwright.sync_api import Browser, Page, sync_playwright
from playwright.sync_api import Error as PlaywrightError

from server.accounts.service import ensure_organisation
from server.app import create_app
from server.database import Database
from server.view3d.viewer import create_viewer
from tests.browser.seeding import seed_fleet, urban_drive

ARTIFACTS = Path(__file__).resolve().parents[2] / "artifacts"
ARGUMENTS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-quic",
]
WATCH_POLICY = """
  window.policyViolations = [];
  document.addEventListener("securitypolicyviolation",
    (e) => window.policyViolations.push(`${e.violatedDirective}: ${e.blockedURI} ${e.sourceFile}:${e.lineNumber}`));
"""


def pytest_collection_modifyitems(items):
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.browser)


@pytest.fixture(scope="module")
def browser() -> Generator[Browser]:
    """Debian's Chromium, else Playwright's own; its event loop must not outlive the file, others start their own."""
    with sync_playwright() as playwright:
        try:
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
        except PlaywrightError as error:
            reason = f"no Chromium to drive: {str(error).strip().splitlines()[0]}"
            if os.environ.get("SCATOLA_TEST_REQUIRE_SERVICES") == "1":
                pytest.fail(reason)
            pytest.skip(reason)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def recording():
    """One simulated drive for all tests; the simulator compiles at its first use."""
    return urban_drive()


@dataclass(frozen=True)
class Site:
    """The served fleet."""

    address: str
    app: FastAPI
    database: Database
    organisation_id: str
    vehicles: dict[str, str]
    """Ids by name."""


@pytest.fixture
def site(settings, database, serve, recording) -> Site:
    """The service with the fleet of `seeding`; its clock is the wall's, like the browser's."""
    app = create_app(settings)
    now = dt.datetime.now(dt.UTC)
    with database.transaction() as session:
        organisation_id = ensure_organisation(session, now=now).id
        vehicles = seed_fleet(session, app.state.store, organisation_id, recording, now=now)
    return Site(serve(app), app, database, organisation_id, vehicles)


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


class Watched:
    """What a page did that it must not do."""

    def __init__(self, page: Page, address: str) -> None:
        self._page, self._host = page, urlsplit(address).netloc
        self.outside: list[str] = []
        self.complaints: list[str] = []
        self.expected: tuple[str, ...] = ()
        """Parts of messages or addresses that a test provokes on purpose."""
        page.add_init_script(WATCH_POLICY)
        page.on("request", lambda request: self._requested(request.url))
        page.on("console", lambda message: self._said(message.type, message.text, message.location["url"]))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))

    def _requested(self, url: str) -> None:
        parts = urlsplit(url)
        if parts.scheme not in ("data", "blob", "about") and parts.netloc != self._host:
            self.outside.append(url)

    def _said(self, kind: str, text: str, url: str) -> None:
        if kind in ("error", "warning") and not any(part in f"{text} {url}" for part in self.expected):
            self.complaints.append(f"{kind}: {text} ({url})")

    def check(self) -> None:
        assert self.outside == []
        assert self.complaints == []
        assert self._page.evaluate("window.policyViolations") == []


@pytest.fixture
def open_page(browser, site, settings) -> Generator:
    """Open a signed-in page: ``open_page(path, **context options) -> Page``."""
    contexts, watched = [], []

    def open_(path: str, *, signed_in: bool = True, expected: tuple[str, ...] = (), **options) -> Page:
        context = browser.new_context(base_url=site.address, **{"viewport": {"width": 1280, "height": 800}, **options})
        contexts.append(context)
        if signed_in:
            code = settings.admin_token.get_secret_value()
            answer = context.request.post("/api/v1/auth/session", data={"code": code})
            assert answer.status == 201, answer.text()
        page = context.new_page()
        page.set_default_timeout(20_000)
        watch = Watched(page, site.address)
        # Where no viewer runs, the page says so in words; the browser logs the refused request.
        watch.expected = ("/view3d/", *expected)
        watched.append(watch)
        page.goto(path)
        return page

    yield open_
    try:
        for watch in watched:
            watch.check()
    finally:
        for context in contexts:
            context.close()


@pytest.fixture
def screenshot():
    """Keep a picture for people: ``screenshot(page, name)``."""
    ARTIFACTS.mkdir(exist_ok=True)
    return lambda page, name: page.screenshot(path=ARTIFACTS / f"{name}.png", full_page=True)
