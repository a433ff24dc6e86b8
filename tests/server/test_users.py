"""People: signing in with password and authenticator, roles, keys; and the pages for it."""

from __future__ import annotations

import re
from contextlib import closing

import httpx
import pyotp
import pytest
import sqlalchemy as sa

from server.accounts.secrets import hash_of
from server.models import ApiKey, AuditEntry, User, WebSession
from tests.conftest import ADMIN_TOKEN

pytestmark = pytest.mark.both_databases
PASSWORD = "correct horse battery"
EMAIL = "ada@fleet.test"


@pytest.fixture(autouse=True)
def fast_hashing(monkeypatch):
    """argon2 with hardly any memory: what is shown here does not depend on it."""
    from argon2 import PasswordHasher

    from server.accounts import passwords

    hasher = PasswordHasher(time_cost=1, memory_cost=64, parallelism=1)
    monkeypatch.setattr(passwords, "_HASHER", hasher)
    monkeypatch.setattr(passwords, "_NOBODY", hasher.hash("nobody has this password"))


def signed_in(address: str, **how) -> httpx.Client:
    client = httpx.Client(base_url=address, timeout=30.0)
    answer = client.post("/api/v1/auth/session", json=how)
    assert answer.status_code == 201, answer.text
    client.headers["X-CSRF-Token"] = answer.json()["csrf_token"]
    return client


@pytest.fixture
def ada(address, admin):
    """A signed-in administrator with a password."""
    made = admin.post("/api/v1/users", json={"email": "Ada@Fleet.test ", "name": "Ada", "role": "admin"})
    assert made.status_code == 201, made.text
    assert made.json()["email"] == EMAIL
    client = signed_in(address, code=made.json()["code"])
    assert client.put("/api/v1/account/password", json={"new": PASSWORD}).status_code == 204
    yield client
    client.close()


def try_to_sign_in(client, **how) -> httpx.Response:
    return client.post("/api/v1/auth/session", json={"email": EMAIL, "password": PASSWORD} | how)


@pytest.mark.usefixtures("ada")
def test_a_password_opens_a_session(client, database):
    with database.reading() as session:
        stored = session.scalars(sa.select(User.password_hash)).one()
    assert stored.startswith("$argon2id$")
    assert PASSWORD not in stored
    wrong = try_to_sign_in(client, password="wrong")
    unknown = try_to_sign_in(client, email="nobody@fleet.test")
    assert wrong.status_code == unknown.status_code == 401
    assert wrong.json() == unknown.json()
    assert try_to_sign_in(client, email=EMAIL.upper()).status_code == 201
    assert client.get("/api/v1/account").json()["name"] == EMAIL
    assert client.post("/api/v1/auth/session", json={"email": EMAIL}).status_code == 422
    assert client.post("/api/v1/auth/session", json={"email": EMAIL, "password": "x", "code": "y"}).status_code == 422


@pytest.mark.usefixtures("ada")
def test_an_account_locks_itself_for_longer_each_time(client, clock):
    for _ in range(5):
        assert try_to_sign_in(client, password="wrong").status_code == 401
    assert try_to_sign_in(client).status_code == 401  # locked, though right
    clock.advance(seconds=61)
    assert try_to_sign_in(client, password="wrong").status_code == 401
    clock.advance(seconds=61)
    assert try_to_sign_in(client).status_code == 401  # two minutes now
    clock.advance(seconds=61)
    assert try_to_sign_in(client).status_code == 201
    assert try_to_sign_in(client, password="wrong").status_code == 401
    assert try_to_sign_in(client).status_code == 201


@pytest.mark.usefixtures("ada")
def test_one_address_is_slowed_down(client):
    answers = [try_to_sign_in(client, email=f"u{n}@x.test").status_code for n in range(12)]
    assert 429 in answers


