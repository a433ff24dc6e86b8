"""The alerts page and what other pages show of alerts, in a real browser."""

from __future__ import annotations

import datetime as dt
import re

import pytest
from playwright.sync_api import expect
from sqlalchemy import select

from server.alerts.raising import Finding, raise_all
from server.live.changes import announce
from server.models import AlertChannel, AlertDelivery, AlertRule, Device, Diagnosis, TheftWatch, Trip, new_id

NARROW = {"viewport": {"width": 390, "height": 844}}


def about(session, site, name):
    vehicle_id = site.vehicles[name]
    return session.scalars(select(Device).where(Device.vehicle_id == vehicle_id)).one(), vehicle_id


def raise_one(site, name, rule, kind, severity, facts, at, **more):
    with site.database.transaction() as session:
        device, vehicle_id = about(session, site, name)
        finding = Finding(rule, kind, severity, new_id(), at, facts, **more)
        raised = raise_all(session, site.organisation_id, device.id, vehicle_id, [finding], now=at)
        session.add_all(raised.alerts)
        session.flush()
        session.add_all(raised.deliveries)
        for alert in raised.alerts:
            announce(
                session,
                "alert",
                at=at,
                organisation_id=site.organisation_id,
                device_id=device.id,
                vehicle_id=vehicle_id,
                data={"alert_id": alert.id},
            )
        return raised.alerts[0].id


@pytest.fixture
def alerted(site):
    """Alerts of several kinds, rules, channels, and a letter that came back."""
    now = dt.datetime.now(dt.UTC)
    own = {"organisation_id": site.organisation_id, "created_at": now}
    with site.database.transaction() as session:
        hook = AlertChannel(
            id=new_id(), name="Control room", kind="webhook", recipients=["https://x.test/"], emergency=True, **own
        )
        mail = AlertChannel(
            id=new_id(), name="Fleet office", kind="email", recipients=["a@b.test"], emergency=False, **own
        )
        channels = [hook.id, mail.id]
        session.add_all([hook, mail])
        more = {"cooldown_s": 0.0, **own}
        rules = [
            AlertRule(
                id=new_id(), name="Silent for a day", kind="silent", parameters={"hours": 24}, channels=channels, **more
            ),
            AlertRule(
                id=new_id(),
                name="Depot",
                kind="geofence",
                parameters={
                    "fence": {"shape": "circle", "lat_deg": 45.4, "lon_deg": 11.9, "radius_m": 300},
                    "on": "both",
                    "margin_m": 25,
                },
                channels=[mail.id],
                **more,
            ),
            AlertRule(
                id=new_id(),
                name="Harsh driving",
                kind="harsh",
                parameters={"count": 5, "per": "day"},
                channels=[],
                **more,
            ),
        ]
        session.add_all(rules)
    place = {"passage": "left", "fence": "Depot", "position": {"lat_deg": 45.40643, "lon_deg": 11.87681}}
    raise_one(site, "Maserati Levante", rules[0], "silent", "attention", {"hours": 24.0}, now - dt.timedelta(hours=3))
    raise_one(site, "Fiat Panda", rules[1], "geofence", "info", place, now - dt.timedelta(minutes=50))
    raise_one(site, "Iveco Daily", rules[0], "moved", "attention", {"angle_deg": 34.0}, now - dt.timedelta(minutes=12))
    with site.database.transaction() as session:
        row = session.scalars(select(AlertDelivery).where(AlertDelivery.channel_id == hook.id)).first()
        row.state, row.attempts, row.finished_at = "dead", 10, now - dt.timedelta(minutes=30)
        row.error = "TimeoutError: the answer was not whole within 10 s"
    return site


