"""An administrator's and a claims handler's ways through the pages, in a real browser."""

from __future__ import annotations

import datetime as dt
import re
from pathlib import Path

import pytest
from playwright.sync_api import expect
from sqlalchemy import select

from server.accounts.service import open_session
from server.models import Device, EventRevision, JobFailure, Rerun, RerunItem, User, new_id
from server.pages.audit_words import DEEDS
from tests.browser.conftest import ARTIFACTS
from tests.browser.test_events import event
from tests.browser.test_every_page import keep
from tests.browser.test_pages import CONTRAST

__all__ = ["event"]

NOW = dt.datetime.now(dt.UTC)


@pytest.fixture
def troubled(site, event) -> str:
    """A dead letter, and a re-run that changed the crash; the run's id."""
    with site.database.transaction() as session:
        device = session.scalars(select(Device).where(Device.vehicle_id == site.vehicles["Iveco Daily"])).one()
        when = {"first_at": NOW - dt.timedelta(hours=5), "last_at": NOW, "dead_at": NOW - dt.timedelta(hours=1)}
        error = "ValueError: the window holds no samples"
        session.add(JobFailure(device_id=device.id, failures=9, error=error, queue="devices", job_id=new_id(), **when))
        old = session.scalars(select(EventRevision).where(EventRevision.event_id == event)).one()
        told = {"kind": "crash", "pdof_deg": -20.0, "impact_speed_kmh": 43.2, "peak_g": 17.9, "t0_s": 120.0}
        told |= {"delta_v_kmh": {"longitudinal": -30.1, "lateral": 10.9, "resultant": 32.0}}
        after = {**told, "delta_v_kmh": {"longitudinal": -30.7, "lateral": 10.8, "resultant": 32.6}}
        run = Rerun(
            id=new_id(),
            organisation_id=site.organisation_id,
            created_at=NOW,
            created_by="administrator",
            algorithm=old.algorithm,
            total=1,
            finished_at=NOW,
        )
        session.add(run)
        session.flush()
        session.add(
            RerunItem(
                rerun_id=run.id,
                event_id=event,
                ordinal=0,
                attempts=1,
                done_at=NOW,
                outcome="revised",
                before={"algorithm": "crash/0", **told},
                after={"algorithm": old.algorithm, "revision": 2, **after},
                differences=["event.delta_v_kmh.resultant"],
            )
        )
        return run.id


@pytest.mark.usefixtures("troubled")
def test_the_administrators_way(open_page, screenshot):
    page = open_page("/", expected=("/admin", "422"))
    page.get_by_role("navigation", name="Sections").get_by_role("link", name="Administration").click()
    dead = page.locator(".tile").filter(has_text="Dead letters")
    expect(dead.locator(".tile-number")).to_have_text("1")
    keep(page, screenshot, "story-admin")
    # A dead letter is looked at and tried again.
    dead.click()
    row = page.get_by_role("row").filter(has_text="the window holds no samples")
    expect(row).to_contain_text("dead letter")
    keep(page, screenshot, "story-admin-work")
    row.get_by_role("button", name="Try again").click()
    expect(page.locator("#failing")).to_contain_text("Nothing fails.")
    # A box is made; its code is shown once.
    tabs = page.get_by_role("navigation", name="Administration")
    tabs.get_by_role("link", name="Boxes").click()
    keep(page, screenshot, "story-admin-boxes")
    page.get_by_label("Name or serial number").fill("SC-0815")
    page.get_by_label("Vehicle", exact=True).select_option(label="Piaggio Porter (GI 909 ZZ)")
    page.get_by_role("button", name="Add").click()
    expect(page.locator("#secret .secret")).to_have_text(re.compile(r"^([0-9A-Z]{4}-){3}[0-9A-Z]{4}$"))
    page.get_by_label("Take signed requests only").check()
    keep(page, screenshot, "story-admin-box")
    page.get_by_role("button", name="Save").click()
    expect(page.locator("#access")).to_contain_text("signature only")
    expect(page.locator("#secret")).to_have_count(0)
    page.get_by_text("Revoke this box").click()
    page.get_by_role("button", name="Revoke", exact=True).click()
    expect(page.locator(".heading")).to_contain_text("revoked")
    # A channel and a rule that uses it; the test message says why it cannot go.
    tabs.get_by_role("link", name="Rules and channels").click()
    page.get_by_role("navigation", name="New channel").get_by_role("link", name="E-mail").click()
    page.get_by_label("Name").fill("Fleet office")
    page.get_by_label("E-mail addresses").fill("office@fleet.test")
    page.get_by_role("button", name="Add").click()
    page.get_by_role("button", name="Send a test message").click()
    expect(page.locator("#trial")).to_contain_text("SCATOLA_SMTP_HOST is not set")
    keep(page, screenshot, "story-admin-channel")
    tabs.get_by_role("link", name="Rules and channels").click()
    page.get_by_role("navigation", name="New rule").get_by_role("link", name="Geofence").click()
    page.get_by_label("Name").fill("Yard")
    page.get_by_role("button", name="Add").click()
    expect(page.get_by_role("alert")).to_contain_text("Give latitude, longitude and radius")
    for label, text in (("Latitude", "45.4064"), ("Longitude", "11.8768"), ("Radius, m", "250")):
        page.get_by_label(label, exact=True).fill(text)
    page.get_by_label("Fleet office").check()
    keep(page, screenshot, "story-admin-rule")
    page.get_by_role("button", name="Add").click()
    expect(page.locator("#rules")).to_contain_text("Yard")
    expect(page.locator("#rules")).to_contain_text("Fleet office")
    keep(page, screenshot, "story-admin-alerts")
    # What a version changed.
    tabs.get_by_role("link", name="Versions").click()
    keep(page, screenshot, "story-admin-versions")
    page.locator("#runs").get_by_role("link").click()
    expect(page.locator("#shifts")).to_contain_text("+0.60")
    expect(page.locator("#items")).to_contain_text("32.0 → 32.6")
    keep(page, screenshot, "story-admin-rerun")
    # All of it is in the log.
    tabs.get_by_role("link", name="Audit").click()
    for action in ("jobs.replay", "box.added", "box.settings", "box.revoked", "channel.tested", "rule.added"):
        expect(page.get_by_role("cell", name=DEEDS[action], exact=True)).to_have_count(1)


