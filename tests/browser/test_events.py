"""The event list and an event's page, as a claims handler walks them."""

from __future__ import annotations

import datetime as dt
import re
import sys
from pathlib import Path
from time import monotonic

import pytest
from playwright.sync_api import expect
from sqlalchemy import select

from server.live.changes import announce
from server.models import Batch, Boot, Device, Event, Installation
from tests.browser.scenes import CHATTER, PATIENCE_MS, wait_coloured
from tests.browser.test_every_page import keep, walk_by_keyboard
from tests.browser.test_pages import css, wait_drawn

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "server"))
from crash_world import crash, store_event


@pytest.fixture
def event(site) -> str:
    """A crash of the first vehicle, on the raw data that it has."""
    with site.database.transaction() as session:
        device = session.scalars(select(Device).where(Device.vehicle_id == site.vehicles["Fiat Panda"])).one()
        batches = session.scalars(select(Batch).where(Batch.device_id == device.id).order_by(Batch.sequence)).all()
        boot = session.scalars(select(Boot).where(Boot.device_id == device.id)).one()
        installation = session.scalars(select(Installation).where(Installation.device_id == device.id)).one()
        t0 = 120.0
        row = store_event(session, crash(t0, utc_t0=boot.unix_s(t0)), device, boot, list(batches), installation)
        announce(
            session,
            "event",
            at=dt.datetime.now(dt.UTC),
            organisation_id=device.organisation_id,
            device_id=device.id,
            vehicle_id=device.vehicle_id,
            data={"event_id": row.id, "event_kind": "crash", "severe": True, "revision": 1},
        )
        return row.id


def test_a_crash_asks_for_attention_and_leads_to_its_page(event, open_page):
    page = open_page("/")
    tile = page.locator(".tile").filter(has=page.get_by_text("Crash", exact=True))
    expect(tile.locator(".tile-number")).to_have_text("1")
    tile.get_by_role("link", name="Fiat Panda").click()
    page.wait_for_url(f"**/events/{event}")
    expect(page.get_by_role("heading", name="Crash", exact=True)).to_be_visible()
    page.get_by_role("link", name="Events").click()
    row = page.get_by_role("row").filter(has=page.get_by_role("link", name="Crash", exact=True))
    expect(row).to_contain_text("[30, 34]")
    expect(row).to_contain_text("Open")
    page.get_by_role("link", name="Manoeuvres").click()
    expect(page.locator("#events")).to_contain_text("Nothing so far")


def walk(page):
    figures = page.locator("#figures")
    for words in (
        "32.0km/h",
        "[29.9, 34.3]",
        "\N{MINUS SIGN}20.0°",
        "ahead on the left",
        "43.2km/h",
        "17.9g",
        "at least: clipped",
    ):
        expect(figures).to_contain_text(words)
    expect(page.locator("#words")).to_contain_text("The force came from ahead on the left (11 o'clock)")
    expect(page.get_by_role("img", name="Force from ahead on the left, 11 o'clock")).to_be_visible()
    expect(page.locator("#numbers")).to_contain_text("NHTSA-2022-all")
    expect(page.locator("#quality")).to_contain_text("9 samples reached the full scale")
    charts = page.locator("event-charts")
    charts.scroll_into_view_if_needed()
    expect(charts).to_have_attribute("data-drawn", "3")
    for plot, colour in (("dv", "axis-x"), ("dv", "axis-y"), ("pulse", "axis-x"), ("speed", "track")):
        wait_drawn(page.locator(f'[data-plot="{plot}"] canvas'), css(page, colour), 100)
    way = page.locator("event-map")
    way.scroll_into_view_if_needed()
    expect(way).to_have_attribute("data-points", "121")
    wait_drawn(way, css(page, "alarm-fill"), 60)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_event_page_shows_everything(event, open_page, screenshot, scheme):
    page = open_page(f"/events/{event}", color_scheme=scheme)
    walk(page)
    screenshot(page, f"event-{scheme}")


def test_the_event_page_is_readable_by_everybody(event, open_page, screenshot):
    page = open_page(f"/events/{event}", locale="it-IT")
    expect(page.get_by_role("heading", name="Da dove è venuta la forza")).to_be_visible()
    keep(page, screenshot, "event-it")


def test_one_cursor_through_charts_and_map(event, open_page):
    page = open_page(f"/events/{event}")
    walk(page)
    way, now = page.locator("event-map"), page.locator("event-charts [data-now]")
    over = page.locator('[data-plot="speed"] .u-over')
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    over.hover(position={"x": 0.25 * box["width"], "y": 40})
    expect(page.locator('[data-now="speed0"]')).to_have_text(re.compile(r"^\d+\.\d\d$"))
    expect(way).to_have_attribute("data-cursor", re.compile(r"^-1\d"))
    # Time zero lies in all three.
    pulse = page.locator('[data-plot="pulse"] .u-over')
    pulse.hover(position={"x": 0.5 * pulse.bounding_box()["width"], "y": 40})
    for place in now.all():
        expect(place).to_have_text(re.compile(r"\d"))
    expect(way).to_have_attribute("data-cursor", re.compile(r"^-?0\.\d"))
    page.mouse.move(5, 5)
    expect(way).to_have_attribute("data-cursor", "")


