"""An engineer's way: a real recording up, a plot down; and a box watched while it sends."""

from __future__ import annotations

import datetime as dt
import gzip
import json
import re
import threading

import httpx
import numpy as np
import pytest
from playwright.sync_api import expect

from server.formats.columns import Columns
from server.formats.drive import from_drive
from server.jobs.analyses import Runner
from server.jobs.work import bring_up_to_date
from tests.browser.test_every_page import RUN_AXE, axe_source
from tests.browser.test_pages import CONTRAST
from tests.recordings import folder


@pytest.fixture
def worker(settings, database):
    """What the worker does beside the boxes' data, until the test ends."""
    stop = threading.Event()
    runner = Runner(settings, database, lambda: dt.datetime.now(dt.UTC))

    def work() -> None:
        while not stop.wait(0.1):
            while not stop.is_set() and runner.once(stop):
                pass

    thread = threading.Thread(target=work)
    thread.start()
    yield
    stop.set()
    thread.join(20.0)
    assert not thread.is_alive()


def rest_of_a_gyro(path) -> None:
    """Eleven minutes of an MPU-6050 at rest; its stamps are bursty, the sensor is not."""
    name = "unmoved-with-x-pointing-forward-10min__mpu6050_gyroscope.csv.gz"
    with gzip.open(folder("sunsided-mpu6050-hmc5883l") / name) as file:
        rows = np.loadtxt(file, delimiter=",", skiprows=1)
    rows = rows[np.unique(rows[:, 0], return_index=True)[1]]
    w = np.radians(rows[:, 1:4])
    path.write_bytes(Columns({"t": rows[:, 0], "wx": w[:, 0], "wy": w[:, 1], "wz": w[:, 2]}).to_parquet())


def full_sphere_of_a_compass(path) -> None:
    """An HMC5883L turned all around, gauss to µT."""
    with gzip.open(folder("sunsided-mpu6050-hmc5883l") / "full-sphere__hmc5883l_compass.csv.gz") as file:
        rows = np.loadtxt(file, delimiter=",", skiprows=1)
    rows = rows[np.unique(rows[:, 0], return_index=True)[1]]
    m = 100.0 * rows[:, 1:4]
    path.write_bytes(Columns({"t": rows[:, 0], "mx": m[:, 0], "my": m[:, 1], "mz": m[:, 2]}).to_parquet())


def poses_of_an_xsens(path) -> None:
    """38 poses of the imu_tk recording, counts to about m/s²."""
    rows = np.loadtxt(folder("imu-tk-xsens") / "xsens_acc.txt.gz")
    f = (rows[:, 1:] - 32768.0) * 9.81744 / 6700.0
    path.write_bytes(Columns({"t": rows[:, 0], "fx": f[:, 0], "fy": f[:, 1], "fz": f[:, 2]}).to_parquet())


def phase_data(path) -> None:
    """The Allan reference series of allantools, as if it were a turn rate in mrad/s at 1 Hz."""
    x = np.loadtxt(folder("allantools-reference") / "phasedat" / "PHASE.DAT", comments="#")
    rate = 1e-3 * np.diff(x)
    t = np.arange(rate.size, dtype=float)
    path.write_bytes(Columns({"t": t, "wx": rate, "wy": rate, "wz": rate}).to_parquet())


def analyse(page, kind: str, path, **typed: str) -> None:
    """Fill the form as a person does and wait for the result."""
    page.goto("/workbench")
    page.get_by_label("What").select_option(kind)
    page.get_by_label("File", exact=True).set_input_files(path)
    for label, value in typed.items():
        page.get_by_label(label).fill(value)
    page.get_by_role("button", name="Analyse", exact=True).click()
    expect(page).to_have_url(re.compile(r"/workbench/[0-9a-f]{32}$"))
    expect(page.locator("#heading")).to_contain_text(re.compile("Done|Failed"), timeout=120_000)


