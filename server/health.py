"""Is the process alive, can it serve, and how is it doing; and the list of the API's routes."""

from __future__ import annotations

import datetime as dt
import html
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

from fastapi import APIRouter, FastAPI, Request
from prometheus_client.exposition import CONTENT_TYPE_LATEST
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.pool import QueuePool
from starlette.responses import HTMLResponse, JSONResponse, Response

from server.alerts.queries import deliveries_in
from server.database import Database
from server.edge import DatabaseOf, Now, StoreOf
from server.ingest import queries
from server.migrations import serves
from server.store import BlobStore
from server.telemetry import Gauges, Telemetry

router = APIRouter(include_in_schema=False)

_LOOKS = ["GET", "HEAD"]

# Anybody may ask, and each look writes to the store: one look serves all who ask within this time.
_READINESS_LIFE = dt.timedelta(seconds=5)


@dataclass(frozen=True, slots=True)
class Check:
    """One part: why it fails, if it does, and whether the service can do without."""

    failure: str | None
    needed: bool = True


class Readiness:
    """What keeps this process from serving, looked at again when the last look is old."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._at: dt.datetime | None = None
        self._checks: dict[str, Check] = {}
        self.draining = False
        """Whether the process is about to end: it serves what comes, but should be sent no more."""
        self.helpers: dict[str, Callable[[], str | None]] = {}
        """Parts without which uploads are still taken, by name; each says why it fails."""

    def checks(self, database: Database, store: BlobStore, now: dt.datetime) -> dict[str, Check]:
        """Each part by its name."""
        with self._lock:
            failed = any(check.failure for check in self._checks.values())
            if self._at is None or failed or not self._at <= now < self._at + _READINESS_LIFE:
                self._checks = _look(database, store)
                self._checks |= {name: Check(ask(), needed=False) for name, ask in self.helpers.items()}
                self._at = now
            return {"draining": Check("this process is about to end" if self.draining else None), **self._checks}


def _look(database: Database, store: BlobStore) -> dict[str, Check]:
    found: dict[str, Check] = {name: Check(None) for name in ("database", "migrations", "store")}
    try:
        database.ping()
        if not serves(database.engine):
            found["migrations"] = Check("the database is not migrated to this version: run `scatola migrate`")
    except SQLAlchemyError as error:
        found["database"] = Check(f"does not answer ({type(error).__name__})")
    try:
        store.check()
    except OSError as error:
        found["store"] = Check(f"cannot be written ({type(error).__name__})")
    return found


@router.api_route("/healthz", methods=_LOOKS)
async def healthz() -> dict[str, str]:
    """The process is alive."""
    return {"status": "ok"}


@router.api_route("/readyz", methods=_LOOKS)
def readyz(request: Request, database: DatabaseOf, store: StoreOf, now: Now, *, every: bool = False) -> JSONResponse:
    """Database, schema and store can serve; names what cannot.

    Without worker or broker uploads are still taken and worked off later: that is `degraded`, and 503 only for who
    asks with `?every=true`.
    """
    checks = cast("Readiness", request.app.state.readiness).checks(database, store, now)
    failing = {name: check for name, check in checks.items() if check.failure is not None}
    refuses = any(check.needed for check in failing.values())
    content = {
        "status": "not ready" if refuses else "degraded" if failing else "ok",
        "failures": {name: check.failure for name, check in failing.items()},
        "checks": {name: check.failure is None for name, check in checks.items()},
    }
    return JSONResponse(content, 503 if refuses or (every and failing) else 200)


@router.get("/metrics")
def metrics(request: Request) -> Response:
    """Figures for Prometheus."""
    telemetry = cast("Telemetry", request.app.state.telemetry)
    return Response(telemetry.render(), headers={"Content-Type": CONTENT_TYPE_LATEST})


def backlog_figures(app: FastAPI) -> Gauges:
    """Gauges of what is due, what fails, and the connections to the database."""
    database = cast("Database", app.state.database)
    figures: Gauges = dict(_pool(database))
    try:
        figures |= _due(database, cast("dt.datetime", app.state.clock()))
    except SQLAlchemyError:
        # Figures of this process are shown all the same: just then somebody looks at them.
        return {"scatola_database_up": ("Whether the database answers", 0.0), **figures}
    depths = cast("Callable[[], dict[str, float] | None] | None", getattr(app.state, "queue_depths", None))
    found = None if depths is None else depths()
    if found is not None:
        figures["scatola_queue_messages"] = ("Messages in the broker, .DQ awaits a retry, .XQ is dead", found)
    return {"scatola_database_up": ("Whether the database answers", 1.0), **figures}


def _due(database: Database, now: dt.datetime) -> Gauges:
    with database.reading() as session:
        due = queries.backlog(session)
        waiting, given_up = (deliveries_in(session, state) for state in ("waiting", "dead"))
        failing, dead = queries.failing(session)
    oldest_s = 0.0 if due.oldest_at is None else max(0.0, (now - due.oldest_at).total_seconds())
    return {
        "scatola_due_batches": ("Batches not worked off yet", float(due.batches)),
        "scatola_due_devices": ("Devices with such batches", float(due.devices)),
        "scatola_alert_deliveries_waiting": ("Alert messages that are owed", float(waiting)),
        "scatola_alert_deliveries_dead": ("Alert messages that were given up", float(given_up)),
        "scatola_due_oldest_seconds": ("Age of the oldest of them", oldest_s),
        "scatola_failing_devices": ("Devices whose work failed last time", float(failing)),
        "scatola_dead_letters": ("Devices whose work keeps failing", float(dead)),
    }


def _pool(database: Database) -> Gauges:
    pool = database.engine.pool
    if not isinstance(pool, QueuePool):
        return {}
    return {
        "scatola_database_connections": ("Connections of this process to the database", float(pool.size())),
        "scatola_database_connections_used": ("Those in use", float(pool.checkedout())),
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