def test_the_event_page_on_a_phone(event, open_page, screenshot):
    page = open_page(f"/events/{event}", viewport={"width": 390, "height": 844}, device_scale_factor=2)
    walk(page)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    screenshot(page, "event-phone")


@pytest.mark.parametrize("width", [320, 390])
def test_pages_and_their_navigation_fit_a_phone(event, site, open_page, width):
    page = open_page("/", viewport={"width": width, "height": 740})
    for path in ("/", "/vehicles", f"/vehicles/{site.vehicles['Fiat Panda']}", "/events", f"/events/{event}", "/users"):
        page.goto(path)
        assert page.evaluate("document.documentElement.scrollWidth") <= width, path
    page.goto("/audit")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for cell in page.locator(".rows td, .rail-link").all():
        assert cell.evaluate("e => e.scrollWidth <= e.clientWidth && e.getBoundingClientRect().right <= innerWidth")


def test_boxes_to_tick_stand_before_their_words(open_page):
    page = open_page("/users")
    for label in page.locator("label.check").all():
        assert label.locator("input").bounding_box()["width"] < 30


def test_downloads_and_review(event, site, open_page):
    page = open_page(f"/events/{event}")
    for name, start in (
        ("Report, PDF", b"%PDF"),
        ("Evidence archive", b"PK"),
        ("Parquet", b"PAR1"),
        ("MCAP", b"\x89MCAP"),
    ):
        with page.expect_download() as download:
            page.locator("#downloads").get_by_role("link", name=name, exact=True).click()
        assert Path(download.value.path()).read_bytes().startswith(start)
    page.get_by_label("Note").fill("Seen with the driver")
    page.get_by_role("button", name="Confirm").click()
    expect(page.locator("#heading")).to_contain_text("Review: confirmed")
    expect(page.locator("#actions")).to_contain_text("Confirmed: Seen with the driver")
    page.get_by_label("Legal hold").fill("Claim 4711")
    page.get_by_role("button", name="Hold: keep").click()
    expect(page.locator("#heading")).to_contain_text("legal hold")
    with site.database.reading() as session:
        row = session.get(Event, event)
        assert (row.verdict, row.hold_reason) == ("confirmed", "Claim 4711")
    page.get_by_label("Legal hold").fill("Settled")
    page.get_by_role("button", name="End the hold").click()
    expect(page.locator("#heading")).not_to_contain_text("legal hold")


def replayed(page):
    """The parts of a replay: whether it plays, its slider, the words of its time, the time of viser's player."""
    bar = page.get_by_role("group", name="Replay")
    expect(bar).to_be_visible(timeout=PATIENCE_MS)
    player = page.frame_locator("scene-3d iframe").locator('input[inputmode="decimal"]')
    return bar.get_by_role("checkbox", name="Play"), bar.get_by_role("slider"), bar.locator("output"), player


@pytest.mark.usefixtures("viewer")
def test_the_replay_plays_and_can_be_scrubbed(event, open_page, screenshot):
    page = open_page(f"/events/{event}", expected=CHATTER)
    page.set_default_timeout(PATIENCE_MS)
    play, at, words, player = replayed(page)
    expect(play).to_be_checked()
    expect(words).not_to_have_text("\N{MINUS SIGN}6.000 s", timeout=PATIENCE_MS)  # it plays
    page.get_by_label("Speed of the replay").select_option("1/50×")
    play.uncheck()
    at.fill("0.085")
    expect(words).to_have_text("0.085 s")
    expect(player).to_have_value("6.1")
    # The scene fades in, slowly where software renders it; the arrow of the force is there from time zero on.
    wait_coloured(page.locator("scene-3d"), lambda drawn: drawn["red"] > 300)
    # Neither viser's bar nor its remark that the machine has no graphics card stands over the picture.
    expect(page.frame_locator("scene-3d iframe").locator("[class*=mantine-Paper]:visible")).to_have_count(0)
    expect(page.frame_locator("scene-3d iframe").locator(".mantine-Notifications-root:visible")).to_have_count(0)
    screenshot(page, "event-replay")
    # By keyboard it goes from sample to sample of the pulse, and ends at its end.
    at.press("ArrowRight")
    expect(words).to_have_text("0.090 s")
    expect(at).to_have_attribute("aria-valuetext", "0.090 s")
    page.get_by_label("Speed of the replay").select_option("1×")
    at.fill("5.5")
    play.check()
    expect(play).not_to_be_checked(timeout=PATIENCE_MS)
    expect(words).to_have_text("6.000 s")
    play.check()
    expect(words).to_have_text(re.compile("^\N{MINUS SIGN}"))  # from the beginning


