"""What tests share.

A test runs on SQLite unless it is marked ``both_databases``; then it also runs on a PostgreSQL on
loopback, in a database of its own that is dropped at the end.  The service is always real: uvicorn
in a thread on a free port, spoken to over HTTP.
"""

from __future__ import annotations

import contextlib
import datetime as dt
import logging
import os
import shutil
import threading
import time
import uuid
from collections.abc import Callable, Generator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings as hypothesis_settings

# A property holds or not; how long an example takes on a busy machine is another matter.
hypothesis_settings.register_profile("scatola", deadline=None)
hypothesis_settings.load_profile("scatola")

# The service is imported by the fixtures that need it: the tests of nav_core need none of it.
if TYPE_CHECKING:
    import httpx
    from fastapi import FastAPI

    from server.database import Database
    from server.models import Organisation
    from server.settings import Settings

ADMIN_TOKEN = "test-administrator"
POSTGRES = "postgresql+psycopg://root@127.0.0.1:5432"
REQUIRE_SERVICES = os.environ.get("SCATOLA_TEST_REQUIRE_SERVICES") == "1"

Serve = Callable[["FastAPI"], str]
MakeDevice = Callable[..., tuple[str, str]]


def pytest_configure(config):
    config.addinivalue_line("markers", "both_databases: runs on SQLite and on PostgreSQL")


def pytest_generate_tests(metafunc):
    if metafunc.definition.get_closest_marker("both_databases") and "dialect" in metafunc.fixturenames:
        postgres = pytest.param("postgresql", marks=pytest.mark.postgres)
        metafunc.parametrize("dialect", ["sqlite", postgres], indirect=True)


def missing_service(reason: str):
    """Skip, or fail where services are required."""
    if REQUIRE_SERVICES:
        pytest.fail(reason)
    pytest.skip(reason)


class TestClock:
    """A clock that stands still until it is told to move on."""

    __test__ = False

    def __init__(self) -> None:
        self.now = dt.datetime(2026, 3, 1, 12, 0, tzinfo=dt.UTC)

    def __call__(self) -> dt.datetime:
        return self.now

    def advance(self, **by: float) -> None:
        self.now += dt.timedelta(**by)


@pytest.fixture(scope="session")
def sqlite_template(tmp_path_factory) -> Path:
    """A migrated database to copy: migrating anew for each test would take most of its time."""
    from server.migrations import upgrade
    from server.settings import Settings

    folder = tmp_path_factory.mktemp("template")
    upgrade(Settings(data_dir=folder, database_url=None))
    return folder / "scatola.sqlite3"


@pytest.fixture(scope="session")
def postgres_url() -> Generator[str]:
    """URL of a migrated throw-away database."""
    import sqlalchemy as sa
    from sqlalchemy.exc import OperationalError

    from server.migrations import upgrade
    from server.settings import Settings

    name = f"scatola_test_{uuid.uuid4().hex[:12]}"
    server = sa.create_engine(f"{POSTGRES}/postgres", isolation_level="AUTOCOMMIT")
    try:
        with server.connect() as connection:
            connection.execute(sa.text(f'CREATE DATABASE "{name}"'))
    except OperationalError as error:
        server.dispose()
        missing_service(f"no PostgreSQL at 127.0.0.1:5432: {str(error.orig).splitlines()[0]}")
    try:
        url = f"{POSTGRES}/{name}"
        upgrade(Settings(database_url=url))
        yield url
    finally:
        with server.connect() as connection:
            connection.execute(sa.text(f'DROP DATABASE "{name}" WITH (FORCE)'))
        server.dispose()


@pytest.fixture
def dialect(request) -> str:
    return getattr(request, "param", "sqlite")


