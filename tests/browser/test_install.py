"""The installer's way through the assistant, at a phone's width, with a box that uploads meanwhile."""

from __future__ import annotations

import datetime as dt
import re
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest
from playwright.sync_api import Page, expect

from nav_core.records import Drive
from nav_core.rotation import angle_between, thesis_to_matrix
from nav_core.simulate import Scenario, simulate
from server.accounts.cookie import COOKIE
from server.accounts.service import open_session
from server.formats.columns import Columns
from server.formats.drive import from_drive
from server.jobs.work import bring_up_to_date
from server.models import User
from server.pages.qr import Code, qr_code
from server.uploader import batches, encode
from tests.browser.conftest import ARGUMENTS, Watched
from tests.browser.scenes import CHATTER, PATIENCE_MS

PHONE = {"width": 390, "height": 844}
MOUNT = thesis_to_matrix(*np.radians([70.0, 20.0, -130.0]))
DRIVE_S = 300.0


class SimulatedBox:
    """Registers itself, and uploads what it is given."""

    def __init__(self, site, settings, name: str) -> None:
        self._site = site
        admin = {"Authorization": f"Bearer {settings.admin_token.get_secret_value()}"}
        self._client = httpx.Client(base_url=site.address, timeout=60.0)
        made = self._client.post("/api/v1/devices", json={"name": name}, headers=admin).json()
        self.id = made["id"]
        self.code = self._client.post(f"/api/v1/devices/{self.id}/claim-code", headers=admin).json()["code"]
        self._headers = {"Authorization": f"Bearer {made['token']}"}
        self._sequence = 0

    def send(self, columns: Columns) -> None:
        media, coding, body = encode(columns, "parquet")
        headers = self._headers | {"Content-Type": media, "Idempotency-Key": f"b/{self._sequence}"}
        if coding:
            headers["Content-Encoding"] = coding
        answer = self._client.post("/api/v1/batches", content=body, headers=headers)
        assert answer.status_code == 202, answer.text
        self._sequence += 1

    def lie(self, f_a) -> None:
        """Two seconds at rest."""
        t = 2.0 * self._sequence + np.arange(0.0, 2.0, 0.02)
        f = np.asarray(f_a) + 0.03 * np.random.default_rng(self._sequence).normal(size=(t.size, 3))
        self.send(Columns({"t": t, "fx": f[:, 0], "fy": f[:, 1], "fz": f[:, 2]}))

    def work(self) -> None:
        """What the worker does."""
        now = lambda: dt.datetime.now(dt.UTC)  # noqa: E731
        bring_up_to_date(self._site.database, self._site.app.state.store, self.id, clock=now)

    def close(self) -> None:
        self._client.close()


@pytest.fixture
def installer(site, open_page) -> Page:
    """The phone of somebody who may install and nothing else."""
    now = dt.datetime.now(dt.UTC)
    with site.database.transaction() as session:
        user = User(
            organisation_id=site.organisation_id, email="ida@fleet.test", name="Ida", role="installer", created_at=now
        )
        session.add(user)
        session.flush()
        opened = open_session(session, site.organisation_id, now=now, user_id=user.id)
    page = open_page("/login", signed_in=False, viewport=PHONE, has_touch=True, expected=("409", "/install/", *CHATTER))
    page.set_default_timeout(PATIENCE_MS)
    page.context.add_cookies([{"name": COOKIE, "value": opened.token, "url": site.address}])
    return page


def fits(page: Page) -> None:
    """Nothing sticks out of a phone's width."""
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth + 1"), page.url


@pytest.fixture
def box(site, settings) -> Iterator[SimulatedBox]:
    made = SimulatedBox(site, settings, "SC-new")
    yield made
    made.close()


