"""Who gets in: the gate, tokens, sessions, CSRF, origins, one-time codes."""

from __future__ import annotations

import re
from pathlib import Path

import httpx
import pytest
import sqlalchemy as sa

import server
from server.accounts import service
from server.accounts.secrets import hash_of
from server.accounts.service import ensure_organisation, first_sign_in, new_sign_in_code
from server.app import create_app
from server.models import SignInCode, WebSession
from server.pages.audit_words import DEEDS

OPEN = ("/healthz", "/readyz", "/metrics", "/openapi.json", "/docs", "/login", "/static/css/none.css")
API = (
    ("GET", "/api/v1/devices"),
    ("POST", "/api/v1/devices"),
    ("POST", "/api/v1/batches"),
    ("PUT", "/api/v1/devices/x/vehicle"),
    ("GET", "/api/v1/trips"),
    ("GET", "/api/v1/live"),
    ("GET", "/api/v1/no/such/thing"),
    ("OPTIONS", "/api/v1/devices"),
    ("DELETE", "/api/"),
)
PAGES = ("/", "/vehicles", "/vehicles/x", "/no/such/page", "/view3d/x/y/", "/apidocs", "/static", "/loginx", "/docs/x")


@pytest.fixture
def code(database, clock, organisation) -> str:
    with database.transaction() as session:
        return new_sign_in_code(session, organisation.id, now=clock())


@pytest.fixture
def browser(client, code) -> httpx.Client:
    """A signed-in browser; its CSRF token is in its headers."""
    answer = client.post("/api/v1/auth/session", json={"code": code})
    assert answer.status_code == 201, answer.text
    client.headers["X-CSRF-Token"] = answer.json()["csrf_token"]
    return client


@pytest.mark.both_databases
def test_without_credentials_only_the_open_paths_answer(client):
    for path in OPEN:
        assert client.get(path).status_code in (200, 404), path
    for method, path in API:
        answer = client.request(method, path, content=b"not even json")
        assert (answer.status_code, answer.json()["code"]) == (401, "unauthenticated"), path
        assert answer.headers["www-authenticate"] == "Bearer"
    for path in PAGES:
        answer = client.get(path)
        assert (answer.status_code, answer.headers["location"]) == (303, f"/login?next={path}"), path
    assert client.get("/vehicles?page=2&x=1").headers["location"] == "/login?next=/vehicles%3Fpage%3D2%26x%3D1"
    assert client.post("/logout").status_code == 303


@pytest.mark.parametrize(
    "authorization", ["Bearer wrong", "Bearer", "bearer  x", "Basic dGVzdA==", "test-administrator", "Bearer \u00e9"]
)
def test_wrong_credentials_are_none(client, authorization):
    header = {"Authorization": authorization.encode("latin-1")}
    assert client.get("/api/v1/devices", headers=header).status_code == 401
    assert client.get("/", headers=header).status_code == 303


@pytest.mark.both_databases
def test_a_device_token_uploads_and_nothing_else(client, admin, make_device):
    device_id, token = make_device()
    device = {"Authorization": f"Bearer {token}"}
    for method, path in (
        ("GET", "/api/v1/devices"),
        ("GET", f"/api/v1/devices/{device_id}"),
        ("POST", "/api/v1/devices"),
        ("GET", "/api/v1/no/such/thing"),
        ("GET", "/"),
    ):
        answer = client.request(method, path, headers=device)
        assert (answer.status_code, answer.json()["code"]) == (403, "forbidden"), path
    assert admin.post("/api/v1/batches", content=b"{").status_code == 403
    assert client.post("/api/v1/batches", content=b"{", headers=device).status_code == 422


@pytest.mark.both_databases
def test_the_administrators_token_works_without_a_session(admin):
    assert admin.get("/api/v1/devices").status_code == 200
    assert admin.post("/api/v1/vehicles", json={"name": "v"}).status_code == 201
    assert admin.get("/api/v1/auth/session").status_code == 401


@pytest.mark.usefixtures("database")
@pytest.mark.both_databases
def test_without_an_administrators_token_none_is_valid(settings, clock, serve):
    app = create_app(settings.model_copy(update={"admin_token": None}), clock=clock)
    with httpx.Client(base_url=serve(app)) as client:
        for token in ("None", "null", "test-administrator"):
            assert client.get("/api/v1/devices", headers={"Authorization": f"Bearer {token}"}).status_code == 401
        assert client.post("/api/v1/auth/session", json={"code": "None"}).status_code == 401