@pytest.fixture
def settings(request, tmp_path, monkeypatch, dialect) -> Settings:
    """Settings of an installation of its own, whatever the environment says."""
    from server.settings import Settings

    for name in list(os.environ):
        if name.startswith("SCATOLA_") and not name.startswith("SCATOLA_TEST_"):
            monkeypatch.delenv(name)
    folder = tmp_path / "data"
    folder.mkdir()
    if dialect == "postgresql":
        url = request.getfixturevalue("postgres_url")
        return Settings(data_dir=folder, database_url=url, admin_token=ADMIN_TOKEN)
    shutil.copy(request.getfixturevalue("sqlite_template"), folder / "scatola.sqlite3")
    return Settings(data_dir=folder, admin_token=ADMIN_TOKEN)


@pytest.fixture
def database(settings, dialect) -> Generator[Database]:
    """The settings' database, empty and migrated."""
    import sqlalchemy as sa

    from server.database import Database
    from server.models import Base

    def empty() -> None:
        with database.transaction() as session:
            session.execute(sa.text("SET LOCAL scatola.audit_retention = 'on'"))
            for table in reversed(Base.metadata.sorted_tables):  # TRUNCATE takes half a second
                session.execute(table.delete())

    database = Database(settings)
    if dialect == "postgresql":
        with database.reading() as session:
            left = session.scalar(sa.text("SELECT EXISTS (SELECT FROM organisation)"))
        if left:  # by a process of the test before, which ended after its database was emptied
            empty()
    yield database
    if dialect == "postgresql":
        empty()
    database.dispose()


@pytest.fixture
def clock() -> TestClock:
    return TestClock()


@pytest.fixture
def app(settings, database, clock) -> FastAPI:
    """The application; not started."""
    import structlog

    from server.app import create_app

    # The service logs from its own thread, past pytest's capture.
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    del database  # emptied after the app is gone
    return create_app(settings, clock=clock)


@pytest.fixture
def serve() -> Generator[Serve]:
    """Serve an application on a free loopback port until the test ends; gives its address."""
    with contextlib.ExitStack() as running:
        yield lambda app: running.enter_context(_served(app))


@contextlib.contextmanager
def _served(app: FastAPI) -> Generator[str]:
    import uvicorn

    from server.patience import PatientProtocol

    server = uvicorn.Server(
        uvicorn.Config(
            app,
            host="127.0.0.1",
            port=0,
            http=PatientProtocol,
            log_config=None,
            access_log=False,
            lifespan="on",
            timeout_graceful_shutdown=1,
        )
    )
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    deadline = time.monotonic() + 10.0
    while not server.started:
        if not thread.is_alive() or time.monotonic() > deadline:
            pytest.fail("the service did not start")
        time.sleep(0.002)
    try:
        port = server.servers[0].sockets[0].getsockname()[1]
        yield f"http://127.0.0.1:{port}"
    finally:
        server.should_exit = True
        thread.join(10.0)


@pytest.fixture
def address(app, serve) -> str:
    """Address of the served application."""
    return serve(app)


@pytest.fixture
def client(address) -> Generator[httpx.Client]:
    """A client without credentials; it follows no redirects."""
    import httpx

    with httpx.Client(base_url=address, timeout=30.0) as client:
        yield client


@pytest.fixture
def admin(address) -> Generator[httpx.Client]:
    """A client with the administrator's token."""
    import httpx

    headers = {"Authorization": f"Bearer {ADMIN_TOKEN}"}
    with httpx.Client(base_url=address, headers=headers, timeout=30.0) as client:
        yield client


@pytest.fixture
def organisation(database, clock) -> Organisation:
    """The default organisation, also without a running service."""
    from server.accounts.service import ensure_organisation

    with database.transaction() as session:
        return ensure_organisation(session, now=clock())


@pytest.fixture
def make_device(admin) -> MakeDevice:
    """Register a box over HTTP: ``make_device() -> (id, token)``."""

    def make(client: httpx.Client | None = None, *, name: str = "box", vehicle_id: str | None = None):
        answer = (client or admin).post("/api/v1/devices", json={"name": name, "vehicle_id": vehicle_id})
        assert answer.status_code == 201, answer.text
        return answer.json()["id"], answer.json()["token"]

    return make