def test_the_claims_handlers_way(event, site, open_page, screenshot):
    with site.database.transaction() as session:
        user = User(
            id=new_id(),
            organisation_id=site.organisation_id,
            email="clara@claims.test",
            name="Clara",
            role="claims",
            created_at=NOW,
            preferences={"units": "imperial"},
        )
        session.add(user)
        session.flush()
        opened = open_session(session, site.organisation_id, now=dt.datetime.now(dt.UTC), user_id=user.id)
        old = session.scalars(select(EventRevision).where(EventRevision.event_id == event)).one()
        kept = {name: getattr(old, name) for name in EventRevision.__table__.columns.keys() if name != "id"}  # noqa: SIM118
        session.add(EventRevision(**{**kept, "number": 0, "algorithm": "crash/0"}))
    page = open_page("/login", signed_in=False, expected=("/admin",))
    page.context.add_cookies([{"name": "scatola_session", "value": opened.token, "url": site.address}])
    page.goto("/events")
    expect(page.get_by_role("link", name="Administration")).to_have_count(0)
    page.get_by_role("row").get_by_role("link", name="Crash").click()
    expect(page.locator("#figures")).to_contain_text("19.9mph")
    expect(page.locator("#words")).to_contain_text("mph")
    expect(page.locator("body")).not_to_contain_text("km/h")
    charts = page.locator("event-charts")
    charts.scroll_into_view_if_needed()
    expect(charts).to_have_attribute("data-drawn", "3")
    page.get_by_text("All hashes, SHA-256").click()
    expect(page.locator("#provenance")).to_contain_text("Upload 0 of the chain")
    page.get_by_label("Legal hold").fill("Claim 4711")
    page.get_by_role("button", name="Hold: keep").click()
    page.get_by_label("Note").fill("Seen with the driver")
    page.get_by_role("button", name="Confirm").click()
    expect(page.locator("#heading")).to_contain_text("Review: confirmed")
    page.wait_for_load_state()  # its style, too
    page.evaluate("scrollTo(0, 0)")
    for width, which in ((1280, "desk"), (390, "phone")):
        page.set_viewport_size({"width": width, "height": 844})
        for scheme in ("dark", "light"):
            page.emulate_media(color_scheme=scheme)
            assert page.evaluate(CONTRAST) == []
            screenshot(page, f"story-claims-{which}-{scheme}")
    page.set_viewport_size({"width": 1280, "height": 800})
    # The number of the claim leads back to the event.
    page.goto("/events")
    page.get_by_text("Verdicts").click()
    with page.expect_download() as download:
        page.get_by_role("link", name="CSV").click()
    assert "confirmed,Seen with the driver" in Path(download.value.path()).read_text()
    page.get_by_role("searchbox", name="Search for").fill("Claim 4711")
    page.get_by_role("searchbox", name="Search for").press("Enter")
    page.wait_for_url(f"**/events/{event}")
    page.goto(f"/events/{event}/compare?before=1&after=1")
    expect(page.get_by_role("heading", name="Revisions compared")).to_be_visible()
    keep(page, screenshot, "story-claims-compare")
    assert page.goto("/admin").status == 403


@pytest.mark.parametrize("vehicle_class", ["van", "truck", "bus", "motorcycle"])
def test_the_sketch_is_of_the_vehicles_class(event, site, open_page, vehicle_class):
    from server.models import Vehicle

    with site.database.transaction() as session:
        session.get_one(Vehicle, site.vehicles["Fiat Panda"]).vehicle_class = vehicle_class
    page = open_page(f"/events/{event}")
    sketch = page.locator("svg.pdof")
    expect(sketch).to_have_attribute("data-class", vehicle_class)
    sketch.screenshot(path=ARTIFACTS / f"sketch-{vehicle_class}.png")
