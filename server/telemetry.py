"""Logs and figures: one line and one count per request, by route template and never by raw path.

A path may hold a view's ticket and a query a sign-in code, so neither is logged; nor are headers or bodies.
"""

from __future__ import annotations

import logging
import re
import sys
import time
import uuid
from collections.abc import Callable, Iterable

import structlog
from prometheus_client import CollectorRegistry, Counter, Histogram
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector
from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.problems import InternalProblemError, problem_response

_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})

log = structlog.stdlib.get_logger("scatola")


def configure_logging(*, as_json: bool, level: str = "info") -> None:
    """One line per event on standard error, of our own and of the libraries that use `logging`."""
    shared: list[structlog.typing.Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    render: structlog.typing.Processor = (
        structlog.processors.JSONRenderer()
        if as_json
        else structlog.dev.ConsoleRenderer(
            colors=sys.stderr.isatty(), exception_formatter=structlog.dev.plain_traceback
        )
    )
    tail: list[structlog.typing.Processor] = [structlog.processors.format_exc_info] if as_json else []
    structlog.configure(
        processors=[*shared, structlog.stdlib.ProcessorFormatter.wrap_for_formatter],
        wrapper_class=structlog.stdlib.BoundLogger,
        logger_factory=structlog.stdlib.LoggerFactory(),
        cache_logger_on_first_use=True,
    )
    formatter = structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=shared,
        processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *tail, render],
    )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(formatter)
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(level.upper())
    # Libraries that tell every step of theirs at the level at which we tell of a request.
    for name in ("alembic", "uvicorn", "httpx", "dramatiq", "pika", "websockets"):
        logging.getLogger(name).setLevel(logging.WARNING)


class Backlog(Collector):
    """Gauges that are asked for when they are scraped."""

    def __init__(self, ask: Callable[[], dict[str, tuple[str, float]]]) -> None:
        self._ask = ask

    def describe(self) -> Iterable[Metric]:
        return ()

    def collect(self) -> Iterable[Metric]:
        for name, (text, value) in self._ask().items():
            yield GaugeMetricFamily(name, text, value=value)


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

    def watch(self, ask: Callable[[], dict[str, tuple[str, float]]]) -> None:
        """Add gauges: name to what it is and its value."""
        self.registry.register(Backlog(ask))


def route_template(scope: Scope) -> str:
    """The route's path with its parameters' names; one word for all that matched none."""
    path = getattr(scope.get("route"), "path", None)
    if isinstance(path, str) and path:
        return path
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
        request_id = given if _REQUEST_ID.fullmatch(given) else uuid.uuid4().hex
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
            await self._app(scope, receive, observed)
        except Exception:
            log.exception("request failed", route=route_template(scope))
            if status:
                raise  # an answer is under way: only cutting it off tells the client
            await problem_response(InternalProblemError(f"Request {request_id} failed"), connection)(
                scope, receive, observed
            )
        finally:
            self._count(scope, status, time.perf_counter() - began)

    def _count(self, scope: Scope, status: int, seconds: float) -> None:
        method = scope["method"] if scope["method"] in _METHODS else "other"
        route = route_template(scope)
        self._telemetry.requests.labels(method, route, str(status)).inc()
        self._telemetry.seconds.labels(method, route).observe(seconds)
        log.info("request", method=method, route=route, status=status, ms=round(seconds * 1e3, 1))
