"""The administrator's page about privacy: rules, a hold, an erasure that is looked at before it is ordered."""

from __future__ import annotations

from playwright.sync_api import expect


def test_an_administrator_sets_rules_and_orders_an_erasure(open_page, site, screenshot):
    page = open_page("/privacy")
    page.get_by_label("Raw samples").fill("30")
    page.get_by_label("Trips").fill("")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_role("status").filter(has_text="saved")).to_be_visible()
    expect(page.get_by_label("Raw samples")).to_have_value("30")
    expect(page.get_by_label("Trips")).to_have_value("")
    screenshot(page, "privacy")

    name, vehicle_id = next(iter(site.vehicles.items()))
    page.get_by_label("Of whom").select_option(f"vehicle:{vehicle_id}")
    page.get_by_label("Why").fill("Letter of 1 March")
    page.get_by_role("button", name="Show what would go").click()
    plan = page.locator("#plan")
    expect(plan).to_contain_text(name)
    expect(plan).to_contain_text("Uploads")
    screenshot(page, "privacy-plan")
    page.get_by_role("button", name="Erase", exact=True).click()
    expect(page.locator("#erasures")).to_contain_text("under way")
    page.set_viewport_size({"width": 390, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    screenshot(page, "privacy-phone")