@pytest.mark.both_databases
def test_a_one_time_code_opens_one_session(client, code, database):
    form = client.get("/login", params={"code": code, "next": "/vehicles"})
    assert form.status_code == 200
    assert code in form.text
    answer = client.post("/login", data={"code": code, "next": "/vehicles"})
    assert (answer.status_code, answer.headers["location"]) == (303, "/vehicles")
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=lax" in cookie
    assert "path=/" in cookie
    assert "secure" not in cookie
    assert client.get("/api/v1/devices").status_code == 200
    assert client.get("/login").headers["location"] == "/"
    token = client.cookies["scatola_session"]
    with database.reading() as session:
        assert session.scalars(sa.select(WebSession.token_hash)).all() == [hash_of(token)]
    client.cookies.clear()
    again = client.post("/login", data={"code": code})
    assert again.status_code == 401
    assert "used already" in again.text
    assert client.post("/api/v1/auth/session", json={"code": code}).json()["code"] == "sign_in_failed"


@pytest.mark.both_databases
def test_a_code_runs_out(client, code, clock):
    clock.advance(hours=25)
    assert client.post("/api/v1/auth/session", json={"code": code}).status_code == 401


@pytest.mark.both_databases
def test_the_administrators_token_signs_a_browser_in(client):
    assert client.post("/login", data={"code": "test-administrator"}).status_code == 303
    assert client.get("/api/v1/devices").status_code == 200


@pytest.mark.parametrize("target", ["//evil.example", "https://evil.example", "/\\evil.example", "evil", "/a\nb"])
def test_signing_in_leads_nowhere_else(client, target):
    answer = client.post("/login", data={"code": "test-administrator", "next": target})
    assert answer.headers["location"] == "/"


def test_the_cookie_is_secure_behind_https(app, serve, code):
    # uvicorn believes a proxy on loopback.
    with httpx.Client(base_url=serve(app), headers={"X-Forwarded-Proto": "https"}) as client:
        answer = client.post("/login", data={"code": code})
        assert "secure" in answer.headers["set-cookie"].lower()


@pytest.mark.both_databases
def test_unsafe_requests_of_a_session_need_its_csrf_token(browser):
    token = browser.headers.pop("X-CSRF-Token")
    body = {"name": "v"}
    refused = browser.post("/api/v1/vehicles", json=body)
    assert (refused.status_code, refused.json()["code"]) == (403, "csrf")
    assert browser.post("/api/v1/vehicles", json=body, headers={"X-CSRF-Token": "wrong"}).status_code == 403
    assert browser.post("/api/v1/vehicles", content=b"{", headers={"X-CSRF-Token": ""}).status_code == 403
    assert browser.get("/api/v1/vehicles").status_code == 200
    assert browser.post("/api/v1/vehicles", json=body, headers={"X-CSRF-Token": token}).status_code == 201
    assert browser.get("/api/v1/auth/session").json() == {"csrf_token": token}


@pytest.mark.both_databases
def test_a_form_may_carry_the_csrf_token(browser):
    token = browser.headers.pop("X-CSRF-Token")
    assert browser.post("/logout", data={"csrf_token": "wrong"}).status_code == 403
    assert browser.post("/logout", content=b"csrf_token=%ff" + b"x" * 70_000, headers=_form()).status_code == 403
    answer = browser.post("/logout", data={"csrf_token": token})
    assert (answer.status_code, answer.headers["location"]) == (303, "/login")
    assert browser.get("/api/v1/devices").status_code == 401


def _form() -> dict[str, str]:
    return {"Content-Type": "application/x-www-form-urlencoded"}


@pytest.mark.both_databases
def test_signing_out_ends_the_session_for_good(browser):
    cookie = browser.cookies["scatola_session"]
    assert browser.delete("/api/v1/auth/session").status_code == 204
    assert browser.get("/api/v1/devices", headers={"Cookie": f"scatola_session={cookie}"}).status_code == 401


def test_other_origins_are_refused(settings, clock, serve, code):
    trusting = settings.model_copy(update={"trusted_origins": ("https://fleet.example",)})
    with httpx.Client(base_url=serve(create_app(trusting, clock=clock))) as client:
        for origin in ("https://evil.example", "null"):
            foreign = client.post("/login", data={"code": code}, headers={"Origin": origin})
            assert foreign.status_code == 403, origin
        foreign = client.post("/login", data={"code": code}, headers={"Sec-Fetch-Site": "cross-site"})
        assert foreign.json()["code"] == "origin"
        own = {"Origin": str(client.base_url).rstrip("/")}
        answer = client.post("/api/v1/auth/session", json={"code": code}, headers=own)
        assert answer.status_code == 201
        client.headers["X-CSRF-Token"] = answer.json()["csrf_token"]
        body = {"name": "v"}
        for origin, status in (("https://evil.example", 403), ("https://fleet.example", 201), (own["Origin"], 201)):
            assert client.post("/api/v1/vehicles", json=body, headers={"Origin": origin}).status_code == status
        assert client.delete("/api/v1/auth/session", headers={"Origin": "https://evil.example"}).status_code == 403