def test_an_authenticator_is_asked_for_once_it_works(ada, client, clock):
    secret = ada.post("/api/v1/account/totp").json()["secret"]
    totp = pyotp.TOTP(secret)

    def code() -> str:
        return totp.at(int(clock().timestamp()))

    assert try_to_sign_in(client).status_code == 201  # not confirmed yet
    assert ada.post("/api/v1/account/totp/confirm", json={"code": "000000"}).status_code == 422
    assert ada.post("/api/v1/account/totp/confirm", json={"code": code()}).status_code == 204
    assert ada.post("/api/v1/account/totp").status_code == 409
    assert try_to_sign_in(client).status_code == 401
    assert try_to_sign_in(client, totp=code()).status_code == 401  # used to confirm: a code is good once
    clock.advance(seconds=30)
    assert try_to_sign_in(client, totp=code()).status_code == 201
    assert try_to_sign_in(client, totp=code()).status_code == 401
    clock.advance(seconds=120)
    assert try_to_sign_in(client, totp=totp.at(int(clock().timestamp()) - 90)).status_code == 401
    assert try_to_sign_in(client, totp=totp.at(int(clock().timestamp()) - 30)).status_code == 201
    assert ada.post("/api/v1/account/totp/end", json={"code": code()}).status_code == 204
    assert try_to_sign_in(client).status_code == 201


def test_a_new_password_ends_the_other_sessions(ada, address, client):
    other = signed_in(address, email=EMAIL, password=PASSWORD)
    for new, status in (("short", 422), ("aaaaaaaaaaaaaaa", 422), (EMAIL, 422), ("another long password", 401)):
        answer = ada.put("/api/v1/account/password", json={"new": new, "current": "wrong"})
        assert answer.status_code in (status, 401), answer.text
    assert ada.put("/api/v1/account/password", json={"new": "short", "current": PASSWORD}).status_code == 422
    new = {"new": "another long password", "current": PASSWORD}
    assert ada.put("/api/v1/account/password", json=new).status_code == 204
    assert ada.get("/api/v1/account").status_code == 200
    assert other.get("/api/v1/account").status_code == 401
    assert try_to_sign_in(client).status_code == 401
    assert try_to_sign_in(client, password="another long password").status_code == 201
    other.close()


def test_a_forgotten_password_is_replaced_with_a_code(ada, admin, address, client):
    user_id = ada.get("/api/v1/account").json()["user_id"]
    code = admin.post(f"/api/v1/users/{user_id}/sign-in-code").json()["code"]
    with closing(signed_in(address, code=code)) as again:
        assert again.put("/api/v1/account/password", json={"new": "a fresh long password"}).status_code == 204
        # Only the first time; from then on the session is like any other.
        assert again.put("/api/v1/account/password", json={"new": PASSWORD}).status_code == 401
    assert client.post("/api/v1/auth/session", json={"code": code}).status_code == 401
    assert try_to_sign_in(client, password="a fresh long password").status_code == 201


@pytest.mark.usefixtures("ada")
def test_who_signs_in_and_changes_people_is_on_record_with_the_address(admin, address):
    with closing(signed_in(address, code=ADMIN_TOKEN)) as by_token:
        assert by_token.post("/api/v1/users", json={"email": "c@fleet.test", "name": "C", "role": "reader"}).is_success
    entries = admin.get("/api/v1/audit").json()["items"]
    told = {(each["action"], each["actor_name"], each["detail"].get("by"), each["address"]) for each in entries}
    assert told >= {
        ("sign_in", EMAIL, "code", "127.0.0.1"),
        ("sign_in", "administrator", "administrator's token", "127.0.0.1"),
        ("user.added", "administrator's token", None, "127.0.0.1"),
        ("user.added", "administrator", None, "127.0.0.1"),
        ("password.changed", EMAIL, None, "127.0.0.1"),
    }


@pytest.mark.usefixtures("ada")
def test_what_is_done_and_seen_is_on_record_with_the_address(admin, client, make_device):
    assert try_to_sign_in(client, password="wrong").status_code == 401
    assert try_to_sign_in(client).status_code == 201
    device_id, _ = make_device()
    for answer in (
        admin.post(f"/api/v1/devices/{device_id}/claim-code"),
        admin.post("/api/v1/vehicles", json={"name": "Van 1"}),
        admin.put("/api/v1/retention", json={"days": {"raw": 400}}),
        admin.get("/api/v1/events/verdicts"),
        admin.get("/api/v1/export/tracks"),
        admin.get("/"),
    ):
        assert answer.is_success, answer.text
    entries = admin.get("/api/v1/audit").json()["items"]
    done = "sign_in.failed", "sign_in", "box.added", "box.claim-code", "vehicle.added", "retention.set", "export"
    assert {each["action"] for each in entries} >= {*done, "location.read"}
    assert {each["address"] for each in entries} == {"127.0.0.1"}


