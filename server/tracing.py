"""Traces from the upload through the job's message to the worker, and the ids that log lines share.

What a job must know of the request that caused it travels with its message as two short words: `request_id`,
and W3C's `traceparent`.  Spans go nowhere unless an endpoint is set; the SDK and its exporter are the extra
`tracing` (ADR 0024), and nothing of them is imported without an endpoint.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager

import structlog
from opentelemetry import trace
from opentelemetry.trace import Span, SpanKind, Status, StatusCode
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

from server.settings import Settings

Carried = dict[str, str]
"""`request_id` and `traceparent`, those that are known."""

REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
_TRACEPARENT = re.compile(r"[0-9a-f]{2}-[0-9a-f]{32}-[0-9a-f]{16}-[0-9a-f]{2}")
_propagator = TraceContextTextMapPropagator()
# Gives spans that record nothing until a provider is set.
tracer = trace.get_tracer("scatola")


def configure_tracing(settings: Settings, role: str) -> Callable[[], None]:
    """Send spans to the settings' endpoint, if there is one; gives what flushes them at the end."""
    if not settings.otlp_endpoint:
        return lambda: None
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.resources import Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
    except ModuleNotFoundError as error:
        raise ValueError("SCATOLA_OTLP_ENDPOINT is set, but scatola[tracing] is not installed") from error
    provider = TracerProvider(resource=Resource.create({"service.name": f"scatola-{role}"}))
    # A collector that is down must hold up nothing: spans wait in a bounded queue and are dropped from it.
    exporter = OTLPSpanExporter(settings.otlp_endpoint.rstrip("/") + "/v1/traces", timeout=2)
    provider.add_span_processor(BatchSpanProcessor(exporter))
    trace.set_tracer_provider(provider)
    return provider.shutdown


def carried() -> Carried:
    """What a job is to know of this request."""
    words: Carried = {}
    _propagator.inject(words)
    words.pop("tracestate", None)
    request_id = structlog.contextvars.get_contextvars().get("request_id")
    return words | {"request_id": request_id} if isinstance(request_id, str) else words


def known(words: Mapping[str, object]) -> Carried:
    """The words of a message that have their form; another process wrote it."""
    forms = {"request_id": REQUEST_ID, "traceparent": _TRACEPARENT}
    found = {name: words.get(name) for name in forms}
    return {name: word for name, word in found.items() if isinstance(word, str) and forms[name].fullmatch(word)}


@contextmanager
def request_span(headers: Mapping[str, str], method: str) -> Generator[Span]:
    """A span around a request, below the caller's where it named one."""
    parent = _propagator.extract(known(headers))
    with tracer.start_as_current_span(
        method,
        context=parent,
        kind=SpanKind.SERVER,
        attributes={"http.request.method": method},
        record_exception=False,  # its text may hold what a caller sent
    ) as span:
        yield span


@contextmanager
def job_span(name: str, words: Carried, *, job_id: str, device_id: str, queue: str) -> Generator[Span]:
    """A span around a job and the ids in its log lines, below the request that caused it."""
    parent = _propagator.extract(words)
    ids = {"job_id": job_id, "device_id": device_id}
    with (
        structlog.contextvars.bound_contextvars(**ids, **{k: v for k, v in words.items() if k == "request_id"}),
        tracer.start_as_current_span(
            name,
            context=parent,
            kind=SpanKind.CONSUMER,
            record_exception=False,
            attributes={"scatola.job_id": job_id, "scatola.device_id": device_id, "scatola.queue": queue},
        ) as span,
    ):
        yield span


def failed(span: Span, what: str) -> None:
    """Mark a span as failed; the words are ours and hold nothing that a caller sent."""
    span.set_status(Status(StatusCode.ERROR, what))