@pytest.mark.both_databases
def test_a_session_slides_and_runs_out(browser, clock):
    first = browser.cookies["scatola_session"]
    for _ in range(3):
        clock.advance(hours=8)
        answer = browser.get("/api/v1/devices")
        assert answer.status_code == 200
        assert answer.headers["set-cookie"].startswith(f"scatola_session={first};")
    assert "set-cookie" not in browser.get("/api/v1/devices").headers
    clock.advance(hours=12, seconds=1)
    assert browser.get("/api/v1/devices").status_code == 401


def test_attempts_are_limited(client, code, clock):
    wrong = [client.post("/api/v1/auth/session", json={"code": f"wrong{i}"}).status_code for i in range(12)]
    assert wrong == [401] * 10 + [429] * 2
    refused = client.post("/api/v1/auth/session", json={"code": code})
    assert refused.status_code == 429
    assert int(refused.headers["retry-after"]) >= 1
    assert client.post("/login", data={"code": code}).status_code == 429
    clock.advance(seconds=10)
    assert client.post("/api/v1/auth/session", json={"code": code}).status_code == 201


@pytest.mark.both_databases
def test_the_first_sign_in_is_printed_until_somebody_is_in(database, clock):
    with database.transaction() as session:
        first = first_sign_in(session, now=clock())
    with database.transaction() as session:
        second = first_sign_in(session, now=clock())
        assert first != second
        assert session.scalar(sa.select(sa.func.count()).select_from(SignInCode)) == 1
    with database.transaction() as session:
        service.redeem(session, second, now=clock(), address="192.0.2.1")
    with database.transaction() as session:
        assert first_sign_in(session, now=clock()) is None
    clock.advance(hours=13)
    with database.transaction() as session:
        assert first_sign_in(session, now=clock()) is not None


@pytest.mark.both_databases
def test_there_is_one_default_organisation(database, clock):
    with database.transaction() as session:
        first = ensure_organisation(session, now=clock()).id
    with database.transaction() as session:
        assert ensure_organisation(session, now=clock()).id == first


@pytest.mark.both_databases
def test_a_views_ticket_opens_that_view_only(client, admin, make_device, clock):
    device_id, _ = make_device()
    other_id, _ = make_device(name="other")
    url = admin.post(f"/api/v1/devices/{device_id}/view-ticket").json()["url"]
    assert client.get(url).status_code == 503  # through the gate; no viewer runs
    assert client.get(url.replace(device_id, other_id)).status_code == 303
    ticket = url.split("/")[2]
    for path in (f"/view3d/{ticket}x/{device_id}/", f"/view3d/{device_id}/"):
        assert client.get(path).status_code == 303
    clock.advance(minutes=11)
    assert client.get(url).status_code == 303


def test_people_get_error_pages_and_programs_problems(browser):
    page = browser.get("/vehicles/none", headers={"Accept": "text/html"})
    assert page.status_code == 404
    assert page.headers["content-type"].startswith("text/html")
    assert "There is no such page" in page.text
    assert "Not found" not in page.text
    italian = {"Accept": "text/html", "Accept-Language": "it"}
    for path in ("/vehicles/none", "/no/such/address"):
        assert "Questa pagina non esiste" in browser.get(path, headers=italian).text
    assert browser.get("/vehicles/none").json()["code"] == "not_found"
    assert browser.get("/api/v1/vehicles/none", headers={"Accept": "text/html"}).json()["code"] == "not_found"
    refused = browser.post("/logout", headers={"Accept": "text/html", "X-CSRF-Token": "wrong"})
    assert (refused.status_code, "This form is out of date" in refused.text) == (403, True)


def test_every_deed_of_the_audit_log_has_words():
    source = "".join(path.read_text() for path in Path(server.__file__).parent.rglob("*.py"))
    deeds = set(re.findall(r'\brecord\([^"]*"([a-z_]+\.[a-z_-]+)"', source))
    assert len(deeds) > 20
    assert deeds <= DEEDS.keys()
