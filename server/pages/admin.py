"""The administration's first page: what needs attention, how the service is, which versions run."""

from __future__ import annotations

import datetime as dt
import shutil
from dataclasses import dataclass
from importlib import metadata
from typing import cast

from fastapi import APIRouter, Request
from sqlalchemy import ColumnElement, func, select
from sqlalchemy.orm import Session
from starlette.responses import HTMLResponse

from server.accounts import audit
from server.accounts.access import Administrator, Caller
from server.edge import DatabaseOf, Now, SettingsOf, StoreOf
from server.health import Readiness
from server.ingest.queries import backlog, failing
from server.jobs.rerun import ALGORITHM
from server.migrations import head
from server.models import AlertDelivery, Device, Event, EventRevision
from server.pages import queries
from server.pages.audit_words import DEEDS
from server.pages.routes import answer
from server.pages.words import SILENT_AFTER, State
from server.settings import Settings
from server.wording import marked

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)

OLD_WORK = dt.timedelta(minutes=15)
LOW_DISK_BYTES = 2e9
LATEST = 8
CHECKS = {
    "database": marked("Database"),
    "migrations": marked("Schema"),
    "store": marked("Store"),
    "worker": marked("Worker"),
    "broker": marked("Broker"),
    "viewer": marked("3D viewer"),
}


@dataclass(frozen=True)
class Matter:
    """Something that an administrator looks after: a number, and where to see more."""

    words: str
    number: int
    href: str
    state: State
    """As it stands with this number."""
    more: str | None = None
    """A text with `%(n)s`."""
    n: str = ""


def _matter(words: str, number: int, href: str, bad: State, more: str | None = None, n: object = "") -> Matter:
    return Matter(words, number, href, bad if number else "good", more, str(n))


def matters(session: Session, caller: Caller, settings: Settings, now: dt.datetime) -> list[Matter]:
    """What needs attention; what the caller may do nothing about is left out."""
    organisation_id = caller.organisation_id
    found: list[Matter] = []
    if caller.may("jobs.manage"):
        boxes, dead = failing(session)
        due = backlog(session)
        late = due.oldest_at is not None and now - due.oldest_at > OLD_WORK
        old = outdated(session, organisation_id)
        found += [
            _matter(
                marked("Dead letters"),
                dead,
                "/admin/work",
                "alarm",
                marked("%(n)s more failed last time and are tried again") if boxes > dead else None,
                boxes - dead,
            ),
            Matter(marked("Uploads waiting"), due.batches, "/admin/work", "attention" if late else "good"),
            _matter(marked("Events by an older version"), old, "/admin/versions", "unknown"),
        ]
    deliveries = select(func.count()).select_from(AlertDelivery).where(AlertDelivery.organisation_id == organisation_id)
    given_up, waiting = (
        session.scalar(deliveries.where(AlertDelivery.state == state)) or 0 for state in ("dead", "waiting")
    )
    found.append(
        _matter(
            marked("Alerts not delivered"),
            given_up,
            "/alerts#dead",
            "alarm",
            marked("%(n)s more are on their way") if waiting else None,
            waiting,
        )
    )
    in_use = select(func.count()).select_from(Device).where(Device.revoked_at.is_(None))
    in_use = in_use.where(Device.organisation_id == organisation_id)
    never = session.scalar(in_use.where(Device.last_seen_at.is_(None))) or 0
    silent = session.scalar(in_use.where(Device.last_seen_at < now - SILENT_AFTER)) or 0
    full = session.scalar(in_use.where(*over_quota(settings, now))) or 0
    return [
        *found,
        _matter(marked("Boxes silent for a day"), silent, "/admin/boxes?show=silent", "attention"),
        _matter(marked("Boxes never heard of"), never, "/admin/boxes?show=new", "unknown"),
        _matter(marked("Boxes over today's quota"), full, "/admin/boxes?show=full", "attention"),
    ]


def over_quota(settings: Settings, now: dt.datetime) -> tuple[ColumnElement[bool], ...]:
    """Conditions for boxes that may send no more today."""
    allowed = func.coalesce(Device.bytes_per_day, settings.device_bytes_per_day)
    return Device.quota_day == now.astimezone(dt.UTC).date(), Device.quota_bytes >= allowed


def outdated(session: Session, organisation_id: str) -> int:
    """Severe events whose newest revision another version computed."""
    query = (
        select(func.count())
        .select_from(Event)
        .join(EventRevision, (EventRevision.event_id == Event.id) & (EventRevision.number == Event.revision))
        .where(Event.organisation_id == organisation_id, Event.severe, EventRevision.algorithm != ALGORITHM)
        .where(Event.withdrawn_at.is_(None), Event.erased_at.is_(None), Event.raw_erased_at.is_(None))
    )
    return session.scalar(query) or 0


@dataclass(frozen=True)
class Storage:
    """How much is kept."""

    boxes: int
    revoked: int
    uploads: int
    """Ever taken: the length of all chains."""
    bytes_today: int
    free_bytes: int | None
    """Of the data folder's disk, where data are there."""
    total_bytes: int | None

    @property
    def low(self) -> bool:
        return self.free_bytes is not None and self.free_bytes < LOW_DISK_BYTES


def storage(session: Session, caller: Caller, settings: Settings, now: dt.datetime) -> Storage:
    """Counted from the boxes' own rows: the uploads themselves are too many to be counted for a page."""
    own = Device.organisation_id == caller.organisation_id
    boxes, revoked, uploads = session.execute(
        select(func.count(), func.count(Device.revoked_at), func.coalesce(func.sum(Device.chain_length), 0)).where(own)
    ).one()
    today = Device.quota_day == now.astimezone(dt.UTC).date()
    taken = session.scalar(select(func.sum(Device.quota_bytes)).where(own, today)) or 0
    free = total = None
    if caller.may("jobs.manage") and settings.blob_url is None and settings.data_dir.exists():
        disk = shutil.disk_usage(settings.data_dir)
        free, total = disk.free, disk.total
    return Storage(boxes - revoked, revoked, uploads, int(taken), free, total)


@router.get("/admin")
def overview(
    request: Request, caller: Administrator, settings: SettingsOf, database: DatabaseOf, store: StoreOf, now: Now
) -> HTMLResponse:
    """What needs attention."""
    readiness = cast("Readiness", request.app.state.readiness)
    with database.reading() as session:
        change = queries.last_change(session, caller.organisation_id)
        context = {
            "matters": matters(session, caller, settings, now),
            "storage": storage(session, caller, settings, now),
            "latest": audit.entries(
                session, caller.organisation_id, before=None, action=None, looks=False, limit=LATEST
            )
            if caller.may("audit.read")
            else [],
            "deeds": DEEDS,
        }
    checks = readiness.checks(request.app.state.database, store, now)
    ending = checks.pop("draining")
    context |= {
        "checks": [(CHECKS.get(name, name), check) for name, check in checks.items()],
        "ending": ending.failure,
        "software": metadata.version("scatola"),
        "schema": head(),
        "algorithm": ALGORITHM,
    }
    return answer(request, "admin.html", caller, "admin", change, context)
