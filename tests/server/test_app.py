"""The shell around every route: health, headers, problems, telemetry."""

from __future__ import annotations

import json
import subprocess
import sys

import httpx
import pytest
import sqlalchemy as sa

from server.app import MAX_JSON_BYTES, create_app
from server.database import make_engine
from server.headers import content_security_policy, tile_source
from server.limits import TokenBuckets
from server.settings import Settings

FORCE = {"t": [0.0, 0.1], "fx": [0, 0], "fy": [0, 0], "fz": [-9.8, -9.8]}


@pytest.mark.both_databases
def test_it_is_alive_and_ready(client):
    assert client.get("/healthz").json() == {"status": "ok"}
    answer = client.get("/readyz")
    checks = dict.fromkeys(("draining", "database", "migrations", "store"), True)
    assert (answer.status_code, answer.json()) == (200, {"status": "ok", "failures": {}, "checks": checks})


def test_readiness_names_what_is_not(settings, clock, serve, database):
    with database.transaction() as session:
        session.execute(sa.text("UPDATE alembic_version SET version_num = 'old'"))
    (settings.data_dir / "blobs").write_text("in the way of the folder")
    address = serve(create_app(settings, clock=clock))
    answer = httpx.get(f"{address}/readyz")
    assert answer.status_code == 503
    assert set(answer.json()["failures"]) == {"migrations", "store"}
    assert httpx.get(f"{address}/healthz").status_code == 200

    with database.transaction() as session:
        session.execute(sa.text("DROP TABLE alembic_version"))
    assert "migrations" in httpx.get(f"{address}/readyz").json()["failures"]


def test_a_database_that_does_not_answer(settings, tmp_path, clock, serve):
    folder = tmp_path / "other"
    folder.mkdir()
    app = create_app(settings.model_copy(update={"data_dir": folder}), clock=clock)
    address = serve(app)
    (folder / "scatola.sqlite3").unlink()
    (folder / "scatola.sqlite3").mkdir()
    app.state.database.engine.dispose()
    assert "database" in httpx.get(f"{address}/readyz").json()["failures"]


def test_every_answer_has_the_security_headers(client):
    for path in ("/healthz", "/login", "/api/v1/devices", "/static/none.js", "/"):
        headers = client.get(path).headers
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "same-origin"
        assert "frame-ancestors 'self'" in headers["content-security-policy"]
        assert "unsafe" not in headers["content-security-policy"]
        assert headers["x-request-id"]
    assert client.get("/login").headers["cache-control"] == "no-store"


def test_operator_tiles_are_let_through_the_policy(tmp_path):
    url = "https://tiles.example/{z}/{x}/{y}.png"
    policy = content_security_policy(Settings(data_dir=tmp_path, map_tiles_url=url))
    assert "img-src 'self' data: blob: https://tiles.example;" in policy
    assert "connect-src 'self' https://tiles.example;" in policy
    assert tile_source("https://{s}.tiles.example/{z}") == "https://*.tiles.example"
    assert tile_source("/own/{z}") == tile_source(None) == tile_source("javascript:alert(1)") == ""


def test_problems_are_rfc_9457(admin):
    answer = admin.get("/api/v1/devices/nope")
    assert answer.headers["content-type"] == "application/problem+json"
    document = answer.json()
    assert (document["status"], document["code"]) == (404, "not_found")
    assert "nope" in document["detail"]
    assert admin.get("/api/v1/nothing").json()["code"] == "not_found"
    wrong = admin.delete("/api/v1/devices")
    assert (wrong.status_code, wrong.json()["code"]) == (405, "method_not_allowed")
    assert "POST" in wrong.headers["allow"]


def test_invalid_input_is_named_but_not_echoed(admin):
    answer = admin.post("/api/v1/devices", json={"name": "", "secret": "hunter2"})
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid")
    assert {error["where"] for error in answer.json()["errors"]} == {"body.name", "body.secret"}
    assert "hunter2" not in answer.text
    for content in (b"{", b"[" * 50_000, b"\xff", b'{"name": NaN}', b'"text"'):
        broken = admin.post("/api/v1/devices", content=content, headers={"Content-Type": "application/json"})
        assert broken.status_code in (400, 422)
        assert broken.headers["content-type"] == "application/problem+json"