def test_a_disabled_user_is_out_at_once(ada, admin, address, client):
    made = admin.post("/api/v1/users", json={"email": "bob@fleet.test", "name": "Bob", "role": "reader"}).json()
    bob = signed_in(address, code=made["code"])
    assert bob.get("/api/v1/devices").status_code == 200
    assert bob.post("/api/v1/vehicles", json={"name": "x"}).status_code == 403
    assert ada.patch(f"/api/v1/users/{made['id']}", json={"role": "manager"}).status_code == 200
    assert bob.post("/api/v1/vehicles", json={"name": "x"}).status_code == 201
    spare = admin.post(f"/api/v1/users/{made['id']}/sign-in-code").json()["code"]
    assert ada.patch(f"/api/v1/users/{made['id']}", json={"disabled": True}).status_code == 200
    assert bob.get("/api/v1/devices").status_code == 401
    assert client.post("/api/v1/auth/session", json={"code": spare}).status_code == 401
    assert ada.post(f"/api/v1/users/{made['id']}/sign-in-code").status_code == 409
    assert ada.post("/api/v1/users", json={"email": "bob@fleet.test", "name": "B", "role": "admin"}).status_code == 409
    bob.close()


def test_the_last_administrator_stays(ada, admin):
    me = ada.get("/api/v1/account").json()["user_id"]
    for change in ({"role": "reader"}, {"disabled": True}):
        answer = ada.patch(f"/api/v1/users/{me}", json=change)
        assert (answer.status_code, answer.json()["code"]) == (409, "last_administrator")
    admin.post("/api/v1/users", json={"email": "c@fleet.test", "name": "C", "role": "admin"})
    assert ada.patch(f"/api/v1/users/{me}", json={"role": "reader"}).status_code == 200
    assert ada.get("/api/v1/users").status_code == 403


def test_a_key_is_worth_a_part_of_its_maker(ada, admin, client, database, clock):
    wanted = {"name": "export", "scopes": ["fleet.read", "raw.read"], "expires_at": "2026-03-02T00:00:00Z"}
    made = ada.post("/api/v1/api-keys", json=wanted).json()
    with database.reading() as session:
        assert session.scalars(sa.select(ApiKey.key_hash)).one() == hash_of(made["key"])
    program = {"Authorization": f"Bearer {made['key']}"}
    assert client.get("/api/v1/devices", headers=program).status_code == 200
    assert client.get("/api/v1/users", headers=program).status_code == 403
    assert client.post("/api/v1/vehicles", json={"name": "x"}, headers=program).status_code == 403
    assert client.put("/api/v1/account/password", json={"new": PASSWORD}, headers=program).status_code == 403
    account = client.get("/api/v1/account", headers=program).json()
    assert account["permissions"] == ["fleet.read", "raw.read"]
    # It sinks with its maker, and it ends.
    admin.post("/api/v1/users", json={"email": "c@fleet.test", "name": "C", "role": "admin"})
    me = ada.get("/api/v1/account").json()["user_id"]
    admin.patch(f"/api/v1/users/{me}", json={"role": "reader"})
    assert client.get("/api/v1/account", headers=program).json()["permissions"] == ["fleet.read"]
    admin.patch(f"/api/v1/users/{me}", json={"role": "admin"})
    endless = ada.post("/api/v1/api-keys", json={"name": "e", "scopes": ["fleet.read"]}).json()
    program = {"Authorization": f"Bearer {endless['key']}"}
    assert client.get("/api/v1/devices", headers=program).status_code == 200
    assert ada.delete(f"/api/v1/api-keys/{endless['id']}").status_code == 204
    assert client.get("/api/v1/devices", headers=program).status_code == 401
    assert sorted(key["revoked_at"] is not None for key in ada.get("/api/v1/api-keys").json()) == [False, True]
    program = {"Authorization": f"Bearer {made['key']}"}
    assert client.get("/api/v1/devices", headers=program).status_code == 200
    clock.advance(days=1)
    assert client.get("/api/v1/devices", headers=program).status_code == 401


def test_nobody_gives_away_what_they_do_not_have(ada, client):
    manager = ada.post("/api/v1/api-keys", json={"name": "m", "scopes": ["users.manage"]}).json()["key"]
    answer = client.post(
        "/api/v1/api-keys",
        json={"name": "more", "scopes": ["raw.read"]},
        headers={"Authorization": f"Bearer {manager}"},
    )
    assert (answer.status_code, answer.json()["code"]) == (422, "scopes")