@pytest.mark.usefixtures("viewer")
def test_nothing_plays_by_itself_for_whoever_wants_no_motion(event, open_page):
    page = open_page(f"/events/{event}", expected=CHATTER, reduced_motion="reduce")
    play, at, words, player = replayed(page)
    # The moment of the impact, and it stays.
    expect(player).to_have_value("6.0", timeout=PATIENCE_MS)
    expect(words).to_have_text("0.000 s")
    at.press("ArrowLeft")
    expect(words).to_have_text("\N{MINUS SIGN}0.005 s")
    expect(play).not_to_be_checked()
    play.check()
    expect(words).to_have_text(re.compile(r"^[1-5]"), timeout=PATIENCE_MS)


def test_charts_by_keyboard(event, open_page):
    page = open_page(f"/events/{event}")
    page.locator("event-charts").scroll_into_view_if_needed()
    expect(page.locator("event-charts")).to_have_attribute("data-drawn", "3")
    chart = page.get_by_role("slider", name="Change of velocity")
    chart.focus()
    chart.press("Home")
    said = re.compile(r"^\W\d+(\.\d+)? ms longitudinal\s0\.00\slateral\s0\.00$")
    expect(chart).to_have_attribute("aria-valuetext", said)
    first = chart.get_attribute("aria-valuetext")
    chart.press("ArrowRight")
    expect(chart).not_to_have_attribute("aria-valuetext", first)
    expect(chart).to_have_attribute("aria-valuetext", said)
    chart.press("ArrowLeft")
    expect(chart).to_have_attribute("aria-valuetext", first)
    chart.press("End")
    # The change of velocity as the table has it, and the other charts and the map at the same instant.
    expect(chart).to_have_attribute("aria-valuetext", re.compile(r"ms longitudinal\s\W30\.\d\d\slateral\s1\d\.\d\d$"))
    expect(page.locator('[data-now="pulse0"]')).to_have_text(re.compile(r"\d"))
    expect(page.locator('[data-now="speed0"]')).to_have_text(re.compile(r"\d"))
    page.locator("event-map").scroll_into_view_if_needed()
    chart.press("PageDown")
    expect(page.locator("event-map")).to_have_attribute("data-cursor", re.compile(r"^0\.\d"))


@pytest.mark.usefixtures("viewer")
def test_replay_charts_and_map_show_one_instant(event, open_page):
    page = open_page(f"/events/{event}", expected=CHATTER)
    page.set_default_timeout(PATIENCE_MS)
    play, at_slider, words, time = replayed(page)
    assert float(at_slider.get_attribute("min")) == -6.0
    way = page.locator("event-map")
    expect(time).not_to_have_value("0.0", timeout=PATIENCE_MS)  # it plays from the beginning on
    way.scroll_into_view_if_needed()
    expect(way).to_have_attribute("data-points", "121")
    expect(page.locator("event-charts")).to_have_attribute("data-drawn", "3")
    over = page.locator('[data-plot="speed"] .u-over')
    over.scroll_into_view_if_needed()

    def pointed(at: float) -> float:
        """Point at an instant of the speed chart, which shows half a minute before and after."""
        until = monotonic() + PATIENCE_MS / 1000.0
        x = over.bounding_box()["width"] * (at + 30.0) / 60.0
        while True:
            over.hover(position={"x": x, "y": 40})
            shown = way.get_attribute("data-cursor")
            # The chart learns a moment after the page was scrolled where it lies.
            if shown and abs(float(shown) - at) < 0.1:
                return float(shown)
            assert monotonic() < until, shown

    # The reader points, the replay stops there; an instant that it does not have is its first or last.
    for wanted, shown in ((0.0, 6.0), (1.2, 7.2), (-1.8, 4.2), (-20.0, 0.0), (20.0, 12.0), (0.0, 6.0)):
        at = pointed(wanted)
        until = monotonic() + PATIENCE_MS / 1000.0
        while abs(float(time.input_value()) - shown) > 0.15:
            assert monotonic() < until, (time.input_value(), shown)
        # To the millisecond, where the player shows tenths of a second.
        expect(words).to_have_text(f"{min(max(at, -6.0), 6.0):.3f} s".replace("-", "\N{MINUS SIGN}"))
        expect(play).not_to_be_checked()
        # What the replay made of it moves neither the reader's cursor nor the page.
        assert float(way.get_attribute("data-cursor")) == at
        expect(over).to_be_in_viewport()
    page.mouse.move(5, 5)
    expect(way).to_have_attribute("data-cursor", "")

    # It plays on, and the cursor of the charts and the mark on the map go along.
    play.check()
    seen = set()
    until = monotonic() + PATIENCE_MS / 1000.0
    while len(seen) < 5:
        assert monotonic() < until, seen
        expect(way).to_have_attribute("data-cursor", re.compile(r"\d"), timeout=PATIENCE_MS)
        seen.add(way.get_attribute("data-cursor"))
    assert all(-6.0 <= float(at) <= 6.1 for at in seen)
    expect(page.locator('[data-now="speed0"]')).to_have_text(re.compile(r"\d"))


@pytest.mark.usefixtures("viewer")
def test_the_event_page_by_keyboard(event, open_page):
    page = open_page(f"/events/{event}", expected=CHATTER)
    replayed(page)
    assert walk_by_keyboard(page) == []