@pytest.mark.usefixtures("viewer")
def test_a_box_is_found_put_into_a_vehicle_and_levelled(installer, box, screenshot):
    page = installer
    page.goto("/install")
    screenshot(page, "install-start")
    fits(page)
    page.get_by_label("Code on the box, or its name").fill("no such thing")
    page.get_by_role("button", name="Find the box").click()
    expect(page.get_by_role("alert")).to_contain_text("No box has this code")
    page.get_by_label("Code on the box, or its name").fill(box.code.lower())
    page.get_by_role("button", name="Find the box").click()
    expect(page.get_by_role("heading", name="SC-new")).to_be_visible()
    expect(page.get_by_text("Drive off")).to_have_count(0)
    page.get_by_role("searchbox", name="Name or plate").fill("porter")
    page.get_by_role("button", name="Search").click()
    page.get_by_role("button", name="Piaggio Porter").click()
    expect(page.locator(".picked")).to_contain_text("Piaggio Porter")
    screenshot(page, "install-box")
    fits(page)

    page.get_by_role("link", name="Level it by hand").click()
    expect(page.get_by_text("Waiting for data: the box must be switched on.")).to_be_visible()
    # The hand of the installer, in the background: askew, then upright, 4° off.
    poses = {
        "askew": 9.81 * np.array([np.sin(0.6), 0.0, -np.cos(0.6)]),
        "upright": 9.81 * np.array([np.sin(np.radians(4.0)), 0.0, -np.cos(np.radians(4.0))]),
    }
    pose, stop = ["askew"], threading.Event()

    def uploading() -> None:
        while not stop.is_set():
            box.lie(poses[pose[0]])
            stop.wait(0.8)

    thread = threading.Thread(target=uploading, daemon=True)
    thread.start()
    try:
        level = page.locator("#level")
        expect(level).to_contain_text("Turn it until the bubble is inside the ring.", timeout=60_000)
        screenshot(page, "install-level-askew")
        pose[0] = "upright"
        expect(level).to_contain_text("−z stands upright", timeout=60_000)
        expect(level).to_contain_text("4.")
        expect(page.locator("button.orientation")).to_have_count(4)
        screenshot(page, "install-level")
        fits(page)
        # From all sides: a scene of one's own shows the orientation that is pressed.
        page.get_by_text("Turn them in 3D").click()
        page.get_by_role("button", name="4", exact=True).click()
        scene = page.locator("scene-3d")
        expect(scene).to_have_attribute("data-state", "open", timeout=PATIENCE_MS)
        expect(scene).to_have_attribute("data-drawn", re.compile(r"\bbox\b"), timeout=PATIENCE_MS)
        state = page.locator("scene-3d iframe").evaluate("frame => new URL('state', frame.src).href")
        shown = page.request.get(state).json()
        assert np.array(shown["R_va"]) @ poses["upright"] == pytest.approx([0.0, 0.0, -9.81], abs=0.3)
        screenshot(page, "install-level-3d")
        page.get_by_text("Turn them in 3D").click()
        page.get_by_label("Reason, kept with the mounting").fill("No drive today")
        page.get_by_role("button", name="+y forward").click()
        expect(page.get_by_role("heading", name="Certificate of installation")).to_be_visible(timeout=60_000)
    finally:
        stop.set()
        thread.join(30.0)
    main = page.get_by_role("main")
    for words in ("Piaggio Porter", "SC-new", "Set by hand: No drive today", "±5.00", "ida@fleet.test"):
        expect(main).to_contain_text(words)
    screenshot(page, "install-certificate")
    fits(page)
    answer = page.request.get(page.get_by_role("link", name="Certificate, PDF").get_attribute("href"))
    assert answer.body().startswith(b"%PDF")


@pytest.fixture(scope="module")
def drive() -> Drive:
    start = dt.datetime.now(dt.UTC).timestamp() - DRIVE_S
    return simulate(Scenario(duration=DRIVE_S, accel_rate=50.0, R_va=MOUNT, start_utc=start), seed=11)[0]