def test_the_operator_makes_tenants(admin, ada, address):
    wanted = {"name": "Other", "administrator": {"email": "eve@other.test", "name": "Eve", "role": "admin"}}
    assert ada.post("/api/v1/organisations", json=wanted).status_code == 403
    made = admin.post("/api/v1/organisations", json=wanted)
    assert made.status_code == 201, made.text
    with closing(signed_in(address, code=made.json()["administrator"]["code"])) as eve:
        assert eve.get("/api/v1/account").json()["organisation_id"] == made.json()["id"]
        assert [user["email"] for user in eve.get("/api/v1/users").json()] == ["eve@other.test"]
        assert eve.post("/api/v1/users", json={"email": EMAIL, "name": "x", "role": "reader"}).status_code == 409
    assert {one["name"] for one in admin.get("/api/v1/organisations").json()} == {"Fleet", "Other"}


def test_what_people_do_is_in_the_log(ada, client, database):
    try_to_sign_in(client, password="wrong")
    try_to_sign_in(client)
    with database.reading() as session:
        rows = session.execute(sa.select(AuditEntry.action, AuditEntry.actor_name, AuditEntry.subject)).all()
    assert ("user.added", "administrator's token", EMAIL) in rows
    assert ("password.changed", EMAIL, EMAIL) in rows
    assert ("sign_in.failed", EMAIL, EMAIL) in rows
    assert ("sign_in", EMAIL, EMAIL) in rows
    assert PASSWORD not in str(ada.get("/api/v1/audit").json())


# --- pages


def test_the_pages_do_it_all_without_a_script(client, admin, database, clock):
    csrf = client.post("/api/v1/auth/session", json={"code": "test-administrator"}).json()["csrf_token"]
    assert "without an account" in client.get("/account").text
    page = client.post("/users", data={"csrf_token": csrf, "email": EMAIL, "name": "<Ada>", "role": "admin"})
    assert page.status_code == 200
    assert "&lt;Ada&gt;" in page.text
    code = re.search(r"login\?code=([\w-]+)", page.text)[1]
    assert client.post("/users", data={"email": "x@y.test", "name": "x", "role": "admin"}).status_code == 403
    for bad in ({"email": "nonsense"}, {"email": EMAIL}, {"role": "king"}):
        wrong = client.post(
            "/users", data={"csrf_token": csrf, "email": "b@c.test", "name": "b", "role": "reader"} | bad
        )
        assert wrong.status_code in (409, 422)
        assert 'role="alert"' in wrong.text
    client.cookies.clear()
    assert client.post("/login", data={"code": code, "next": "/account"}).headers["location"] == "/account"
    csrf = re.search(r'name="csrf_token" value="([^"]+)"', client.get("/account").text)[1]
    form = {"csrf_token": csrf}
    assert client.post("/account/password", data=form | {"new": "short"}).status_code == 422
    assert client.post("/account/password", data=form | {"new": PASSWORD}).status_code == 303
    secret = re.search(r'class="secret">([A-Z2-7]+)<', client.post("/account/totp", data=form).text)[1]
    totp = pyotp.TOTP(secret)
    code = totp.at(int(clock().timestamp()))
    assert client.post("/account/totp/confirm", data=form | {"code": code}).status_code == 303
    page = client.post("/api-keys", data=form | {"name": "k", "scopes": ["fleet.read", "audit.read"]})
    assert "sck_" in page.text
    assert "sck_" not in client.get("/users").text
    with database.reading() as session:
        key_id, scopes = session.execute(sa.select(ApiKey.id, ApiKey.scopes)).one()
    assert scopes == ["audit.read", "fleet.read"]
    assert client.post(f"/api-keys/{key_id}/revoke", data=form).status_code == 303
    audit = client.get("/audit")
    for word in ("totp.on", "key.added", "key.revoked", EMAIL):
        assert word in audit.text
    client.cookies.clear()
    clock.advance(seconds=30)
    form = {"email": EMAIL, "password": PASSWORD, "totp": ""}
    assert client.post("/login", data=form).status_code == 401
    form["totp"] = totp.at(int(clock().timestamp()))
    assert client.post("/login", data=form | {"next": "/vehicles"}).headers["location"] == "/vehicles"
    with database.reading() as session:
        assert session.scalar(sa.select(sa.func.count(WebSession.id)).where(WebSession.user_id.is_not(None))) == 2
    assert admin.get("/users").status_code == 200
