"""The application: what it is made of, in which order, and what runs around every request."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from importlib import metadata

from anyio import CapacityLimiter
from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool

from server import description, health, problems, static_files
from server.accounts import routes as accounts
from server.accounts import user_routes as users
from server.accounts.audit import RecentLooks
from server.accounts.gate import AccessGate
from server.accounts.service import ensure_organisation
from server.alerts import routes as alerts
from server.analyses import routes as analyses
from server.bulk import routes as bulk
from server.contradictions import routes as contradictions
from server.database import Database
from server.devices import box_routes as boxes
from server.devices import routes as devices
from server.diagnosis import routes as diagnosis
from server.edge import Clock
from server.events import routes as events
from server.evidence import routes as evidence
from server.headers import SecurityHeaders
from server.ingest import routes as ingest
from server.installations import routes as installations
from server.limits import BodyLimit, NoNul, TokenBuckets
from server.live import routes as live
from server.migrations import serves
from server.moments import utc_now
from server.operations import routes as operations
from server.pages import accounts as account_pages
from server.pages import admin, admin_alerts, admin_boxes, admin_work, event_list, fleet_routes, how, templating
from server.pages import alerts as alert_pages
from server.pages import install_routes as install_pages
from server.pages import mounting_routes as mounting_pages
from server.pages import privacy as privacy_pages
from server.pages import routes as pages
from server.pages import trips as trip_pages
from server.pages import workbench as workbench_pages
from server.privacy import routes as privacy
from server.reports import routes as reports
from server.settings import Settings
from server.signals import routes as signals
from server.signals.thin import Memory
from server.statistics import routes as statistics
from server.store import open_store
from server.telemetry import RequestTelemetry, Telemetry, log
from server.trips import routes as trips
from server.vehicles import routes as vehicles
from server.view3d import proxy, replay, tickets

MAX_JSON_BYTES = 1024 * 1024
# Decoding is work for a core and holds a batch in memory several times over.
CONCURRENT_UPLOADS = 8


def _nobody_to_wake(device_id: str) -> None:
    """Stand-in until a supervisor or broker wants to know; the worker also looks by itself."""
    del device_id


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncGenerator[None]:
    def prepare() -> None:
        database: Database = app.state.database
        if not serves(database.engine):
            log.warning("the database is not migrated to this version")
            return
        with database.transaction() as session:
            ensure_organisation(session, now=app.state.clock())

    await run_in_threadpool(prepare)
    yield
    app.state.database.dispose()


def create_app(settings: Settings, *, clock: Clock = utc_now) -> FastAPI:
    """Application on the settings' database and store.

    Its `state` has `settings`, `database`, `store`, `clock`, and `wake` and `wake_burst`, which are called
    with the id of a device that became due, the latter by a burst, and may be replaced.
    """
    app = FastAPI(
        title="Scatola",
        version=metadata.version("scatola"),
        lifespan=_lifespan,
        docs_url=None,
        redoc_url=None,
        swagger_ui_oauth2_redirect_url=None,
        # The framework's own spans and records hold paths and queries, which carry tickets and codes; ours hold routes.
        telemetry={
            "tracing": False,
            "metrics": False,
            "logs": False,
            "operation_spans": False,
            "auto_configure": False,
        },
    )
    state = app.state
    state.settings = settings
    state.database = Database(settings)
    state.store = open_store(settings)
    state.clock = clock
    state.wake = state.wake_burst = _nobody_to_wake
    state.readiness = health.Readiness()
    state.telemetry = telemetry = Telemetry()
    state.recent_looks = RecentLooks()
    state.thinned = Memory()
    state.login_attempts = TokenBuckets(accounts.LOGIN_ATTEMPTS_PER_MINUTE)
    state.claim_attempts = TokenBuckets(boxes.CLAIMS_PER_MINUTE)
    state.uploads = TokenBuckets(settings.device_requests_per_minute)
    state.upload_slots = CapacityLimiter(CONCURRENT_UPLOADS)
    telemetry.watch(lambda: health.backlog_figures(app))

    problems.install(app)
    description.install(app)
    templating.install(app)
    for part in (
        ingest,  # first: routes are tried in this order, and no other is asked for as often
        health,
        accounts,
        users,
        devices,
        boxes,
        vehicles,
        installations,
        trips,
        events,
        reports,
        evidence,
        privacy,
        alerts,
        diagnosis,
        statistics,
        contradictions,
        live,
        signals,
        analyses,
        tickets,
        replay,
        operations,
        bulk,
        proxy,
        pages,
        event_list,
        mounting_pages,
        install_pages,
        fleet_routes,
        account_pages,
        privacy_pages,
        alert_pages,
        workbench_pages,
        trip_pages,
        how,
        admin,
        admin_boxes,
        admin_alerts,
        admin_work,
    ):
        app.include_router(part.router, responses=problems.described(401, 403, 404, 422))
    static_files.mount(app)

    # The last that is added is the outermost.
    app.add_middleware(
        BodyLimit,
        max_bytes=MAX_JSON_BYTES,
        except_paths=frozenset({ingest.PATH, analyses.PATH}),
        larger={workbench_pages.PATH: analyses.MAX_FILE_BYTES + MAX_JSON_BYTES},
    )
    app.add_middleware(NoNul, except_paths=frozenset({ingest.PATH, analyses.PATH}))
    app.add_middleware(AccessGate)
    app.add_middleware(SecurityHeaders, settings=settings)
    app.add_middleware(RequestTelemetry, telemetry=telemetry)
    return app