def test_ordinary_bodies_stay_small(admin):
    def endless():
        for _ in range(20):
            yield b" " * (MAX_JSON_BYTES // 10)

    for content in (b" " * (MAX_JSON_BYTES + 1), endless()):
        answer = admin.post("/api/v1/vehicles", content=content, headers={"Content-Type": "application/json"})
        assert (answer.status_code, answer.json()["code"]) == (413, "too_large")


def test_a_failure_inside_is_a_problem_without_its_details(app, serve):
    @app.get("/healthz/broken")
    def broken():
        raise RuntimeError("secret detail")

    admin = {"Authorization": "Bearer test-administrator", "X-Request-ID": "abc-1"}
    answer = httpx.get(f"{serve(app)}/healthz/broken", headers=admin)
    assert (answer.status_code, answer.json()["code"]) == (500, "internal")
    assert "secret" not in answer.text
    assert answer.headers["x-request-id"] == "abc-1"
    assert "abc-1" in answer.json()["detail"]


def test_request_ids_that_could_forge_log_lines_are_replaced(client):
    answer = client.get("/healthz", headers={"X-Request-ID": "a b=c"})
    assert answer.headers["x-request-id"] != "a b=c"


@pytest.mark.both_databases
def test_metrics_count_by_template(client, admin, make_device):
    device_id, token = make_device()
    admin.get(f"/api/v1/devices/{device_id}")
    headers = {"Authorization": f"Bearer {token}", "Idempotency-Key": "a/0"}
    for _ in range(2):
        assert client.post("/api/v1/batches", json={"columns": FORCE}, headers=headers).status_code == 202
    client.get("/no/such/place")
    client.post("/api/v1/batches", json={"columns": FORCE})
    text = client.get("/metrics").text
    assert 'scatola_requests_total{method="GET",route="/api/v1/devices/{device_id}",status="200"} 1.0' in text
    assert 'scatola_requests_total{method="POST",route="/api/v1/batches",status="401"} 1.0' in text
    assert 'scatola_batches_total{outcome="accepted"} 1.0' in text
    assert 'scatola_batches_total{outcome="duplicate"} 1.0' in text
    assert "scatola_batch_rows_total 2.0" in text
    assert "scatola_due_batches 1.0" in text
    assert "scatola_due_devices 1.0" in text
    assert device_id not in text
    assert "/no/such/place" not in text


def test_logs_hold_no_token_query_or_body(settings):
    """In a process of its own, as `serve` configures it."""
    program = """
import httpx, threading, time, uvicorn, sys
from pathlib import Path
from server.app import create_app
from server.settings import Settings
from server.logs import configure_logging
configure_logging(as_json=True)
app = create_app(Settings(data_dir=Path(sys.argv[1]), admin_token="very-secret-token"))
server = uvicorn.Server(uvicorn.Config(app, port=0, log_config=None, access_log=False))
thread = threading.Thread(target=server.run); thread.start()
while not server.started: time.sleep(0.01)
url = f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
httpx.get(url + "/login?code=secret-code")
httpx.post(url + "/api/v1/auth/session", json={"code": "very-secret-token"})
httpx.get(url + "/api/v1/devices/secret-path", headers={"Authorization": "Bearer very-secret-token"})
server.should_exit = True; thread.join()
"""
    run = subprocess.run(
        [sys.executable, "-c", program, str(settings.data_dir)], capture_output=True, text=True, check=True
    )
    lines = [json.loads(line) for line in run.stderr.splitlines() if line.startswith("{")]
    requests = [line for line in lines if line["event"] == "request"]
    assert [(line["route"], line["status"]) for line in requests] == [
        ("/login", 200),
        ("/api/v1/auth/session", 201),
        ("/api/v1/devices/{device_id}", 404),
    ]
    assert all(line["request_id"] for line in requests)
    own = "\n".join(
        line for line in run.stderr.splitlines() if '"logger": "httpx"' not in line and "HTTP Request" not in line
    )
    assert "secret" not in own


def test_the_api_process_stays_light():
    heavy = ("scipy", "numba", "viser", "dramatiq", "pandas", "matplotlib")
    program = f"import sys, server.app, server.formats.decode; print([m for m in {heavy!r} if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_decoding_loads_nothing_heavy_either():
    program = """
import sys, numpy as np
from server.formats.columns import Columns
from server.formats.decode import decode
body = Columns({"t": np.arange(3.0)}).to_parquet()
decode("application/vnd.apache.parquet", body, max_decoded_bytes=1000)
decode("text/csv", b"t\\n0\\n", max_decoded_bytes=1000)
decode("application/json", b'{"columns": {"t": [0]}}', max_decoded_bytes=1000)
print([m for m in ("scipy", "numba", "viser", "dramatiq", "pandas") if m in sys.modules])
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_the_api_is_described_without_another_host(client):
    schema = client.get("/openapi.json").json()
    assert "/api/v1/batches" in schema["paths"]
    assert not [path for path in schema["paths"] if not path.startswith("/api/v1/")]
    page = client.get("/docs")
    assert page.status_code == 200
    assert "/api/v1/batches" in page.text
    assert "http://" not in page.text
    assert "https://" not in page.text


def test_the_api_describes_its_problems(client):
    paths = client.get("/openapi.json").json()["paths"]
    upload = paths["/api/v1/batches"]["post"]["responses"]
    assert set(upload) >= {"202", "401", "403", "409", "413", "415", "422", "429"}
    assert "409" in paths["/api/v1/devices"]["post"]["responses"]
    for path, operations in paths.items():
        for operation in operations.values():
            problems = {status: found for status, found in operation["responses"].items() if int(status) >= 400}
            assert set(problems) >= {"401", "403", "404", "422"}, path
            for found in problems.values():
                assert list(found["content"]) == ["application/problem+json"], path


def test_head_asks_the_same_as_get(client):
    for path in ("/healthz", "/readyz"):
        answer = client.head(path)
        assert (answer.status_code, answer.content) == (200, b"")
        assert answer.headers["content-length"] == client.get(path).headers["content-length"]


def test_token_buckets():
    buckets = TokenBuckets(60)
    assert [buckets.take("a", 0.0) for _ in range(60)] == [0.0] * 60
    assert buckets.take("a", 0.0) == pytest.approx(1.0)
    assert buckets.take("b", 0.0) == 0.0
    assert buckets.take("a", 1.0) == 0.0
    assert buckets.take("a", 1.5) == pytest.approx(0.5)
    assert buckets.take("a", -100.0) > 0.0  # a clock set back grants nothing
    for index in range(20_000):
        buckets.take(f"k{index}", 100.0 + index)
    assert len(buckets._buckets) < 10_100


def test_what_it_can_do_without_degrades_it_and_what_it_cannot_does_not_serve(app, client):
    app.state.readiness.helpers["broker"] = lambda: "does not answer"
    answer = client.get("/readyz")
    assert (answer.status_code, answer.json()["status"]) == (200, "degraded")
    assert answer.json()["failures"] == {"broker": "does not answer"}
    assert answer.json()["checks"]["broker"] is False
    assert client.get("/readyz", params={"every": True}).status_code == 503
    app.state.readiness.draining = True
    answer = client.get("/readyz")
    assert (answer.status_code, answer.json()["status"]) == (503, "not ready")
    assert client.get("/healthz").status_code == 200


def test_many_who_ask_for_figures_ask_the_database_once(app, client, monkeypatch):
    asked = []
    real = app.state.database.reading
    monkeypatch.setattr(app.state.database, "reading", lambda: asked.append(1) or real())
    monkeypatch.setattr("server.telemetry.GAUGES_LIFE_S", 3600.0)
    texts = [client.get("/metrics").text for _ in range(5)]
    assert len(asked) == 1
    for name in (
        "scatola_dead_letters",
        "scatola_failing_devices",
        "scatola_database_up",
        "scatola_due_oldest_seconds",
    ):
        assert all(f"\n{name} " in text for text in texts), name


def test_the_description_says_who_may_call_and_what_may_come(app):
    schema = app.openapi()
    assert set(schema["components"]["securitySchemes"]) == {"token", "session", "box", "signature"}
    wanted = {
        ("post", "/api/v1/batches"): [{"box": []}, {"signature": []}],
        ("get", "/api/v1/device"): [{"box": []}, {"signature": []}],
        ("get", "/api/v1/events"): [{"token": []}, {"session": []}],
        ("post", "/api/v1/claim"): [],
        ("post", "/api/v1/auth/session"): [],
    }
    for (method, path), security in wanted.items():
        assert schema["paths"][path][method]["security"] == security, path
    for path, operations in schema["paths"].items():
        for method, operation in operations.items():
            statuses = set(operation["responses"])
            assert "503" in statuses, path
            assert ("507" in statuses) >= (method != "get"), path
            assert ("413" in statuses) >= ("requestBody" in operation), path
            assert ("410" in statuses) == ("{event_id}" in path), path
    assert app.openapi() is schema


def test_what_the_state_of_things_forbids_is_described(admin, app, make_device):
    """Statuses that only come when something was done before, so that no generator of requests finds them."""
    described = app.openapi()["paths"]
    vehicle = admin.post("/api/v1/vehicles", json={"name": "Panda"}).json()["id"]
    device, _ = make_device(vehicle_id=vehicle)
    admin.post(f"/api/v1/devices/{device}/revoke").raise_for_status()
    for method, path, filled in (
        ("delete", "/api/v1/vehicles/{vehicle_id}", f"/api/v1/vehicles/{vehicle}"),
        ("post", "/api/v1/devices/{device_id}/token", f"/api/v1/devices/{device}/token"),
        ("post", "/api/v1/devices/{device_id}/claim-code", f"/api/v1/devices/{device}/claim-code"),
    ):
        answer = admin.request(method, filled)
        assert answer.status_code == 409, path
        assert "409" in described[path][method]["responses"], path
    tries = [admin.post("/api/v1/auth/session", json={"code": "x"}) for _ in range(11)]
    assert tries[-1].status_code == 429
    assert "429" in described["/api/v1/auth/session"]["post"]["responses"]


@pytest.mark.both_databases
def test_a_nul_character_is_refused_wherever_it_stands(admin):
    """PostgreSQL's text holds none; SQLite would store what could then not be moved there."""
    json_type = {"Content-Type": "application/json; charset=utf-8"}
    big = b'{"name": "' + b"x" * 150 + b'", "plate": "\\u0000"}'

    def in_pieces():
        for k in range(0, len(big), 7):
            yield big[k : k + 7]

    answers = [
        admin.post("/api/v1/vehicles", json={"name": "a\0b"}),
        admin.post("/api/v1/vehicles", content=in_pieces(), headers=json_type),
        admin.get("/api/v1/events", params={"device": "\0"}),
        admin.get("/api/v1/events/%00"),
        admin.get("/api/v1/audit", params={"action": "a\0"}),
        admin.post("/admin/boxes", data={"name": "a\0"}),
        admin.post("/api/v1/accident-claims", json={"reference": "\0"}),
    ]
    for answer in answers:
        assert answer.status_code == 422, (answer.request.url, answer.text)
        assert "NUL" in answer.text
    assert answers[0].json()["code"] == answers[1].json()["code"] == answers[2].json()["code"] == "invalid"
    assert admin.post("/api/v1/vehicles", json={"name": "a", "plate": "u0000"}).status_code == 201


@pytest.mark.both_databases
def test_errors_of_the_database_do_not_tell_the_values_of_a_statement(settings):
    engine = make_engine(settings)
    with engine.connect() as connection, pytest.raises(sa.exc.DBAPIError) as raised:
        connection.execute(sa.text("SELECT * FROM no_such_table WHERE token_hash = :digest"), {"digest": "d867fba8"})
    engine.dispose()
    assert "d867fba8" not in str(raised.value)
