"""What is told of requests: one line and one count per request, by route template and never by raw path.

A path may hold a view's ticket and a query a sign-in code, so neither is logged; nor are headers or bodies.
"""

from __future__ import annotations

import math
import os
import threading
import time
import uuid
from collections.abc import Callable, Iterable

import structlog
from prometheus_client import CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.multiprocess import MultiProcessCollector
from prometheus_client.registry import Collector
from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.accounts.gate import DEVICE_PATHS
from server.problems import InternalProblemError, problem_response
from server.tracing import REQUEST_ID, failed, request_span
from server.troubles import trouble_of

Gauges = dict[str, tuple[str, float | dict[str, float]]]
"""Name to what it is and its value, or its value by queue."""

_UNTRACED = ("/healthz", "/readyz", "/metrics", "/static")
_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})

GAUGES_LIFE_S = 2.0

log = structlog.stdlib.get_logger("scatola")


class Backlog(Collector):
    """Gauges that are asked for when they are scraped, but not of every one of many who ask at once."""

    def __init__(self, ask: Callable[[], Gauges]) -> None:
        self._ask = ask
        self._lock = threading.Lock()
        self._asked: float = -math.inf
        self._found: Gauges = {}

    def describe(self) -> Iterable[Metric]:
        return ()

    def collect(self) -> Iterable[Metric]:
        with self._lock:
            if time.monotonic() - self._asked > GAUGES_LIFE_S:
                self._found = self._ask()
                self._asked = time.monotonic()
            found = self._found
        for name, (text, value) in found.items():
            if not isinstance(value, dict):
                yield GaugeMetricFamily(name, text, value=value)
                continue
            family = GaugeMetricFamily(name, text, labels=("queue",))
            for queue, count in value.items():
                family.add_metric((queue,), count)
            yield family


class Telemetry:
    """The figures of one application; each has a registry of its own, so that tests can run several."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        by_route = ("method", "route", "status")
        self.requests = Counter("scatola_requests", "Requests", by_route, registry=self.registry)
        self.seconds = Histogram(
            "scatola_request_seconds", "Time to answer", ("method", "route"), registry=self.registry
        )
        self.batches = Counter(
            "scatola_batches", "Batches by what became of them", ("outcome",), registry=self.registry
        )
        self.batch_bytes = Counter("scatola_batch_bytes", "Bytes of accepted batches as sent", registry=self.registry)
        self.batch_rows = Counter("scatola_batch_rows", "Rows of accepted batches", registry=self.registry)
        self.batch_readings = Counter(
            "scatola_batch_readings", "Three-axis accelerometer readings of accepted batches", registry=self.registry
        )
        self._gauges = CollectorRegistry()

    def watch(self, ask: Callable[[], Gauges]) -> None:
        """Add gauges."""
        self._gauges.register(Backlog(ask))

    def render(self) -> bytes:
        """The figures as Prometheus reads them: of all processes that count together, where several do."""
        figures = self.registry
        if os.environ.get("PROMETHEUS_MULTIPROC_DIR"):
            figures = CollectorRegistry()
            MultiProcessCollector(figures)
        return generate_latest(figures) + generate_latest(self._gauges)


def route_template(scope: Scope) -> str:
    """The route's path with its parameters' names; one word for all that matched none."""
    path = getattr(scope.get("route"), "path", None)
    if isinstance(path, str) and path:
        return path
    if scope["path"] in DEVICE_PATHS:
        return str(scope["path"])  # refused before it was matched: a box with a wrong token must show
    for root in ("/static", "/view3d"):
        if scope["path"].startswith(root + "/"):
            return root
    return "unmatched"


class RequestTelemetry:
    """Outermost of the middleware: gives the request its id, times and counts it, and catches what fell through."""

    def __init__(self, app: ASGIApp, *, telemetry: Telemetry) -> None:
        self._app = app
        self._telemetry = telemetry

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        connection = HTTPConnection(scope)
        given = connection.headers.get("x-request-id", "")
        request_id = given if REQUEST_ID.fullmatch(given) else uuid.uuid4().hex
        began = time.perf_counter()
        status = 0

        async def observed(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                MutableHeaders(scope=message)["X-Request-ID"] = request_id
            await send(message)

        structlog.contextvars.clear_contextvars()
        structlog.contextvars.bind_contextvars(request_id=request_id)
        try:
            if scope["path"].startswith(_UNTRACED):
                await self._app(scope, receive, observed)
            else:
                await self._traced(scope, receive, observed, lambda: status)
        except Exception as error:
            trouble = trouble_of(error)
            if trouble is None:
                log.exception("request failed", route=route_template(scope))
            else:
                log.error("request failed", route=route_template(scope), code=trouble.code, error=str(error)[:500])  # noqa: TRY400  an operator mends it: no traceback
            if status:
                raise  # an answer is under way: only cutting it off tells the client
            problem = trouble or InternalProblemError(f"Request {request_id} failed")
            await problem_response(problem, connection)(scope, receive, observed)
        finally:
            self._count(scope, status, time.perf_counter() - began)

    async def _traced(self, scope: Scope, receive: Receive, send: Send, status: Callable[[], int]) -> None:
        method = scope["method"] if scope["method"] in _METHODS else "other"
        with request_span(HTTPConnection(scope).headers, method) as span:
            try:
                await self._app(scope, receive, send)
            finally:
                route = route_template(scope)
                span.update_name(f"{method} {route}")
                span.set_attributes({"http.route": route, "http.response.status_code": status()})
                if status() >= 500:
                    failed(span, f"status {status()}")

    def _count(self, scope: Scope, status: int, seconds: float) -> None:
        method = scope["method"] if scope["method"] in _METHODS else "other"
        route = route_template(scope)
        self._telemetry.requests.labels(method, route, str(status)).inc()
        self._telemetry.seconds.labels(method, route).observe(seconds)
        log.info("request", method=method, route=route, status=status, ms=round(seconds * 1e3, 1))
