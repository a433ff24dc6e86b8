"""Adding somebody, choosing a password, setting up an authenticator: in the browser, as a person does it."""

from __future__ import annotations

import re
import time

import pyotp
from playwright.sync_api import expect


def test_a_new_person_comes_in_and_secures_the_account(open_page, screenshot):
    page = open_page("/users")
    page.get_by_label("E-mail").fill("ada@fleet.test")
    page.get_by_label("Name").fill("Ada")
    page.get_by_label("Role", exact=True).select_option("manager")
    page.get_by_role("button", name="Add", exact=True).click()
    link = page.locator(".secret").inner_text()
    expect(page.get_by_role("row").filter(has_text="ada@fleet.test")).to_contain_text("never")
    screenshot(page, "people")

    ada = open_page("/login", signed_in=False, expected=("/users",))
    ada.goto(link)
    ada.get_by_role("button", name="Sign in with the code").click()
    expect(ada).to_have_url(re.compile("/account$"))
    ada.get_by_label("New password").fill("correct horse battery")
    ada.get_by_role("button", name="Save the password").click()
    expect(ada.get_by_role("status").filter(has_text="saved")).to_be_visible()
    ada.get_by_role("button", name="Set up").click()
    totp = pyotp.TOTP(ada.locator(".secret").inner_text())
    screenshot(ada, "account")
    used = totp.now()
    ada.get_by_label("Code", exact=True).fill(used)
    ada.get_by_role("button", name="Confirm").click()
    expect(ada.get_by_text("Set up: signing in needs a code.")).to_be_visible()
    # A fleet manager sees the fleet on the map, no samples, no people.
    expect(ada.get_by_role("link", name="People")).to_have_count(0)
    assert ada.goto("/users").status == 403
    ada.goto("/account")
    ada.get_by_role("button", name="Sign out").click()
    ada.get_by_label("E-mail").fill("ada@fleet.test")
    ada.get_by_label("Password").fill("correct horse battery")
    # The code after the one that confirmed: a code is good once, and the next one is taken a little early.
    ada.get_by_label("Authenticator code").fill(totp.at(int(time.time()) + 30))
    screenshot(ada, "login")
    ada.get_by_role("button", name="Sign in", exact=True).click()
    expect(ada.get_by_role("heading", name="Fleet")).to_be_visible()

    page.goto("/audit")
    for words in ("Person added", "Password changed", "Authenticator set up", "Signed in", "Saw locations"):
        expect(page.get_by_role("cell", name=words, exact=True).first).to_be_visible()
    screenshot(page, "audit")
