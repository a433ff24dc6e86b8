"""A served installation as an operator sees it: lines with ids and no secrets, one trace, figures, an end in order."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import httpx
import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest

from tests.e2e.service import ADMIN, eventually, free_port

BATCH = {"columns": {"t": [0.0, 0.5], "fx": [0, 0], "fy": [0, 0], "fz": [-9.8, -9.8]}}


@pytest.fixture
def collector():
    """A collector of spans: its address, and (service, name, trace) of each span that it got."""
    spans = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self):
            body = self.rfile.read(int(self.headers["Content-Length"]))
            for resource in ExportTraceServiceRequest.FromString(body).resource_spans:
                service = next(a.value.string_value for a in resource.resource.attributes if a.key == "service.name")
                spans.extend(
                    (service, span.name, span.trace_id.hex(), str(span))
                    for scope in resource.scope_spans
                    for span in scope.spans
                )
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}", spans
    server.shutdown()
    server.server_close()


class Serving:
    def __init__(self, tmp_path, **settings: str) -> None:
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self.log = tmp_path / "log"
        environment = {name: value for name, value in os.environ.items() if not name.startswith("SCATOLA_")}
        environment |= {
            "SCATOLA_DATA_DIR": str(tmp_path / "data"),
            "SCATOLA_PORT": str(self.port),
            "SCATOLA_ADMIN_TOKEN": ADMIN,
            "SCATOLA_LOG_JSON": "true",
            "SCATOLA_LOG_LEVEL": "debug",
            **settings,
        }
        with self.log.open("wb") as log:
            command = [sys.executable, "-m", "server.cli.main", "serve"]
            self.process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=log)
        eventually(self.ready, within_s=90, what="the service is ready")

    def ready(self) -> bool:
        try:
            return httpx.get(f"{self.url}/readyz", timeout=30).status_code == 200
        except httpx.TransportError:
            return False

    def lines(self) -> list[dict]:
        return [json.loads(line) for line in self.log.read_text().splitlines() if line.startswith("{")]

    def device(self) -> str:
        headers = {"Authorization": f"Bearer {ADMIN}"}
        return httpx.post(f"{self.url}/api/v1/devices", json={"name": "box"}, headers=headers, timeout=30).json()[
            "token"
        ]


@pytest.fixture
def serving(tmp_path):
    running = []

    def serve(**settings: str) -> Serving:
        running.append(Serving(tmp_path, **settings))
        return running[-1]

    yield serve
    for one in running:
        if one.process.poll() is None:
            one.process.kill()
        one.process.wait()


def test_an_upload_is_followed_through_log_trace_and_figures(serving, collector):
    endpoint, spans = collector
    service = serving(SCATOLA_OTLP_ENDPOINT=endpoint, OTEL_BSP_SCHEDULE_DELAY="200")
    token = service.device()
    headers = {"Authorization": f"Bearer {token}", "Idempotency-Key": "secret-boot/0", "X-Request-ID": "upload-1"}
    httpx.post(f"{service.url}/api/v1/batches", json=BATCH, headers=headers, timeout=30).raise_for_status()
    # What a log must not hold: tokens in every place where one may turn up, codes, cookies, a body.
    with httpx.Client(base_url=service.url, timeout=30) as browser:
        cookie = browser.post("/api/v1/auth/session", json={"code": ADMIN}).cookies["scatola_session"]
        browser.get("/login?code=a-secret-code&next=/")
        httpx.get(f"{service.url}/view3d/{'t' * 32}/{'0' * 32}/", timeout=30)
        browser.get(f"/api/v1/devices/{token}", headers={"Authorization": "Bearer wrong-secret-token"})

    def job() -> dict | None:
        found = [line for line in service.lines() if line["event"] == "job" and line.get("request_id") == "upload-1"]
        return found[0] if found else None

    line = eventually(job, within_s=120, what="the worker tells of the job")
    assert re.fullmatch("[0-9a-f]{32}", line["job_id"])
    assert line["batches"] == 1

    def one_trace() -> bool:
        uploads = [trace for _, name, trace, _ in spans if name == "POST /api/v1/batches"]
        return bool(uploads) and ("scatola-worker", "bring up to date", uploads[0]) in {each[:3] for each in spans}

    eventually(one_trace, within_s=60, what="one trace holds the upload and its job")
    (trace,) = {trace for _, name, trace, _ in spans if name == "POST /api/v1/batches"}
    names = {(service, name) for service, name, found, _ in spans if found == trace}
    assert {("scatola-api", name) for name in ("decode", "store blob", "commit row")} < names

    def counted() -> bool:
        figures = httpx.get(f"{service.url}/metrics", timeout=30).text
        return 'scatola_jobs_total{outcome="done",queue="devices"}' in figures and "scatola_due_batches 0.0" in figures

    eventually(counted, within_s=30, what="the API shows what the worker counted")
    figures = httpx.get(f"{service.url}/metrics", timeout=30).text
    assert "scatola_batch_readings_total 2.0" in figures
    assert 'scatola_job_batches_total{outcome="done"} 1.0' in figures
    told = service.log.read_text() + figures + "".join(text for *_, text in spans)
    for secret in (token, ADMIN, cookie, "a-secret-code", "t" * 32, "wrong-secret-token", "secret-boot", "-9.8"):
        assert secret not in told, secret


def test_it_drains_finishes_what_is_under_way_and_ends(serving):
    service = serving(SCATOLA_DRAIN_SECONDS="2")
    token = service.device()
    body = json.dumps(BATCH).encode()
    head = (
        f"POST /api/v1/batches HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {token}\r\nIdempotency-Key: b/0\r\n"
        f"Content-Type: application/json\r\nContent-Length: {len(body)}\r\n\r\n"
    )
    ended = threading.Event()

    def listen() -> None:
        headers = {"Authorization": f"Bearer {ADMIN}"}
        with httpx.stream("GET", f"{service.url}/api/v1/live", headers=headers, timeout=30) as stream:
            began.set()
            for _ in stream.iter_bytes():
                pass
        ended.set()

    began = threading.Event()
    threading.Thread(target=listen, daemon=True).start()
    assert began.wait(20)
    with socket.create_connection(("127.0.0.1", service.port), timeout=20) as upload:
        upload.sendall(head.encode() + body[:10])
        service.process.send_signal(signal.SIGTERM)
        asked = time.monotonic()
        answer = eventually(
            lambda: (found := httpx.get(f"{service.url}/readyz")).status_code == 503 and found,
            within_s=2,
            what="not ready while it drains",
        )
        assert answer.json()["failures"] == {"draining": "this process is about to end"}
        assert httpx.get(f"{service.url}/healthz").status_code == 200
        upload.sendall(body[10:])
        assert b" 202 " in upload.recv(65536).splitlines()[0]
    assert service.process.wait(15) == 0
    assert time.monotonic() - asked < 10.0
    assert ended.wait(5)
