"""Is the process alive, can it serve, and how is it doing; and the list of the API's routes."""

from __future__ import annotations

import datetime as dt
import html
import threading
from typing import cast

from fastapi import APIRouter, FastAPI, Request
from prometheus_client import generate_latest
from prometheus_client.exposition import CONTENT_TYPE_LATEST
from sqlalchemy.exc import SQLAlchemyError
from starlette.responses import HTMLResponse, JSONResponse, Response

from server.alerts.queries import deliveries_in
from server.database import Database
from server.edge import DatabaseOf, Now, StoreOf
from server.ingest import queries
from server.migrations import is_current
from server.store import BlobStore
from server.telemetry import Telemetry

router = APIRouter(include_in_schema=False)

_LOOKS = ["GET", "HEAD"]

# Anybody may ask, and each look writes to the store: one look serves all who ask within this time.
_READINESS_LIFE = dt.timedelta(seconds=5)


class Readiness:
    """What keeps this process from serving, looked at again when the last look is old."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._at: dt.datetime | None = None
        self._failures: dict[str, str] = {}

    def failures(self, database: Database, store: BlobStore, now: dt.datetime) -> dict[str, str]:
        """Name of each part that is not ready, and why."""
        with self._lock:
            if self._at is None or self._failures or not self._at <= now < self._at + _READINESS_LIFE:
                self._failures = _look(database, store)
                self._at = now
            return self._failures


def _look(database: Database, store: BlobStore) -> dict[str, str]:
    failures: dict[str, str] = {}
    try:
        database.ping()
        if not is_current(database.engine):
            failures["migrations"] = "the database is not migrated to this version: run `scatola migrate`"
    except SQLAlchemyError as error:
        failures["database"] = f"does not answer ({type(error).__name__})"
    try:
        store.check()
    except OSError as error:
        failures["store"] = f"cannot be written ({type(error).__name__})"
    return failures


@router.api_route("/healthz", methods=_LOOKS)
async def healthz() -> dict[str, str]:
    """The process is alive."""
    return {"status": "ok"}


@router.api_route("/readyz", methods=_LOOKS)
def readyz(request: Request, database: DatabaseOf, store: StoreOf, now: Now) -> JSONResponse:
    """Database, schema and store can serve; names what cannot."""
    readiness = cast("Readiness", request.app.state.readiness)
    failures = readiness.failures(database, store, now)
    content = {"status": "not ready" if failures else "ok", "failures": failures}
    return JSONResponse(content, 503 if failures else 200)


@router.get("/metrics")
def metrics(request: Request) -> Response:
    """Figures for Prometheus."""
    telemetry = cast("Telemetry", request.app.state.telemetry)
    return Response(generate_latest(telemetry.registry), headers={"Content-Type": CONTENT_TYPE_LATEST})


def backlog_figures(app: FastAPI) -> dict[str, tuple[str, float]]:
    """Gauges of what is due."""
    database = cast("Database", app.state.database)
    now = cast("dt.datetime", app.state.clock())
    with database.reading() as session:
        due = queries.backlog(session)
        waiting, dead = (deliveries_in(session, state) for state in ("waiting", "dead"))
    oldest_s = 0.0 if due.oldest_at is None else max(0.0, (now - due.oldest_at).total_seconds())
    return {
        "scatola_due_batches": ("Batches not worked off yet", float(due.batches)),
        "scatola_due_devices": ("Devices with such batches", float(due.devices)),
        "scatola_alert_deliveries_waiting": ("Alert messages that are owed", float(waiting)),
        "scatola_alert_deliveries_dead": ("Alert messages that were given up", float(dead)),
        "scatola_due_oldest_seconds": ("Age of the oldest of them", oldest_s),
    }


@router.get("/docs")
def docs(request: Request) -> HTMLResponse:
    """The routes in words; no script, and nothing from another host."""
    schema = cast("FastAPI", request.app).openapi()
    rows = [
        f"<tr><td><code>{html.escape(method.upper())}</code></td><td><code>{html.escape(path)}</code></td>"
        f"<td>{html.escape(str(operation.get('description') or operation.get('summary') or ''))}</td></tr>"
        for path, operations in sorted(schema["paths"].items())
        for method, operation in operations.items()
    ]
    return HTMLResponse(
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>Scatola API</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1"><h1>Scatola API</h1>'
        '<p>The machine-readable description is <a href="/openapi.json">openapi.json</a>.</p>'
        "<table><thead><tr><th>Method</th><th>Path</th><th>What it does</th></tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table></html>"
    )