def test_driving_off_leads_to_a_certificate(installer, box, drive, screenshot):
    page = installer
    page.goto(f"/install/{box.id}")
    page.get_by_role("button", name="Piaggio Porter").click()
    page.get_by_role("link", name="Drive off").click()
    expect(page.get_by_text("Waiting for the first data")).to_be_visible()
    signal = page.get_by_label("Sound and vibration when it is ready")
    expect(signal).not_to_be_checked()
    signal.check()
    progress, percents = page.locator("#progress"), []
    for k, columns in enumerate(batches(from_drive(drive), 20.0)):
        box.send(columns)
        box.work()
        told = page.request.get(f"/api/v1/devices/{box.id}/installation").json()
        # Nobody reloads: the page follows by server-sent events.
        # Nobody is told of a per cent that is not whole yet: the page rounds down.
        shown = re.compile(rf"^({told['percent']}|{told['percent'] - 1})\s*%$")
        expect(progress.locator(".ring-number")).to_have_text(shown, timeout=PATIENCE_MS)
        expect(progress).to_contain_text("box is heard")
        if not percents or told["percent"] >= percents[-1] + 15:
            percents.append(told["percent"])
            screenshot(page, f"install-drive-{k}")
            fits(page)
        if told["status"] == "ready":
            break
    expect(progress).to_have_attribute("data-ready", "yes", timeout=60_000)
    expect(progress).to_contain_text("Ready")
    assert percents[0] < 50 < percents[-1]
    expect(page.locator("#sigmas")).to_contain_text(re.compile(r"±\d\.\d\d"))
    screenshot(page, "install-drive-done")
    page.get_by_role("link", name="Done: the certificate").click()
    expect(page.get_by_role("main")).to_contain_text("Piaggio Porter")
    pdf = page.request.get(page.get_by_role("link", name="Certificate, PDF").get_attribute("href"))
    assert pdf.status == 200
    mounted = page.request.get(f"/api/v1/devices/{box.id}/installation").json()
    assert np.degrees(angle_between(np.array(mounted["R_va"]), MOUNT)) < 4.0


def filmed(code: Code, path: Path, width: int = 640, height: int = 480) -> None:
    """A film of one picture, YUV 4:2:0: the code on grey, as a camera sees it."""
    luma = np.full((height, width), 170, dtype=np.uint8)
    scale = 320 // code.size
    label = np.full((code.size, code.size), 235, dtype=np.uint8)
    for x, y in re.findall(r"M(\d+) (\d+)h1v1h-1z", code.d):
        label[int(y), int(x)] = 20
    label = np.kron(label, np.ones((scale, scale), dtype=np.uint8))
    luma[80 : 80 + label.shape[0], 150 : 150 + label.shape[1]] = label
    chroma = np.full(width * height // 2, 128, dtype=np.uint8)
    frame = b"FRAME\n" + luma.tobytes() + chroma.tobytes()
    path.write_bytes(f"YUV4MPEG2 W{width} H{height} F10:1 Ip A1:1 C420jpeg\n".encode() + 5 * frame)


def test_the_code_on_a_box_is_scanned(site, browser, settings, box, tmp_path, screenshot):
    filmed(qr_code(f"{site.address}/install?code={box.code}"), tmp_path / "film.y4m")
    camera = [
        "--use-fake-ui-for-media-stream",
        "--use-fake-device-for-media-stream",
        f"--use-file-for-fake-video-capture={tmp_path / 'film.y4m'}",
    ]
    phone = browser.browser_type.launch(executable_path=shutil.which("chromium"), args=[*ARGUMENTS, *camera])
    try:
        context = phone.new_context(base_url=site.address, viewport=PHONE)
        context.request.post("/api/v1/auth/session", data={"code": settings.admin_token.get_secret_value()})
        page = context.new_page()
        page.set_default_timeout(PATIENCE_MS)
        watched = Watched(page, site.address)
        page.goto("/install")
        page.get_by_role("button", name="Scan the code").click()
        expect(page.get_by_label("Picture of the camera")).to_be_visible()
        page.wait_for_url(f"**/install/{box.id}", timeout=PATIENCE_MS)
        expect(page.get_by_role("heading", name="SC-new")).to_be_visible()
        screenshot(page, "install-scanned")
        watched.check()
    finally:
        phone.close()


def test_a_phone_without_a_camera_says_so(installer):
    installer.goto("/install")
    installer.get_by_role("button", name="Scan the code").click()
    expect(installer.locator("#scan-words")).to_have_text("The camera is not allowed or not there: type the code.")