@pytest.mark.usefixtures("worker")
@pytest.mark.parametrize(
    ("kind", "make", "typed", "figures", "words"),
    [
        ("allan", rest_of_a_gyro, {"Rate in Hz, where the stamps are irregular": "99.32"}, 1, "Bias instability"),
        ("allan", phase_data, {}, 1, "rad/s/√Hz"),
        ("accelerometer", poses_of_an_xsens, {"Gravity at the place, m/s²": "9.81744"}, 3, "theta_yz"),
        ("magnetometer", full_sphere_of_a_compass, {}, 6, "beta_x"),
    ],
    ids=["gyro", "reference", "poses", "compass"],
)
def test_an_engineer_analyses_a_real_recording(
    site, open_page, screenshot, tmp_path, kind, make, typed, figures, words
):
    path = tmp_path / f"{make.__name__}.parquet"
    make(path)
    page = open_page("/workbench")
    analyse(page, kind, path, **typed)
    expect(page.locator("#heading")).to_contain_text("Done")
    expect(page.locator("#result")).to_contain_text(words)
    expect(page.locator("figure.graph")).to_have_count(figures)
    assert page.locator(".graph-line, .graph-dots").first.get_attribute("d").startswith("M")
    screenshot(page, f"workbench-{make.__name__}")
    with page.expect_download() as download:
        page.get_by_role("link", name="JSON").click()
    assert json.loads(download.value.path().read_bytes())["kind"] == kind
    address = page.url
    page.set_viewport_size({"width": 390, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    screenshot(page, f"workbench-{make.__name__}-phone")
    page.evaluate(axe_source())
    assert page.evaluate(RUN_AXE) == []
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        assert page.evaluate(CONTRAST) == []
    page.goto("/workbench")
    expect(page.locator(f'a[href="{address.removeprefix(site.address)}"]')).to_be_visible()


@pytest.mark.usefixtures("worker")
def test_a_drive_becomes_a_track_and_estimators_side_by_side(open_page, screenshot, tmp_path, recording):
    path = tmp_path / "drive.parquet"
    path.write_bytes(from_drive(recording).to_parquet())
    page = open_page("/workbench")
    analyse(page, "track", path, **{"For, s; 0 withholds nothing": "20"})
    expect(page.locator("#result")).to_contain_text("Withheld fixes within")
    expect(page.get_by_role("img", name="The stretch without GPS")).to_be_visible()
    screenshot(page, "workbench-track")
    page.get_by_role("link", name="Analyse again").click()
    expect(page.locator("#ask")).to_contain_text("drive.parquet")
    page.get_by_label("What").select_option("mounting")
    page.get_by_role("button", name="Analyse", exact=True).click()
    expect(page.locator("#heading")).to_contain_text("Done", timeout=120_000)
    table = page.locator("#result table")
    for method in ("Filter of the thesis", "Two phases", "Online", "Whole drive"):
        expect(table).to_contain_text(method)
    expect(page.get_by_role("img", name="Largest eigenvalue of the normalised covariance")).to_be_visible()
    screenshot(page, "workbench-mounting")
    page.get_by_role("link", name="From the reference, about the vehicle's axes").click()
    expect(page.get_by_role("img", name="About z, down")).to_be_visible()
    assert page.url.endswith("?show=apart")


@pytest.mark.usefixtures("worker")
def test_a_bad_file_a_wrong_setting_and_nothing_at_all_are_told(open_page, tmp_path):
    path = tmp_path / "holiday.jpg"
    path.write_bytes(b"\xff\xd8\xff\xe0 no drive")
    page = open_page("/workbench", expected=("422",))
    page.get_by_role("button", name="Analyse", exact=True).click()
    expect(page.get_by_role("alert")).to_have_text("Choose a file or a trip.")
    page.get_by_label("File", exact=True).set_input_files(path)
    page.get_by_label("Rate in Hz, where the stamps are irregular").fill("-5")
    page.get_by_role("button", name="Analyse", exact=True).click()
    expect(page.get_by_role("alert")).to_contain_text("rate_hz")
    analyse(page, "allan", path)
    expect(page.locator("#result")).to_contain_text("holiday.jpg is no drive file")
    page.get_by_role("button", name="Delete").click()
    expect(page.locator("#analyses")).to_contain_text("No analysis yet.")


def batch(start: float, seconds: float, now: float, origin: float) -> dict[str, list[float | None]]:
    """What a box of 200 Hz sends of a stretch of its clock that ends `now`."""
    t = np.arange(start, start + seconds, 0.005)
    fixes = np.arange(t.size) % 50 == 0
    columns = {"t": t, "fx": np.sin(t), "fy": np.cos(t), "fz": -9.81 + 0.1 * np.sin(9.0 * t)}
    values = {name: column.tolist() for name, column in columns.items()}
    of_fix = {"lat": 45.0, "lon": 11.0, "alt": 100.0, "speed": 12.0, "course": 30.0, "fix": 1.0}
    values |= {name: [value if fix else None for fix in fixes] for name, value in of_fix.items()}
    values["utc"] = [origin + s if fix else None for s, fix in zip(t.tolist(), fixes, strict=True)]
    assert origin + start + seconds <= now + 1.0
    return values


def test_a_box_is_watched_live(site, open_page, screenshot, settings):
    app = site.app
    page = open_page("/")
    headers = {"Authorization": f"Bearer {settings.admin_token.get_secret_value()}"}
    box = httpx.post(f"{site.address}/api/v1/devices", json={"name": "live box"}, headers=headers).json()
    origin = dt.datetime.now(dt.UTC).timestamp() - 60.0

    def send(sequence: int, start: float, seconds: float) -> None:
        now = dt.datetime.now(dt.UTC).timestamp()
        answer = httpx.post(
            f"{site.address}/api/v1/batches",
            json={"columns": batch(start, seconds, now, origin)},
            headers={"Authorization": f"Bearer {box['token']}", "Idempotency-Key": f"b/{sequence}"},
            timeout=30.0,
        )
        assert answer.status_code == 202, answer.text
        bring_up_to_date(site.database, app.state.store, box["id"], clock=lambda: dt.datetime.now(dt.UTC))

    send(0, 0.0, 20.0)
    page.goto(f"/devices/{box['id']}/live")
    value = page.locator('[data-now="fx"]')

    def sine(t: float) -> str:
        return f"{np.sin(t):.2f}".replace("-", "\N{MINUS SIGN}")

    expect(value).to_have_text(sine(19.995))
    expect(page.locator("#health")).to_contain_text("200")
    assert page.locator("canvas").count() == 2
    send(1, 20.0, 10.0)
    expect(value).to_have_text(sine(29.995))  # told by the stream, fetched, drawn
    send(2, 40.0, 5.0)  # ten seconds are missing
    expect(value).to_have_text(sine(44.995))
    page.get_by_role("button", name="60 s").click()
    page.get_by_role("button", name="Turn rate").click()
    expect(page.locator('[data-group="w"]')).to_be_visible()
    page.get_by_role("button", name="Pause").click()
    expect(page.get_by_role("button", name="Pause")).to_have_attribute("aria-pressed", "true")
    screenshot(page, "live-monitor")
    # A frame costs little: the page stays free while a minute of 200 Hz glides by.
    page.get_by_role("button", name="Pause").click()
    longest = page.evaluate(
        """() => new Promise((done) => {
          let last = performance.now(), worst = 0, left = 60;
          const look = (now) => {
            worst = Math.max(worst, now - last);
            last = now;
            --left ? requestAnimationFrame(look) : done(worst);
          };
          requestAnimationFrame(look);
        })"""
    )
    assert longest < 1000.0, longest
    page.set_viewport_size({"width": 390, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    screenshot(page, "live-monitor-phone")