def test_an_alert_appears_by_itself_and_is_acknowledged(alerted, open_page, screenshot):
    page = open_page("/alerts")
    rows = page.locator("#alerts tbody tr")
    expect(rows).to_have_count(3)
    expect(page.locator("#heading")).to_contain_text("3 wait for somebody to look")
    expect(page.locator("#live-words")).to_have_text("Live")
    facts = {"why": "moves without ignition", "position": {"lat_deg": 45.4064, "lon_deg": 11.8768}}
    raise_one(alerted, "Fiat Panda", None, "theft", "alarm", facts, dt.datetime.now(dt.UTC))
    expect(rows).to_have_count(4)
    expect(rows.first).to_contain_text("The vehicle moves without ignition · 45.40640 11.87680")
    screenshot(page, "alerts-1280")
    rows.first.get_by_role("button", name="Acknowledge").click()
    expect(page.locator("#alerts tbody tr")).to_have_count(3)
    page.get_by_role("link", name="All", exact=True).click()
    expect(page.locator("#alerts tbody tr").first).to_contain_text("administrator")


def test_a_letter_that_came_back_is_sent_again(alerted, open_page):
    page = open_page("/alerts")
    dead = page.locator("#dead")
    expect(dead).to_contain_text("the answer was not whole within 10 s")
    dead.get_by_role("button", name="Try again").click()
    expect(page.locator("#alerts tbody tr")).to_have_count(3)
    expect(page.locator("#dead")).to_have_count(0)
    with alerted.database.reading() as session:
        assert {row.state for row in session.scalars(select(AlertDelivery))} == {"waiting"}


@pytest.mark.usefixtures("alerted")
def test_the_fleet_page_counts_alerts(open_page, screenshot):
    page = open_page("/")
    tile = page.locator(".tile", has_text="Alerts")
    expect(tile.locator(".tile-number")).to_have_text("3")
    screenshot(page, "alerts-fleet-1280")
    tile.get_by_role("link", name="Iveco Daily").click()
    expect(page).to_have_url(re.compile("/alerts#alert-"))


@pytest.mark.usefixtures("alerted")
def test_the_alerts_page_fits_a_phone(open_page, screenshot):
    page = open_page("/alerts", **NARROW)
    expect(page.locator("#alerts tbody tr")).to_have_count(3)
    screenshot(page, "alerts-390")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize("size", [{}, NARROW], ids=["1280", "390"])
def test_the_vehicle_page_shows_use_theft_mode_and_diagnosis(site, open_page, screenshot, size, request):
    now = dt.datetime.now(dt.UTC)
    with site.database.transaction() as session:
        device, vehicle_id = about(session, site, "Fiat Panda")
        for days in range(1, 9):
            began_at = now - dt.timedelta(days=days, hours=3)
            session.add(
                Trip(
                    organisation_id=site.organisation_id,
                    device_id=device.id,
                    vehicle_id=vehicle_id,
                    boot="old",
                    t_first_s=0.0,
                    t_last_s=1.0,
                    began_at=began_at,
                    ended_at=began_at + dt.timedelta(minutes=30 + days),
                    under_way=False,
                    distance_m=20_000.0 + 1000 * days,
                    position_distance_m=20_000.0,
                    moving_s=1500.0,
                    max_speed_mps=25.0,
                    algorithm="x",
                    input_sha256="",
                )
            )
        for name, value in (("battery_v", 12.43), ("temperature_c", 31.5), ("ignition", 0.0), ("avl.113", 87.0)):
            session.add(Diagnosis(device_id=device.id, name=name, at=now - dt.timedelta(minutes=3), value=value))
    page = open_page(f"/vehicles/{vehicle_id}", **size)
    driving = page.locator("#driving")
    expect(driving).to_contain_text("of 100")
    expect(driving).to_contain_text("50 is five of them on 100 km")
    expect(page.locator("#diagnosis")).to_contain_text("12.4")
    theft = page.locator("#theft")
    expect(theft).to_contain_text("Off")
    theft.get_by_role("button", name="Arm").click()
    expect(page.locator("#theft")).to_contain_text("any movement is an alarm")
    with site.database.transaction() as session:
        session.get_one(TheftWatch, vehicle_id).alarm_at = now
    page.reload()
    expect(page.locator("#theft")).to_contain_text("Moves as it should not")
    name = request.node.callspec.id
    page.locator("#theft").scroll_into_view_if_needed()
    screenshot(page, f"alerts-vehicle-{name}")
    assert page.evaluate("document.documentElement.scrollWidth") <= (390 if size else 1280)
    page.locator("#theft").get_by_role("button", name="End the alarm").click()
    expect(page.locator("#theft")).to_contain_text("Off")
